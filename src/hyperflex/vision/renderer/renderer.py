"""The synthetic camera: a scene with a moving rope, and its frames, integrated over each row's exposure."""

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.core.image.exposure import Capsules, RowTimes, expose
from hyperflex.files import PathLike
from hyperflex.vision.camera import Camera
from hyperflex.vision.renderer.motion import RopeMotion
from hyperflex.vision.tone import linear_tone
from hyperflex.vision.video import Image, VideoWriter

Colour = tuple[float, float, float]  # blue, green, red, 0 to 255
Hidden = Callable[[float], Flags]  # time, s -> which markers (K,) are covered

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
    rope_texture : float
        Relative standard deviation of the brightness of pieces of the rope, each twice as long as the rope is wide.
    shine : float
        Brightness of a highlight along the rope, levels, like that of a wire: on the side of the light, which comes
        from the upper left, and weaker where the rope points towards it.
    shadow : (float, float, float)
        Of the rope on the wall: how far to the right and up, m, and the share of the light that is missing in it.
    bars : tuple of Bar
        Drawn over the rope and below the markers.
    background : (3,) array_like
        Blue, green, red of the wall.
    wall_texture : float
        Standard deviation of the wall's grain, levels, in sizes from a pixel to a sixteenth of the picture.
    clutter : int
        Number of things on the wall: discs and bars, a quarter of them in the first marker's colour, or the rope's.
    light_drift, drift_period : float
        By which part the light varies, and how slowly, s; the colours' balance varies by a quarter of that.
    exposure_steps : tuple of (float, float)
        Of an automatic exposure: from which time on, s, the picture is by which factor brighter.
    noise : float
        Standard deviation of a channel, levels.
    tone : (256,) array_like, optional
        Light of the levels 0 to 255, 0 to 255, as of :func:`srgb_tone`; all colours are levels.
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
    Levels count as proportional to light, unless `tone` is given; no vignetting.
    """

    arc_lengths: Array
    marker_diameter: float = 0.025
    marker_colours: ArrayLike = RED
    rope_width: float = 0.006
    rope_colour: ArrayLike = DARK
    rope_texture: float = 0.0
    shine: float = 0.0
    shadow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bars: tuple[Bar, ...] = ()
    background: ArrayLike = (175.0, 185.0, 190.0)
    wall_texture: float = 0.0
    clutter: int = 0
    light_drift: float = 0.0
    drift_period: float = 10.0
    exposure_steps: tuple[tuple[float, float], ...] = ()
    noise: float = 2.0
    tone: Array | None = None
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
        for name in ("rope_width", "rope_texture", "shine", "wall_texture", "light_drift", "noise"):
            checked[name] = checks.number(name, getattr(self, name), sign="nonnegative")
        for name in ("rope_colour", "background"):
            checked[name] = checks.array(name, getattr(self, name), (3,), sign="nonnegative")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def wall(self, image_size: tuple[int, int]) -> npt.NDArray[np.float32]:
        """Return the background (height, width, 3) with its grain and clutter, a soft shade over it."""
        import cv2

        width, height = image_size
        rng = np.random.default_rng((self.seed, 1))
        base = np.asarray(self.background, dtype=np.float64)
        image = np.tile(base, (height, width, 1))
        own = np.vstack([np.asarray(self.marker_colours).reshape(-1, 3), self.rope_colour])[0]
        if self.wall_texture:
            image += self.wall_texture * _grain(rng, (height, width))
        for k in range(self.clutter):
            colour = own if k % 4 == 0 else rng.uniform(40.0, 220.0, 3)
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
        step = next((factor for since, factor in self.exposure_steps[::-1] if since <= t), 1.0)
        return np.asarray(step * gain * balance)

    def is_black(self, t: float) -> bool:
        """Whether nothing of the rope is seen at a time, s."""
        return any(start <= t < end for start, end in self.blackouts)

    def covered(self, t: float) -> Flags:
        """Return which markers (K,) are covered at a time, s."""
        return np.full(self.arc_lengths.size, self.is_black(t)) if self.hidden is None else self.hidden(t)


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Return noise (*shape, 3) of standard deviation 1, in sizes that double; colours vary by a third."""
    import cv2

    sizes = 2.0 ** np.arange(int(np.log2(min(shape) / 16)) + 1)
    total = np.zeros((*shape, 3))
    for size in sizes.tolist():
        coarse = tuple(int(np.ceil(side / size)) for side in shape)
        part = rng.standard_normal((*coarse, 1)) + rng.standard_normal((*coarse, 3)) / 3.0
        total += cv2.resize(part, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(total / total.std())


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

    def hidden(t: float) -> Flags:
        return ((changes <= t).sum(axis=1) + covered_first) % 2 == 1 if share > 0.0 else np.zeros(count, bool)

    return hidden


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth of T frames with K markers.

    Attributes
    ----------
    stamps : (T,) float64
        Time stamps of the frames, s.
    times : (T, K) float64
        When each marker was exposed (the middle of it, in its own row), s.
    places : (T, K, 3) float64
        Its place at that time, m: x, y, and off the plane.
    pixels : (T, K, 2) float64
        Its place in the picture, px.
    streaks : (T, K, 2) float64
        Its movement in the picture during the exposure, px.
    visible : (T, K) bool
        Whether its middle is in the picture and not covered.
    arc_lengths : (K,) float64
        Of the markers, m.
    """

    stamps: Array
    times: Array
    places: Array
    pixels: Array
    streaks: Array
    visible: Flags
    arc_lengths: Array


class _Layer(NamedTuple):
    """Capsules that join to one shape."""

    arcs: Array  # (C, 2) m, of their ends
    radius: float  # m
    colour: ArrayLike  # (3,), or (C, 3)
    shine: float = 0.0  # levels, of a highlight on the side of the light


class Renderer:
    """Renders the frames that a camera would take of a moving rope.

    Parameters
    ----------
    camera : Camera
        With the swing plane's pose, exposure, readout and delay.
    motion : RopeMotion
        The rope; take a finer chain than the one that tracks it.
    scene : Scene
    sub_exposures : int
        Least number of instants of an exposure; fast ropes get more, at most 1.5 px apart.

    Examples
    --------
    >>> import numpy as np
    >>> camera = Camera.facing((320, 240), pixels_per_metre=150.0, origin=(160.0, 20.0), exposure=0.01)
    >>> motion = RopeMotion([0.0, 1.0], np.zeros((2, 4)), np.zeros((2, 4)), [0.25] * 4)
    >>> image = Renderer(camera, motion, Scene([0.5, 1.0])).image(0.5)
    >>> image.shape, image[95, 160].tolist() != image[95, 100].tolist()
    ((240, 320, 3), True)
    """

    NODE = 1e-3  # s, between the instants from which the motion within a frame is interpolated
    ITERATIONS = 8  # of the row in which a marker is seen and the time of that row
    COVER, COVER_SIZE = (70.0, 75.0, 75.0), 1.5  # colour and size (of the marker's) of what hides a marker
    LIGHT = (-0.6, -0.8)  # direction to the light in the picture, right and down
    HIGHLIGHT = 0.4  # width of the highlight over the rope's; its middle is at most half of the rope's radius aside

    def __init__(self, camera: Camera, motion: RopeMotion, scene: Scene, sub_exposures: int = 8) -> None:
        self.camera, self.motion, self.scene = camera, motion, scene
        self.sub_exposures = checks.count("sub_exposures", sub_exposures)
        self._wall = self._light(scene.wall(camera.image_size))
        self._rng = np.random.default_rng((scene.seed, 2))
        width, height = (
            camera.image_size
        )  # frames cut a window each from a larger piece of noise: faster than drawing it
        noise = self._rng.standard_normal((height + 64, width + 64, 3), dtype=np.float32)
        self._noise = np.float32(scene.noise) * noise
        self._upright = camera.readout_direction in ("down", "up")

    def with_motion(self, motion: RopeMotion) -> "Renderer":
        """Return the same camera, before the same wall, with another motion."""
        other = copy(self)
        other.motion = motion
        return other

    def _light(self, levels: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Return the light of levels of the scene."""
        tone = self.scene.tone
        return np.asarray(levels if tone is None else np.interp(levels, linear_tone(), tone), np.float32)

    def image(self, stamp: float) -> Image:
        """Return the frame (height, width, 3) with a time stamp, s."""
        import cv2

        width, height = self.camera.image_size
        levels = self._wall.copy()
        *shift, dark = self.scene.shadow
        if dark:
            rope = [] if self.scene.is_black(stamp) else self._rope()[:1]
            for part, shade in self._exposures(stamp, rope, (), shift):
                levels[part] *= 1.0 - np.float32(dark) * shade[:, :, 3:]
        for part, seen in self._exposures(stamp, self._layers(stamp), self.scene.occluders):
            levels[part] *= 1.0 - seen[:, :, 3:]
            levels[part] += seen[:, :, :3]
        levels *= self.scene.light(stamp).astype(np.float32)
        if self.scene.tone is not None:
            levels = np.interp(levels, self.scene.tone, linear_tone()).astype(np.float32)
        du, dv = self._rng.integers(0, 64, 2)
        levels += self._noise[dv : dv + height, du : du + width]
        return np.asarray(cv2.convertScaleAbs(np.maximum(levels, 0.0)), dtype=np.uint8)

    def truth(self, stamps: ArrayLike) -> Truth:
        """Return the truth of frames with these time stamps (T,), s."""
        scene, camera = self.scene, self.camera
        instants = checks.array("stamps", stamps, (-1,), unit="s")

        def exposed(shift: float) -> list[Array]:
            each = [self._exposed(stamp, shift) for stamp in instants.tolist()]
            return [np.array(column) for column in zip(*each, strict=True)]

        times, places, pixels = exposed(0.0)
        begin, end = (exposed(side * camera.exposure)[2] for side in (-0.5, 0.5))
        visible: Flags = np.asarray(((pixels >= 0.0) & (pixels <= np.array(camera.image_size) - 1.0)).all(axis=2))
        for stamp, place, seen in zip(instants.tolist(), places, visible, strict=True):
            seen &= ~scene.covered(stamp) & ~self._behind(place, stamp) & (not scene.is_black(stamp))
        return Truth(instants, times, places, pixels, end - begin, visible, scene.arc_lengths)

    def write(self, path: PathLike, stamps: ArrayLike, quality: int = 18) -> Truth:
        """Write an MP4 of frames with these time stamps (T,), s, not negative; return the truth.

        Parameters
        ----------
        path, quality
            See :class:`VideoWriter`.
        stamps : (T,) array_like
            See :func:`frame_times`.
        """
        instants = checks.times("stamps", stamps)
        with VideoWriter(path, self.camera.image_size, quality) as video:
            for stamp in instants.tolist():
                video.write(self.image(stamp), stamp)
        return self.truth(instants)

    def _exposed(self, stamp: float, shift: float) -> tuple[Array, Array, Array]:
        """Return times (K,), s, places (K, 3), m, and pixels (K, 2) of markers, `shift` after their rows' exposure."""
        arcs = self.scene.arc_lengths
        t, each = np.full(arcs.size, stamp - self.camera.delay), np.arange(arcs.size)
        for _ in range(self.ITERATIONS):
            places = self.motion.places(t, arcs)[each, each]
            pixels = self.camera.project(places)
            t = self.camera.exposure_times(stamp, pixels) + shift
        places = self.motion.places(t, arcs)[each, each]
        return t, places, self.camera.project(places)

    def _behind(self, places: Array, t: float) -> Flags:
        """Return which of the places (K, 3) lie behind an occluder."""
        result = np.zeros(len(places), bool)
        for bar in self.scene.occluders:
            start = np.array(bar.start) + t * np.array(bar.velocity)
            along = np.array(bar.end) - np.array(bar.start)
            share = np.clip((places[:, :2] - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
            result |= np.linalg.norm(places[:, :2] - start - share[:, None] * along, axis=1) < 0.5 * bar.width
        return result

    def _rope(self) -> list[_Layer]:
        """Return the rope, in pieces of different brightness, and the highlight along it."""
        scene, joints = self.scene, self.motion.joint_arc_lengths
        if scene.rope_width == 0.0:
            return []
        links, arcs = np.stack([joints[:-1], joints[1:]], axis=1), joints
        if scene.rope_texture:
            counts = np.ceil(np.diff(joints) / (2.0 * scene.rope_width)).astype(int)
            pieces = [
                np.linspace(start, end, count, endpoint=False)
                for (start, end), count in zip(links.tolist(), counts.tolist(), strict=True)
            ]
            arcs = np.concatenate([*pieces, joints[-1:]])
        rng = np.random.default_rng((scene.seed, 3))
        brightness = 1.0 + scene.rope_texture * rng.standard_normal((len(arcs) - 1, 1))
        colours, radius = np.clip(brightness * np.asarray(scene.rope_colour), 0.0, 255.0), 0.5 * scene.rope_width
        rope = _Layer(np.stack([arcs[:-1], arcs[1:]], axis=1), radius, colours)
        highlight = _Layer(links, self.HIGHLIGHT * radius, scene.rope_colour, scene.shine)
        return [rope, highlight] if scene.shine else [rope]

    def _layers(self, stamp: float) -> list[_Layer]:
        """Return the drawn shapes of the rope, from back to front."""
        scene = self.scene
        if scene.is_black(stamp):
            return []
        layers = self._rope()
        layers += [_Layer(np.array([[bar.start, bar.end]]), 0.5 * bar.width, bar.colour) for bar in scene.bars]
        radius = 0.5 * scene.marker_diameter
        for arc, colour, covered in zip(
            scene.arc_lengths, np.asarray(scene.marker_colours), scene.covered(stamp), strict=True
        ):
            marker = np.full((1, 2), arc)
            layers.append(_Layer(marker, radius, colour))
            layers += [_Layer(marker, self.COVER_SIZE * radius, self.COVER)] if covered else []
        return layers

    def _exposures(
        self, stamp: float, layers: list[_Layer], fronts: tuple[Occluder, ...], shift: ArrayLike = (0.0, 0.0)
    ) -> Iterator[tuple[slice, npt.NDArray[np.float32]]]:
        """Yield the rows in which something is seen, and its colour times cover, and cover, in them; or nothing."""
        if not layers and not fronts:
            return
        capsules, times = self._capsules(stamp, layers, fronts, shift)
        width, height = self.camera.image_size
        cover = np.zeros((height, width, 4) if self._upright else (width, height, 4), np.float32)
        expose(capsules, times, cover)
        seen = cover if self._upright else cover.transpose(1, 0, 2)
        rows = np.flatnonzero(seen[:, :, 3].any(axis=1))
        if rows.size:
            part = slice(rows[0], rows[-1] + 1)
            yield part, seen[part]

    def _capsules(
        self, stamp: float, layers: list[_Layer], fronts: tuple[Occluder, ...], shift: ArrayLike
    ) -> tuple[Capsules, RowTimes]:
        """Return the shapes in pixels at several instants about a frame, and the exposure times of its rows."""
        camera = self.camera
        start = stamp - camera.delay - 0.5 * camera.exposure
        span = camera.exposure + camera.readout
        nodes = max(2, int(np.ceil(span / self.NODE)) + 1)
        instants = start + np.linspace(0.0, span, nodes)
        arcs = np.concatenate([np.zeros((0, 2)), *(layer.arcs for layer in layers)])
        places = self.motion.places(instants, arcs.ravel())
        places[:, :, :2] += np.asarray(shift)
        for bar in fronts:
            ends = np.array([bar.start, bar.end]) + instants[:, None, None] * np.array(bar.velocity)
            places = np.concatenate([places, np.pad(ends, ((0, 0), (0, 0), (0, 1)))], axis=1)
        pixels = camera.project(places.reshape(-1, 3)).reshape(nodes, -1, 2, 2)
        scales = np.sqrt(np.abs(np.linalg.det(camera.linearize(places[nodes // 2])[1][:, :, :2])))
        drawn = [*layers, *(_Layer(np.zeros((1, 2)), 0.5 * front.width, front.colour) for front in fronts)]
        sizes = [len(layer.arcs) for layer in drawn]
        radii = np.repeat([layer.radius for layer in drawn], sizes) * scales.reshape(-1, 2).mean(axis=1)
        colours = np.concatenate([np.broadcast_to(layer.colour, (len(layer.arcs), 3)) for layer in drawn])
        shine = np.repeat([layer.shine for layer in drawn], sizes)
        if shine.any():
            along = (pixels[:, :, 1] - pixels[:, :, 0]) @ np.array([1.0, 1.0j])
            normal = 1j * along / np.maximum(np.abs(along), 1e-9)
            facing = normal.real * self.LIGHT[0] + normal.imag * self.LIGHT[1]
            aside = (shine > 0.0) * 0.5 * radii / self.HIGHLIGHT * facing * normal
            pixels += np.stack([aside.real, aside.imag], axis=-1)[:, :, None]
            colours = np.minimum(colours + (shine * facing[nodes // 2] ** 2)[:, None], 255.0)
        if not self._upright:
            pixels = pixels[..., ::-1]
        rows = camera.image_size[1 if self._upright else 0]
        step = (nodes - 1) / span if span > 0.0 else 0.0
        slope = camera.readout / max(rows - 1, 1) * step
        backwards = camera.readout_direction in ("up", "left")
        first = 0.5 * camera.exposure * step + (camera.readout * step if backwards else 0.0)
        fastest = np.abs(np.diff(pixels, axis=0)).max(initial=0.0) * camera.exposure * step
        samples = max(self.sub_exposures, int(fastest / 1.5)) if camera.exposure > 0.0 else 1
        times = RowTimes(first, -slope if backwards else slope, camera.exposure * step, samples)
        ends = np.ascontiguousarray(pixels.reshape(nodes, -1, 4))
        return Capsules(ends, radii, np.repeat(np.arange(len(drawn)), sizes), self._light(colours)), times


def frame_times(
    start: float, end: float, rate: float, *, jitter: float = 0.0, dropped: float = 0.0, seed: int = 0
) -> Array:
    """Return time stamps of frames, s, as cameras give them.

    Parameters
    ----------
    start, end : float
        Of the video, s.
    rate : float
        Mean frames a second, Hz.
    jitter : float
        By which part of the time between frames that time varies, below 0.5, uniform.
    dropped : float
        Share of the frames that are missing, at random; the first one stays.
    seed : int
        Of the random numbers.
    """
    step = 1.0 / checks.number("rate", rate, sign="positive", unit="Hz")
    rng = np.random.default_rng(seed)
    times = np.arange(start, end, step)
    times = times + step * min(jitter, 0.499) * rng.uniform(-1.0, 1.0, times.size) * (np.arange(times.size) > 0)
    kept = rng.random(times.size) >= dropped
    kept[:1] = True
    return times[kept]
