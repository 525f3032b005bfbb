"""The impact of a whip on a small peg at its target: impulse and energy from a run with contact."""

from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.model import DEFAULT_CONTACT_STEP, Peg, Setup
from hyperflex.motion import Motion
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import starts_outside
from hyperflex.planning.tasks.tip import touched_samples
from hyperflex.planning.verification import limit_bend
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory


@dataclass(frozen=True)
class Impact:
    """Impact of a whip's tip on a small fixed peg whose surface is at the target.

    Attributes
    ----------
    t : float
        Time of the first touch, s; NaN if the rope does not touch the peg.
    impulse : float
        Impulse on the peg within the duration, N s.
    impulse_along : float
        Its component in the required direction, N s.
    energy : float
        Energy lost in the impact while the rope is on the peg, J.
    link : int
        First link in contact, counted from the motor; -1 if none is.
    message : str
        Why there is no impact of the tip, and impulse and energy are 0: the rope does not touch the peg, or lies on it
        before, or touches it first elsewhere. Empty if there is one.
    radius, duration : float
        Of the peg, m, and of the impact, s.
    """

    t: float
    impulse: float
    impulse_along: float
    energy: float
    link: int
    message: str = ""
    radius: float = 0.01
    duration: float = 0.05

    @property
    def success(self) -> bool:
        """Whether the tip touches the peg first, about the expected time."""
        return not self.message


def simulate_impact(
    problem: Problem,
    point: Array,
    direction: float,
    motion: Motion,
    near: float,
    *,
    radius: float = 0.01,
    mu: float = 0.3,
    duration: float = 0.05,
) -> Impact:
    """Simulate a motion with a small fixed peg at a target and measure the impact, expected at time `near`, s.

    Parameters
    ----------
    problem : Problem
        Its obstacles are not simulated.
    point : (2,) array
        The target, m. The peg lies behind it, so that the tip touches the peg where it passes the target.
    direction : float
        Direction of the tip there, rad.
    motion : Motion
        Of the arm.
    near : float
        Expected time of the impact, s: the peg must be touched within 0.15 s.
    radius, mu : float
        Of the peg, m, and its friction coefficient.
    duration : float
        Of an impact, s.

    Notes
    -----
    The impact is the first touch of all, by the tip: within the last link, or the peg's width from the rope's end.
    Forces are averaged over samples; a collision within a sample adds its impulse (see :func:`collision_impulse`) if
    the sample loses more than a hundredth of the energy. Raises SimulationError if the run fails.
    """
    radius, window, sudden = checks.number("radius", radius, sign="positive", unit="m"), 0.15, 0.01
    way = np.array([np.cos(direction), np.sin(direction)])
    x, y = point + (radius + problem.rope.radius) * way
    step, coarse = 0.5 * DEFAULT_CONTACT_STEP, 1e-3
    begin = max(step, near - window)
    t = begin + step * np.arange(np.ceil((near - begin + window + duration) / step))
    t = np.append(np.arange(0.0, begin - 0.5 * coarse, coarse), t)
    peg = Peg(float(x), float(y), radius, mu)
    setup = Setup(limit_bend(problem.rope), motion, problem.arm, duration=float(t[-1]), pegs=(peg,))
    if not starts_outside(setup):
        return Impact(0.0, 0.0, 0.0, 0.0, -1, "the rope lies on the peg from the start")
    run = simulate(setup, t_eval=t)
    touched = touched_samples(run, (peg,))
    if not touched.any():
        return Impact(float("nan"), 0.0, 0.0, 0.0, -1, "the rope does not touch the peg")
    first = int(touched.argmax())
    link, along = _touching(run, peg, first)
    beyond = float(run.setup.rope.length[link:].sum()) - along
    if t[first] < begin or beyond > max(run.setup.rope.length[-1], 2.0 * radius) + 1e-9:
        where = f"link {link + 1} touches the peg first, at {t[first]:.2f} s and {1e2 * beyond:.0f} cm from the tip"
        return Impact(float(t[first]), 0.0, 0.0, 0.0, link, f"{where}; the tip was expected at {near:.2f} s")
    rows = slice(first, min(first + round(duration / step), t.size - 1) + 1)
    lost = np.where(touched, np.diff(np.asarray(run.contact_loss), prepend=0.0), 0.0)  # others: joints at their limits
    energy = float(lost[rows].sum())
    total = -step * np.asarray(run.contact_force)[rows].sum(axis=(0, 1))  # on the peg
    for k in first + np.flatnonzero(lost[rows] > sudden * energy):
        total = total - collision_impulse(run, peg, int(k))
    impulse = float(np.hypot(*total)), float(total @ way)
    return Impact(float(run.t[first]), *impulse, energy, link, radius=radius, duration=duration)


def collision_impulse(run: Trajectory, peg: Peg, k: int) -> Array:
    """Impulse (2,), N s, of a collision on the rope between samples k - 1 and k; finite forces are neglected.

    From the jump of the generalised momenta: an impulse P at distance s along link c changes that of link i by l_i t_i
    P before c, by s t_c P at c and not beyond, with t_i across link i.
    """
    length = run.setup.rope.length
    link, along = _touching(run, peg, k)
    lever = np.where(np.arange(length.size) < link, length, 0.0)
    lever[link] = along
    across = np.stack([np.cos(run.q[k]), np.sin(run.q[k])], axis=-1)
    jump = momenta(run, k) - momenta(run, k - 1)
    return np.asarray(np.linalg.lstsq(lever[:, None] * across, jump, rcond=None)[0])


def momenta(run: Trajectory, k: int) -> Array:
    """Generalised momenta (n,) of the links' angles at sample k, N m s."""
    rope = run.setup.rope
    across = np.stack([np.cos(run.q[k]), np.sin(run.q[k])], axis=-1)
    spin = run.qd[k][:, None] * across
    ends = run.base_velocity[k] + np.cumsum(rope.length[:, None] * spin, axis=0)
    centres = ends + (rope.com - rope.length)[:, None] * spin
    carried = rope.mass[:, None] * centres
    beyond = carried.sum(axis=0) + rope.tip_mass * ends[-1] - np.cumsum(carried, axis=0)
    own = rope.com[:, None] * carried + rope.length[:, None] * beyond
    return np.asarray((own * across).sum(axis=1) + rope.inertia * run.qd[k])


def _touching(run: Trajectory, peg: Peg, k: int) -> tuple[int, float]:
    """Return the link nearest to a peg at sample k, and how far along it the nearest point is, m."""
    length, q = run.setup.rope.length, run.q[k]
    out = np.array([peg.x, peg.y]) - run.joints[k, :-1]
    along = np.clip(out[:, 0] * np.sin(q) - out[:, 1] * np.cos(q), 0.0, length)
    link = int(np.hypot(out[:, 0] - along * np.sin(q), out[:, 1] + along * np.cos(q)).argmin())
    return link, float(along[link])
