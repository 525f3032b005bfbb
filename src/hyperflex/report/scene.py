"""Common parts of pictures, films and players of a run: overlay, interpolated shapes, time span, view."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Obstacle, Wall
from hyperflex.trajectory import Trajectory, interpolated


class Line(NamedTuple):
    """A curve: its label, empty where it is the only one of its plot, and its values (T,) at the run's samples."""

    label: str
    values: Array


class Plot(NamedTuple):
    """A plot over time: what it shows, the unit, and its curves, three at most.

    A dashed line marks its `level`, a value that is required, say.
    """

    title: str
    unit: str
    lines: tuple[Line, ...]
    level: float | None = None


class Dots(NamedTuple):
    """Measured places to mark: times (K,), s, and places (K, m, 2), m, NaN where there are none."""

    t: Array
    places: Array


@dataclass(frozen=True, eq=False)
class Overlay:
    """Additional content of a picture, film or player of a run; each shows what it supports.

    Attributes
    ----------
    note : callable, optional
        Called with the simulated time, s; returns the text of a film's or player's frame.
    trail : float
        Time for which the path of the tip stays visible in a player or film, s.
    targets : (k, 2) float64
        Points to mark with a ring, m.
    obstacles : tuple of Peg, Wall, Ground
        Those of the run's set-up that the rope must not touch: violet.
    marks : tuple of float
        Times that the plots of a player mark, s.
    plots : tuple of Plot
        Plots of a player in addition to those of every run.
    dots : Dots, optional
        Measured places: a player marks the nearest in time with rings.
    ropes : tuple of Trajectory
        Further runs with as many links, drawn thin by a player, such as samples of an uncertain rope.
    """

    note: Callable[[float], str] | None = None
    trail: float = 0.8
    targets: Array = field(default_factory=lambda: np.zeros((0, 2)))
    obstacles: tuple[Obstacle, ...] = ()
    marks: tuple[float, ...] = ()
    plots: tuple[Plot, ...] = ()
    dots: Dots | None = None
    ropes: tuple[Trajectory, ...] = ()


PLAIN = Overlay()


class Shapes(NamedTuple):
    """Rope and arm at k instants."""

    joints: Array  # (k, n + 1, 2) positions, m, the tip last
    pivots: Array  # (k, 2) of the motor's shaft, m; the first joint where there is no arm


def shapes(run: Trajectory, times: Array) -> Shapes:
    """Return the rope at `times` (k,), s, by cubic interpolation of angles and rates; links keep their length."""
    q = interpolated(run.t, run.q, run.qd, times)
    base = interpolated(run.t, run.base, run.base_velocity, times)
    joints = run.setup.rope.joints(q, base)
    arm = run.setup.arm
    if arm is None:
        return Shapes(joints, base)
    return Shapes(joints, base - arm.tip(interpolated(run.t, run.arm_angle, run.arm_rate, times)) + arm.pivot)


def span(run: Trajectory, start: float | None, end: float | None) -> tuple[float, float]:
    """Return the first and last time to show, s: the given ones or the run's; InvalidInput if outside of the run."""
    first = float(run.t[0]) if start is None else checks.number("start", start, unit="s")
    last = float(run.t[-1]) if end is None else checks.number("end", end, unit="s")
    if not run.t[0] <= first < last <= run.t[-1]:
        given = [f"{name}={value:g}" for name, value in (("start", start), ("end", end)) if value is not None]
        raise InvalidInput(
            f"{' and '.join(given)} is no part of the run",
            allowed=f"times from {run.t[0]:g} to {run.t[-1]:g} s, the start before the end",
        )
    return first, last


def last_sweep(run: Trajectory) -> tuple[float, float]:
    """Return begin and end, s, of the last sweep of a rope, at least half as wide as the widest; else of the whole run.

    A sweep is from one instant to the next at which the middle of the mass turns back, to the left or to the right.
    """
    mass = run.setup.rope.mass
    middles = 0.5 * (run.joints[:, 1:, 0] + run.joints[:, :-1, 0])
    x = middles @ mass / mass.sum() if mass.any() else middles.mean(axis=1)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x)))) + 1
    widths = np.abs(np.diff(x[turns]))
    if not widths.size:
        return float(run.t[0]), float(run.t[-1])
    last = int(np.flatnonzero(widths >= 0.5 * widths.max())[-1])
    return float(run.t[turns[last]]), float(run.t[turns[last + 1]])


def view(run: Trajectory, points: Array, above: float) -> tuple[Array, Array]:
    """Return the lower left and upper right corner (2,), m, of a view of points (k, 2), m, pegs and walls.

    The margin at the top is `above` times the margin of the other sides.
    """
    pegs = [(peg.x + side * peg.radius, peg.y + side * peg.radius) for peg in run.setup.round_pegs for side in (-1, 1)]
    pegs += [end for wall in run.setup.pegs if isinstance(wall, Wall) for end in wall_ends(wall)]
    points = np.concatenate([points, np.reshape(pegs, (-1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.06 * (high - low).max()
    low, high = low - margin, high + np.array([margin, above * margin])
    across, up = high - low
    side = np.array([0.5 * max(0.0, up / 1.15 - across), 0.0])  # a picture is at most 1.15 times as tall as wide
    return low - side, high + side


def wall_ends(wall: Wall) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of a wall, m."""
    return (wall.x, wall.y), (wall.x2, wall.y2)
