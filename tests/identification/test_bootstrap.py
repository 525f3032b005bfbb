"""Parametric bootstrap: it scatters as the covariance says, repeats by its seed, and keeps what is done."""

import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from hyperflex.budget import Budget
from hyperflex.core.tangent.forward_sensitivity import forward_sensitivities
from hyperflex.identification import FitOptions, Identification, bootstrap, identify
from hyperflex.identification.fit import fit
from hyperflex.identification.uncertainty import bootstrap as _bootstrap
from hyperflex.identification.uncertainty.bootstrap import Bootstrap, Draws
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from hyperflex.status import Status
from tests.faults.interrupting import left_by
from tests.identification.linear import autoregressive, fitted, waves
from tests.refusals import refuses

ROPE = Rope(length=[0.3], mass=[0.1], com=[0.14], friction=2e-4)


@pytest.fixture(scope="module")
def found() -> Identification:
    t = np.arange(41) / 15.0
    run = simulate(ROPE, duration=t[-1], t_eval=t, q0=[0.9], tol=1e-9)
    data = run.q + 0.01 * np.random.default_rng(0).standard_normal(run.q.shape)
    data[10:14] = np.nan
    return identify(
        Recording(t, data),
        ROPE,
        ["inertia", "friction"],
        options=FitOptions(window=np.inf, train=np.inf, intervals=None),
    )


def noise_of(basis: Basis, draws: int) -> np.ndarray:
    """Return drawn noise (draws, m, C) of the first window."""
    noise = Draws(basis, 0)
    seen = np.where(basis.windows[0].weight > 0.0, noise.clean[0], 0.0)
    return np.array([noise.windows(np.random.default_rng(k))[0].y - seen for k in range(draws)])


def test_fits_scatter_as_the_covariance_says(found):
    result = bootstrap(found, 60)
    assert result.names == (*found.parameters, "J/p1[0]", "c/p1[0]")
    assert (result.samples.shape, result.failed, result.status) == ((60, 4), 0, Status.SUCCESS)
    std = np.array([np.sqrt(found.std[n][0] ** 2 - found.model_std[n][0] ** 2) for n in ("inertia", "friction")])
    np.testing.assert_allclose(
        result.samples[:, :2].std(axis=0), std, rtol=0.35
    )  # a standard deviation from 60 draws is known to 9 %
    middle = np.array([found.values[name][0] for name in ("inertia", "friction")])
    np.testing.assert_array_less(np.abs(result.samples[:, :2].mean(axis=0) - middle), 4.0 * std / np.sqrt(60))
    one = result.interval("friction[0]", 0.8)
    inside = (result.samples[:, 1] > one.low) & (result.samples[:, 1] < one.high)
    assert (one.kind, inside.sum()) == ("bootstrap", 48)


def test_pickled_draws_compile_nothing(found):
    """Kernels are compiled for arrays that cannot be written to; what comes out of a pickle can be."""
    bootstrap(found, 1)
    draws = Draws(found.basis, 0)
    before = len(forward_sensitivities.signatures)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(draws))([3]), draws([3]))
    assert len(forward_sensitivities.signatures) == before > 0


def test_the_seed_fixes_each_draw_whatever_their_number(found):
    few, more, other = bootstrap(found, 2), bootstrap(found, 3), bootstrap(found, 2, seed=1)
    np.testing.assert_array_equal(few.samples, more.samples[:2])
    assert (few.samples != other.samples).all()


def test_ctrl_c_keeps_what_is_done(found, monkeypatch):
    done = 0

    def some(*args, **options):
        nonlocal done
        done += 1
        if done == 3:
            raise KeyboardInterrupt
        return fit(*args, **options)

    monkeypatch.setattr(_bootstrap, "fit", some)
    result = left_by(lambda: bootstrap(found, 10))
    assert result.status is Status.INTERRUPTED
    assert result.samples.shape == (2, 4)


def test_out_of_time_it_keeps_what_is_done(found):
    seconds = iter(range(100))
    result = bootstrap(found, 10, time_budget=Budget(4.5, clock=lambda: float(next(seconds))))
    assert result.status is Status.OUT_OF_TIME
    assert 0 < len(result.samples) < 10
    assert "out of time" in result.message


def test_coloured_residuals_are_drawn_coloured():
    basis = fitted(waves(150), autoregressive(np.random.default_rng(1), (150, 1), 0.8))
    drawn = noise_of(basis, 300)[:, :, 0]
    lagged = (drawn[:, 1:] * drawn[:, :-1]).mean() / (drawn**2).mean()
    assert lagged == pytest.approx(basis.information.memory[1], abs=0.02)  # of 300 x 150 draws
    assert lagged > 0.5
    assert (drawn**2).mean() == pytest.approx(basis.information.variance, rel=0.05)
    assert (drawn[:, 0] ** 2).mean() == pytest.approx(basis.information.variance, rel=0.25)  # of 300 draws: 8 %


def test_noise_of_a_long_window_takes_little_memory():
    draws = Draws(fitted(waves(20_000), autoregressive(np.random.default_rng(1), (20_000, 1), 0.8)), 0)
    tracemalloc.start()
    noise = draws.coloured(np.random.default_rng(0).standard_normal((20_000, 1)))
    assert draws.root.size < 100
    assert tracemalloc.get_traced_memory()[1] < 10 * noise.nbytes
    tracemalloc.stop()
    assert (noise[1:] * noise[:-1]).mean() == pytest.approx(draws.basis.information.memory[1], abs=0.05)


def test_robust_losses_draw_their_outliers_again():
    noise = np.random.default_rng(2).standard_normal((100, 1))
    noise[40] = 50.0
    basis = fitted(waves(100), noise, "cauchy")
    drawn = noise_of(basis, 100)
    assert 0.003 < (np.abs(drawn) > 40.0).mean() < 0.03  # one in a hundred
    assert np.unique(np.round(drawn, 9)).size <= 100


def test_gaps_stay_gaps_and_weights_count():
    basis = fitted(waves(60), np.random.default_rng(3).standard_normal((60, 1)))
    weight = np.full((60, 1), 0.25)  # 1 / noise: four times as noisy as the unit says
    weight[5:9] = 0.0
    windows = [replace(basis.windows[0], weight=weight)]
    drawn = noise_of(replace(basis, windows=windows), 200)
    assert (drawn[:, 5:9] == 0.0).all()
    # of 200 x 56 draws
    assert drawn[:, 9:].std() == pytest.approx(4.0 * np.sqrt(basis.information.variance), rel=0.05)


def test_refusals(found):
    refuses("count", bootstrap, found, 0)
    refuses("no longer has its fit", bootstrap, replace(found, _basis=None))
    result = Bootstrap(("mass",), np.array([[1.0], [2.0]]), 0)
    refuses(r"no such parameter.*mass", result.interval, "inertia")
    refuses("level", result.interval, "mass", 1.0)


def test_numbers_and_intervals_of_ratios_are_printed(found):
    result = bootstrap(found, 20)
    told = str(result)
    assert "inertia[0]" in told
    assert "J/p1[0]" in told
    interval = result.interval("J/p1[0]")
    assert interval.low < float(found.ratios["J/p1"][0]) < interval.high
    # one mass and centre are held: J/p1 moves with the inertia alone, by 1 / p1
    p1 = float(ROPE.mass[0] * ROPE.com[0])
    own = result.interval("inertia[0]")
    assert interval.high - interval.low == pytest.approx((own.high - own.low) / p1, rel=1e-9)  # rounding
    refuses("J/p1", result.interval, "J/p1[1]")
