"""The synthetic camera: frames of a moving rope, integrated over each row's exposure."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.core.image.exposure import Capsules, RowTimes, expose
from hyperflex.files import NetCDF, PathLike, Variable
from hyperflex.vision.camera import Camera
from hyperflex.vision.renderer.motion import RopeMotion
from hyperflex.vision.renderer.scene import Scene, finished, tiles_of_noise
from hyperflex.vision.video import Image, VideoWriter


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
    visible: npt.NDArray[np.bool_]
    arc_lengths: Array

    def write(self, path: PathLike) -> None:
        """Write the truth to a NetCDF file, complete or not at all."""
        frame, each = ("frame",), ("frame", "marker")
        variables = {
            "stamp": Variable(frame, self.stamps, {"units": "s"}),
            "time": Variable(each, self.times, {"units": "s", "long_name": "middle of the exposure"}),
            "place": Variable((*each, "axis"), self.places, {"units": "m"}),
            "pixel": Variable((*each, "image_axis"), self.pixels, {"units": "px"}),
            "streak": Variable((*each, "image_axis"), self.streaks, {"units": "px"}),
            "visible": Variable(each, self.visible.astype(np.int8), {"units": "1"}),
            "arc_length": Variable(("marker",), self.arc_lengths, {"units": "m"}),
        }
        files.write_netcdf(path, NetCDF(variables, {"format": "hyperflex rendered truth 1"}))


_Layer = tuple[Array, float, npt.ArrayLike]


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

    def __init__(self, camera: Camera, motion: RopeMotion, scene: Scene, sub_exposures: int = 8) -> None:
        self.camera, self.motion, self.scene = camera, motion, scene
        self.sub_exposures = checks.count("sub_exposures", sub_exposures)
        self._wall = scene.wall(camera.image_size)
        self._rng = np.random.default_rng((scene.seed, 2))
        self._noise = tiles_of_noise(scene.noise, camera.image_size, self._rng) if scene.noise else None
        self._upright = camera.readout_direction in ("down", "up")

    def image(self, stamp: float) -> Image:
        """Return the frame (height, width, 3) with a time stamp, s."""
        capsules, times = self._capsules(stamp)
        width, height = self.camera.image_size
        cover = np.zeros((height, width, 4) if self._upright else (width, height, 4), np.float32)
        if capsules is not None:
            expose(capsules, times, cover)
        seen = cover if self._upright else cover.transpose(1, 0, 2)
        levels = self._wall.copy()
        rows = np.flatnonzero(seen[:, :, 3].any(axis=1))
        if rows.size:
            part = slice(rows[0], rows[-1] + 1)
            levels[part] *= 1.0 - seen[part, :, 3:]
            levels[part] += seen[part, :, :3]
        levels *= self.scene.light(stamp).astype(np.float32)
        if self._noise is not None:
            du, dv = self._rng.integers(0, 64, 2)
            levels += self._noise[dv : dv + height, du : du + width]
        return finished(levels)

    def truth(self, stamps: npt.ArrayLike) -> Truth:
        """Return the truth of frames with these time stamps (T,), s."""
        scene, camera = self.scene, self.camera
        instants = checks.array("stamps", stamps, (-1,), unit="s")
        count = scene.arc_lengths.size
        times = np.zeros((instants.size, count))
        places, pixels = np.zeros((instants.size, count, 3)), np.zeros((instants.size, count, 2))
        streaks, visible = np.zeros_like(pixels), np.zeros((instants.size, count), bool)
        for k, stamp in enumerate(instants.tolist()):
            times[k], places[k], pixels[k] = self._exposed(stamp, 0.0)
            begin, end = (self._exposed(stamp, side * camera.exposure)[2] for side in (-0.5, 0.5))
            streaks[k] = end - begin
            inside = (pixels[k] >= 0.0).all(axis=1) & (pixels[k] <= np.array(camera.image_size) - 1.0).all(axis=1)
            covered = np.zeros(count, bool) if scene.hidden is None else scene.hidden(stamp)
            visible[k] = inside & ~covered & ~self._behind(places[k], stamp) & (not scene.is_black(stamp))
        return Truth(instants, times, places, pixels, streaks, visible, scene.arc_lengths)

    def write(self, path: PathLike, stamps: npt.ArrayLike, quality: int = 18) -> Truth:
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

    def _behind(self, places: Array, t: float) -> npt.NDArray[np.bool_]:
        """Return which of the places (K, 3) lie behind an occluder."""
        result = np.zeros(len(places), bool)
        for bar in self.scene.occluders:
            start = np.array(bar.start) + t * np.array(bar.velocity)
            along = np.array(bar.end) - np.array(bar.start)
            share = np.clip((places[:, :2] - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
            result |= np.linalg.norm(places[:, :2] - start - share[:, None] * along, axis=1) < 0.5 * bar.width
        return result

    def _layers(self, stamp: float) -> list[_Layer]:
        """Return what is drawn on the rope, from the back to the front: ends (C, 2) of capsules, radius, m, colour."""
        scene, joints = self.scene, self.motion.joint_arc_lengths
        if scene.is_black(stamp):
            return []
        layers: list[_Layer] = [(np.array([[bar.start, bar.end]]), 0.5 * bar.width, bar.colour) for bar in scene.bars]
        if scene.rope_width > 0.0:
            layers.insert(0, (np.stack([joints[:-1], joints[1:]], axis=1), 0.5 * scene.rope_width, scene.rope_colour))
        hidden = np.zeros(scene.arc_lengths.size, bool) if scene.hidden is None else scene.hidden(stamp)
        radius = 0.5 * scene.marker_diameter
        for arc, colour, covered in zip(scene.arc_lengths, np.asarray(scene.marker_colours), hidden, strict=True):
            marker = np.full((1, 2), arc)
            layers += [(marker, radius, colour), (marker, self.COVER_SIZE * radius, self.COVER)][: 2 if covered else 1]
        return layers

    def _capsules(self, stamp: float) -> tuple[Capsules | None, RowTimes]:
        """Return what is drawn in pixels at some instants about a frame, and when its rows are exposed."""
        camera, layers, fronts = self.camera, self._layers(stamp), self.scene.occluders
        start = stamp - camera.delay - 0.5 * camera.exposure
        span = camera.exposure + camera.readout
        nodes = max(2, int(np.ceil(span / self.NODE)) + 1)
        instants = start + np.linspace(0.0, span, nodes)
        arcs = np.concatenate([np.zeros((0, 2)), *(ends for ends, *_ in layers)])
        places = self.motion.places(instants, arcs.ravel())
        for bar in fronts:
            ends = np.array([bar.start, bar.end]) + instants[:, None, None] * np.array(bar.velocity)
            places = np.concatenate([places, np.pad(ends, ((0, 0), (0, 0), (0, 1)))], axis=1)
        pixels = camera.project(places.reshape(-1, 3)).reshape(nodes, -1, 2, 2)
        scales = np.sqrt(np.abs(np.linalg.det(camera.linearize(places[nodes // 2])[1][:, :, :2])))
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
        drawn = [(len(ends), radius, colour) for ends, radius, colour in layers]
        drawn += [(1, 0.5 * front.width, front.colour) for front in fronts]
        if not drawn:
            return None, times
        sizes = [size for size, *_ in drawn]
        radii = np.repeat([radius for _, radius, _ in drawn], sizes) * scales.reshape(-1, 2).mean(axis=1)
        colours = np.repeat([colour for *_, colour in drawn], sizes, axis=0).astype(np.float32)
        ends = np.ascontiguousarray(pixels.reshape(nodes, -1, 4))
        return Capsules(ends, radii, np.repeat(np.arange(len(drawn)), sizes), colours), times


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
    return np.asarray(times[kept])
