"""One contact: the velocity of its point and its impulse as a term of the sweep."""

from hyperflex.core.contact.arrays import AHEAD, STICK
from hyperflex.core.contact.sweep import add_contact
from hyperflex.core.jit import lean


@lean
def add_contact_impulse(found, impulses, motion, c, heavy, pn, pt):  # type: ignore[no-untyped-def]
    """Add contact c, in its present mode, to ``motion.touch``: impulses pn, pt, N s, at rest; `heavy` is M, kg.

    What slips has the tangential impulse that goes with the normal one; pt is of no account then.
    """
    i, s = found.link[c], found.place[c]
    sin, cos = motion.trig[i], motion.trig[motion.w.size + i]
    nx, ny = found.nx[c], found.ny[c]
    if impulses.mode[c] == STICK:
        b = (heavy, 0.0, 0.0, heavy)
        add_contact(motion.touch, i, s, sin, cos, b, (pn * nx - pt * ny, pn * ny + pt * nx))
    else:
        ratio = friction_ratio(found, impulses, c)
        fx, fy = nx - ratio * ny, ny + ratio * nx
        b = (heavy * fx * nx, heavy * fx * ny, heavy * fy * nx, heavy * fy * ny)
        add_contact(motion.touch, i, s, sin, cos, b, (pn * fx, pn * fy))


@lean
def friction_ratio(found, impulses, c):  # type: ignore[no-untyped-def]
    """Tangential impulse of a contact that slips, in parts of the normal one."""
    return -found.mu[c] if impulses.mode[c] == AHEAD else found.mu[c]


@lean
def velocity(found, motion, c):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c after the step, m/s: along its normal, and along its tangent."""
    n = motion.w.size
    i = found.link[c]
    lever = found.place[c] * (motion.w[i] + motion.change[i])
    vx = motion.speed[0, i] + motion.turned[0, i] + motion.place[0, i] + lever * motion.trig[n + i]
    vy = motion.speed[1, i] + motion.turned[1, i] + motion.place[1, i] + lever * motion.trig[i]
    return vx * found.nx[c] + vy * found.ny[c], vy * found.nx[c] - vx * found.ny[c]
