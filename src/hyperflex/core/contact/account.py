"""Energy account of a contact step: what joints, air, axles and contacts take, and work put in."""

from hyperflex.core.chain.articulated_body import energies
from hyperflex.core.contact.air import drag_work
from hyperflex.core.contact.arrays import OPEN
from hyperflex.core.contact.joints import friction_impulse, joint_losses
from hyperflex.core.contact.sweep import TX, TY
from hyperflex.core.contact.turning_pegs import lost_in_bearings
from hyperflex.core.contact.warm_start import STEADY
from hyperflex.core.jit import non_allocating

# of ContactWorkspace.account, J: lost in joints, air, axles; in contacts, limits; put in
FRICTION, CONTACT, WORK = range(3)


@non_allocating
def mean_velocities(chain, motion, base, out):  # type: ignore[no-untyped-def]
    """Mean velocities of the joints in a step, m/s, to ``out`` (2, n + 1), along which forces acted; `base` (3, 9)."""
    n = motion.w.size
    out[0, 0], out[1, 0] = 0.5 * (base[0, 5] + base[2, 5]), 0.5 * (base[0, 6] + base[2, 6])
    for i in range(n):
        way = chain.length[i] * (motion.w[i] + 0.5 * motion.change[i])
        out[0, i + 1] = out[0, i] + way * motion.frame[i, TX]
        out[1, i + 1] = out[1, i] + way * motion.frame[i, TY]


@non_allocating
def account_step(chain, workspace, torque, whole, h):  # type: ignore[no-untyped-def]
    """Energy that joints, air, axles and contacts took in a step, and work put in: impulses times mean velocities."""
    motion, base, spin = workspace.motion, workspace.base, workspace.spin
    contacts, impulses, mean = workspace.contacts, workspace.impulses, workspace.ahead_speed
    n = motion.w.size
    mean_velocities(chain, motion, base, mean)
    taken, steady = 0.0, workspace.pace[STEADY]
    for i in range(n):
        change = motion.change[i] - (motion.change[i - 1] if i > 0 else motion.base[2])
        rate = motion.w[i] - (motion.w[i - 1] if i > 0 else base[0, 3]) + 0.5 * change
        impulse, slope = friction_impulse(chain, motion, workspace.trend, steady, base, h, i)
        taken -= (impulse - slope * change) * rate
    taken += drag_work(workspace.air, motion, workspace.out[n:], base[0], base[2], h)
    rubbed, limited = joint_losses(workspace.joints)
    workspace.account[FRICTION] = taken + rubbed + lost_in_bearings(spin)
    taken = limited
    for c in range(contacts.total[0]):
        if impulses.mode[c] == OPEN:
            continue
        i, p = contacts.link[c], contacts.peg[c]
        lever = contacts.place[c] * (motion.w[i] + 0.5 * motion.change[i])
        vx, vy = mean[0, i] + lever * motion.trig[n + i], mean[1, i] + lever * motion.trig[i]
        sliding = vy * contacts.nx[c] - vx * contacts.ny[c]
        sliding -= 0.5 * spin.reach[p] * (spin.before[p] + spin.after[p])
        taken -= impulses.normal[c] * (vx * contacts.nx[c] + vy * contacts.ny[c]) + impulses.tangent[c] * sliding
    workspace.account[CONTACT] = taken
    work = 0.5 * (motion.load[0] * (base[0, 5] + base[2, 5]) + motion.load[1] * (base[0, 6] + base[2, 6]))
    work += 0.5 * motion.load[2] * (base[0, 3] + base[2, 3])
    work += 0.5 * h * torque * (motion.w[0] + workspace.out[n])
    for k, g in ((0, chain.gx), (1, chain.gy)):
        fallen = 0.5 * h * (base[0, 5 + k] + base[2, 5 + k]) - (base[2, 7 + k] - base[0, 7 + k])
        work += whole * g * fallen + motion.tip[k] * mean[k, n]
    workspace.account[WORK] = work


@non_allocating
def energy(chain, y, base, trig):  # type: ignore[no-untyped-def]
    """Kinetic and potential energy of angles and rates y (2 n or more,), J; `base` (9,) motion of the first joint.

    `trig` is scratch, as in ``energies``.
    """
    n = chain.length.size
    point = (base[7], base[8], base[5], base[6], base[4], base[3])
    kinetic, potential = energies(chain, y[:n], y[n : 2 * n], point, trig)
    return kinetic + potential
