"""State sources of a controller: the truth, or a simulated camera with noise, delay and a wrong model."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.control import SimulatedCamera, TrueState
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=6, radius=0.003, friction=1e-3)
ARM = hf.Arm(length=0.1)
MOTION = hf.arm_strokes([0.0, 1.0])


def camera(**changed) -> SimulatedCamera:
    settings = {"rate": 30.0, "delay": 0.1, "angle_std": 0.0, "rate_std": 0.0} | changed
    rope = settings.pop("rope", ROPE)
    return SimulatedCamera(TrueState(ROPE, ARM), rope, ARM, **settings)


def test_the_truth_is_the_simulation_though_it_is_required_in_pieces():
    source = TrueState(ROPE, ARM, tol=1e-8)
    # Later half turns are unknown when the first states are requested.
    states = [source.state(t, MOTION if t > 0.9 else hf.arm_strokes([0.0])) for t in (0.4, 0.8, 1.3, 1.31)]
    run = hf.simulate(ROPE, MOTION, arm=ARM, duration=1.5, t_eval=[0.4, 0.8, 1.3, 1.31], tol=1e-8)
    # Steps differ; tol of 1e-8 m is 6e-8 rad of a link, a hundred times that for a second of motion.
    np.testing.assert_allclose([s.q for s in states], run.q, atol=6e-6)
    np.testing.assert_allclose([s.qd for s in states], run.qd, atol=1e-4)


def test_the_truth_does_not_go_back():
    source = TrueState(ROPE, ARM)
    source.state(0.5, MOTION)
    refuses("goes back", source.state, 0.4, MOTION)


def test_a_camera_without_noise_and_with_the_right_model_bridges_its_delay():
    seen, true = camera().state(1.234, MOTION), TrueState(ROPE, ARM).state(1.234, MOTION)
    assert seen.t == 1.234
    # Two runs at the default tolerance of 1e-5 m, 6e-5 rad of a link.
    np.testing.assert_allclose(seen.q, true.q, atol=1e-3)


def test_a_wrong_model_errs_more_the_longer_the_delay():
    true = TrueState(ROPE, ARM).state(1.5, MOTION)
    wrong = ROPE.replace(friction=5e-3)
    errors = [np.abs(camera(rope=wrong, delay=d).state(1.5, MOTION).q - true.q).max() for d in (0.0, 0.1, 0.3)]
    assert errors[0] < 1e-3 < errors[1] < errors[2]


def test_noise_is_of_the_frame_and_repeats():
    noisy = [camera(angle_std=0.01, rate_std=0.1, delay=0.0, seed=3).state(1.0, MOTION) for _ in range(2)]
    np.testing.assert_array_equal(noisy[0].q, noisy[1].q)
    other = camera(angle_std=0.01, rate_std=0.1, delay=0.0, seed=4).state(1.0, MOTION)
    assert np.abs(other.q - noisy[0].q).max() > 1e-3
    source = camera(angle_std=0.01, delay=0.0)
    true = TrueState(ROPE, ARM)
    errors = [source.state(k / 30.0, MOTION).q - true.state(k / 30.0, MOTION).q for k in range(60)]
    # 360 draws: the standard deviation is known to 1 / sqrt(720) = 3.7 %; four of those.
    assert np.std(errors) == pytest.approx(0.01, rel=0.15)


def test_before_the_first_frame_the_rope_hangs():
    np.testing.assert_array_equal(camera(delay=0.5).state(0.0, MOTION).q, 0.0)


def test_another_number_of_links_is_refused():
    finer = hf.Rope.uniform(length=1.0, mass=0.1, n_links=7, radius=0.003, friction=0.0)
    refuses("links", camera(rope=finer).state, 1.0, MOTION)


def test_times_that_do_not_add_up_to_the_last_digit_are_no_error():
    """Runs between such times end a rounding error before the requested time."""
    pairs = np.random.default_rng(0).uniform([0.1, 1.1], [0.3, 1.3], (400, 2))
    first, then = next((a, b) for a, b in pairs.tolist() if a + (b - a) < b)
    source = TrueState(ROPE, ARM)
    assert [source.state(t, MOTION).t for t in (first, then)] == [first, then]
    eye = camera(delay=then - first, rate=1.0 / first)  # its frame is taken at `first`, and carried to `then`
    assert eye.state(then, MOTION).t == then
