"""Animations of a run: arm, rope and the tip's trail as a GIF or an MP4 video, drawn with Pillow."""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg, Wall
from hyperflex.report.shapes import NO_TARGETS, ground_corners, shapes, span, view, wall_ends
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from PIL import Image

FrameProgress = Callable[[int, int], None]
Note = Callable[[float], str]
Colour = tuple[int, int, int]

_NIGHT, _PALE, _WHITE = (12, 19, 34), (170, 182, 200), (255, 255, 255)
_ROPE, _TRAIL, _GRID, _PEG = (242, 212, 121), (79, 195, 192), (28, 38, 58), (214, 92, 70)
_FINE = 2  # frames are drawn this much larger, then shrunk, for smooth edges
_GHOSTS = 5
_LINE = 18  # pixels from one line of words to the next
_TRAIL_POINTS = 80
_RING = 8 * _FINE  # radius of the ring round a point, pixels


@dataclass(frozen=True)
class _View:
    """Where metres lie on the canvas: origin (pixels of x = y = 0) and scale (pixels per metre)."""

    width: int
    height: int
    origin: tuple[float, float]
    scale: float

    def pixels(self, points: Array) -> list[tuple[float, float]]:
        x = self.origin[0] + self.scale * points[:, 0]
        y = self.origin[1] - self.scale * points[:, 1]
        return list(zip(x.tolist(), y.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class _Scene:
    """What every frame shows: a run, where it lies, how long the tip's path stays, s, and points (k, 2) to mark, m."""

    run: Trajectory
    view: _View
    trail: float
    targets: Array


def animate(
    run: Trajectory,
    path: str | Path,
    *,
    start: float | None = None,
    end: float | None = None,
    frame_rate: int = 25,
    speed: float = 1.0,
    width: int = 640,
    trail: float = 0.8,
    title: str = "",
    note: Note | None = None,
    targets: Array | None = None,
    progress: FrameProgress | None = None,
) -> None:
    """Write an animated GIF, or an MP4 video, of a run, whole or not at all.

    Parameters
    ----------
    run, path
        What to show, and where to write: a name that ends in .gif or .mp4.
    start, end : float, optional
        Simulated time to show, s; the whole run by default.
    frame_rate : int
        Frames per second; of a GIF 10, 20, 25 or 50, as it counts in hundredths of a second.
    speed : float
        Simulated seconds per second of the film, > 0.
    width : int
        Of the picture, pixels; the height follows from the rope's reach.
    trail : float
        How long the tip's path stays visible, s.
    title, note : str, callable, optional
        Written in the upper left corner, above the time; called with the simulated time, s, for what to write below.
    targets : (k, 2) float64, optional
        Points to mark with a ring, m.
    progress : callable, optional
        Called with (frames done, frames in all).

    Raises
    ------
    InvalidInput
        Another suffix, frame rate, speed or span than allowed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".gif", ".mp4"):
        allowed = "a name ending in .gif or .mp4"
        raise InvalidInput("animation has an unknown kind of file", got=str(path), allowed=allowed)
    if checks.count("frame_rate", frame_rate, most=240) not in (10, 20, 25, 50) and suffix == ".gif":
        raise InvalidInput(
            "frame_rate does not fit a GIF", got=frame_rate, allowed="10, 20, 25 or 50 frames per second"
        )
    pace = checks.number("speed", speed, sign="positive") / frame_rate
    first, last = span(run, start, end)
    times = np.arange(first, last + 0.5 * pace, pace)
    targets = NO_TARGETS if targets is None else targets
    room = 0 if note is None else _LINE * (note(float(times[-1])).count("\n") + 2)
    scene = _Scene(run, _view(run, targets, checks.count("width", width, least=64), room), trail, targets)
    frames = _frames(scene, times, (title, note), progress)
    if suffix == ".gif":
        files.write_bytes(path, _gif(frames, frame_rate))
        return
    from hyperflex.vision import VideoWriter

    with VideoWriter(path, (scene.view.width // _FINE, scene.view.height // _FINE)) as video:
        for number, frame in enumerate(frames):
            video.write(np.asarray(frame)[..., ::-1], number / frame_rate)  # blue first


def _gif(frames: "Iterator[Image.Image]", frame_rate: int) -> bytes:
    from PIL import Image

    palette = Image.new("P", (1, 1))
    palette.putpalette([value for colour in _PALETTE for value in colour])
    indexed = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    buffer = io.BytesIO()
    next(indexed).save(
        buffer, format="GIF", save_all=True, append_images=indexed, duration=1000 // frame_rate, loop=0, optimize=False
    )
    return buffer.getvalue()


def _view(run: Trajectory, targets: Array, width: int, room: int) -> _View:
    """Fit everything that the rope and the arm reach into the canvas, below `room` pixels for words."""
    low, high = view(run, np.concatenate([run.joints.reshape(-1, 2), targets]), above=2.0)
    scale = _FINE * width / (high[0] - low[0])
    height = room + round((high[1] - low[1]) * scale / _FINE / 2) * 2
    origin = (float(-low[0] * scale), float(high[1] * scale) + _FINE * room)
    return _View(_FINE * width, _FINE * height, origin, float(scale))


def _frames(
    scene: _Scene, times: Array, words: tuple[str, Note | None], progress: FrameProgress | None
) -> "Iterator[Image.Image]":
    from PIL import Image, ImageDraw, ImageFont

    view = scene.view
    step = times[1] - times[0] if times.size > 1 else 0.0
    fonts = (ImageFont.load_default(14 * _FINE), ImageFont.load_default(12 * _FINE))
    for number, time in enumerate(times):
        image = Image.new("RGB", (view.width, view.height), _NIGHT)
        draw = ImageDraw.Draw(image)
        _draw_scene(draw, scene, time, step)
        corner = 14 * _FINE
        title, note = words
        text = f"t = {time:5.2f} s" if note is None else f"t = {time:5.2f} s\n{note(float(time))}"
        draw.text((corner, corner), title, fill=_WHITE, font=fonts[0])
        draw.multiline_text((corner, corner + 20 * _FINE), text, fill=_PALE, font=fonts[1], spacing=4 * _FINE)
        yield image.reduce(_FINE)
        if progress is not None:
            progress(number + 1, times.size)


def _draw_scene(draw: Any, scene: _Scene, time: float, step: float) -> None:
    run, view = scene.run, scene.view
    start = run.t[0]
    ghosts = np.maximum(time - step * np.arange(_GHOSTS, -1, -1), start)  # the last one is now
    drawn = shapes(run, ghosts)
    origin = view.pixels(np.zeros((1, 2)))[0]
    draw.line([(0, origin[1]), (view.width, origin[1])], fill=_GRID, width=_FINE)
    draw.line([(origin[0], 0), (origin[0], view.height)], fill=_GRID, width=_FINE)
    for each in run.setup.pegs:
        if isinstance(each, Peg):
            centre = view.pixels(np.array([[each.x, each.y]]))[0]
            _dot(draw, centre, max(each.radius * view.scale, 2 * _FINE), _PEG)
        elif isinstance(each, Wall):
            draw.line(view.pixels(np.array(wall_ends(each))), fill=_PEG, width=3 * _FINE)
        else:
            draw.polygon(view.pixels(ground_corners(each, 2.0 * (view.width + view.height) / view.scale)), fill=_GRID)
    for k in range(_GHOSTS):
        draw.line(view.pixels(drawn.joints[k]), fill=_blend(_ROPE, 0.40 * (k + 1) / (_GHOSTS + 1)), width=_FINE)
    past = np.linspace(max(time - scene.trail, start), time, _TRAIL_POINTS)
    path = view.pixels(shapes(run, past).joints[:, -1])
    for k in range(len(path) - 1):
        draw.line(path[k : k + 2], fill=_blend(_TRAIL, 0.15 + 0.75 * k / len(path)), width=2 * _FINE)
    rope = view.pixels(drawn.joints[-1])
    draw.line(rope, fill=_ROPE, width=3 * _FINE, joint="curve")
    _dot(draw, rope[-1], 4 * _FINE, _WHITE)
    for x, y in view.pixels(scene.targets):
        draw.ellipse([x - _RING, y - _RING, x + _RING, y + _RING], outline=_PEG, width=2 * _FINE)
    pivot = view.pixels(drawn.pivots[-1:])[0]
    draw.line([pivot, rope[0]], fill=_WHITE, width=5 * _FINE)
    _dot(draw, pivot, 5 * _FINE, _WHITE)


def _dot(draw: Any, centre: tuple[float, float], radius: float, colour: Colour) -> None:
    x, y = centre
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=colour)


def _blend(colour: Colour, part: float) -> Colour:
    """Mix `part` of a colour with the background."""
    red, green, blue = (round(part * c + (1.0 - part) * b) for c, b in zip(colour, _NIGHT, strict=True))
    return red, green, blue


_SHADES = 16
_PALETTE = [_blend(c, k / (_SHADES - 1)) for c in (_ROPE, _TRAIL, _WHITE, _PALE, _GRID, _PEG) for k in range(_SHADES)]
