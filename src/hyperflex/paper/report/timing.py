"""The part on the paper's timing control: Fig. 13, claim C5, and the table of radii."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.paper import timing
from hyperflex.paper.casting import READINGS, Reading
from hyperflex.paper.report.part import Item, Part
from hyperflex.paper.timing import DURATION, LEADS, WINDOW, timed
from hyperflex.report import BLUE, GREEN, GREY, RED, Picture, Section, TextTable, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOUR = dict(zip(LEADS, (BLUE, GREEN, RED, GREY), strict=True))
_DASH = dict(zip(LEADS, ("-", ":", "-.", (0, (6.0, 1.5, 1.5, 1.5, 1.5, 1.5))), strict=True))  # as in the paper
_SHOWN = 5.0  # s of the portraits: later turns hide each other
_EDGE = 2.2  # m, whip spikes are cut off here


def levels_table() -> TextTable:
    """Return the median of r in each window, for every reading and t_b."""
    rows = tuple(
        (reading.title, f"{lead:.2f} s", *(f"{level:.2f}" for level in timed(reading, lead).levels))
        for reading in READINGS
        for lead in LEADS
    )
    edges = np.arange(0.0, DURATION, WINDOW)
    return TextTable(("reading", "t_b", *(f"{a:g}-{a + WINDOW:g} s" for a in edges)), rows)


def fig13() -> "Figure":
    """Phase portraits and the course of r for the four t_b, in each reading."""
    with new_figure(12.0, 6.6, f"Timing control, simulated (Fig. 13); above: the first {_SHOWN:g} s") as figure:
        axes = figure.subplots(2, len(READINGS), sharey="row", height_ratios=(1.6, 1.0))
        for (above, below), reading in zip(axes.T, READINGS, strict=True):
            _portraits(above, reading)
            _levels(below, reading)
        axes[0, 0].set_ylabel("c dx/dt, m   (c = 0.40 s)")
        axes[1, 0].set_ylabel(f"median of r in {WINDOW:g} s, m")
        legend(figure, axes[1, 0])
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


def _sections(_: list[Section], pictures: tuple[Picture, ...]) -> list[Section]:
    levels = f"Median of r in each {WINDOW:g} s, m."
    return [
        Section("Figure 13", pictures=pictures),
        Section("Radius under the timing control", text=(levels,), table=levels_table()),
    ]


_CAPTION = (
    f"Above: the tip's phase portrait in the first {_SHOWN:g} s, cut off at {_EDGE:g} m where the tip cracks like "
    f"a whip (the CSV file is not). Below: the median of r in {WINDOW:g} s. In the paper t_b = 0 is largest in "
    "the end and 0.20 s most efficient on the way; claim C5 says what it is here."
)
PART = Part(
    title="Timing control by the tip's phase",
    lead=(
        "Timing control: each half turn of the arm starts t_b before the tip crosses x = 0 (section IV.B), the "
        "crossing predicted exactly, by the model that is simulated."
    ),
    claims_title="Claim of the paper on timing control, simulated",
    message="simulating the timing control",
    items={"fig13": Item(timing.fig13, fig13, _CAPTION)},
    claims=timing.timing_claims,
    sections=_sections,
)
