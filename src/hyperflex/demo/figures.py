"""Figures of the demo: the identified parameters beside the truth, and the two casts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hyperflex.demo.run import Demo, Parameter
from hyperflex.report.style import BLUE, GREEN, GREY, RED, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def parameters_figure(parameters: tuple[Parameter, ...]) -> Figure:
    """Draw each parameter over its mapped truth: guess, plain cut, and the identified value with its 95 % interval."""
    with new_figure(10.0, 1.3 + 0.75 * len(parameters)) as figure:
        axis: Any = figure.subplots()
        for row, each in enumerate(parameters):
            low, high = each.interval
            axis.plot([low / each.mapped, high / each.mapped], [row, row], color=BLUE, lw=5.0, alpha=0.45)
            for value, marker, colour, label in (
                (each.value, "o", BLUE, "identified, 95 % interval"),
                (each.mapped, "|", GREEN, "mapped truth (noise-free fit)"),
                (each.cut, "D", GREY, "the rope simply cut into as many links"),
                (each.guess, "x", RED, "first guess"),
            ):
                style = {"color": colour, "ms": 22.0 if marker == "|" else 7.0, "mew": 1.8, "ls": "none"}
                axis.plot([value / each.mapped], [row], marker, label=None if row else label, **style)
        axis.set_yticks(range(len(parameters)), [each.name for each in parameters])
        axis.set(ylim=(len(parameters) - 0.5, -0.5), xlabel="value over mapped truth", xscale="log")
        ticks = [0.5, 0.7, 1.0, 1.5, 2.0, 3.0]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        legend(figure, axis, place="upper center")
    return figure


def casts_figure(demo: Demo) -> Figure:
    """Draw the tip's path to the side for the identified rope and for the rope that made the recording."""
    with new_figure(10.0, 2.9, "Cast, simulated") as figure:
        axis: Any = figure.subplots()
        for run, name, style in (
            (demo.reference, "the rope", {"color": GREY, "lw": 3.0, "alpha": 0.6}),
            (demo.cast, "identified", {"color": BLUE, "lw": 1.2}),
        ):
            axis.plot(run.t, run.tip[:, 0], label=f"{name}, {run.q.shape[1]} links", **style)
        axis.set(xlabel="time, s", ylabel="tip x, m", xlim=(0.0, demo.cast.t[-1]))
        legend(figure, axis, columns=2)
    return figure
