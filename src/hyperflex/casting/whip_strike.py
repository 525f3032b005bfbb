"""What a whip does at its target in a verified run, and its blow on something that stands there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.casting.lash import Mark, peaks
from hyperflex.casting.thrower import Thrower
from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.model import DEFAULT_CONTACT_STEP, Peg
from hyperflex.motion import Motion
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

TOL = 1e-7  # m
SAMPLE_TIME, WINDOW = 2e-3, 0.15  # s: between samples; how far from the time that is expected a peak is looked for
RADIUS, BLOW = 0.01, 0.05  # m, s: a peg to strike, and how long the blow is watched
TOUCH = 1e-3  # N


@dataclass(frozen=True, eq=False)
class Lash:
    """The greatest peak of the tip's speed about the expected time, in a simulated run.

    Attributes
    ----------
    t : float
        When, s.
    place, velocity : (2,) float64
        Of the tip, m, m/s.
    miss : float
        Distance from the target, m.
    off : float
        Angle between velocity and the asked direction, rad.
    before : float
        Greatest speed of the tip before, m/s.
    reason : str
        Why it is not what was asked, the miss aside; empty if it is.
    run : Trajectory
    """

    t: float
    place: Array
    velocity: Array
    miss: float
    off: float
    before: float
    reason: str
    run: Trajectory

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        return float(np.hypot(*self.velocity))


@dataclass(frozen=True)
class Impact:
    """A whip's blow on a small fixed peg whose surface is at the target.

    Attributes
    ----------
    t : float
        When the rope first touches it, s; NaN if it does not, and then the rest is 0.
    impulse : float
        What the peg takes up in BLOW seconds, N s.
    along : float
        Its part in the asked direction, N s.
    force : float
        Greatest force, mean over a step, N.
    energy : float
        Energy that is lost to the blow, J.
    links : int
        Links counted from the tip that the impulse came through.
    """

    t: float
    impulse: float
    along: float
    force: float
    energy: float
    links: int


def lash(thrower: Thrower, mark: Mark, motion: Motion, near: float, *, tol: float = TOL) -> Lash | None:
    """Run a motion from rest and find the greatest peak of the tip's speed about time `near`, s.

    None where the run fails or has no peak there.
    """
    t = SAMPLE_TIME * np.arange(np.ceil((near + WINDOW) / SAMPLE_TIME) + 1.0)
    try:
        run = simulate(thrower.rope, motion, arm=thrower.arm, duration=float(t[-1]), t_eval=t, tol=tol)
    except SimulationError:
        return None
    found = peaks(run.t, run.tip[None], run.tip_velocity[None])
    about = np.abs(found.t - near) < WINDOW
    if not about.any():
        return None
    k = int(np.where(about, found.speed, 0.0).argmax())
    earlier = found.speed[found.t < found.t[k]]
    place, velocity = found.place[k], found.velocity[k]
    off, speed = abs(float(mark.off(velocity))), float(found.speed[k])
    reason = ""
    if speed < mark.speed:
        reason = f"the tip's speed is {speed:.2f} m/s, and {mark.speed:g} is asked"
    elif off > mark.within:
        reason = f"the tip's direction is {np.degrees(off):.0f} degrees off, {np.degrees(mark.within):.0f} allowed"
    return Lash(
        float(found.t[k]),
        place,
        velocity,
        float(np.hypot(*(place - mark.point))),
        off,
        float(earlier.max(initial=0.0)),
        reason,
        run,
    )


def impact(
    thrower: Thrower, mark: Mark, motion: Motion, near: float, *, radius: float = RADIUS, mu: float = 0.3
) -> Impact:
    """Run a motion beside a small fixed peg at the target and measure the blow.

    Parameters
    ----------
    thrower : Thrower
    mark : Mark
        The peg lies behind it in the asked direction, so that the tip touches the peg where it passes the target.
    motion : Motion
    near : float
        When the blow is expected, s.
    radius : float
        Of the peg, m.
    mu : float
        Friction on it.

    Raises
    ------
    SimulationError
        If the run fails.
    """
    radius = checks.number("radius", radius, sign="positive", unit="m")
    way = np.array([np.cos(mark.direction), np.sin(mark.direction)])
    x, y = mark.point + (radius + thrower.rope.radius) * way
    step = 0.5 * DEFAULT_CONTACT_STEP  # no step of the run is longer than two samples, and each counts with its force
    t = step * np.arange(np.ceil((near + WINDOW + BLOW) / step) + 1.0)
    run = simulate(
        thrower.rope,
        motion,
        arm=thrower.arm,
        duration=float(t[-1]),
        t_eval=t,
        pegs=[Peg(float(x), float(y), radius, mu)],
        refine=False,
    )
    force = -np.asarray(run.contact_force)  # on the peg
    size = np.hypot(*np.moveaxis(force.sum(axis=1), -1, 0))
    if not (size > TOUCH).any():
        return Impact(float("nan"), 0.0, 0.0, 0.0, 0.0, 0)
    first = int((size > TOUCH).argmax())
    blow = slice(first, first + int(BLOW / step))
    pushes = force[blow].sum(axis=0) * step  # (n, 2)
    total = pushes.sum(axis=0)
    through = np.flatnonzero(np.hypot(*pushes.T) > 0.05 * np.hypot(*total))
    loss = np.asarray(run.contact_loss)
    return Impact(
        float(run.t[first]),
        float(np.hypot(*total)),
        float(total @ way),
        float(size[blow].max()),
        float(loss[blow][-1] - loss[max(0, first - 1)]),
        thrower.rope.n_links - int(through.min()) if through.size else 0,
    )
