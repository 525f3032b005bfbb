"""The part on online estimation (paper section III D): Fig. 8, claim C8, and who loses how many markers."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.paper import estimation
from hyperflex.paper.estimation import DRAWN, RATE, SINCE, SWINGS, T_SIM, TITLES, TRACKERS, Followed, followed, true_tip
from hyperflex.paper.estimator import SAMPLES
from hyperflex.paper.report.part import Item, Part
from hyperflex.report import BLUE, GREEN, GREY, INK, RED, Picture, Section, TextTable, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOUR = dict(zip(TRACKERS, (BLUE, GREEN, RED, GREY), strict=True))
_MARKER = dict(zip(TRACKERS, "os^v", strict=True))
_FIGURES = {  # of a summary: title, factor to the unit shown
    "captured": (f"captured after {SINCE:g} s, %", 1e2),
    "wrong": ("taken for another, %", 1e2),
    "tip": ("tip at frames, mm", 1e3),
    "between": ("between frames, mm", 1e3),
    "velocity": ("tip velocity, %", 1e2),
    "rates": ("link rates, %", 1e2),
}


def trackers_table() -> TextTable:
    """Return captures and errors of every tracker: the mean over the swings, and the worst in brackets."""
    rows = []
    for name in TRACKERS:
        found = [followed(name, swing.seed).summary() for swing in SWINGS]
        cells = []
        for key, (_, factor) in _FIGURES.items():
            values = [factor * value for each in found if (value := each[key]) is not None]
            worst = min if key == "captured" else max
            cells.append(f"{np.mean(values):.3g} ({worst(values):.3g})" if values else "-")
        rows.append((TITLES[name], *cells))
    return TextTable(("tracker", *(title for title, _ in _FIGURES.values())), tuple(rows))


def fig8() -> "Figure":
    """The tip as it is estimated, the capture rate, and the error of prediction, over time."""
    runs = {name: followed(name, DRAWN.seed) for name in TRACKERS}
    with new_figure(9.0, 8.0, f"Online estimation at {RATE:g} frames/s, rendered (Fig. 8)") as figure:
        tip, rate, error = figure.subplots(3, 1, sharex=True, height_ratios=(1.2, 1.0, 1.0))
        _tip(tip, runs["paper"])
        for name, run in reversed(runs.items()):
            style: Any = {"color": _COLOUR[name], "marker": _MARKER[name], "ms": 3.5, "lw": 1.0, "label": TITLES[name]}
            rate.plot(run.t, 100.0 * run.captured_share, **style)
            error.plot(run.t, 1e3 * run.expected_error, **style)
        rate.set(ylabel="visible markers captured, %", ylim=(-4.0, 104.0))
        error.set(ylabel="error of prediction, mm (rms)", yscale="log", xlabel="time, s")
        legend(figure, tip, rate, place="lower center", columns=4)
    return figure


def _tip(axis: Any, run: Followed) -> None:
    """Draw the tip's x: true, as the paper's estimator has it, and what of it was seen."""
    times = (run.t[:, None] + np.linspace(0.0, T_SIM, SAMPLES + 1)).ravel()
    axis.plot(times, true_tip(run.seen)[..., 0].ravel(), color=GREY, lw=3.0, alpha=0.5, label="true")
    axis.plot(times, run.tip[..., 0].ravel(), color=INK, lw=0.9, label="estimated, continuous")
    seen = run.captured[:, -1]
    axis.plot(run.t[seen], run.places[seen, -1, 0], "o", color=BLUE, ms=4.0, label="captured")
    lost = ~seen & ~np.isnan(run.expected[:, -1, 0])
    axis.plot(run.t[lost], run.expected[lost, -1, 0], "x", color=RED, ms=6.0, mew=1.5, label="not captured: predicted")
    axis.set(ylabel="x of the tip, m")


def _sections(_: list[Section], pictures: tuple[Picture, ...]) -> list[Section]:
    text = (
        f"Means over {len(SWINGS)} swings, the worst in brackets. After {SINCE:g} s; errors are rms, those of velocity "
        "and rates over the rms of the true ones; between frames the tip is foretold. A tracker that finds fewer than "
        "70 % of the markers in their windows searches the whole picture, which counts as a loss in that frame."
    )
    return [
        Section("Figure 8", pictures=pictures),
        Section("Trackers compared", text=(text,), table=trackers_table()),
    ]


_CAPTION = (
    "Above: the tip as the paper's estimator (Fig. 7) has it, at all times; the rope is first seen in the middle of "
    "its swing, when rates are not known. Middle: the part of the visible markers found where they were looked for and "
    "rightly named. Below: how far markers were from where they were expected. Beside it our own filter and two "
    "trackers without dynamics."
)
PART = Part(
    title="Online estimation by a camera",
    lead=(
        "Online estimation: simulate t_sim ahead, look for the markers there, take the prediction where they are not "
        "found, correct (section III D); a free swing of a rope of 100 links, rendered."
    ),
    claims_title="Claim of the paper on online estimation, rendered",
    message="rendering and following swings",
    items={"fig8": Item(estimation.fig8, fig8, _CAPTION)},
    claims=estimation.estimation_claims,
    sections=_sections,
)
