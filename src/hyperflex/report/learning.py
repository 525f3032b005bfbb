"""The figure of learning from casts."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, Figure, legend, new_figure

if TYPE_CHECKING:
    from hyperflex.execution import Attempt


def learning_figure(ways: "Mapping[str, Sequence[Attempt]]") -> "Figure":
    """Draw the attempts of one or more ways of learning: distance from the strike that winds, and what wound.

    `ways` are attempts by the name of their way, four at most.
    """
    with new_figure(6.4, 3.8, "Learning from each cast") as figure:
        axis = figure.subplots()
        for (name, attempts), colour in zip(ways.items(), (BLUE, RED, GREEN, GREY), strict=False):
            number = np.array([each.number for each in attempts])
            distance = np.array([1e3 * each.position for each in attempts])
            axis.plot(number, distance, color=colour, label=name)
            wound = np.array([bool(each.wound) for each in attempts])
            for some, face in ((wound, colour), (~wound, "white")):
                axis.scatter(number[some], distance[some], s=46, facecolor=face, edgecolor=colour, zorder=3)
        for face, label in ((INK, "wound"), ("white", "missed")):
            axis.scatter([], [], s=46, facecolor=face, edgecolor=INK, label=label)
        axis.set(xlabel="cast", ylabel="distance from the strike aimed at, mm", yscale="log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.set_xticks(range(1, 1 + max(len(attempts) for attempts in ways.values())))
        legend(figure, axis, place="lower center", columns=6)
    return figure
