"""A rope that a camera sees while a plan is carried out: a real camera, or one that is rendered before an emulator."""

import math
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Self

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.child import Child, Records
from hyperflex.errors import EstimatorLost
from hyperflex.estimate import CameraStateSource, EstimatedParameter, TrackingTask
from hyperflex.hardware import Emulator, EmulatorLog
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import CastPlan
from hyperflex.trajectory import swept
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

    def turns(self, arm_angle: Callable[[Array], Array], peg: Peg, side: int) -> tuple[Array, Array]:
        """Return the times (T,), s, of the pictures, and the turns of the rope about a peg in each; NaN: not seen."""
        arm, rope, arcs = checks.instance("arm", self.task.arm, Arm), self.task.rope, np.asarray(self.task.arc_lengths)
        seen = list(self.spots)
        t = np.array([at for at, _ in seen])
        tips = arm.tip(arm_angle(t))
        found = [wound_turns(rope, arcs, tip, peg, side, spots) for tip, (_, spots) in zip(tips, seen, strict=True)]
        parts = np.lib.stride_tricks.sliding_window_view(np.pad(found, 4, "edge"), 9) if found else np.zeros((0, 9))
        turns, known = np.full(t.shape, math.nan), np.isfinite(parts).sum(axis=1) > 4
        turns[known] = np.nanmedian(parts[known], axis=1)  # of nine: markers pass before others
        return t, turns


def measured_length() -> list[EstimatedParameter]:
    """Return what a tracker estimates of a rope whose length was measured to 2 %."""
    return [EstimatedParameter("length", 0.02)]


def wound_turns(rope: Rope, arc_lengths: Array, start: Array, peg: Peg, side: int, spots: Array) -> float:
    """Return by how many turns a rope is wound about a peg, from its markers, whose order is not known.

    From the start markers follow each other at about their distances along the rope, up to the peg. All others off the
    peg are those of the free end, the last of the rope. What is between both, less the straight ways to the peg, is on
    it. Right to some 0.3 turns where the rope hangs slack; markers that are hidden by others make them more. Where a
    marker more would have to be seen off the peg, nothing is known.

    Parameters
    ----------
    rope : Rope
    arc_lengths : (K,) float64
        Of the markers, m.
    start : (2,) float64
        The rope's first joint, m.
    peg : Peg
    side : int
        1 if the rope winds counterclockwise, else -1.
    spots : (M, 2) float64
        Places of all that looks like a marker, m.

    Returns
    -------
    float
        Signed, as of :func:`observed_turns`; 0 if nothing of the rope is on the peg, NaN if none, or too few, are
        seen off it.
    """
    middle, radius = np.array([peg.x, peg.y]), peg.radius + rope.radius
    free = [spot for spot in spots if math.dist(spot, middle) > 2.0 * radius]
    if not free:
        return math.nan
    chain, arc = [start], 0.0  # of what leads to the peg
    for gap in np.diff(arc_lengths, prepend=0.0).tolist():
        steps = [abs(math.dist(spot, chain[-1]) - gap) for spot in free]
        if not steps or min(steps) > 0.3 * gap:
            break
        chain.append(free.pop(int(np.argmin(steps))))
        arc += gap
    first = arc_lengths.size - len(free)  # marker of the free end
    end = sorted(free, key=lambda spot: math.dist(spot, middle))
    ways = [math.dist(each, middle) for each in (chain[-1], *end[:1])]
    straight = sum(math.sqrt(max(0.0, way**2 - radius**2)) for way in ways)
    on = (arc_lengths[first] if end else rope.total_length) - arc - straight
    if first < 0 or on <= 0.0:
        return 0.0
    if max(ways) > 1.3 * np.diff(arc_lengths, prepend=0.0).max() + 2.0 * radius:
        return math.nan
    beside = sum(math.acos(min(1.0, radius / way)) for way in ways)  # rad, to where a way meets the peg
    about = sum(float(swept(np.array(each) - middle).sum()) for each in (chain, end) if len(each) > 1)
    return (side * (on / radius + beside) + about) / math.tau


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
    rate : float
        Frames a second, Hz.

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
        arc_lengths: npt.ArrayLike | None = None,
        rate: float = 30.0,
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
        self.task = TrackingTask(believed, arcs, view, [colour], arm, measured_length())
        period = 1.0 / checks.number("rate", rate, sign="positive", unit="Hz")
        given = emulator.states, rope.length, arm, view, scene, period, self.frames
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
    period: float,
    frames: SharedFrames,
) -> None:
    """Render frames in real time until the parent ends; say when the first one is there."""
    begin = time.monotonic()
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
