"""A rope that a camera sees while a plan is carried out: a real camera, or one that is rendered before an emulator."""

import math
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.child import Child, Records
from hyperflex.errors import EstimatorLost
from hyperflex.estimate import CameraStateSource, EstimatedParameter, TrackingTask
from hyperflex.hardware import Emulator, EmulatorLog
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import CastPlan
from hyperflex.vision import Camera, Frame, Image, MarkerColour, Occluder, Renderer, RopeMotion, Scene


class CameraRope(CameraStateSource):
    """The rope as a camera sees it (a :class:`ClockedSource`); the task has an arm, which moves as the run commands.

    Let it estimate the rope's "length": a plan is then followed with a rope as long as it is seen to be.

    The estimate knows no contact: it ends soon after the rope has struck. Whether it is wound is seen in the markers.
    """

    contact = False

    def start_clock(self, at: float | None = None) -> None:
        """Make a moment of the monotonic clock, s, or now, t = 0; in the latter case search the rope anew."""
        super().start_clock(at)
        if at is None:
            self.search()

    def turns(self, arm_angle: Callable[[Array], Array], peg: Peg, side: int, rope: Rope) -> tuple[Array, Array]:
        """Return the times (T,), s, of the pictures, and the turns of the rope about a peg in each (T, 2).

        Those that explain the markers best, and the most that may be: of :func:`wound_turns`. NaN: not seen.
        """
        arm, seen = checks.instance("arm", self.task.arm, Arm), list(self.spots)
        arcs = np.asarray(self.task.arc_lengths) * rope.total_length / self.task.rope.total_length
        middle, radius = peg.point, peg.radius + rope.radius
        t = np.array([at for at, _ in seen])
        starts = arm.tip(arm_angle(t)) - middle
        found = [
            wound_turns(arcs, radius, side, start, at - middle) for start, (_, at) in zip(starts, seen, strict=True)
        ]
        return t, np.array(found).reshape(-1, 2)


def measured_length() -> list[EstimatedParameter]:
    """Return what a tracker estimates of a rope whose length was measured to 2 %."""
    return [EstimatedParameter("length", 0.02)]


def wound_turns(arc_lengths: Array, radius: float, side: int, start: Array, spots: Array) -> tuple[float, float]:
    """Return by how many turns a rope is wound about a peg at the origin, from its markers, whose order is not known.

    Paths along the rope from marker to marker are compared, straight or round the peg, by the squares of how much
    longer (over 10 mm) or shorter (over 15 %: a slack rope) they are than the rope between the markers, and of how far
    they cut into the peg (over 10 mm), and by the markers that are not seen: those on the peg hide each other. A path's
    turns are exact, but for the place of the peg. A wound rope may often be explained with a turn less as well, one
    that is not wound hardly ever with a turn more.

    Parameters
    ----------
    arc_lengths : (K,) float64
        Of the markers, m.
    radius : float
        Of peg and rope, m.
    side : int
        1 if the rope winds counterclockwise, else -1.
    start : (2,) float64
        The rope's first joint, m.
    spots : (M, 2) float64
        Places of all that looks like a marker, m.

    Returns
    -------
    best : float
        Turns of the likeliest path, signed as of :func:`observed_turns`; NaN if less than half of the markers are seen.
    most : float
        The most turns of a path that is at least a tenth as likely.
    """
    if 2 * len(spots) < arc_lengths.size:
        return math.nan, math.nan
    where = np.vstack([start, spots])
    way, away = where - where[:, None], np.hypot(*where.T)
    square = np.maximum((way**2).sum(axis=2), 1e-12)
    nearest = where[:, None] - way * np.clip((where[:, None] * way).sum(axis=2) / square, -1.0, 0.0)[:, :, None]
    near = np.linalg.norm(nearest, axis=2)
    cut = np.maximum(0.0, np.minimum(radius, np.minimum(away, away[:, None])) - near)
    angle, reach = np.arctan2(where[:, 1], where[:, 0]), np.maximum(away, 1.001 * radius)
    tangent, meets = np.sqrt(reach**2 - radius**2), np.arccos(radius / reach)
    about = (side * (angle - angle[:, None])) % math.tau
    round_peg = about + math.tau * np.arange(3)[:, None, None]
    on = round_peg - meets - meets[:, None]
    # From spot to spot, straight and round the peg: angle about it, rad, length, m, and cost
    turned = np.concatenate([(about - math.tau * (about > math.pi))[None], round_peg])
    length = np.concatenate([np.sqrt(square)[None], tangent + tangent[:, None] + radius * on])
    cost = np.concatenate([(cut[None] / 0.01) ** 2, np.where(on > 0.0, 0.0, np.inf)])
    unseen, hidden, stray = 3.0, 2.5, 8.0  # costs of a marker, of one on the peg at the end, and of a spot that is none
    arcs = np.append(arc_lengths, 0.0)  # the last one is the start's, whose number is -1
    paths = np.zeros((1, 4 + len(where)))  # cost, angle, last spot, number of its marker, and which spots are used
    paths[0, 3:5] = -1.0, 1.0
    for number, arc in enumerate(arc_lengths.tolist()):
        last, before = paths[:, 2:4].T.astype(int)
        gap = (arc - arcs[before])[:, None]
        over = length[:, last] - gap
        allowed = np.where(over > 0.0, 0.01, 0.15 * gap)  # m, of a rope that is taut, and of a slack one
        total = cost[:, last] + (over / allowed) ** 2 + unseen * (number - 1 - before)[:, None]
        how, path, spot = np.nonzero((total < np.inf) & (paths[:, 4:] == 0.0))
        longer = paths[path]
        longer[:, 0] += total[how, path, spot]
        longer[:, 1] += turned[how, last[path], spot]
        longer[:, 2], longer[:, 3] = spot, number
        longer[np.arange(spot.size), 4 + spot] = 1.0
        paths = np.concatenate([longer, paths])
        paths = paths[np.argsort(paths[:, 0] + unseen * (number - paths[:, 3]), kind="stable")[:200]]
    last, number = paths[:, 2:4].T.astype(int)
    missed, unused = arc_lengths.size - 1 - number, (paths[:, 4:] == 0.0).sum(axis=1)
    wrapped = (arc_lengths[-1] - arcs[number] - tangent[last]) / radius  # rad, of an end that is not seen, on the peg
    end = np.where(missed * wrapped > 0.0, 0.0, np.inf)
    turns = np.append(paths[:, 1], paths[:, 1] + meets[last] + wrapped) / math.tau
    total = np.append(unseen * missed, hidden * missed + end) + np.tile(paths[:, 0] + stray * unused, 2)
    best = total.argmin()
    most = turns[total < total[best] + 2.0 * math.log(10.0)].max()
    return side * float(turns[best]), side * float(most)


class SharedFrames:
    """Frames in memory that processes share: one writes, others iterate over the newest (a source of frames).

    Parameters
    ----------
    image_size : (int, int)
        Width and height, px.
    """

    def __init__(self, image_size: tuple[int, int]) -> None:
        width, height = self.image_size = image_size
        self.notes: list[str] = []
        kind = [("stamp", np.float64), ("image", np.uint8, (height, width, 3))]
        self._frames, self._closed = Records(3, kind), False  # one is written, one is read

    @property
    def count(self) -> int:
        """Frames written so far."""
        return self._frames.written

    def write(self, image: Image, stamp: float) -> None:
        """Write a frame (height, width, 3) with its time stamp, s."""
        self._frames.write((stamp, image))

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames as they come: one that nobody took in time is left out."""
        seen = self.count
        while not self._closed:
            if self.count == seen:
                time.sleep(1e-3)
                continue
            seen = self.count
            frame = self._frames.read(1)[0]
            yield Frame(float(frame["stamp"]), frame["image"], seen - 1)

    def close(self) -> None:
        """End the iteration."""
        self._closed = True


class EmulatedCamera:
    """A camera before an emulated rope with markers: it renders frames in a process of its own, in real time.

    Use it as a context manager, within that of the emulator. Its frames come as late as the camera's ``delay`` says,
    or as late as they are rendered if that is later.

    Parameters
    ----------
    plan : CastPlan
        Of the rope that is believed to hang there.
    emulator : Emulator
    rope : Rope
        The emulated one.
    peg : Peg, optional
        The emulated one; by default the plan's.
    camera : Camera, optional
        By default one that sees all places which the rope can reach, 480 pixels wide and high.
    arc_lengths : (K,) array_like, optional
        Of the markers along the believed rope, m; by default ten, the last at its tip. On an emulated rope that is
        longer they are as much farther apart.

    Attributes
    ----------
    frames : SharedFrames
        To be tracked: ``CameraRope(camera.frames, camera.task)``.
    task : TrackingTask
        The believed rope with its markers; its length is estimated.
    """

    def __init__(
        self,
        plan: CastPlan,
        emulator: Emulator,
        rope: Rope,
        peg: Peg | None = None,
        *,
        camera: Camera | None = None,
        arc_lengths: ArrayLike | None = None,
    ) -> None:
        arm, believed, peg = plan.problem.arm, plan.problem.rope, peg or plan.target
        arcs = np.arange(0.1, 1.05, 0.1) * believed.total_length if arc_lengths is None else np.asarray(arc_lengths)
        view = camera or _facing(arm, believed)
        self.frames = SharedFrames(view.image_size)
        size = max(0.025, 5.0 / view.pixels_per_metre)  # m, of a marker: five pixels at least
        scene = Scene(
            arcs * rope.total_length / believed.total_length,
            marker_diameter=size,
            rope_width=2.0 * rope.radius,
            occluders=(Occluder((peg.x, peg.y), (peg.x, peg.y), 2.0 * peg.radius),),
        )
        seen = float(np.pi / 4.0 * (size * view.pixels_per_metre) ** 2)  # px^2
        colour = MarkerColour(np.asarray(scene.marker_colours)[0], area=seen)
        self.task = TrackingTask(believed, arcs, view, [colour], arm, measured_length(), waits=True)
        given = emulator.states, rope.length, arm, view, scene, self.frames
        self._child, self._emulator = Child("The emulated camera", EstimatorLost, film, *given), emulator

    def __enter__(self) -> Self:
        self._emulator.pid  # noqa: B018 raises if it does not run: there is no rope
        self._child.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._child.end()

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._child.pid


def film(
    link: Connection,
    states: Records,
    length: Array,
    arm: Arm,
    camera: Camera,
    scene: Scene,
    frames: SharedFrames,
) -> None:
    """Render frames in real time until the parent ends; say when the first one is there."""
    begin, period = time.monotonic(), 1.0 / 30.0  # s
    renderer = Renderer(camera, _filmed(states, length, arm, begin), scene)
    middle = time.monotonic()  # of the exposure of the row that is read first
    while not link.poll():
        middle += period * max(1, math.ceil((time.monotonic() - middle) / period))
        exposed = middle + 0.5 * camera.exposure + camera.readout
        while (motion := _filmed(states, length, arm, middle - camera.exposure)).t[-1] < exposed:
            if link.poll(1e-3):
                return
        image = renderer.with_motion(motion).image(middle + camera.delay)
        time.sleep(max(0.0, middle + camera.delay - time.monotonic()))
        frames.write(image, middle + camera.delay)
        if frames.count == 1:
            link.send((0, None))


def _filmed(states: Records, length: Array, arm: Arm, since: float) -> RopeMotion:
    """Return how rope and arm have moved since a moment of the monotonic clock, s, and a little before it."""
    log = EmulatorLog(np.zeros((0, 0)), states.read(newest=100), {})
    t, angle, rate = (log.column(name) for name in ("t", "arm_angle", "arm_rate"))
    first = max(0, min(int(np.searchsorted(t, since)), t.size - 1) - 1)
    q, qd = (each[first:] for each in log.rope)
    angle, rate = angle[first:], rate[first:]
    return RopeMotion(t[first:], q, qd, length, arm.tip(angle), arm.tip_velocity(angle, rate))


def _facing(arm: Arm, rope: Rope) -> Camera:
    """Return a camera that sees all places which a rope on an arm can reach; its frames come 30 ms late."""
    side = 480.0
    scale = side / (2.1 * (arm.length + rope.total_length))
    middle = 0.5 * side + scale * np.array([-arm.pivot[0], arm.pivot[1]])
    return Camera.facing((480, 480), pixels_per_metre=scale, origin=middle, exposure=0.004, delay=0.03)
