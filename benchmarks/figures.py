"""The benchmarks' pictures."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

Points = Sequence[tuple[float, float]]
MARKERS = "osD^vP*X<>"
COLOURS = ("#d1495b", "#e08e1b", "#00798c", "#30638e", "#6a4c93", "#8d6346", "#5b8c5a", "#666666")


def work_precision(groups: Mapping[tuple[str, str], Points], good: float, remark: str, path: Path) -> None:
    """Draw time (ms per simulated second) against error (mm): a colour for each simulator, a line for each method."""
    axes = _axes()
    axes.axvspan(good, 1e6, color="#f0f0f0", zorder=0)
    axes.axvline(good, color="#999999", lw=1, ls="--", zorder=1)
    colours: dict[str, str] = {}
    for k, ((simulator, method), points) in enumerate(groups.items()):
        colour = colours.setdefault(simulator, COLOURS[len(colours) % len(COLOURS)])
        _line(axes, points, f"{simulator}: {method}", MARKERS[k % len(MARKERS)], colour)
    errors = [x for points in groups.values() for x, _ in points]
    axes.set_xlim(0.3 * min(errors), 4.0 * max(errors))
    axes.text(good, 0.25, f" {good:g} mm", transform=axes.get_xaxis_transform(), color="#777777")
    axes.set_xlabel("error of the tip, the larger of those at 2 s and 5 s, mm")
    axes.set_ylabel("ms per simulated second")
    _save(axes, "The paper's cast, 50 links: work against precision", path, remark)


def against_links(groups: Mapping[str, Points], title: str, label: str, path: Path) -> None:
    """Draw a cost against the number of links."""
    axes = _axes()
    for k, (name, points) in enumerate(groups.items()):
        _line(axes, points, name, MARKERS[k % len(MARKERS)], COLOURS[k % len(COLOURS)])
    axes.set_xlabel("number of links n")
    axes.set_ylabel(label)
    _save(axes, title, path)


def against_settings(panels: Mapping[str, Mapping[str, Points]], good: float, title: str, path: Path) -> None:
    """Draw errors (mm) against a setting, one panel for each kind of setting, whose name labels the axis."""
    figure = Figure(figsize=(8.5, 4.8), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (label, groups) in zip(figure.subplots(1, len(panels), sharey=True), panels.items(), strict=True):
        _logarithmic(axes)
        axes.axhline(good, color="#999999", lw=1, ls="--", zorder=1)
        for k, (name, points) in enumerate(groups.items()):
            _line(axes, points, name, MARKERS[k], COLOURS[k])
        axes.set_xlabel(label)
        if max(axes.get_xlim()) < 30.0 * min(axes.get_xlim()):  # no power of ten, or only one, for labels
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
            axes.xaxis.set_major_formatter(
                FuncFormatter(lambda value, _: f"{value:g}" if value >= 1e-3 else f"{value:.0e}")
            )
            axes.xaxis.set_minor_locator(NullLocator())
    axes.text(
        1.0, good, f"{good:g} mm ", transform=axes.get_yaxis_transform(), ha="right", va="bottom", color="#777777"
    )
    figure.axes[0].set_ylabel("error of the tip, mm")
    figure.axes[0].legend(frameon=False, fontsize=9)
    figure.suptitle(title, x=0.02, ha="left")
    figure.savefig(path)


def _axes() -> Axes:
    figure = Figure(figsize=(8.5, 7.5), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _logarithmic(axes)
    return axes


def _logarithmic(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major", color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _line(axes: Axes, points: Points, label: str, marker: str, colour: str) -> None:
    """Draw points in the order of their first coordinate; hollow, so that overlapping ones stay visible."""
    x, y = zip(*sorted(points), strict=True)
    axes.plot(x, y, color=colour, marker=marker, ms=8, mfc="none", mew=1.6, lw=1.0, label=label)


def _save(axes: Axes, title: str, path: Path, remark: str = "") -> None:
    axes.set_title(title, loc="left")
    legend = axes.figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    legend.set_title("\n".join(textwrap.wrap(remark, 100)), prop={"size": 9})
    axes.figure.savefig(path)
