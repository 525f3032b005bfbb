"""What is refused before anything is fitted: noise without motion, and times that do not suit the rope."""

import numpy as np
import pytest

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification import RecordingSetup, identify
from hyperflex.identification.measurements import check_motion, check_times
from hyperflex.model import Rope
from hyperflex.paper import iterative_revision
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from tests.identification.twins import QUICK
from tests.refusals import refuses

ROPE = Rope.uniform(length=1.0, mass=7.65e-3, n_links=5, inertia=1.43e-7, friction=6.3e-4)
NOISE = 0.01  # rad
ARCS = [0.2, 0.4, 0.6, 0.8, 1.0]


def swing(size: float, frames: int, rate: float = 7.5, rope: Rope = ROPE) -> tuple[Array, Array, Array]:
    """Return times, angles and joints of a swing let go at `size`, rad."""
    t = np.arange(frames) / rate
    run = simulate(rope, duration=float(t[-1]), t_eval=t, q0=np.full(rope.n_links, size))
    return t, run.q, run.joints[:, 1:].reshape(frames, -1)


def noise(shape: tuple[int, ...], seed: int = 0) -> Array:
    return NOISE * np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.parametrize("declared", [None, NOISE])
@pytest.mark.parametrize(("size", "frames"), [(0.0, 81), (0.003, 20)])
def test_noise_is_no_motion(size, frames, declared):
    t, q, _ = swing(size, frames)
    recording = Recording(t, q + noise(q.shape), noise=declared)
    for each in (recording, Recording(t, 0.3 + recording.data, noise=declared)):  # a camera that is not level
        refuses("no motion beyond noise", identify, each, ROPE, ["friction:shared"])
        refuses("no motion beyond noise", iterative_revision, each, ROPE)


def test_noise_of_markers_is_no_motion():
    t, _, places = swing(0.0, 81)
    recording = Recording(t, places + 0.2 * noise(places.shape), kind="markers", noise=0.2 * NOISE)
    with pytest.raises(InvalidInput, match="no motion beyond noise"):
        identify(recording, ROPE, ["friction:shared"], setup=RecordingSetup(arc_lengths=ARCS))


def moves(*recordings: Recording) -> bool:
    """Whether these are taken for recordings of a motion."""
    try:
        check_motion(*recordings)
    except InvalidInput:
        return False
    return True


def test_white_noise_hardly_ever_passes():
    passed = sum(moves(Recording(np.arange(81) / 7.5, noise((81, 3), seed))) for seed in range(200))
    assert passed <= 3  # one in a thousand is meant; four of 200 come by chance once in 18000


def test_small_swings_above_their_noise_pass():
    t, q, places = swing(0.03, 81)
    for seed in range(5):
        assert moves(Recording(t, q + noise(q.shape, seed)))
        assert moves(Recording(t, q + noise(q.shape, seed), noise=10 * NOISE))  # declared with too much care
        assert moves(Recording(t, q), Recording(t, places + 0.2 * noise(places.shape, seed), kind="markers"))
    t, q, _ = swing(0.05, 8)
    assert moves(Recording(t, q))


@pytest.mark.parametrize("length", [0.1, 0.2, 0.4])  # periods of 3.9 to 7.8 samples, their bends of two to four
def test_a_swing_that_is_sampled_slowly_passes(length):
    pair = Rope(length=[length / 2] * 2, mass=[0.1] * 2, friction=1e-6)
    t, q, _ = swing(0.1, 81, rope=pair)
    assert moves(Recording(t, q + 0.3 * noise(q.shape)))


def test_one_gross_outlier_hides_no_motion():
    t, q, _ = swing(0.05, 81)
    data = q + 0.1 * noise(q.shape)
    data[40, 2] = 100.0
    assert moves(Recording(t, data))


def test_stiff_ropes_may_be_short_and_weightless_ones_slow():
    t, q, _ = swing(0.3, 5, rate=100.0)
    refuses("too short", check_times, Recording(t, q), ROPE)
    check_times(Recording(t, q), ROPE.replace(stiffness=1.0))
    check_times(Recording(1e3 * t, q), ROPE.replace(gravity=(0.0, 0.0)))


def test_revise_asks_for_motion_and_time_too():
    t, q, _ = swing(0.3, 81)
    refuses("nothing moves", iterative_revision, Recording(t, 0.0 * q), ROPE)
    refuses("another unit", iterative_revision, Recording(1e3 * t, q), ROPE)


@pytest.mark.parametrize("links", [1, 2])
def test_the_tip_alone_identifies_a_rope(links):
    rope = Rope(length=[0.4 / links] * links, mass=[0.1, 0.06][:links], friction=3e-4)
    t = np.arange(0.0, 8.0, 0.02)
    tip = simulate(rope, duration=8.0, t_eval=t, q0=[0.8] * links).tip + np.array([0.3, 0.1])
    spread = 1e-3
    recording = Recording(
        t, tip + spread * np.random.default_rng(0).standard_normal(tip.shape), kind="markers", noise=spread
    )
    guess, free = rope.replace(friction=1e-3), ["friction:shared"]
    refuses(r"origin=\(x, y\)", identify, recording, guess, free, setup=RecordingSetup(arc_lengths=[0.4]))
    refuses("marker alone", recording.angles)
    found = identify(recording, guess, free, setup=RecordingSetup(arc_lengths=[0.4], origin=(0.3, 0.1)), options=QUICK)
    assert found.success
    value, std = float(found.values["friction"][0]), float(found.std["friction"][0])
    assert abs(value - 3e-4) < 4.0 * std < 6e-5  # chance of more: 6e-5; far less than the guess is off
