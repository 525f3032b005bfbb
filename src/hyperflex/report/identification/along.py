"""Parameters that each link has of its own, drawn along the rope."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hyperflex.identification import Identification
from hyperflex.model import Rope
from hyperflex.report.identification.parameters import Number, numbers
from hyperflex.report.style import BLUE, GREY, look, new_figure
from hyperflex.report.units import readable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST = 6  # links; fewer are read in a table


def along_figure(found: Identification, guess: Rope | None = None) -> Figure | None:
    """Draw each property that many links have of their own, with 95 % intervals; None where there is no such one."""
    own: dict[str, list[Number]] = {}
    for each in numbers(found):
        if each.place is not None and each.name != "arc":
            own.setdefault(each.name, []).append(each)
    wanted = {name: each for name, each in own.items() if len(each) >= LEAST}
    if not wanted:
        return None
    with look():
        figure = new_figure(10.0, 0.5 + 2.0 * len(wanted))
        axes = figure.subplots(len(wanted), 1, squeeze=False, sharex=True)[:, 0]
        for axis, (name, every) in zip(axes, wanted.items(), strict=True):
            places = np.array([each.place for each in every])
            values, low, high = (np.array([getattr(each, key) for each in every]) for key in ("value", "low", "high"))
            unit = readable(name, values)
            axis.vlines(places, low / unit.size, high / unit.size, color=BLUE, lw=2.0, alpha=0.45)
            axis.plot(places, values / unit.size, "o", ms=4.0, color=BLUE, label="identified, 95 % interval")
            if guess is not None:
                start = getattr(guess, name)[places] / unit.size
                axis.plot(places, start, "x", ms=4.0, color=GREY, label="first guess")
            axis.set(ylabel=unit.name, title=name.replace("_", " "))
        axes[-1].set_xlabel("link, from the first joint to the tip")
        axes[-1].locator_params(axis="x", integer=True)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=8.5)
    return figure
