"""The paper's method: initial state by downhill simplex (7), alternating revision (Fig. 4), compared with NF and CM."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import paper
from hyperflex.errors import IdentificationError
from hyperflex.paper import natural_frequency_inertia, natural_period, revision, squared_error, swing_period
from tests.refusals import left_by, refuses

T = np.arange(41) / 7.5
ROPE = hf.Rope.uniform(0.6, 0.06, 3, inertia=2e-5, friction=2e-3)
GUESS = ROPE.replace(inertia=4e-5 * np.ones(3), friction=4e-3 * np.ones(3))
START = np.array([0.7, 0.5, 0.9])


def swing(rope: hf.Rope = ROPE, noise: float = 0.0, rates: float = 0.0, t: np.ndarray = T) -> hf.Recording:
    qd0 = rates * np.array([1.0, -1.0, 2.0])
    q = hf.simulate(rope, duration=t[-1], t_eval=t, q0=START, qd0=qd0, tol=1e-9).q
    return hf.Recording(t, q + noise * np.random.default_rng(3).standard_normal(q.shape))


def test_initial_angles_are_found():
    away = START + np.array([0.2, -0.1, 0.3])
    found = hf.estimate_initial_state(swing(), ROPE, start=(away, np.zeros(3)))
    assert found.success
    # The simplex ends within ANGLE_STEP = 1e-4 of the least error; friction makes the sharpest bend weak in the data.
    np.testing.assert_allclose(found.q, START, atol=1e-3)
    assert (found.qd == 0.0).all()
    assert found.error < 1e-6


def test_the_optimised_start_is_better_than_a_noisy_first_frame():
    recording = swing(noise=0.01)
    found = hf.estimate_initial_state(recording, ROPE)
    measured = squared_error(recording, ROPE, np.append(recording.data[0], np.zeros(3)))
    true = squared_error(recording, ROPE, np.append(START, np.zeros(3)))
    assert found.error < min(true, measured)


def test_initial_rates_are_found_along_with_the_angles():
    recording = swing(rates=1.5)
    still = hf.estimate_initial_state(recording, ROPE)
    found = hf.estimate_initial_state(recording, ROPE, rates="free")
    assert still.error > 0.1  # rates of some rad/s cannot be made up by angles
    # The simplex ends within ANGLE_STEP of the least error, here 0, and in rates within that over PACE.
    np.testing.assert_allclose(found.q, START, atol=1e-3)
    np.testing.assert_allclose(found.qd, [1.5, -1.5, 3.0], atol=1e-2)
    assert found.error < 1e-5


def test_measured_rates_are_those_of_a_parabola_through_three_samples():
    t = np.array([0.0, 0.1, 0.25, 0.4])
    angle = np.stack([0.3 - 2.0 * t + 5.0 * t**2, 0.1 + t], axis=1)
    rope = hf.Rope.uniform(0.4, 0.04, 2, friction=0.0)
    found = hf.estimate_initial_state(hf.Recording(t, angle), rope, rates="measured", max_evaluations=1)
    np.testing.assert_allclose(found.qd, [-2.0, 1.0], rtol=1e-12)


def test_the_error_is_the_sum_of_squares_and_gaps_count_nothing():
    recording = swing()
    state = np.append(START, np.zeros(3))
    data = recording.data + 0.01
    # Rollouts of the search are good to some 1e-5 rad.
    assert squared_error(hf.Recording(T, data), ROPE, state) == pytest.approx(123 * 1e-4, rel=5e-3)
    data[5:9, 1] = np.nan
    assert squared_error(hf.Recording(T, data), ROPE, state) == pytest.approx(119 * 1e-4, rel=5e-3)
    assert squared_error(recording, ROPE, np.append(START, [np.nan, 0.0, 0.0])) == np.inf


def test_ctrl_c_keeps_the_best_state_so_far(monkeypatch):
    recording, seen = swing(noise=0.01), []

    def error(measured, rope, state):
        if len(seen) > 40 and seen[-1] > min(seen):
            raise KeyboardInterrupt
        seen.append(squared_error(measured, rope, state))
        return seen[-1]

    monkeypatch.setattr(revision, "squared_error", error)
    found = left_by(lambda: hf.estimate_initial_state(recording, ROPE))
    assert found.status == "interrupted"
    assert found.error == min(seen) < seen[-1]
    assert found.evaluations == len(seen)


def test_the_revision_settles_at_the_truth_and_tells_its_rounds():
    heard = []
    found = hf.iterative_revision(swing(), GUESS, progress=heard.append)
    assert found.success
    assert found.converged_after is not None
    assert found.converged_after <= 5
    assert tuple(heard) == found.rounds
    assert (found.rounds[0].inertia, found.rounds[0].friction) == (4e-5, 4e-3)
    # Without noise only the simplex's 1e-4 rad are left; they come to less than a thousandth in J and eta.
    assert found.best.inertia == pytest.approx(2e-5, rel=5e-3)
    assert found.best.friction == pytest.approx(2e-3, rel=1e-3)
    assert found.rope.inertia == pytest.approx(np.full(3, found.best.inertia))
    assert found.rounds[0].error > 100.0 * found.error
    assert found.evaluations == sum(each.evaluations for each in found.rounds)


@pytest.mark.nightly
def test_the_uncertainty_of_the_revision_is_that_of_repeated_noise():
    draws = []
    for seed in range(16):
        recording = swing()
        noise = 5e-3 * np.random.default_rng(seed).standard_normal(recording.data.shape)
        draws.append(hf.iterative_revision(hf.Recording(T, recording.data + noise), ROPE, rounds=2))
    for name in ("inertia", "friction"):
        values = np.array([getattr(draw.best, name) for draw in draws])
        # 16 draws: a standard deviation known within 18 % (one sigma), and a mean within a quarter of it.
        assert 0.6 < values.std(ddof=1) / draws[0].std[name] < 1.6
        assert abs(values.mean() - getattr(ROPE, name)[0]) < 1.0 * draws[0].std[name]


def test_mixed_profiles_use_the_recording_and_stay_away_from_the_truth():
    best = hf.iterative_revision(swing(noise=0.01), GUESS)
    for profile in ("measured", "measured rates"):
        found = hf.iterative_revision(swing(noise=0.01), GUESS, profile=profile, rounds=3)
        assert found.rounds[1].friction != pytest.approx(4e-3, rel=1e-3)
        assert found.error == min(each.error for each in found.rounds)
        assert found.error > 1.2 * best.error


@pytest.mark.nightly
def test_a_printed_friction_is_revised_as_printed():
    printed = ROPE.replace(friction_model="printed")
    found = hf.iterative_revision(swing(printed), GUESS.replace(friction_model="printed"))
    assert found.best.friction == pytest.approx(2e-3, rel=1e-3)
    assert found.rope.friction_model == "printed"


def test_what_would_become_negative_stops_at_zero_and_the_rest_adapts():
    # Links without inertia of their own, and noise that gives a negative one: about one recording in two.
    none = ROPE.replace(inertia=np.zeros(3))
    data = swing(none).data
    recording = hf.Recording(T, data + 5e-3 * np.random.default_rng(1).standard_normal(data.shape))
    found = hf.iterative_revision(recording, GUESS)
    assert found.success
    assert found.best.inertia == 0.0
    # With J at 0, E is least at the eta that was found: as much is lost on either side of it.
    lost = [
        hf.estimate_initial_state(recording, found.rope.replace(friction=found.rope.friction + step)).error
        - found.error
        for step in (-found.std["friction"], found.std["friction"])
    ]
    assert min(lost) > 0.0
    assert lost[0] == pytest.approx(lost[1], rel=0.25)  # a tenth of std, where it settles, makes a fifth of it at most


def test_ctrl_c_keeps_the_best_round_so_far(monkeypatch):
    rounds, count = [], []

    def error(measured, rope, state):
        count.append(1)
        if len(rounds) == 2 and len(count) > 1:
            raise KeyboardInterrupt
        return squared_error(measured, rope, state)

    monkeypatch.setattr(revision, "squared_error", error)

    def told(each):
        rounds.append(each)
        count.clear()

    found = left_by(lambda: hf.iterative_revision(swing(), GUESS, progress=told))
    assert found.status == "interrupted"
    assert len(rounds) == 2
    assert found.error == min(each.error for each in rounds)
    assert found.converged_after is None


def test_recordings_and_ropes_that_do_not_fit_are_refused():
    refuses("different numbers of links", hf.iterative_revision, swing(), hf.Rope.uniform(0.6, 0.06, 4, friction=0.0))
    refuses("profile is not known", hf.iterative_revision, swing(), GUESS, profile="integrated")
    refuses("rates is not known", hf.estimate_initial_state, swing(), ROPE, rates="zero")
    data = swing().data.copy()
    data[1, 2] = np.nan
    refuses("first three samples", hf.estimate_initial_state, hf.Recording(T, data), ROPE)
    refuses("recording is no Recording", hf.estimate_initial_state, data, ROPE)


def test_a_start_from_which_nothing_can_be_simulated_is_refused():
    with pytest.raises(IdentificationError, match="cannot be simulated from the start"):
        hf.estimate_initial_state(swing(), ROPE, start=(np.full(3, 1e4), np.zeros(3)))


def test_natural_period_of_a_single_link_is_that_of_a_pendulum():
    rope = hf.Rope(length=[0.4], mass=[0.2], com=[0.15], inertia=[3e-3], stiffness=[0.05])
    period = 2.0 * np.pi * np.sqrt((3e-3 + 0.2 * 0.15**2) / (0.2 * 9.81 * 0.15 + 0.05))
    assert natural_period(rope) == pytest.approx(period, rel=1e-12)


def test_natural_period_of_a_fine_chain_is_that_of_a_hanging_chain():
    # A continuous chain: omega = (j0 / 2) sqrt(g / L) with the first zero j0 of Bessel's J0; n links: off by 1 / n^2.
    rope = hf.Rope.uniform(1.0, 0.01, 100, friction=0.0)
    assert natural_period(rope) == pytest.approx(2.0 * np.pi / (0.5 * 2.404825557695773 * np.sqrt(9.81)), rel=1e-4)


def test_inertia_by_natural_frequency_inverts_the_period_of_a_rod():
    # A rod that hangs from its end, J = m L^2 / 12: T from (8), and back. Two equal links share it.
    length, mass = 0.8, 0.1
    inertia = mass * length**2 / 12.0
    period = 2.0 * np.pi * np.sqrt((inertia + mass * 0.16) / (mass * 9.81 * 0.4))
    rope = hf.Rope.uniform(length, mass, 2, friction=0.0)
    assert natural_frequency_inertia(rope, period) == pytest.approx(inertia / 2.0, rel=1e-12)
    refuses("too short", natural_frequency_inertia, rope, 0.5 * period)


def test_inertia_of_the_papers_rope_by_natural_frequency_is_near_its_figure():
    # Printed: 102e-6. L = 1.0 m and 1.53e-3 kg a link are inferred from rounded figures; 2 % in T is 12 % in J.
    rope = hf.Rope.uniform(1.0, 5 * 1.53e-3, 5, friction=0.0)
    assert natural_frequency_inertia(rope, 1.61) == pytest.approx(102e-6, rel=0.12)


def test_cylinder_inertia_is_the_ropes_default():
    rope = hf.Rope.uniform(2.0, 0.125, 50, radius=0.0025, friction=0.0)
    np.testing.assert_array_equal(paper.cylinder_inertia(rope), rope.inertia)
    printed = paper.cylinder_inertia(hf.Rope.uniform(1.0, 5 * 1.53e-3, 5, friction=0.0))
    assert printed[0] == pytest.approx(5.09e-6, rel=5e-3)


@pytest.mark.parametrize(("step", "noise"), [(0.1, 0.02), (0.01, 0.03)], ids=["few samples", "noise about zero"])
def test_period_of_a_measured_swing(step, noise):
    t = np.arange(0.0, 8.0, step)
    angle = np.exp(-0.2 * t) * np.cos(2.0 * np.pi * t / 1.7)
    angle += noise * np.random.default_rng(2).standard_normal(t.size)
    # Nine half periods are counted; the first and the last crossing are off by 0.03 rad / (2 rad/s) or so each.
    assert swing_period(hf.Recording(t, angle[:, None])) == pytest.approx(1.7, rel=0.01)
    refuses("too few swings", swing_period, hf.Recording(t, 1.0 + 0.1 * angle[:, None]))
