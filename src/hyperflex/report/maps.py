"""Maps: the targets of a reach map, and what a vibration holds and a motor reaches."""

import math
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import VibrationMap
from hyperflex.model import MotorLimits, unit_along
from hyperflex.planning import ReachMap
from hyperflex.report.pictures import OBSTACLE, draw_obstacle
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, Figure, legend, new_figure


def reach_figure(reach: ReachMap) -> "Figure":
    """Draw a reach map to scale: contact angle of the targets that are wound, reason for the others."""
    from matplotlib.colors import ListedColormap

    rope, arm, pivot = reach.problem.rope, reach.problem.arm, np.array(reach.problem.arm.pivot)[:, None]
    edges = [_edges(reach.x), _edges(reach.y)]
    width, height = (float(np.ptp(each)) for each in edges)
    tall = float(np.clip(6.0 * height / width, 3.0, 8.0))
    with new_figure(max(5.6, min(9.0, tall * width / height) + 2.6), tall + 1.0) as figure:
        axis: Any = figure.subplots()
        size = f"Rope of {rope.total_length:.3g} m, {1e3 * rope.total_mass:.3g} g"
        title = f"{size}; targets of {1e3 * reach.radius:.3g} mm radius\n{reach.in_short()}"
        axis.set(title=f"{title}; {reach.time_budget:g} s each (simulated)", xlabel="x, m", ylabel="y, m (up)")
        axis.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]], aspect="equal")
        failed = ~(reach.wound | reach.infeasible) & (reach.status >= 0)
        for where, colour, rim, label in (
            (reach.infeasible, "#e3e6ea", GREY, "not feasible, not searched"),
            (failed, "#f0b7b0", RED, "feasible, but no cast found in the time"),
            (reach.status < 0, "white", GREY, "not planned: interrupted"),
        ):
            if where.any():
                axis.pcolormesh(*edges, np.ma.masked_where(~where, np.ones(where.shape)), cmap=ListedColormap([colour]))
                axis.plot([], [], "s", color=colour, mec=rim, ms=9.0, label=label)
        if reach.wound.any():
            degrees = np.ma.masked_invalid(np.degrees(reach.contact_angle))
            mesh = axis.pcolormesh(*edges, degrees, cmap="YlGnBu", vmin=0.0, vmax=max(360.0, float(degrees.max())))
            figure.colorbar(mesh, ax=axis, label="wound: angle of the target covered, degrees", shrink=0.8)
        far = arm.length + rope.total_length
        for radius, colour, label in (
            (far, GREY, f"the rope's end comes no farther than {far:.3g} m"),
            (arm.length, BLUE, "circle of the arm's tip"),
        ):
            axis.plot(
                *(pivot + radius * unit_along(np.linspace(0.0, math.tau, 361), 0)), color=colour, ls="--", label=label
            )
        axis.plot(*pivot, "o", color=INK, label="motor's shaft")
        drawn = {each: draw_obstacle(axis, each, 8.0 * far, OBSTACLE) for each in reach.problem.obstacles}
        inside = {type(each): patch for each, patch in drawn.items() if patch.get_window_extent().overlaps(axis.bbox)}
        for kind, patch in inside.items():
            patch.set_label(f"{kind.__name__.lower()}, an obstacle")
        legend(figure, axis, place="lower center", columns=2)
    return figure


def vibration_figure(found: VibrationMap, limits: MotorLimits | None = None) -> "Figure":
    """Draw the tilt over amplitude and frequency, and what a motor of these limits reaches with the map's arm."""
    line, rope = math.degrees(found.direction), found.rope
    title = (
        f"Tilt of a rope of {rope.total_length:.3g} m, vibrated along {line:.3g} degrees\n"
        "0 hangs, 90 is horizontal, 180 is upright; averaged equations"
    )
    with new_figure(7.6, 5.4, title) as figure:
        axis: Any = figure.subplots()
        ways, tilt = 1e3 * found.amplitude, np.ma.masked_invalid(np.degrees(found.tilt))
        axis.grid(visible=False)
        mesh = axis.pcolormesh(ways, found.frequency, tilt, alpha=np.where(found.holds, 1.0, 0.35), cmap="YlGnBu")
        figure.colorbar(mesh, ax=axis, label="tilt, degrees")
        axis.plot([], [], "s", color="#b9c6d8", ms=9.0, label="pale: averaging does not apply")
        axis.plot([], [], "s", color="white", mec=GREY, ms=9.0, label="white: not held")
        if limits is not None and found.arm is not None:
            omega, reach = math.tau * found.frequency, 1e3 * found.arm.length
            for way, colour, name in (
                (reach * limits.speed / omega, GREEN, "limit of the motor's speed"),
                (reach * limits.acceleration / omega**2, RED, "limit of the motor's acceleration"),
            ):
                axis.plot(way, found.frequency, color=colour, label=name)
        axis.set(xlim=ways[[0, -1]], ylim=found.frequency[[0, -1]])
        axis.set(xlabel="amplitude of the first joint, mm", ylabel="frequency, Hz")
        legend(figure, axis, place="lower center", columns=2)
    return figure


def _edges(places: Array) -> Array:
    """Return the edges (K + 1,) of cells around positions (K,), m."""
    if places.size == 1:
        return np.asarray(places[0] + np.array([-0.05, 0.05]))
    between = 0.5 * (places[1:] + places[:-1])
    return np.concatenate([[2.0 * places[0] - between[0]], between, [2.0 * places[-1] - between[-1]]])
