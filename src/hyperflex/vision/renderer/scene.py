"""The scene of the synthetic camera: rope, markers, bars, background, light, noise, and what hides the rope."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.vision.video import Image

Colour = tuple[float, float, float]  # blue, green, red, 0 to 255
Hidden = Callable[[float], npt.NDArray[np.bool_]]  # time, s -> which markers (K,) are covered

RED, DARK = (40.0, 30.0, 210.0), (45.0, 45.0, 45.0)


class Bar(NamedTuple):
    """A straight bar along the rope, as the links of a pendulum are.

    Attributes
    ----------
    start, end : float
        Arc lengths of its ends, m.
    width : float
        m; its ends are round.
    colour : (float, float, float)
        Blue, green, red, 0 to 255.
    """

    start: float
    end: float
    width: float
    colour: Colour


class Occluder(NamedTuple):
    """A bar in front of the rope.

    Attributes
    ----------
    start, end : (float, float)
        Its ends in the swing plane, m.
    width : float
        m.
    colour : (float, float, float)
        Blue, green, red, 0 to 255.
    velocity : (float, float)
        Velocity, m/s; `start` and `end` are its ends at t = 0.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    width: float
    colour: Colour = (110.0, 120.0, 125.0)
    velocity: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything in the picture.

    Parameters
    ----------
    arc_lengths : (K,) array_like
        Of the markers, m; empty for none.
    marker_diameter : float
        m.
    marker_colours : (3,) or (K, 3) array_like
        Blue, green, red, 0 to 255, of all or of each.
    rope_width : float
        m; 0: it is not seen.
    rope_colour : (3,) array_like
        Blue, green, red.
    bars : tuple of Bar
        Drawn over the rope and below the markers.
    background : (3,) array_like
        Blue, green, red of the wall.
    clutter : int
        Number of things on the wall: discs and bars, a quarter of them in the first marker's colour.
    light_drift, drift_period : float
        By which part the light varies, and how slowly, s; the colours' balance varies by a quarter of that.
    noise : float
        Standard deviation of a channel, levels.
    occluders : tuple of Occluder
        Before everything.
    hidden : callable, optional
        Of a time, s, to which markers (K,) are covered by something dark that goes along; see :func:`random_occlusion`.
    blackouts : tuple of (float, float)
        From when to when nothing of the rope is seen, s.
    seed : int
        Of clutter and noise.

    Notes
    -----
    Levels count as proportional to light; no gamma, no vignetting, no auto exposure.
    """

    arc_lengths: Array
    marker_diameter: float = 0.025
    marker_colours: npt.ArrayLike = RED
    rope_width: float = 0.006
    rope_colour: npt.ArrayLike = DARK
    bars: tuple[Bar, ...] = ()
    background: npt.ArrayLike = (175.0, 185.0, 190.0)
    clutter: int = 0
    light_drift: float = 0.0
    drift_period: float = 10.0
    noise: float = 2.0
    occluders: tuple[Occluder, ...] = ()
    hidden: Hidden | None = None
    blackouts: tuple[tuple[float, float], ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        arcs = checks.array("arc_lengths", self.arc_lengths, (-1,), unit="m")
        colours = np.asarray(self.marker_colours, dtype=np.float64)
        colours = np.tile(colours, (arcs.size, 1)) if colours.ndim == 1 else colours
        checked: dict[str, Any] = {
            "arc_lengths": arcs,
            "marker_diameter": checks.number("marker_diameter", self.marker_diameter, sign="positive", unit="m"),
            "marker_colours": checks.array("marker_colours", colours, (arcs.size, 3), sign="nonnegative"),
            "clutter": checks.count("clutter", self.clutter, least=0),
            "drift_period": checks.number("drift_period", self.drift_period, sign="positive", unit="s"),
        }
        for name in ("rope_width", "light_drift", "noise"):
            checked[name] = checks.number(name, getattr(self, name), sign="nonnegative")
        for name in ("rope_colour", "background"):
            checked[name] = checks.array(name, getattr(self, name), (3,), sign="nonnegative")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def wall(self, image_size: tuple[int, int]) -> npt.NDArray[np.float32]:
        """Return the background (height, width, 3) with its clutter, a soft shade over it."""
        import cv2

        width, height = image_size
        rng = np.random.default_rng((self.seed, 1))
        base = np.asarray(self.background, dtype=np.float64)
        image = np.tile(base, (height, width, 1))
        for k in range(self.clutter):
            own = np.asarray(self.marker_colours).reshape(-1, 3)
            colour = own[0] if k % 4 == 0 and len(own) else rng.uniform(40.0, 220.0, 3)
            place = rng.uniform(0.0, 1.0, 2) * [width, height]
            size = rng.uniform(0.004, 0.03) * width
            if k % 2:
                end = place + rng.uniform(-0.15, 0.15, 2) * width
                near, far = (point.astype(int).tolist() for point in (place, end))
                cv2.line(image, near, far, colour.tolist(), max(2, int(size)), cv2.LINE_AA)
            else:
                cv2.circle(image, tuple(map(int, place)), int(size), colour.tolist(), -1, cv2.LINE_AA)
        v, u = np.mgrid[0:height, 0:width]
        shade = 1.0 - 0.08 * u / width - 0.06 * v / height
        return np.asarray(cv2.GaussianBlur(image * shade[..., None], (0, 0), 0.7), dtype=np.float32)

    def light(self, t: float) -> Array:
        """Return the factor (3,) of each channel at a time, s."""
        phase = 2.0 * np.pi * t / self.drift_period
        gain = 1.0 - 0.5 * self.light_drift * (1.0 - np.cos(phase))
        balance = 1.0 + 0.25 * self.light_drift * np.sin(0.7 * phase) * np.array([1.0, 0.0, -1.0])
        return np.asarray(gain * balance)

    def is_black(self, t: float) -> bool:
        """Whether nothing of the rope is seen at a time, s."""
        return any(start <= t < end for start, end in self.blackouts)


def random_occlusion(count: int, share: float, duration: float, *, until: float, seed: int = 0) -> Hidden:
    """Return which of the markers are covered at a time: each on and off at random, independent of the others.

    Parameters
    ----------
    count : int
        Number of markers.
    share : float
        Of the time that each is covered, 0 to 1.
    duration : float
        Mean time covered at a stretch, s (exponential).
    until : float
        End of the schedule, s; it starts at 0.
    seed : int
        Of the random numbers.
    """
    share = checks.number("share", share, sign="nonnegative")
    rng = np.random.default_rng(seed)
    means = np.array([duration * (1.0 - share) / max(share, 1e-9), duration])  # free, covered
    many = 10 + int(4.0 * until / duration)
    covered_first = rng.random(count) < share
    lengths = rng.exponential(1.0, (count, many)) * means[(np.arange(many) + covered_first[:, None]) % 2]
    changes = np.cumsum(lengths, axis=1)

    def hidden(t: float) -> npt.NDArray[np.bool_]:
        return ((changes <= t).sum(axis=1) + covered_first) % 2 == 1 if share > 0.0 else np.zeros(count, bool)

    return hidden


def tiles_of_noise(std: float, image_size: tuple[int, int], rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Return noise (height + 64, width + 64, 3) from which frames cut a window each, much faster than drawing anew."""
    width, height = image_size
    return np.float32(std) * rng.standard_normal((height + 64, width + 64, 3), dtype=np.float32)


def finished(levels: npt.NDArray[np.float32]) -> Image:
    """Return levels rounded and cut to 0 to 255."""
    import cv2

    return np.asarray(cv2.convertScaleAbs(np.maximum(levels, 0.0)), dtype=np.uint8)
