"""One contact: the velocity of its point and its impulse as a term of the sweep."""

from hyperflex.core.contact.arrays import AHEAD, STICK
from hyperflex.core.contact.sweep import add_contact
from hyperflex.core.jit import non_allocating


@non_allocating
def add_contact_impulse(contacts, impulses, motion, c, penalty, pn, pt):  # type: ignore[no-untyped-def]
    """Add contact c, in its present mode, to ``motion.touch``: impulses pn, pt, N s, at rest; `penalty` is M, kg.

    What slips has the tangential impulse that goes with the normal one; pt is of no account then.
    """
    i, s = contacts.link[c], contacts.place[c]
    sin, cos = motion.trig[i], motion.trig[motion.w.size + i]
    nx, ny = contacts.nx[c], contacts.ny[c]
    if impulses.mode[c] == STICK:
        b = (penalty, 0.0, 0.0, penalty)
        add_contact(motion.touch, i, s, sin, cos, b, (pn * nx - pt * ny, pn * ny + pt * nx))
    else:
        ratio = friction_ratio(contacts, impulses, c)
        fx, fy = nx - ratio * ny, ny + ratio * nx
        b = (penalty * fx * nx, penalty * fx * ny, penalty * fy * nx, penalty * fy * ny)
        add_contact(motion.touch, i, s, sin, cos, b, (pn * fx, pn * fy))


@non_allocating
def friction_ratio(contacts, impulses, c):  # type: ignore[no-untyped-def]
    """Tangential impulse of a contact that slips, in parts of the normal one."""
    return -contacts.mu[c] if impulses.mode[c] == AHEAD else contacts.mu[c]


@non_allocating
def velocity(contacts, motion, c):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c after the step, m/s: along its normal, and along its tangent."""
    n = motion.w.size
    i = contacts.link[c]
    lever = contacts.place[c] * (motion.w[i] + motion.change[i])
    vx = motion.speed[0, i] + motion.turned[0, i] + motion.place[0, i] + lever * motion.trig[n + i]
    vy = motion.speed[1, i] + motion.turned[1, i] + motion.place[1, i] + lever * motion.trig[i]
    return vx * contacts.nx[c] + vy * contacts.ny[c], vy * contacts.nx[c] - vx * contacts.ny[c]
