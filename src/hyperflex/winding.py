"""Winding measures of a trajectory: turns about a peg, tension, slip, and a tug test."""

from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array, Indices
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Peg, Rope, Setup, unit_across, unit_along
from hyperflex.motion import moving_pivot
from hyperflex.simulation import base_motion, simulate
from hyperflex.trajectory import State, Trajectory, swept

TOUCH = 1e-4  # m, gap below which a link lies on a peg
LIFTED = 0.1  # of its length, gap above which a link between two that lie on a peg does not
STEADY = 0.1  # s, over which a pull must last to count
PULL = 0.05  # m, of a taut rope
LOOSE, QUICK = 0.9, 3.0  # part of what hangs loose that is taken up faster, and how much faster


@dataclass(frozen=True)
class Winding:
    """Winding of a rope on a peg during a run.

    Attributes
    ----------
    turns : (T,) float64
        Signed angle about the peg from the rope's first joint to its end, over 2 pi; positive counterclockwise.
    arc : (T,) float64
        Signed angle about the peg from the first to the last link in contact, rad; 0 with fewer than two links in
        contact.
    contact : (T,) float64
        Angle of the peg that the rope covers, rad, >= 0: from link to link between those, where none is off it by more
        than LIFTED of its length.
    before, after : (T,) float64
        Tension of the rope next to the links in contact, towards the motor and towards the tip, N: the force through
        their outer joints along the next link, or along the last link itself; < 0 for compression. NaN without contact.
    tail : (T,) float64
        Weight of the rope beyond the links in contact, including the tip mass, N; NaN without contact.
    """

    turns: Array
    arc: Array
    contact: Array
    before: Array
    after: Array
    tail: Array


@dataclass(frozen=True)
class TugTest:
    """Result of a pull at the motor-side end of a wound rope.

    Attributes
    ----------
    hold : float
        Largest force along the pull, averaged over STEADY, before the rope had slipped, N.
    slipped : bool
        Whether the rope slipped within the pull; if not, `hold` is a lower bound.
    run : Trajectory
        The simulated pull.
    slip : (T,) float64
        Slip of the rope on the peg, m, see :func:`rope_slip`; of a peg that turns, about its axle.
    allowed : float
        Slip, m, from which on the rope counts as slipped.
    """

    hold: float
    slipped: bool
    run: Trajectory
    slip: Array
    allowed: float

    def holds(self, force: float) -> bool:
        """Whether the rope withstood a pull of `force`, N, with less than the allowed slip."""
        return self.hold >= checks.positive("force", force, "N")


def measure_winding(run: Trajectory, peg: Peg) -> Winding:
    """Measure how a rope is wound round a peg.

    Parameters
    ----------
    run : Trajectory
        Simulated with this peg.
    peg : Peg

    Returns
    -------
    Winding

    Raises
    ------
    InvalidInput
        If the run had no such peg.
    """
    _own(run, peg)
    rope, angles = run.rope, swept(run.joints - peg.point)
    arc, contact, before, after, tail = np.repeat([0.0, 0.0, np.nan, np.nan, np.nan], run.t.size).reshape(5, -1)
    _, out, gap = closest_points(rope, peg, run.q, run.joints)
    near = np.flatnonzero((gap < TOUCH).any(axis=1))  # samples at which a link touches
    gap, out = gap[near], out[near]
    touching = gap < TOUCH
    first = touching.argmax(axis=1)
    last = touching.shape[1] - 1 - touching[:, ::-1].argmax(axis=1)
    rows = np.arange(near.size)
    through = np.cumsum(np.concatenate([np.zeros((near.size, 1)), angles[near]], axis=1), axis=1)
    middle = 0.5 * (through[:, :-1] + through[:, 1:])
    arc[near] = middle[rows, last] - middle[rows, first]
    between = np.arange(gap.shape[1])
    on = np.asarray((gap < LIFTED * rope.length) & (between >= first[:, None]) & (between <= last[:, None]))
    contact[near] = np.abs(np.where(on[:, 1:] & on[:, :-1], swept(out), 0.0).sum(axis=1))
    force, q = _joint_forces(run, near), run.q[near]
    along = unit_along(q)
    inner, outer = np.maximum(first - 1, 0), np.minimum(last + 1, rope.n_links - 1)
    before[near] = -(force[rows, first] * along[rows, inner]).sum(axis=-1)
    after[near] = -(force[rows, last + 1] * along[rows, outer]).sum(axis=-1)
    beyond = rope.tip_mass + np.append(np.cumsum(rope.mass[::-1])[::-1], 0.0)
    tail[near] = rope.g * beyond[last + 1]
    return Winding(angles.sum(axis=1) / (2.0 * np.pi), arc, contact, before, after, tail)


def turns(run: Trajectory, peg: Peg) -> Array:
    """Return the signed turns (T,) of the rope about a peg, which need not be one of the run's; see :class:`Winding`.

    Parameters
    ----------
    run : Trajectory
    peg : Peg
    """
    return np.asarray(swept(run.joints - peg.point).sum(axis=1) / (2.0 * np.pi))


def rope_tension(run: Trajectory) -> Array:
    """Return the force through each joint (T, n + 1), N, the tip last; by Newton's law from the tip.

    Parameters
    ----------
    run : Trajectory
        Run with a prescribed arm or a fixed end. In contact with pegs, accelerations and forces are means over the
        step.
    """
    force = _joint_forces(checks.instance("run", run, Trajectory), np.arange(run.t.size))
    return np.hypot(force[..., 0], force[..., 1])


def _joint_forces(run: Trajectory, rows: Indices) -> Array:
    """Force at samples `rows` (k,) on what is beyond each joint from what is before it (k, n + 1, 2), N, tip last."""
    rope, drive, q, rate = run.rope, run.setup.drive(), run.q[rows], run.qd[rows]
    if run.setup.torque_driven:
        base = np.gradient(run.base_velocity, run.t, axis=0)[rows]
    else:
        base = np.array([base_motion(drive, t)[:2] for t in run.t[rows]]).reshape(-1, 2)
    bend = run.qdd[rows, :, None] * unit_across(q) - (rate**2)[..., None] * unit_along(q)
    joints = np.cumsum(np.concatenate([base[:, None], rope.length[:, None] * bend], axis=1), axis=1)
    centres = joints[:, :-1] + rope.com[:, None] * bend
    needed = rope.mass[:, None] * (centres - rope.gravity)
    if run.contact_force is not None:
        needed = needed - run.contact_force[rows]
    end = rope.tip_mass * (joints[:, -1:] - rope.gravity) - np.array(run.setup.tip_force)
    return np.cumsum(np.concatenate([end, needed[:, ::-1]], axis=1), axis=1)[:, ::-1]


def rope_slip(run: Trajectory, peg: Peg, *, since: float | None = None) -> Array:
    """Return how far the rope has slipped on a peg since a time (T,), m; positive towards the tip.

    Parameters
    ----------
    run : Trajectory
        Simulated with this peg.
    peg : Peg
    since : float, optional
        Start of the measurement, s; by default the start of the run.

    Returns
    -------
    (T,) float64
        NaN before `since`, and everywhere if the rope is not in contact at that time; infinite if no link that was in
        contact then still is.

    Notes
    -----
    The slip is that of the link that moved least, of the links in contact at both times: an inextensible rope is held
    as long as one of them is, even if a loose tail slides. A rolling link does not slip: its contact moves along the
    link by ds and round the peg by ds / R. Nor does a link that moves with a turning peg.
    """
    checks.instance("run", run, Trajectory)
    checks.instance("peg", peg, Peg)
    begin = 0 if since is None else int(np.searchsorted(run.t, checks.number("since", since, unit="s") - 1e-12))
    if begin >= run.t.size:
        raise InvalidInput("since is after the end of the run", got=since, allowed=f"at most {run.t[-1]:g} s")
    turned = 0.0 if run.peg_angle is None else run.peg_angle[begin:, _own(run, peg)]
    moved = slid(run.rope, peg, run.q[begin:], run.joints[begin:], turned)
    return np.concatenate([np.full(begin, np.nan), moved])


def slid(rope: Rope, peg: Peg, q: Array, joints: Array, turned: Array | float = 0.0) -> Array:
    """As :func:`rope_slip`, since the first of samples q (T, n), rad, and joints (T, n + 1, 2), m, of a rope.

    `turned` (T,), rad, is the peg's own angle; without it the way is that of the rope round the axle.
    """
    place, away, gap = closest_points(rope, peg, q, joints)
    along = unit_along(q[0])
    sense = np.sign(away[0, :, 0] * along[:, 1] - away[0, :, 1] * along[:, 0])
    angle = np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=0)
    angle = angle - np.broadcast_to(turned, angle.shape[:1])[:, None]
    way = sense * (peg.radius + rope.radius) * (angle - angle[0]) - (place - place[0])
    held = (gap[:1] < TOUCH) & (gap < TOUCH)
    least = np.where(held, np.abs(way), np.inf).argmin(axis=1)
    rows = np.arange(least.size)
    return np.where(held[rows, least], way[rows, least], np.inf if held[0].any() else np.nan)


@interruptible()
def tug_test(
    run: Trajectory,
    peg: Peg,
    *,
    speed: float = 0.02,
    distance: float | None = None,
    allowed: float = 5e-3,
    time_budget: float | Budget | None = None,
) -> TugTest:
    """Continue a run by a slow pull of the rope's motor-side end away from a peg, and measure the holding force.

    Parameters
    ----------
    run : Trajectory
        Run that ended with the rope on the peg.
    peg : Peg
    speed : float
        Of the pull, m/s.
    distance : float, optional
        Distance of the pull, m; by default the slack between motor and peg, most of it at three times the speed, plus
        PULL.
    allowed : float
        Allowed slip on the peg, m.
    time_budget : float or Budget, optional
        As of :func:`hyperflex.simulate`, s.

    Returns
    -------
    TugTest
    """
    speed = checks.positive("speed", speed, "m/s")
    allowed = checks.positive("allowed", allowed, "m")
    checks.instance("run", run, Trajectory)
    checks.instance("peg", peg, Peg)
    loose = _slack(run, peg) if distance is None else 0.0
    quick = LOOSE * loose
    rest = checks.positive("distance", loose + PULL if distance is None else distance, "m") - quick
    end = run.joints[-1, 0]
    away = end - peg.point
    away /= np.hypot(*away)
    time = np.cumsum([0.0, quick / (QUICK * speed), rest / speed])[quick == 0.0 :]
    path = end + np.array([[0.0], [quick], [quick + rest]])[quick == 0.0 :] * away
    start = State(t=0.0, q=run.q[-1], qd=run.qd[-1], peg_rate=None if run.peg_rate is None else run.peg_rate[-1])
    same = {name: getattr(run.setup, name) for name in ("pegs", "contact_step", "tip_force", "tol")}
    setup = Setup(run.rope, moving_pivot(time, *path.T), duration=float(time[-1]), **same)
    pulled = simulate(setup, state=start, time_budget=time_budget)
    way = slid(pulled.rope, peg, pulled.q, pulled.joints)
    gone = np.abs(way) > allowed
    slipped = bool(gone.any())
    pull = _pull(pulled)[: int(np.argmax(gone)) + 1 if slipped else pulled.t.size]
    count = min(max(1, round(STEADY / float(pulled.t[1] - pulled.t[0]))), pull.size)
    steady = np.convolve(pull, np.full(count, 1.0 / count), mode="valid")
    return TugTest(hold=float(steady.max()), slipped=slipped, run=pulled, slip=way, allowed=allowed)


def _pull(run: Trajectory) -> Array:
    """Force along the way of a moving end (T,), N: its work over its way, from the sample before to the one after.

    A rope that comes taut trembles: its tension at an instant tells little.
    """
    force = np.diff(run.motor_work) / np.hypot(*np.diff(run.base, axis=0).T)
    return np.asarray(0.5 * (np.append(force[:1], force) + np.append(force, force[-1:])))


def _slack(run: Trajectory, peg: Peg) -> float:
    """Length of the rope from the motor to where it first lies on a peg at the end, less the straight way there, m."""
    rope = run.rope
    place, _, gap = (value[0] for value in closest_points(rope, peg, run.q[-1:], run.joints[-1:]))
    if not (gap < TOUCH).any():
        return 0.0
    i = int((gap < TOUCH).argmax())
    point = run.joints[-1, i] + place[i] * unit_along(run.q[-1, i])
    return max(0.0, float(rope.length[:i].sum() + place[i] - np.hypot(*(point - run.joints[-1, 0]))))


def _own(run: Trajectory, peg: Peg) -> int:
    """Return which of the round pegs of a run a peg is; one that it has not is refused."""
    pegs = checks.instance("run", run, Trajectory).setup.round_pegs
    if peg not in pegs:
        raise InvalidInput("peg is not one of the run's", got=peg, allowed=", ".join(map(str, pegs)) or "none")
    return pegs.index(peg)


def closest_points(rope: Rope, peg: Peg, q: Array, joints: Array) -> tuple[Array, Array, Array]:
    """Place of the point of each link closest to a peg's centre (T, n), m; from there to it (T, n, 2), m; gap, m."""
    along = unit_along(q)
    to_peg = peg.point - joints[:, :-1]
    place = np.clip((to_peg * along).sum(axis=-1), 0.0, rope.length)
    away = place[..., None] * along - to_peg
    return place, away, np.hypot(away[..., 0], away[..., 1]) - peg.radius - rope.radius
