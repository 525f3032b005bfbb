"""The part of the reproduction that is on the paper's timing control (Fig. 13): figure, claim C5, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import paper
from hyperflex.paper import LEADS, READINGS, Reading, timed
from hyperflex.paper.report.part import Part, write_picture
from hyperflex.paper.timing import DURATION, WINDOW
from hyperflex.report.page import Picture, Section
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, look, new_figure, png
from hyperflex.report.tables import TextTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = ("fig13",)
TITLE = "Timing control by the tip's phase"
CLAIMS = "Claim of the paper on timing control, simulated"
LEAD = (
    "Timing control: each half turn of the arm starts t_b before the tip crosses x = 0 (section IV.B), the crossing "
    "predicted exactly, by the model that is simulated."
)
_COLOUR = dict(zip(LEADS, (BLUE, GREEN, RED, GREY), strict=True))
_DASH = dict(zip(LEADS, ("-", ":", "-.", (0, (6.0, 1.5, 1.5, 1.5, 1.5, 1.5))), strict=True))  # as in the paper
_SHOWN = 5.0  # s of the portraits: later turns hide each other
_EDGE = 2.2  # m, whip spikes are cut off here


def write(wanted: Sequence[str], folder: Path, tell: Callable[[str], None]) -> Part:
    """Write the figure to `folder`."""
    tell("simulating the timing control")
    content = png(fig13())
    written = [file for name in wanted for file in write_picture(folder, name, content, paper.fig13())]
    caption = (
        f"Above: the tip's phase portrait in the first {_SHOWN:g} s, cut off at {_EDGE:g} m where the tip cracks like "
        f"a whip (the CSV file is not). Below: the median of r in {WINDOW:g} s. In the paper t_b = 0 is largest in "
        "the end and 0.20 s most efficient on the way; claim C5 tells what is here."
    )
    sections = [
        Section("Figure 13", pictures=(Picture(content, caption),)),
        Section(
            "Radius under the timing control", text=(f"Median of r in each {WINDOW:g} s, m.",), table=levels_table()
        ),
    ]
    return Part(written, paper.timing_claims(), sections)


def levels_table() -> TextTable:
    """Return the median of r in each window, for every reading and t_b."""
    rows = tuple(
        (reading.title, f"{lead:.2f} s", *(f"{level:.2f}" for level in timed(reading, lead).levels))
        for reading in READINGS
        for lead in LEADS
    )
    edges = np.arange(0.0, DURATION, WINDOW)
    return TextTable(("reading", "t_b", *(f"{a:g}-{a + WINDOW:g} s" for a in edges)), rows)


def fig13() -> Figure:
    """Phase portraits and the course of r for the four t_b, in each reading."""
    with look():
        figure = new_figure(12.0, 6.6)
        axes = figure.subplots(2, len(READINGS), sharey="row", height_ratios=(1.6, 1.0))
        for (above, below), reading in zip(axes.T, READINGS, strict=True):
            _portraits(above, reading)
            _levels(below, reading)
        axes[0, 0].set_ylabel("c dx/dt, m   (c = 0.40 s)")
        axes[1, 0].set_ylabel(f"median of r in {WINDOW:g} s, m")
        handles, labels = axes[1, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(LEADS), fontsize=8.5)
        title = f"Timing control, simulated (Fig. 13); above: the first {_SHOWN:g} s"
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
    return figure


def _portraits(axis: Any, reading: Reading) -> None:
    for lead in reversed(LEADS):
        tip = timed(reading, lead).spiral
        shown = tip.t <= _SHOWN
        axis.plot(tip.x[shown], tip.scaled_velocity[shown], color=_COLOUR[lead], ls=_DASH[lead], lw=1.1)
    axis.set(xlim=(-_EDGE, _EDGE), ylim=(-_EDGE, _EDGE), aspect="equal", xlabel="x, m")
    axis.set_title(reading.title.replace(", ", ",\n"), fontsize=8.5)


def _levels(axis: Any, reading: Reading) -> None:
    middle = np.arange(0.5 * WINDOW, DURATION, WINDOW)
    for lead in LEADS:
        label = f"t_b = {lead:.2f} s"
        axis.plot(
            middle, timed(reading, lead).levels, color=_COLOUR[lead], ls=_DASH[lead], marker="o", ms=3, label=label
        )
    axis.set(xlabel="time, s", xlim=(0.0, DURATION), ylim=(0.0, _EDGE))
