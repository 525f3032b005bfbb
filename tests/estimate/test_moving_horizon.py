"""The moving horizon: several starts, blackouts, wrong explanations, and a real double pendulum's withheld markers."""

import numpy as np
import pytest
from benchmarks import pendulum_tracking as pendulum

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.estimate import MovingHorizon, Observations, RopeFilter, smooth
from tests.refusals import refuses

GAP, NOISE = 0.08, 2.5e-4  # s between frames: links turn by more than half a turn from one to the next


def spin(seed: int, frames: int = 20) -> hf.Trajectory:
    """The real pendulum's model, thrown by chance: full rotations of both links."""
    rng = np.random.default_rng(seed)
    q0, qd0 = rng.uniform(-3.0, 3.0, 2), rng.normal(0.0, 40.0, 2)
    return hf.simulate(pendulum.pendulum(), duration=GAP * frames, q0=q0, qd0=qd0, t_eval=GAP * np.arange(frames))


def seen(run: hf.Trajectory, hidden: slice = slice(0, 0)) -> list[Observations]:
    places = np.asarray(run.joints)[:, 1:] + NOISE * np.random.default_rng(0).normal(size=(run.t.size, 2, 2))
    places[hidden] = np.nan
    return [Observations(float(t), each, NOISE) for t, each in zip(run.t, places, strict=True)]


def horizon(starts: int = 16) -> MovingHorizon:
    arcs = np.cumsum(pendulum.LENGTHS)
    return MovingHorizon(pendulum.pendulum(), arcs, starts=starts, process_noise=0.5)


def errors(tracker: RopeFilter, run: hf.Trajectory, observations: list[Observations]) -> Array:
    """Largest errors of a link's rate in each frame, rad/s."""
    result = []
    for k, each in enumerate(observations):
        tracker.update(each)
        assert np.isfinite(tracker.state.covariance).all()
        result.append(np.abs(tracker.state.qd - run.qd[k]).max())
    return np.array(result)


def test_several_starts_find_the_rates_that_one_does_not():
    """Two frames leave each rate ambiguous by whole turns, 79 rad/s; the third and fourth resolve it."""
    right = {1: 0, 16: 0}
    for seed in range(3):
        run = spin(seed)
        for starts in right:
            found = errors(horizon(starts), run, seen(run))
            right[starts] += bool((found[8:] < 5.0).all())
    assert right == {1: 0, 16: 3}


def test_explanations_are_weighed_and_dropped():
    run, tracker = spin(1), horizon()
    counts, wide = [], []
    for each in seen(run):
        tracker.update(each)
        weights = tracker.explanations
        counts.append(weights.size)
        wide.append(np.sqrt(np.diag(tracker.state.covariance)[2:]).max())
        assert weights.sum() == pytest.approx(1.0)
        assert (np.diff(weights) <= 0.0).all()
        assert weights.min() > 1e-4
    assert counts[1] > 1  # two frames
    assert counts[-1] == 1
    assert wide[1] > 10.0  # the mixture's
    assert wide[-1] < 1.0


def test_after_a_blackout():
    """Four frames without a marker while both links turn round and round."""
    run = spin(3, 26)
    found = errors(horizon(), run, seen(run, slice(12, 16)))
    assert (found[8:12] < 5.0).all()
    assert (found[20:] < 5.0).all()


def test_a_wrong_explanation_is_given_up():
    """Nonsense, then the pendulum: a new beginning, with a level of noise that nonsense did not raise."""
    run, tracker = spin(2, 30), horizon()
    rng = np.random.default_rng(1)
    for k, each in enumerate(seen(run)):
        if k < 6:
            tracker.update(Observations(each.t, 0.1 * rng.normal(size=(2, 2)), NOISE))
        else:
            tracker.update(each)
    assert np.abs(tracker.state.qd - run.qd[-1]).max() < 5.0
    assert tracker.measurement_noise.value < 3.0


def test_noise_eight_times_as_large_as_declared_is_learnt():
    """At first no explanation is valid, in frame after frame: then the level must be wrong, not the state."""
    cable, rng = (
        hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, radius=0.002, friction=2e-4),
        np.random.default_rng(0),
    )
    run = hf.simulate(cable, duration=2.4, q0=np.full(5, 0.8), t_eval=np.arange(0.0, 2.4, 0.04))
    tracker = MovingHorizon(cable, np.linspace(0.2, 1.0, 5), starts=1)
    for t, joints in zip(run.t, np.asarray(run.joints)[:, 1:], strict=True):
        tracker.update(Observations(float(t), joints + 1e-3 * rng.normal(size=(5, 2)), 1.25e-4))
    assert tracker.measurement_noise.value == pytest.approx(8.0, rel=0.3)


def test_the_horizon_has_the_requested_length():
    run, tracker = spin(1), horizon()
    assert tracker.smoothed == ()
    assert tracker.horizon is None
    for each in seen(run):
        tracker.update(each)
    assert len(tracker.smoothed) == tracker.frames == 8
    last, now = tracker.smoothed[-1], tracker.state
    assert last.t == now.t == run.t[-1]
    np.testing.assert_allclose(last.q, now.q, atol=1e-12)
    # to each variance the square of what is negligible is added where the state is handed out: (5e-5)^2, times g / L
    np.testing.assert_allclose(np.diag(last.covariance), np.diag(now.covariance), rtol=1e-4, atol=2e-7)
    before = tracker.state
    tracker.predict(GAP)
    assert tracker.state.t == pytest.approx(before.t + GAP)
    tracker.restart()
    assert tracker.horizon is None


def test_bad_input():
    refuses("frames", MovingHorizon, pendulum.pendulum(), [0.09], frames=1)
    refuses("starts", MovingHorizon, pendulum.pendulum(), [0.09], starts=0)
    begun = horizon(starts=1)
    begun.update(seen(spin(0, frames=1))[0])
    refuses("the estimator has begun", smooth, begun, seen(spin(0, frames=2))[1:])
    refuses("no marker was seen", smooth, horizon(), [Observations(0.0, np.full((2, 2), np.nan), NOISE)])


@pytest.mark.parametrize("run", pendulum.RUNS)
@pytest.mark.parametrize(("rate", "duration"), [(50.0, 3.0), (25.0, 5.0), (12.5, 10.0)])
@pytest.mark.nightly
def test_withheld_markers_of_the_real_pendulum(run, rate, duration, data_dir, record_property):
    """The first seconds, when it turns over most; ``benchmarks/pendulum_tracking.py`` does the whole of both runs."""
    recording = pendulum.read(data_dir / "ibm_double_pendulum", run, rate, duration, seed=1)
    angles = np.unwrap(np.arctan2(*(recording.places[:, 1] - recording.places[:, 0]).T))
    assert np.ptp(angles) > 2.0 * np.pi
    found, _ = pendulum.follow(pendulum.estimator(MovingHorizon), recording)
    used = pendulum.counted(recording)
    record_property("withheld, mm rms", round(1e3 * pendulum.rms(found[used]), 2))
    assert used.sum() > 20
    assert pendulum.rms(found[used]) < pendulum.ASKED[rate]
