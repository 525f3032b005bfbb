"""The synthetic camera: frames of a moving rope, integrated over each row's exposure."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.image.exposure import Capsules, RowTimes, expose
from hyperflex.files import PathLike
from hyperflex.vision.camera import Camera
from hyperflex.vision.renderer.motion import RopeMotion
from hyperflex.vision.renderer.scene import Scene, finished, tiles_of_noise
from hyperflex.vision.renderer.truth import Truth
from hyperflex.vision.video import Image, VideoWriter

_NODE = 1e-3  # s, between the places from which the motion within a frame is interpolated
_COVER = (70.0, 75.0, 75.0)  # colour of what hides a marker
_COVER_SIZE = 1.5  # of the marker's diameter


@dataclass
class _Shape:
    """Capsules of one layer: ends as indices of the points, radii in m, one colour."""

    first: list[int]
    second: list[int]
    radius: float
    colour: Array


class Renderer:
    """Makes the frames that a camera would take of a moving rope.

    Parameters
    ----------
    camera : Camera
        With the swing plane's pose; its exposure, readout and delay are obeyed.
    motion : RopeMotion
        The rope; of a finer chain than the one that is to be tracked.
    scene : Scene
        What is seen.
    sub_exposures : int
        At least so many instants make an exposure; fast ropes get more, so that none is further from the next than
        1.5 px.

    Examples
    --------
    >>> import numpy as np
    >>> camera = Camera.facing((320, 240), pixels_per_metre=150.0, origin=(160.0, 20.0), exposure=0.01)
    >>> motion = RopeMotion([0.0, 1.0], np.zeros((2, 4)), np.zeros((2, 4)), [0.25] * 4)
    >>> image = Renderer(camera, motion, Scene([0.5, 1.0])).image(0.5)
    >>> image.shape, image[95, 160].tolist() != image[95, 100].tolist()
    ((240, 320, 3), True)
    """

    def __init__(self, camera: Camera, motion: RopeMotion, scene: Scene, sub_exposures: int = 8) -> None:
        self.camera, self.motion, self.scene = camera, motion, scene
        self.sub_exposures = checks.count("sub_exposures", sub_exposures)
        self._wall = scene.wall(camera.image_size)
        self._rng = np.random.default_rng((scene.seed, 2))
        self._noise = tiles_of_noise(scene.noise, camera.image_size, self._rng) if scene.noise else None
        self._upright = camera.readout_direction in ("down", "up")
        joints = motion.joint_arc_lengths
        bars = [s for bar in scene.bars for s in (bar.start, bar.end)]
        self._arcs = np.concatenate([joints, scene.arc_lengths, bars])

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
        """Return what frames with these time stamps (T,), s, show in truth."""
        scene, camera = self.scene, self.camera
        instants = checks.array("stamps", stamps, (-1,), unit="s")
        count = scene.arc_lengths.size
        times = np.zeros((instants.size, count))
        places, pixels = np.zeros((instants.size, count, 3)), np.zeros((instants.size, count, 2))
        streaks, visible = np.zeros_like(pixels), np.zeros((instants.size, count), bool)
        for k, stamp in enumerate(instants.tolist()):
            t = np.full(count, stamp - camera.delay)
            for _ in range(8):  # the row depends on the time at which the marker is seen, and that on the row
                places[k], pixels[k] = self._markers(t)
                t = camera.exposure_times(stamp, pixels[k])
            times[k] = t
            places[k], pixels[k] = self._markers(t)
            ends = [self._seen_in_exposure(stamp, t, side * 0.5 * camera.exposure) for side in (1.0, -1.0)]
            streaks[k] = ends[0] - ends[1]
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

    def _markers(self, t: Array) -> tuple[Array, Array]:
        """Return places (K, 3), m, and pixels (K, 2) of the markers, each at its own time (K,)."""
        places = self.motion.places(t, self.scene.arc_lengths)
        own = places[np.arange(t.size), np.arange(t.size)]
        return own, self.camera.project(own)

    def _seen_in_exposure(self, stamp: float, t: Array, shift: float) -> Array:
        """Return pixels (K, 2) of the markers where rows see them a time `shift`, s, after their middle."""
        pixels = self._markers(t)[1]
        for _ in range(8):
            pixels = self._markers(self.camera.exposure_times(stamp, pixels) + shift)[1]
        return pixels

    def _behind(self, places: Array, t: float) -> npt.NDArray[np.bool_]:
        """Return which of the places (K, 3) lie behind an occluder."""
        result = np.zeros(len(places), bool)
        for bar in self.scene.occluders:
            start = np.array(bar.start) + t * np.array(bar.velocity)
            along = np.array(bar.end) - np.array(bar.start)
            share = np.clip((places[:, :2] - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
            result |= np.linalg.norm(places[:, :2] - start - share[:, None] * along, axis=1) < 0.5 * bar.width
        return result

    def _shapes(self, stamp: float) -> list[_Shape]:
        """Return what is drawn, from the back to the front."""
        scene, joints = self.scene, self.motion.joint_arc_lengths.size
        shapes = []
        if not scene.is_black(stamp):
            if scene.rope_width > 0.0:
                links = list(range(joints - 1))
                rope = np.asarray(scene.rope_colour)
                shapes.append(_Shape(links, [k + 1 for k in links], 0.5 * scene.rope_width, rope))
            at = joints + scene.arc_lengths.size
            for k, bar in enumerate(scene.bars):
                shapes.append(_Shape([at + 2 * k], [at + 2 * k + 1], 0.5 * bar.width, np.array(bar.colour)))
            hidden = None if scene.hidden is None else scene.hidden(stamp)
            for k in range(scene.arc_lengths.size):
                marker, radius = [joints + k], 0.5 * scene.marker_diameter
                shapes.append(_Shape(marker, marker, radius, np.asarray(scene.marker_colours)[k]))
                if hidden is not None and hidden[k]:
                    shapes.append(_Shape(marker, marker, _COVER_SIZE * radius, np.array(_COVER)))
        for k, front in enumerate(scene.occluders):
            at = self._arcs.size + 2 * k
            shapes.append(_Shape([at], [at + 1], 0.5 * front.width, np.array(front.colour)))
        return shapes

    def _capsules(self, stamp: float) -> tuple[Capsules | None, RowTimes]:
        """Return what is drawn in pixels at some times about a frame, and when its rows are exposed."""
        camera = self.camera
        start = stamp - camera.delay - 0.5 * camera.exposure
        span = camera.exposure + camera.readout
        nodes = max(2, int(np.ceil(span / _NODE)) + 1)
        instants = start + np.linspace(0.0, span, nodes) if span > 0.0 else np.full(2, start)
        places = self.motion.places(instants, self._arcs)
        if self.scene.occluders:
            moved = [
                np.array([*end, 0.0]) + instants[:, None] * np.array([*bar.velocity, 0.0])
                for bar in self.scene.occluders
                for end in (bar.start, bar.end)
            ]
            places = np.concatenate([places, np.stack(moved, axis=1)], axis=1)
        pixels = camera.project(places.reshape(-1, 3)).reshape(nodes, -1, 2)
        scales = np.sqrt(np.abs(np.linalg.det(camera.linearize(places[nodes // 2]).by_point[:, :, :2])))
        if not self._upright:
            pixels = pixels[:, :, ::-1]
        shapes = self._shapes(stamp)
        rows = camera.image_size[1 if self._upright else 0]
        step = (nodes - 1) / span if span > 0.0 else 0.0
        slope = camera.readout / max(rows - 1, 1) * step
        backwards = camera.readout_direction in ("up", "left")
        first = 0.5 * camera.exposure * step + (camera.readout * step if backwards else 0.0)
        moved_most = np.abs(np.diff(pixels, axis=0)).max(initial=0.0) * camera.exposure * step
        samples = max(self.sub_exposures, int(moved_most / 1.5)) if camera.exposure > 0.0 else 1
        times = RowTimes(first, -slope if backwards else slope, camera.exposure * step, samples)
        if not shapes:
            return None, times
        one = [k for shape in shapes for k in shape.first]
        two = [k for shape in shapes for k in shape.second]
        sizes = [len(s.first) for s in shapes]
        radii = np.repeat([s.radius for s in shapes], sizes) * 0.5 * (scales[one] + scales[two])
        ends = np.ascontiguousarray(np.concatenate([pixels[:, one], pixels[:, two]], axis=2))
        colours = np.repeat([s.colour for s in shapes], sizes, axis=0).astype(np.float32)
        return Capsules(ends, radii, np.repeat(np.arange(len(shapes)), sizes), colours), times


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
