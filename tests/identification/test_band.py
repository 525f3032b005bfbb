"""The band of a prediction: as wide as the parameters, the state it starts from and the noise make it."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.identification import pipeline as _identify
from hyperflex.identification.fit import Window, fit_state
from hyperflex.identification.model import Parameters, Plant, parse
from hyperflex.identification.pipeline import identify
from hyperflex.identification.prediction import prediction_std
from hyperflex.identification.uncertainty.covariance import Information
from tests.identification.twins import WHOLE
from tests.refusals import left_by

ROPE = hf.Rope(length=[0.17, 0.23], mass=[0.21, 0.16], com=[0.11, 0.09], inertia=[6e-4, 8e-4], friction=[1.2e-3, 5e-4])
NOISE = 2e-3
T, AHEAD = np.arange(26) * 0.02, 0.5 + np.arange(1, 21) * 0.05


def plant() -> Plant:
    return Plant(Parameters(ROPE, parse(ROPE, ["friction"])))


def known(x: Array, covariance: Array, correlation: float = 1.0) -> Information:
    """What a fit leaves of x, as far as a band needs it."""
    none = np.zeros((x.size, 0))
    return Information(x, np.ones(x.size), np.zeros(0), none, none, covariance, correlation)


def window(y: Array, prior: Array | None = None) -> Window:
    known = np.ones_like(y)
    known[3:6, 1] = 0.0
    none = np.zeros((0, 4)) if prior is None else prior
    return Window(T, y, known, np.array([0.6, 0.9, 0.0, 0.0]), none)


def predicted(model: Plant, x: Array, seen: Window) -> Array:
    """Return the prediction (20, 2) from a newly fitted state."""
    found = fit_state(model, x, seen, seen.guess)
    result = model.predict(x, np.append(T[0], AHEAD), found[0])
    return result[1:]


@pytest.fixture(scope="module")
def swing() -> Array:
    run = hf.simulate(ROPE, duration=0.5, t_eval=T, q0=[0.6, 0.9], tol=1e-8)
    return np.asarray(run.q)


def test_an_error_of_the_parameters_moves_state_and_prediction(swing):
    model, seen = plant(), window(swing)
    x = model.parameters.start
    found = fit_state(model, x, seen, seen.guess)
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    ours = prediction_std(model, known(x, covariance), seen, found, AHEAD, np.full(2, 1e-9))
    # The same by central differences of refitted predictions: steps of 1e-3 leave a relative error of some 1e-5.
    steps = 1e-3 * np.eye(2)
    slopes = np.stack([(predicted(model, x + h, seen) - predicted(model, x - h, seen)) / 2e-3 for h in steps], axis=2)
    theirs = np.sqrt(np.einsum("mci,ij,mcj->mc", slopes, covariance, slopes))
    np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=1e-3 * theirs.max())


def test_noise_of_the_window_and_of_the_sample_itself(swing):
    model, seen = plant(), window(swing)
    x = model.parameters.start
    found = fit_state(model, x, seen, seen.guess)
    noise = np.array([1e-3, 3e-3])
    ours = prediction_std(model, known(x, np.zeros((2, 2))), seen, found, AHEAD, noise)
    rng = np.random.default_rng(1)
    draws = [predicted(model, x, window(swing + noise * rng.normal(size=swing.shape))) for _ in range(150)]
    theirs = np.sqrt(np.var(draws, axis=0) + noise**2)
    # 150 draws give a standard deviation to 6 %; three times that.
    np.testing.assert_allclose(ours, theirs, rtol=0.18)
    wide = prediction_std(model, known(x, np.zeros((2, 2)), 4.0), seen, found, AHEAD, noise)
    np.testing.assert_allclose(wide**2 - noise**2, 4.0 * (ours**2 - noise**2), rtol=1e-9)


def test_a_prior_holds_the_state(swing):
    prior = np.array([[-1.0, 1.0, 0.0, 0.0]]) / 1e-6  # both links in line
    model, free, held = plant(), window(swing), window(swing, prior)
    x = model.parameters.start
    about, noise = known(x, np.zeros((2, 2))), np.full(2, NOISE)
    found = fit_state(model, x, free, free.guess)
    assert (
        prediction_std(model, about, held, found, AHEAD, noise)
        < prediction_std(model, about, free, found, AHEAD, noise)
    ).all()


def test_where_the_motion_cannot_be_followed_the_band_is_unknown(swing):
    class Blind(Plant):
        def jacobian(self, x, t, state):
            return None

    model, seen = Blind(plant().parameters), window(swing)
    found = (seen.guess, np.zeros(2 * T.size))
    about = known(model.parameters.start, np.zeros((2, 2)))
    assert np.isnan(prediction_std(model, about, seen, found, AHEAD, np.full(2, NOISE))).all()


def recorded(seed: int) -> hf.Recording:
    t = np.arange(1200) * 0.02
    run = hf.simulate(ROPE, duration=t[-1], t_eval=t, q0=[0.6, 0.9])
    return hf.Recording(t, run.q + np.random.default_rng(seed).normal(0.0, NOISE, run.q.shape))


def test_the_band_holds_what_it_says():
    result = identify(recorded(7), ROPE.replace(friction=1e-3), ["friction"], options=hf.FitOptions(train=5.0))
    held = result.held_out
    assert held.std.shape == held.measured.shape
    # 1800 values, errors of the 18 states shared by 100 each: 95 % within about 1.5 %, three times that is allowed.
    assert abs(held.inside - 0.95) < 0.045
    assert result.summary()["held_out"]["inside_band"] == held.inside
    assert (held.std > 0.9 * NOISE).all()


def test_outliers_do_not_widen_the_band():
    clean = recorded(8)
    rng = np.random.default_rng(9)
    spoilt = clean.data + np.where(rng.random(clean.data.shape) < 0.05, 0.3, 0.0)
    spoilt[clean.t > 5.0] = clean.data[clean.t > 5.0]
    options = hf.FitOptions(train=5.0, loss="cauchy")
    result = identify(hf.Recording(clean.t, spoilt), ROPE.replace(friction=1e-3), ["friction"], options=options)
    assert np.median(result.held_out.std) < 1.5 * NOISE  # 0.07 with the outliers as noise


EIGHT = hf.Rope.uniform(length=0.8, mass=0.1, n_links=8, friction=5e-4)
ARCS = [0.2, 0.4, 0.6, 0.8]


def four_markers(frames: int, origin: tuple[float, float], noise: float | None) -> hf.Recording:
    """Every second joint of eight links, with 1 mm of noise."""
    t = np.arange(frames) * 0.04
    run = hf.simulate(EIGHT, duration=t[-1], t_eval=t, q0=0.4 + 0.15 * np.arange(8))
    places = (run.joints[:, [2, 4, 6, 8]] + np.array(origin)).reshape(t.size, -1)
    return hf.Recording(t, places + np.random.default_rng(3).normal(0.0, 1e-3, (frames, 8)), "markers", noise=noise)


def test_a_rope_with_few_markers_is_predicted_to_its_noise():
    """The prior of its shape must not outweigh the markers."""
    setup, guess = hf.RecordingSetup(arc_lengths=ARCS), EIGHT.replace(friction=1e-3)
    recording, options = four_markers(100, (0.3, -0.1), 1e-3), hf.FitOptions(train=2.4)
    result = identify(recording, guess, ["friction:shared"], setup=setup, options=options)
    # noise of 1 mm and what a state on 12 samples adds; 0.1 m without weights
    assert (result.held_out.rms < 3e-3).all()
    # Where the camera sees the first joint, told in its own frame.
    for name, truth in (("origin_x", 0.3), ("origin_y", -0.1)):
        assert abs(result.values[name] - truth) < 4.0 * result.std[name]
        assert result.std[name] < 2e-3


def test_markers_without_given_noise_are_not_outweighed_by_the_prior():
    places, guess = hf.RecordingSetup(arc_lengths=ARCS, origin=[0.0, 0.0]), EIGHT.replace(friction=1e-3)
    recording = four_markers(60, (0.0, 0.0), None)
    result = identify(recording, guess, ["friction:shared"], setup=places, options=WHOLE)
    assert (np.abs(result.values["friction"] - 5e-4) < 4.0 * result.std["friction"]).all()
    assert (result.residual_rms < 1.5e-3).all()  # noise of 1 mm; 6 to 34 mm where a prior in std beats errors in m


def test_ctrl_c_while_predicting_keeps_the_fit(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(_identify, "predict", interrupted)
    result = left_by(
        lambda: identify(recorded(7), ROPE.replace(friction=1e-3), ["friction"], options=hf.FitOptions(train=5.0))
    )
    assert result.status == "interrupted"
    assert result.held_out is None
    assert (np.abs(result.values["friction"] - ROPE.friction) < 5.0 * result.std["friction"]).all()
