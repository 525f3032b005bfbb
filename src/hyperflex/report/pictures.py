"""Pictures and films of a run on a dark ground: arm, rope, path of the tip and obstacles, drawn with Matplotlib."""

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks, files
from hyperflex.checks import Array, ByName
from hyperflex.errors import InvalidInput
from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.report.scene import PLAIN, Overlay, last_sweep, shapes, span, view, wall_ends
from hyperflex.report.style import Axes, Figure, new_figure, style_context
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from PIL import Image

NIGHT, PALE, GROUND = "#0c1322", "#aab6c8", "#1c263a"
ROPE, TRAIL, PEG, OBSTACLE = "#f2d479", "#4fc3c0", "#d65c46", "#a07be0"
_FIRST_TO_LAST = ("#27406b", "#2f7fb5", TRAIL, ROPE, "#ff8a4c")  # colours of a strobe's instants
_DPI = 100  # pixels an inch of a film


def strobe_figure(
    run: Trajectory,
    *,
    start: float | None = None,
    end: float | None = None,
    count: int = 48,
    title: str = "",
    width: float = 9.0,
    overlay: Overlay = PLAIN,
    near: tuple[Array, float] | None = None,
    ax: "Axes | None" = None,
) -> "Figure":
    """Draw the rope at `count` instants of a run, early ones dark, late ones bright, with the path of the tip.

    A bar in the lower left corner shows the colours with the first and the last time.

    Parameters
    ----------
    run : Trajectory
    start, end : float, optional
        First and last instant, s; with neither, the last sweep of the rope (:func:`last_sweep`).
    count : int
        Number of instants, at least 2.
    title : str
        Text in the upper left corner.
    width : float
        Width of the picture, inches; the height follows from the rope's reach.
    overlay : Overlay
        Targets, and obstacles, whose colour the title then explains.
    near : (2,) array_like and float, optional
        Centre and half width, m, of what is shown, in place of all that the rope reaches.
    ax : matplotlib.axes.Axes, optional
        Axes to draw into, in place of a new figure.

    Raises
    ------
    InvalidInput
        If the instants are fewer than 2 or not within the run.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    first, last = last_sweep(run) if start is None and end is None else span(run, start, end)
    times = np.linspace(first, last, checks.count("count", count, least=2))
    drawn, along = shapes(run, times), np.linspace(first, last, 800)
    trail = shapes(run, along).joints[:, -1]
    points = np.concatenate([drawn.joints.reshape(-1, 2), trail, drawn.pivots, overlay.targets])
    low, high = view(run, points, above=1.5) if near is None else (near[0] - near[1], near[0] + near[1])
    with _dark_axes(ax, width, width * (high[1] - low[1]) / (high[0] - low[0])) as axis:
        _stage(axis, run, low, high, overlay)
        fade = np.linspace(0.35, 1.0, count) ** 1.5
        dusk: Any = {
            "cmap": LinearSegmentedColormap.from_list("dusk", _FIRST_TO_LAST),
            "norm": Normalize(first, last),
        }
        for glow, opacity in ((5.5, 0.07), (3.0, 0.16), (1.4, 1.0)):
            glowing = {"array": times, "alpha": opacity * fade, "capstyle": "round", **dusk}
            axis.add_collection(LineCollection(list(drawn.joints), linewidths=glow, **glowing))
        axis.add_collection(LineCollection(_pieces(trail), array=along[:-1], linewidths=0.7, alpha=0.55, **dusk))
        tips = drawn.joints[:, -1].T
        axis.scatter(tips[0], tips[1], s=7.0, c=times, zorder=3, lw=0, **dusk)
        if run.setup.arm is not None:
            arms = list(np.stack([drawn.pivots, drawn.joints[:, 0]], axis=1))
            axis.add_collection(LineCollection(arms, colors=PALE, linewidths=1.0, alpha=0.12))
            axis.plot(*arms[-1].T, color="white", lw=2.6, zorder=5)
        axis.plot(*drawn.pivots[-1], "o", color="white", ms=5.5, mec=NIGHT, mew=1.2, zorder=6)
        length = 10.0 ** np.floor(np.log10(0.4 * (high[0] - low[0])))
        scale = 0.97 - length / (high[0] - low[0]), 0.97  # a bar of a round length in the lower right corner
        axis.plot(scale, [0.045, 0.045], color=PALE, lw=1.2, transform=axis.transAxes)
        style: Any = {"transform": axis.transAxes, "color": PALE, "fontsize": 8.0}
        axis.text(np.mean(scale), 0.057, f"{length:g} m", ha="center", **style)
        words = f"{title}; violet: obstacles" if overlay.obstacles else title
        style |= {"color": "white", "fontsize": 11.0, "fontweight": "bold"}
        axis.text(0.018, 0.965, words, va="top", bbox={"facecolor": NIGHT, "lw": 0.0, "alpha": 0.8}, **style)
        key = axis.inset_axes((0.03, 0.04, 0.26, 0.012))  # the colours, in the lower left corner
        style = {"orientation": "horizontal", "ticklocation": "top", "ticks": (first, last), "format": "%.2f s"}
        axis.figure.colorbar(ScalarMappable(**dusk), cax=key, **style).outline.set_visible(False)
        key.tick_params(colors=PALE, labelsize=8.0, length=0.0)
        low_label, high_label = key.get_xticklabels()
        low_label.set_horizontalalignment("left")
        high_label.set_horizontalalignment("right")
    return axis.figure  # type: ignore[return-value] # or the subfigure of a user's axes


def animate(
    run: Trajectory,
    path: str | Path,
    *,
    start: float | None = None,
    end: float | None = None,
    frame_rate: int = 25,
    speed: float = 1.0,
    width: int = 640,
    title: str = "",
    overlay: Overlay = PLAIN,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write an animated GIF, or an MP4 video, of a run, whole or not at all.

    Parameters
    ----------
    run : Trajectory
    path : path-like
        File to write: a name that ends in .gif or .mp4.
    start, end : float, optional
        Simulated time to show, s; the whole run by default.
    frame_rate : int
        Frames per second; of a GIF 10, 20, 25 or 50.
    speed : float
        Simulated seconds per second of the film, > 0.
    width : int
        Width of the picture, pixels; the height follows from the rope's reach.
    title : str
        Text in the upper left corner.
    overlay : Overlay
        Trail of the tip, targets, obstacles, and a note, which has as many lines at each time.
    progress : callable, optional
        Called with the numbers of frames done and in all.

    Raises
    ------
    InvalidInput
        If the file's suffix, the frame rate, the speed or the times cannot be used.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".gif", ".mp4"):
        allowed = "a name ending in .gif or .mp4"
        raise InvalidInput("animation has an unknown kind of file", got=str(path), allowed=allowed)
    rate = checks.count("frame_rate", frame_rate, most=240)
    if suffix == ".gif" and (100 % rate or rate > 50):  # viewers slow down frames of less than 0.02 s
        allowed = "10, 20, 25 or 50 frames per second: a GIF counts in hundredths of a second"
        raise InvalidInput("frame_rate does not fit a GIF", got=frame_rate, allowed=allowed)
    step = checks.positive("speed", speed) / frame_rate
    first, last = span(run, start, end)
    times = np.arange(first, last + 0.5 * step, step)
    draw = _film(run, times, checks.count("width", width, least=64), title, overlay)

    def frames() -> "Iterator[Image.Image]":
        for k in range(times.size):
            yield draw(k)
            if progress is not None:
                progress(k + 1, times.size)

    if suffix == ".gif":
        files.write_bytes(path, _gif(frames(), draw(times.size - 1), frame_rate))
        return
    from hyperflex.vision import VideoWriter

    with VideoWriter(path, draw(0).size) as video:
        for k, frame in enumerate(frames()):
            video.write(np.asarray(frame)[..., ::-1], k / frame_rate)  # blue, green, red


def _film(run: Trajectory, times: Array, width: int, title: str, overlay: Overlay) -> "Callable[[int], Image.Image]":
    """Return a function that draws frame k at ``times[k]``, s."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba_array
    from PIL import Image

    note = overlay.note or (lambda _: "")
    low, high = view(run, np.concatenate([run.joints.reshape(-1, 2), overlay.targets]), above=2.0)
    header = 0 if overlay.note is None else 18 * (note(float(times[-1])).count("\n") + 2)  # pixels, for the note
    height = header + 2 * round(0.5 * width * (high[1] - low[1]) / (high[0] - low[0]))
    with new_figure(width / _DPI, height / _DPI, layout=None) as figure:
        figure.set_dpi(_DPI)
        figure.set_facecolor(NIGHT)
        axis = figure.add_axes((0.0, 0.0, 1.0, 1.0 - header / height))
        _stage(axis, run, low, high, overlay)
        for line in (axis.axhline, axis.axvline):
            line(0.0, color=GROUND, lw=0.7, zorder=0)
        opacities = (0.07, 0.13, 0.2, 0.27, 0.33, 1.0)  # of five earlier ropes, and the rope now
        ropes = LineCollection([], linewidths=[0.8] * 5 + [2.1], colors=to_rgba_array(ROPE, opacities))
        trail = LineCollection([], linewidths=1.4, colors=to_rgba_array(TRAIL, np.linspace(0.15, 0.9, 79)))
        axis.add_collection(ropes)
        axis.add_collection(trail)
        (arm,) = axis.plot([], [], color="white", lw=3.5)
        dots = axis.scatter([0.0, 0.0], [0.0, 0.0], s=30.0, color="white", zorder=5)
        place: ByName = {"va": "top", "x": 14.0 / width, "linespacing": 1.35}
        figure.text(y=1.0 - 12.0 / height, s=title, fontsize=10.0, color="white", **place)
        text = figure.text(y=1.0 - 33.0 / height, s="", fontsize=8.5, color=PALE, **place)
    moving = (trail, ropes, dots, arm, text)
    for artist in moving:
        artist.set_animated(True)
    canvas: Any = figure.canvas
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    step = times[1] - times[0] if times.size > 1 else 0.0

    def draw(k: int) -> Image.Image:
        t, start = float(times[k]), run.t[0]
        now = shapes(run, np.maximum(t - step * np.arange(5.0, -1.0, -1.0), start))
        ropes.set_segments(list(now.joints))
        trail.set_segments(_pieces(shapes(run, np.linspace(max(t - overlay.trail, start), t, 80)).joints[:, -1]))
        arm.set_data(*np.stack([now.pivots[-1], now.joints[-1, 0]]).T)
        dots.set_offsets(np.stack([now.pivots[-1], now.joints[-1, -1]]))
        text.set_text(f"t = {t:5.2f} s\n{note(t)}")
        canvas.restore_region(background)
        for artist in moving:
            figure.draw_artist(artist)
        return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")

    return draw


def _gif(frames: "Iterator[Image.Image]", colours: "Image.Image", frame_rate: int) -> bytes:
    """Return frames as an animated GIF, all with the palette of a picture with all `colours`."""
    from PIL import Image

    palette = colours.quantize(96)
    indexed = (each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames)
    buffer, duration = io.BytesIO(), 1000 // frame_rate
    options: ByName = {"save_all": True, "append_images": indexed, "loop": 0, "optimize": False}
    next(indexed).save(buffer, format="GIF", duration=duration, **options)
    return buffer.getvalue()


@contextmanager
def _dark_axes(ax: "Axes | None", width: float, height: float) -> "Iterator[Axes]":
    """Give the user's axes, in the package's style until the end of the block, or axes that fill a new figure."""
    if ax is None:
        with new_figure(width, height, layout=None) as figure:
            figure.set_facecolor(NIGHT)
            yield figure.add_axes((0.0, 0.0, 1.0, 1.0))
        return
    with style_context():
        ax.set_aspect("equal")
        yield ax


def _stage(axis: "Axes", run: Trajectory, low: Array, high: Array, overlay: Overlay) -> None:
    """Set up dark axes, m, without ticks, with the pegs, walls and grounds of the run and the targets."""
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), facecolor=NIGHT, xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    for each in run.setup.pegs:
        draw_obstacle(axis, each, 10.0 * float((high - low).max()), OBSTACLE if each in overlay.obstacles else PEG)
    axis.plot(*overlay.targets.T, "o", ms=15.0, mfc="none", mec=PEG, mew=1.8, zorder=7)


def draw_obstacle(axis: Any, obstacle: Obstacle, far: float, colour: str) -> Any:
    """Draw a peg, wall or ground and return it; only the surface of a ground has an obstacle's colour."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if isinstance(obstacle, Peg):
        outline = Path.circle((obstacle.x, obstacle.y), obstacle.radius)
        style: Any = {"facecolor": colour, "edgecolor": colour, "lw": 0.7, "zorder": 1}  # below the rope
    elif isinstance(obstacle, Wall):
        outline, style = Path(wall_ends(obstacle)), {"facecolor": "none", "edgecolor": colour, "lw": 2.2, "zorder": 4}
    else:
        out = np.array([obstacle.nx, obstacle.ny]) / np.hypot(obstacle.nx, obstacle.ny)
        sides = np.array([[-1, 0], [1, 0], [1, -1], [-1, -1], [-1, 0]])  # along the surface, and out of the ground
        corners = np.array([obstacle.x, obstacle.y]) + far * sides @ np.array([[-out[1], out[0]], out])
        outline = Path(corners, closed=True)
        style = {"facecolor": GROUND, "edgecolor": colour if colour == OBSTACLE else GROUND, "lw": 2.2, "zorder": 0}
    return axis.add_patch(PathPatch(outline, **style))


def _pieces(path: Array) -> list[Array]:
    """Return the pieces (2, 2) of a path (k, 2), one for each colour."""
    return list(np.stack([path[:-1], path[1:]], axis=1))
