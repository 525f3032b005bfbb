"""A rope that a camera sees while a plan is carried out: turns by its markers, frames that processes share."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.errors import EstimatorLost, InvalidInput
from hyperflex.estimate import TrackingTask
from hyperflex.execution import CameraRope, EmulatedCamera
from hyperflex.execution.camera import SharedFrames, wound_turns
from hyperflex.hardware import Emulator, MotorModel
from hyperflex.hardware.emulate import MoteusDevice
from hyperflex.vision import Camera, MarkerColour
from tests.execution.test_run import short_plan

ROPE = hf.Rope.uniform(length=1.0, mass=0.05, n_links=20, radius=0.0025, friction=1e-3)
ARCS = np.arange(1, 11) / 10.0
PEG, START = hf.Peg(0.5, -0.2, 0.03), np.array([0.0, 0.0])
RADIUS = PEG.radius + ROPE.radius


def wound(side: int) -> tuple[Array, float]:
    """Return the markers of a taut rope wound so about the peg that 10 cm of it hang down, and its true turns."""
    middle = np.array([PEG.x, PEG.y])
    away = START - middle
    far = float(np.hypot(*away))
    straight = math.sqrt(far**2 - RADIUS**2)
    angle = math.atan2(away[1], away[0]) + side * math.acos(RADIUS / far)  # where it meets the peg
    on = 1.0 - straight - 0.1
    places = []
    for arc in ARCS.tolist():
        if arc <= straight:
            meets = middle + RADIUS * np.array([math.cos(angle), math.sin(angle)])
            places.append(START + arc / straight * (meets - START))
            continue
        turned = angle + side * min(arc - straight, on) / RADIUS
        out = np.array([math.cos(turned), math.sin(turned)])
        places.append(middle + RADIUS * out + max(0.0, arc - straight - on) * side * np.array([-out[1], out[0]]))
    turns = math.acos(RADIUS / far) + on / RADIUS + math.atan(0.1 / RADIUS)
    return np.array(places), side * turns / math.tau


@pytest.mark.parametrize("side", [-1, 1])
def test_turns_are_counted_by_markers_whose_order_is_not_known(side: int) -> None:
    places, turns = wound(side)
    mixed = np.random.default_rng(0).permutation(places)
    assert wound_turns(ROPE, ARCS, START, PEG, side, mixed) == pytest.approx(turns, abs=0.15)
    away = places[np.hypot(*(places - [PEG.x, PEG.y]).T) > 0.05]  # on the peg, markers hide each other
    assert wound_turns(ROPE, ARCS, START, PEG, side, away) == pytest.approx(turns, abs=0.15)


def test_a_rope_that_hangs_free_has_no_turns_and_one_that_is_not_seen_unknown_ones() -> None:
    hanging = ARCS[:, None] * np.array([0.0, -1.0])
    assert wound_turns(ROPE, ARCS, START, PEG, 1, hanging) == 0.0
    beside = START + ARCS[:, None] * np.array([PEG.x, PEG.y]) / math.hypot(PEG.x, PEG.y)  # it passes behind the peg
    assert 0.0 <= wound_turns(ROPE, ARCS, START, PEG, 1, beside) <= 0.5
    assert math.isnan(wound_turns(ROPE, ARCS, START, PEG, 1, np.zeros((0, 2))))


@pytest.mark.parametrize("side", [-1, 1])
def test_turns_are_unknown_where_markers_before_the_peg_are_not_seen(side: int) -> None:
    places, _ = wound(side)
    before = np.hypot(*(places - START).T) < 0.45
    for seen in (~before, np.arange(ARCS.size) != 3):  # none before the peg, or all but the last before it
        assert math.isnan(wound_turns(ROPE, ARCS, START, PEG, side, places[seen]))


def test_an_emulated_camera_before_an_emulator_that_does_not_run_is_one_line() -> None:
    plan = short_plan()
    emulator = Emulator(MoteusDevice, MotorModel(), plan.problem.rope)
    with pytest.raises(InvalidInput, match="the emulator does not run"):
        EmulatedCamera(plan, emulator, plan.problem.rope).__enter__()


def test_the_newest_of_shared_frames_is_given() -> None:
    frames, image = SharedFrames((4, 3)), np.zeros((3, 4, 3), np.uint8)
    every = iter(frames)

    def write() -> None:
        for k in range(3):
            frames.write(image + k, 0.1 * k)

    late = threading.Timer(0.2, write)
    late.start()
    frame = next(every)
    late.join()
    last = frame if frame.index == 2 else next(every)
    assert last.time == pytest.approx(0.2)
    assert np.all(last.image == 2)
    frames.write(image + 7, 1.0)
    assert np.all(last.image == 2)  # a frame that was given does not change
    frames.close()
    assert next(every, None) is None or not list(every)


def test_frames_of_another_size_than_the_calibration_are_one_line() -> None:
    camera = Camera.facing((64, 48), pixels_per_metre=20.0, origin=(32.0, 10.0))
    task = TrackingTask(ROPE, ARCS, camera, [MarkerColour(np.array([40.0, 30.0, 210.0]))], hf.Arm())
    with pytest.raises(EstimatorLost, match=r"another size than the camera's calibration.*32x24"):
        CameraRope(SharedFrames((32, 24)), task).__enter__()


def test_the_clock_of_a_camera_can_be_set() -> None:
    camera = Camera.facing((64, 48), pixels_per_metre=20.0, origin=(32.0, 10.0))
    task = TrackingTask(ROPE, ARCS, camera, [MarkerColour(np.array([40.0, 30.0, 210.0]))], hf.Arm())
    source = CameraRope(SharedFrames((64, 48)), replace(task))
    source.start_clock(1000.0)
    other = CameraRope(SharedFrames((64, 48)), task)
    other.start_clock(1000.5)
    assert source.now - other.now == pytest.approx(0.5, abs=0.1)
