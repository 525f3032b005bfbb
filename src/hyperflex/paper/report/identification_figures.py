"""Pictures of the paper's Figs. 3, 5 and 6 from the identification twin of :mod:`hyperflex.paper`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import paper
from hyperflex.paper import SMALL, SWINGS, Swing, record, revised
from hyperflex.paper.identification import FEW, LINKS, NOISE, motion
from hyperflex.paper.identification_figures import CURVES
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRAMES = 40  # of calculated curves, in each second
PAPER_FIG6 = {22: 0.046, 81: 0.040}  # rad^2, as printed
COLOURS = (BLUE, RED, GREEN)


def fig3() -> Figure:
    """Initial angles, measured and optimised, and the tip's error that follows from each."""
    with look():
        figure = new_figure(9.4, 5.8)
        for row, swing in zip(figure.subplots(len(SWINGS), 2, width_ratios=(1, 2.2)), SWINGS, strict=True):
            _starts(row[0], swing)
            _errors(row[1], swing)
        _head(figure, "Measured and optimised initial angles, simulated (Fig. 3)")
    return figure


def _starts(axis: Any, swing: Swing) -> None:
    link = np.arange(1, LINKS + 1)
    axis.axhline(0.0, color=GREY, lw=1.0, label="true")
    for q, marker, colour, label in (
        (record(swing).data[0], "o", RED, "measured"),
        (revised(swing).best.q, "s", BLUE, "optimised"),
    ):
        axis.plot(link, 1e3 * (q - swing.angle), marker, color=colour, ms=5.5, label=label)
    axis.set(xticks=link, xlabel="link", ylabel="off the truth, mrad")
    axis.set_title(f"initial angles, let go at {swing.angle:g} rad")
    axis.margins(x=0.12, y=0.15)
    axis.legend(fontsize=8.0, loc="best")


def _errors(axis: Any, swing: Swing) -> None:
    recording, found = record(swing), revised(swing)
    for q, marker, colour, error in (
        (recording.data[0], "o", RED, found.best.measured_start),
        (found.best.q, "s", BLUE, found.error),
    ):
        start = np.append(q, np.zeros(LINKS))
        away = recording.data[:, -1] - motion(found.rope, start, recording.t)[:, -1]
        axis.plot(recording.t, 1e3 * away, marker, ls="-", lw=0.7, color=colour, ms=2.8, label=f"E = {error:.4f} rad²")
    axis.axhspan(-1e3 * NOISE, 1e3 * NOISE, color=GREY, alpha=0.15, lw=0, label="noise (rms)")
    axis.set(xlabel="time, s", ylabel="left over, mrad", xlim=(0.0, recording.t[-1]))
    axis.set_title("tip link: measured less calculated from either start")
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.3 * (high - low))
    axis.legend(fontsize=8.0, loc="upper right", ncols=3)


def fig5() -> Figure:
    """Tip angle against time: measured, calculated by the revision, and with the first guess."""
    recording, found, first = record(SMALL), revised(SMALL), revised(SMALL).rounds[0]
    t = np.linspace(0.0, recording.t[-1], round(recording.t[-1] * FRAMES) + 1)
    guess = found.rope.replace(inertia=np.full(LINKS, first.inertia), friction=np.full(LINKS, first.friction))
    cases = (
        (guess, first.q, RED, (0, (4.0, 1.6)), "first guess (CM), its best start"),
        (found.rope, found.best.q, BLUE, "-", "revised (IR)"),
    )
    with look():
        figure = new_figure(9.4, 4.9)
        top, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1))
        below.axhspan(-1e3 * NOISE, 1e3 * NOISE, color=GREY, alpha=0.15, lw=0, label="noise (rms)")
        for rope, q, colour, dash, label in cases:
            start = np.append(q, np.zeros(LINKS))
            top.plot(t, motion(rope, start, t)[:, -1], color=colour, ls=dash, label=label)
            away = recording.data[:, -1] - motion(rope, start, recording.t)[:, -1]
            below.plot(recording.t, 1e3 * away, "o", ls="-", lw=0.6, ms=2.6, color=colour)
        top.plot(recording.t, recording.data[:, -1], "o", ms=4.2, mfc="none", mec=INK, mew=0.9, label="measured")
        top.set(ylabel="angle of link 5, rad", xlim=(0.0, recording.t[-1]))
        below.set(ylabel="left over, mrad", xlabel="time, s")
        top.legend(fontsize=8.5, loc="upper right", ncols=3)
        below.legend(fontsize=8.0, loc="lower left")
        _head(figure, f"Angle of the rope's tip, simulated, let go at {SMALL.angle:g} rad (Fig. 5)")
    return figure


def fig6() -> Figure:
    """E over all samples against how many of them were used."""
    table = paper.fig6()
    counts = table.columns["samples"]
    with look():
        figure = new_figure(7.6, 4.4)
        axis = figure.subplots()
        for swing, colour in zip(CURVES, COLOURS, strict=False):
            axis.plot(counts, table.columns[f"error_{swing.key}"], "o-", ms=4.5, color=colour, label=swing.title)
        axis.plot(*zip(*PAPER_FIG6.items(), strict=True), "D", ms=6.5, mfc="none", mec=INK, mew=1.3, label="the paper")
        axis.axvline(FEW, color=GREY, lw=0.8, ls=(0, (4.0, 2.0)))
        axis.set(xlabel="samples used, from the first on", ylabel="E over all 81 samples, rad²", ylim=(0.0, None))
        axis.annotate("3 s", (FEW, 0.0), (4, 4), textcoords="offset points", color=GREY, fontsize=8.5)
        axis.legend(fontsize=8.5, loc="upper right")
        _head(figure, "Identification error and samples used, simulated (Fig. 6)")
    return figure


def _head(figure: Figure, title: str) -> None:
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
