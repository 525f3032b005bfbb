"""Identification from other than clean angles: markers anywhere, outliers, a camera with its own clock."""

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification import FitOptions, RecordingSetup, identify
from hyperflex.identification.measurements import build_plant, measure
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from tests.identification.twins import WHOLE, recorded
from tests.refusals import refuses

CABLE = Rope.uniform(1.0, 0.06, 12, radius=0.0025, friction=3e-4)
NOISE = 2e-3  # rad or m


def seen(joints: Array, rope: Rope, arc_lengths: Array) -> Array:
    """Places (T, K, 2) at distances along a rope, by interpolation between its joints."""
    ends = np.append(0.0, np.cumsum(rope.length))
    return np.stack(
        [[[np.interp(s, ends, frame[:, axis]) for axis in (0, 1)] for s in arc_lengths] for frame in joints], axis=0
    )


def marked(t: Array, q0: Array, arc_lengths: Array, seed: int, origin: tuple[float, float] = (0.0, 0.0)) -> Recording:
    """Markers along the cable, seen with noise in a picture's frame."""
    run = simulate(CABLE, duration=t[-1], t_eval=t, q0=q0, tol=1e-8)
    noise = NOISE * np.random.default_rng(seed).standard_normal((t.size, arc_lengths.size, 2))
    places = seen(run.joints, CABLE, arc_lengths) + noise + np.array(origin)
    return Recording(t, places.reshape(t.size, -1), kind="markers", noise=NOISE)


def test_fewer_markers_than_links_find_friction_within_its_interval():
    arc_lengths = np.array([0.2, 0.45, 0.7, 1.0])  # no marker at the first joint, which the camera need not see
    recording = marked(np.arange(46) / 15.0, 0.6 + 0.4 * np.linspace(0, 1, 12), arc_lengths, 2, origin=(0.4, 1.2))
    setup = RecordingSetup(arc_lengths=arc_lengths)
    found = identify(recording, CABLE.replace(friction=1e-3), ["friction:shared"], setup=setup, options=WHOLE)
    assert found.success
    assert found.unit == "m"
    gap = abs(found.values["friction"][0] - 3e-4) / found.std["friction"][0]
    assert gap < 4.0  # 6e-5 of chance; the seed is fixed
    assert found.std["friction"][0] < 0.2 * 3e-4  # and it is reported: three seconds of four markers
    for name, truth in (("origin_x", 0.4), ("origin_y", 1.2)):
        assert abs(found.values[name] - truth) < 4.0 * found.std[name]
    np.testing.assert_allclose(found.residual_rms, NOISE, rtol=0.4)  # 46 values a channel: 10 %, four times


def test_a_known_first_joint_counts_as_a_marker_and_folded_links_are_among_the_starts():
    """A tip near the first joint does not show to which side the pendulum is bent: both are starts of a window."""
    angles = np.tile([0.4, 2.9], (20, 1))  # rad; folded
    joints = np.cumsum(DOUBLE.length[:, None] * np.stack([np.sin(angles[0]), -np.cos(angles[0])], axis=1), axis=0)
    places = np.tile(joints.ravel(), (20, 1)) + np.arange(20)[:, None] * 1e-6
    t = np.arange(20) / 100.0
    both = measure(Recording(t, places, kind="markers"), DOUBLE, np.array([0.3, 0.55]), np.zeros((20, 2)))
    assert both.prior.size == 0
    np.testing.assert_allclose(both.shape.data, angles, atol=1e-3)
    tip = measure(Recording(t, places[:, 2:], kind="markers"), DOUBLE, np.array([0.55]), np.zeros((20, 2)))
    window = tip.windows(0.1)[0][0]
    off = [np.abs(np.cos(each[:2] - angles[0]) - 1.0).max() for each in (window.guess, *window.others)]
    assert len(off) == 3
    assert off[0] > 0.3
    assert min(off) < 1e-3


@pytest.mark.parametrize(("rows", "part"), [(slice(70), "fitted"), (slice(60, None), "held out")])
def test_a_marker_without_a_value_in_a_part_is_named(rows, part):
    t = np.arange(91) / 30.0
    places = simulate(CABLE, duration=t[-1], t_eval=t, q0=np.full(12, 0.8)).joints[:, [4, 8, 12]].reshape(t.size, -1)
    places[rows, 2:4] = np.nan
    recording, setup = Recording(t, places, kind="markers"), RecordingSetup(arc_lengths=[1.0 / 3.0, 2.0 / 3.0, 1.0])
    with pytest.raises(InvalidInput, match=f"the marker at 0.666667 m has no value in the part {part}"):
        identify(recording, CABLE, setup=setup, options=FitOptions(train=2.2, lead=0.1, ahead=0.3))


def test_where_a_marker_sits_can_be_found():
    arc_lengths = np.array([0.0, 0.3, 0.6, 0.8, 1.0])
    recording = marked(np.arange(91) / 30.0, np.full(12, 0.8), arc_lengths, 3)
    setup = RecordingSetup(arc_lengths=arc_lengths + np.array([0.0, 0.0, 0.03, 0.0, 0.0]), origin=(0.0, 0.0))
    found = identify(recording, CABLE, ["friction:shared", "arc[2]"], setup=setup, options=WHOLE)
    assert found.success
    assert found.values["arc"].shape == (5,)
    assert abs(found.values["arc"][2] - 0.6) < 4.0 * found.std["arc"][2]
    assert 0.0 < found.std["arc"][2] < 2e-3
    assert found.values["arc"][3] == 0.8


def test_a_taper_is_found_as_two_numbers():
    true = CABLE.replace(friction=3e-4 * np.exp(1.2 * (np.arange(12) + 0.5 - 6.0) / 12.0))
    recording = recorded(true, np.full(12, 0.8), np.arange(151) / 50.0, NOISE, seed=4, tol=1e-8)
    found = identify(recording, CABLE.replace(friction=2e-4), ["friction:factor", "friction:taper"], options=WHOLE)
    assert abs(found.values["friction:factor"] - 1.5) < 4.0 * found.std["friction:factor"]
    assert abs(found.values["friction:taper"] - 1.2) < 4.0 * found.std["friction:taper"]
    np.testing.assert_allclose(found.rope.friction, true.friction, rtol=0.1)


@pytest.mark.parametrize("arc_lengths", [[0.2, 0.1], [-0.1, 0.2], [0.1, 0.9], [0.1]])
def test_arcs_off_the_rope_are_refused(arc_lengths):
    t = np.linspace(0.0, 2.0, 101)
    places = np.stack([np.cos(5.0 * t), np.sin(t), np.cos(6.0 * t), np.sin(2.0 * t)], axis=1)
    with pytest.raises(InvalidInput, match="arc_lengths"):
        identify(
            Recording(t, places, kind="markers"), DOUBLE, ["friction"], setup=RecordingSetup(arc_lengths=arc_lengths)
        )


@pytest.mark.parametrize("told", [True, False], ids=["arc_lengths", "at the joints"])
def test_a_marker_that_never_moves_is_named(told):
    t = np.arange(91) / 30.0
    run = simulate(DOUBLE, duration=t[-1], t_eval=t, q0=[0.8, 1.2], tol=1e-7)
    places = run.joints.reshape(t.size, -1) + 1e-4 * np.random.default_rng(0).standard_normal((t.size, 6))
    places[:, 2:4] = [0.1, -0.28]
    arc_lengths = [0.0, 0.3, 0.55] if told else None
    with pytest.raises(InvalidInput, match="marker 1 never moves"):
        identify(
            Recording(t, places, kind="markers"), DOUBLE, ["friction"], setup=RecordingSetup(arc_lengths=arc_lengths)
        )


def test_a_rope_held_at_both_ends_is_not_called_reversed():
    """Both ends are at rest up to 1 mm of noise, which is not a motion of the first one."""
    t, along = np.arange(300) / 50.0, np.linspace(0.0, 1.0, 6)
    sway = 0.1 * np.sin(np.pi * along) * np.cos(4.0 * t)[:, None]
    places = np.stack([0.5 * along + sway, -0.2 * np.sin(np.pi * along) + 0.3 * sway], axis=2)
    places += 1e-3 * np.random.default_rng(0).standard_normal(places.shape)
    rope = Rope(length=[0.12] * 5, mass=[0.02] * 5)
    with pytest.raises(InvalidInput, match=r"marker 5 never moves.*held at both ends"):
        identify(Recording(t, places.reshape(t.size, -1), kind="markers"), rope)
    run = simulate(DOUBLE, duration=t[-1], t_eval=t, q0=[0.8, 1.2], tol=1e-7)
    places = run.joints[:, ::-1] + 1e-4 * np.random.default_rng(0).standard_normal((t.size, 3, 2))
    refuses("The first marker moves", identify, Recording(t, places.reshape(t.size, -1), kind="markers"), DOUBLE)


@pytest.mark.parametrize(("noise", "precision"), [(1e-2, 1e-7), (1e-4, 5e-9), (1e-9, 1e-9)])
def test_rollouts_are_as_fine_as_the_markers_are_known(noise, precision):
    """For positions known to 0.1 mm, a tolerance of 1e-7 makes the sum of squares too rough for a fit to converge."""
    line, t = Rope.uniform(2.0, 0.1, 4, friction=1e-4), np.linspace(0.0, 1.0, 5)
    places = Recording(t, np.zeros((5, 4)), kind="markers", noise=noise)
    setup = RecordingSetup(arc_lengths=[1.0, 2.0], origin=(0.0, 0.0))
    plant = build_plant(places, line, ["friction:shared"], setup)
    assert plant.precision == pytest.approx(precision)
