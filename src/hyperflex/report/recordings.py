"""The figure of a recording: its channels over time and, of markers, their paths."""

from typing import Any

import numpy as np

from hyperflex.recording import Recording
from hyperflex.report.style import BLUE, GREEN, GREY, RED, Figure, new_figure


def recording_figure(recording: Recording, names: tuple[str, ...] = ()) -> "Figure":
    """Draw a recording: angles in degrees over time; of markers x and y, m, over time, and the paths.

    `names` are those of links or markers, by default their numbers. Of many, some from the first to the last are drawn.
    """
    marked = recording.kind == "markers"
    count = recording.data.shape[1] // (2 if marked else 1)
    names = names or tuple(f"{'marker' if marked else 'link'} {k}" for k in range(count))
    colours = [BLUE, RED, GREEN, GREY, "#7a5ea8", "#c08a2b"]
    shown = np.unique(np.linspace(0, count - 1, min(count, len(colours))).round().astype(int))
    with new_figure(10.0, 4.6, recording.name or "recording") as figure:
        if not marked:
            axis = figure.subplots()
            for k, colour in zip(shown, colours, strict=False):
                axis.plot(recording.t, np.degrees(recording.data[:, k]), color=colour, label=names[k])
            axis.set(xlabel="time, s", ylabel="degrees", title="Angles from hanging")
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=6)
            return figure
        parts: Any = figure.subfigures(1, 2, width_ratios=(1.5, 1.0))
        left, path = parts
        axes = left.subplots(2, 1, sharex=True)
        plane = path.subplots()
        for k, colour in zip(shown, colours, strict=False):
            x, y = recording.data[:, 2 * k], recording.data[:, 2 * k + 1]
            axes[0].plot(recording.t, x, color=colour)
            axes[1].plot(recording.t, y, color=colour)
            plane.plot(x, y, ".-", markersize=2.0, lw=0.6, color=colour, label=names[k])
        axes[0].set(ylabel="x, m", title="Places over time")
        axes[1].set(ylabel="y, m", xlabel="time, s")
        plane.set(xlabel="x, m", ylabel="y, m", title="Paths")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=8.0)
    return figure
