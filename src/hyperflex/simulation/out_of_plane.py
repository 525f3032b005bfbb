"""Motion out of the plane of a planar run, to first order: a rope that begins askew, a leaning plane, a draught."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.sideways import lean as integrate
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interruption import interruptible
from hyperflex.model import Rope, swing_rate
from hyperflex.status import Status
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP = 0.01  # s, of the integration at first: half of the 20 ms in which a cast's accelerations change
GROWTHS = 100  # instants at most at which the growth is computed: each takes a singular value


@dataclass(frozen=True, eq=False, repr=False)
class Sideways:
    """Motion out of the plane of a run, made by :func:`sideways`; linear in what causes it.

    Attributes
    ----------
    run : Trajectory
        The planar run.
    t : (T,) float64
        Times, s: those of the run until it touches an obstacle.
    angles, rates : (T, n) float64
        Angles of the links out of the plane, rad, and their rates, rad/s.
    touch : float or None
        Time of the first sample at which the rope touches an obstacle, s: the motion is known until before it.
    error : float
        Error of the joints' positions, m: half of their largest difference from a computation with every second sample
        and twice the step, whose error is about three times as large, or more.
    finer : int
        Refinement factor of the steps, relative to 10 ms.
    """

    run: Trajectory
    t: Array
    angles: Array
    rates: Array
    touch: float | None
    error: float
    finer: int = 1

    def __repr__(self) -> str:
        what = f"{self.t[0]:g} to {self.t[-1]:g} s, up to {1e3 * np.abs(self.joints).max():.3g} mm out of the plane"
        ends = "" if self.touch is None else f"ends before {self.touch:g} s, where the rope touches an obstacle"
        return f"Sideways({'; '.join(filter(None, (what, ends, self.warning(), 'joint limits are not seen')))})"

    def warning(self) -> str:
        """Return that angles are too large for the first order; empty if not."""
        return lean_warning(float(np.abs(self.angles).max()))

    @cached_property
    def joints(self) -> Array:
        """Distances (T, n + 1) of the joints from the plane, m; the last one is the tip's."""
        return np.pad(_places(self.run.rope, self.angles), ((0, 0), (1, 0)))

    @property
    def tip(self) -> Array:
        """Distance (T,) of the tip from the plane, m."""
        return self.joints[:, -1]

    def growth(self) -> tuple[Array, Array]:
        """Return times (K,), s, and the largest growth factor (K,) of a deviation at the start.

        The size of a deviation is the root of the sum of squares over all joints of their distances from the plane, m,
        and of their velocities, m/s, times the swing time sqrt(length / g), at most 1 s. The growth is the largest
        singular value of the map from the start's deviations to those at t.
        """
        rope, t = self.run.rope, self.t
        n = rope.n_links
        swing = 1.0 / max(1.0, swing_rate(rope))
        unit, start = (np.eye(n) - np.eye(n, k=1)) / rope.length, np.zeros((2, 2 * n, n))  # one joint is off the plane
        start[0, :n], start[1, n:] = unit, unit / swing
        rows = np.unique(np.linspace(0, t.size - 1, GROWTHS).astype(int))
        found = [1.0]
        for first, last in pairwise(rows.tolist()):
            x, v = start = _integrate(self.run, slice(first, last + 1), np.zeros((2, n)), start, self.finer)[:, -1]
            found.append(float(np.linalg.norm(np.hstack([_places(rope, x), swing * _places(rope, v)]), 2)))
        return t[rows], np.array(found)

    def plot(self) -> "Figure":
        """Draw the deviation of tip and middle over time, and its shape at the end: return a Matplotlib figure."""
        from hyperflex.report import sideways_figure

        return sideways_figure(self)


@interruptible()
def sideways(
    run: Trajectory, *, tilt: ArrayLike | None = None, rate: ArrayLike = 0.0, lean: float = 0.0, side: float = 0.0
) -> Sideways:
    """Compute the motion of a planar run out of its plane, to first order in the angles out of it.

    Parameters
    ----------
    run : Trajectory
        Planar run with a prescribed arm, or without one, from its first sample on. It needs samples every 20 ms or more
        often: accelerations between them are interpolated. The rope has no dry friction.
    tilt : float or (n,) array_like, optional
        Angles of the links out of the plane at the first sample, rad, positive towards the viewer. By default `lean`:
        the rope hangs at rest along gravity.
    rate : float or (n,) array_like
        Their rates, rad/s.
    lean : float
        Angle of the plane from gravity, rad, if the shaft is not level.
    side : float
        Force of a draught on each metre of rope across the plane, N/m.

    Returns
    -------
    Sideways
        The motion until the rope first touches an obstacle.

    Raises
    ------
    InvalidInput
        If the run has a torque-driven arm, dry friction, friction as the paper prints it, or too few or too coarse
        samples (an `error` above 5 % of the motion), or if `lean` is given without `tilt` for a rope that does not
        begin hanging at rest.
    SimulationError
        If the motion is not finite.

    Notes
    -----
    Model: docs/models.md, (M.40)-(M.45). Joints resist bending equally in all directions and transmit twist. Joint
    limits and the rope's contact with itself are ignored. Cost: 0.3 to 0.6 of that of a run in free flight, up to 1.5
    if steps must be finer.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> cast = hf.simulate(cable, hf.arm_swings(t_move=0.73, t_rest=0.53), arm=hf.Arm(length=0.105), duration=3.0)
    >>> one_degree = hf.sideways(cast, tilt=0.01745)
    >>> round(float(abs(one_degree.tip).max()), 2)
    0.07
    """
    rope, n = checks.instance("run", run, Trajectory).setup.rope, run.q.shape[1]
    lean = checks.number("lean", lean, unit="rad")
    side = checks.number("side", side, unit="N/m")
    given = (("tilt", lean if tilt is None else tilt, "rad"), ("rate", rate, "rad/s"))
    start = np.stack([checks.array(name, value, (n,), unit=unit, scalar=True) for name, value, unit in given])[:, None]
    if run.setup.torque is not None:
        fix = "Give its angle as a motion: hyperflex.sampled_motion(run.t, run.arm_angle)"
        raise InvalidInput("motion sideways needs a prescribed arm", got="an arm driven by a torque", fix=fix)
    refuse_rope(rope)
    forces = np.zeros(0) if run.contact_force is None else run.contact_force.any(axis=(1, 2))
    count = int(forces.argmax()) if forces.any() else run.t.size
    if count < 3:
        raise InvalidInput("the run has too few samples before it touches", got=count, allowed="3 or more")
    if tilt is None and lean and max(np.abs(run.q[0] - rope.hanging_angle).max(), np.abs(run.qd[0]).max()) > 1e-6:
        raise InvalidInput("the rope does not begin hanging at rest", got="no tilt", fix="Give tilt along with lean")
    weight = rope.g * lean
    load = np.stack([rope.length, 0.5 * rope.length**2]) * side + np.stack([rope.mass, rope.mass * rope.com]) * weight
    load[:, -1] += weight * rope.tip_mass * np.array([1.0, rope.length[-1]])
    step = np.diff(run.t[:count]).max()
    for finer in (1, 2, 4):
        (angles, rates), (coarse, _) = (
            _integrate(run, slice(0, count, each), load, start, finer)[:, :, 0] for each in (1, 2)
        )
        most, apart = (np.abs(_places(rope, each)).max() for each in (angles, coarse - angles[::2]))
        error = apart / 2.0
        if error <= 0.05 * most:
            break
    if error > 0.05 * most or (run.contact_force is not None and step > 2.0 * STEP + 1e-9):
        what = f"{step:.3g} s apart; the motion is wrong by some {error / max(most, 1e-300):.2g} of it"
        allowed, fix = f"0.05 of it; {2.0 * STEP:g} s apart with obstacles", "Simulate with a finer t_eval"
        raise InvalidInput("the samples of the run are too coarse", got=what, allowed=allowed, fix=fix)
    touch = float(run.t[count]) if count < run.t.size else None
    return Sideways(run, run.t[:count], angles, rates, touch, float(error), finer)


def _places(rope: Rope, angles: Array) -> Array:
    """Return how far from the plane links that lean by angles (..., n) end, m; for their rates, how fast, m/s."""
    return np.cumsum(rope.length * angles, axis=-1)


def lean_warning(most: float) -> str:
    """Return that a link that leans by `most`, rad, is beyond the first order; empty if it is not.

    In MuJoCo a cast of 12 links (tests/oracles) is that far off its greatest deviation, at most in 4 s.
    """
    found = math.degrees(most)
    return f"a link leans by {found:.3g} degrees: the first order is 5 % off at 22, useless at 74" * (found > 20.0)


def refuse_rope(rope: Rope) -> None:
    """Raise InvalidInput if a rope has friction that is not linear out of the plane."""
    if rope.friction_model != "relative":
        allowed = "friction_model='relative'"
        raise InvalidInput("one-sided joint friction is planar", got=rope.friction_model, allowed=allowed)
    if rope.dry_friction.any():
        most, fix = f"dry_friction up to {rope.dry_friction.max():.3g} N m", "Leave dry friction out"
        raise InvalidInput("dry friction is not linear out of the plane", got=most, allowed="0", fix=fix)


def _integrate(run: Trajectory, rows: slice, load: Array, start: Array, finer: int) -> Array:
    """Integrate motions from `start` (2, m, n) over the samples `rows` to (2, T, m, n). Fewer samples, longer steps."""
    setup, values = run.setup, tuple(np.ascontiguousarray(each[rows]) for each in (run.t, run.q, run.qd, run.qdd))
    found = np.empty((2, values[0].size, *start.shape[1:]))
    found[:, 0] = start
    parts = finer * max(1, math.ceil(float(np.diff(run.t).max()) / STEP - 1e-9))
    integrate(setup.rope.chain(), setup.drive(), values, load, setup.tip_force, parts, *found)
    if not np.isfinite(found[:, -1]).all():
        text = "the motion out of the plane grows beyond all bounds: simulate with more samples"
        raise SimulationError(text, status=Status.NOT_FINITE, time=float(values[0][-1]))
    return found
