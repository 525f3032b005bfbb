"""Pictures of an identification: what was measured, fitted and predicted, and how sure the parameters are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.demo.run import Demo, Parameter
from hyperflex.identification import Identification
from hyperflex.recording import Recording
from hyperflex.report.identification.figures import broken
from hyperflex.report.identification.fitted import beside
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def prediction_figure(recording: Recording, found: Identification, links: tuple[int, ...]) -> Figure:
    """Draw measured angles of some links with the fit and the prediction of the held-out part.

    Parameters
    ----------
    recording : Recording
        What was measured.
    found : Identification
        What was made of it.
    links : tuple of int
        Which links, one panel each, link 0 nearest the motor; the titles count from 1.
    """
    angles, view = recording.angles(), beside(recording, found)
    with look():
        figure = new_figure(10.0, 1.2 + 2.0 * len(links))
        axes = np.atleast_1d(figure.subplots(len(links), 1, sharex=True))
        for axis, link in zip(axes, links, strict=True):
            axis.plot(angles.t, angles.data[:, link], ".", ms=3.0, color=GREY, label="measured")
            broken(axis, view.fit_t, view.fitted[:, link], color=BLUE, label="fitted")
            if found.held_out is not None:
                held = found.held_out
                broken(axis, held.t, held.predicted[:, link], color=RED, lw=1.6, label="predicted without data")
                axis.axvspan(found.settings["fitted_to"], angles.t[-1], color=RED, alpha=0.05, lw=0)
            axis.set_ylabel("angle, rad")
            tip = " (the tip)" if link == recording.n_links - 1 else ""
            axis.set_title(f"link {link + 1} of {recording.n_links}{tip}")
        axes[-1].set(xlabel="time, s", xlim=(angles.t[0], angles.t[-1]))
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=8.5)
        figure.suptitle(recording.name, x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
    return figure


def parameters_figure(parameters: tuple[Parameter, ...]) -> Figure:
    """Draw each parameter over its mapped truth: guess, plain cut, and the identified value with its 95 % interval."""
    with look():
        figure = new_figure(10.0, 1.3 + 0.75 * len(parameters))
        axis: Any = figure.subplots()
        for row, each in enumerate(parameters):
            low, high = each.interval
            axis.plot([low / each.mapped, high / each.mapped], [row, row], color=BLUE, lw=5.0, alpha=0.45)
            _mark(axis, each.value / each.mapped, row, "o", BLUE, "identified, 95 % interval", row == 0)
            _mark(axis, 1.0, row, "|", GREEN, "mapped truth (noise-free fit)", row == 0, size=22.0)
            _mark(axis, each.cut / each.mapped, row, "D", GREY, "the rope simply cut into as many links", row == 0)
            _mark(axis, each.guess / each.mapped, row, "x", RED, "first guess", row == 0)
        axis.set_yticks(range(len(parameters)), [each.name for each in parameters])
        axis.set(ylim=(len(parameters) - 0.5, -0.5), xlabel="value over mapped truth", xscale="log")
        ticks = [0.5, 0.7, 1.0, 1.5, 2.0, 3.0]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8.5)
    return figure


def casts_figure(demo: Demo) -> Figure:
    """Draw the tip's path to the side for the identified rope and for the rope that made the recording."""
    with look():
        figure = new_figure(10.0, 2.9)
        axis: Any = figure.subplots()
        links = (demo.reference.q.shape[1], demo.cast.q.shape[1])
        axis.plot(
            demo.reference.t,
            demo.reference.tip[:, 0],
            color=GREY,
            lw=3.0,
            alpha=0.6,
            label=f"the rope, {links[0]} links",
        )
        axis.plot(demo.cast.t, demo.cast.tip[:, 0], color=BLUE, lw=1.2, label=f"identified, {links[1]} links")
        axis.set(xlabel="time, s", ylabel="tip x, m", xlim=(0.0, demo.cast.t[-1]))
        figure.legend(*axis.get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=8.5)
        figure.suptitle("Cast, simulated", x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
    return figure


def _mark(axis: Any, x: float, y: float, marker: str, colour: str, label: str, first: bool, size: float = 7.0) -> None:
    axis.plot([x], [y], marker, color=colour, ms=size, mew=1.8, label=label if first else None, ls="none")
