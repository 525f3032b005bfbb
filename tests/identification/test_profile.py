"""Profile likelihood: closed forms of linear problems, bounds that are felt, and what a result keeps and tells."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import f, norm

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.identification import Finding, FitOptions, Identification, Kind, identify, profile
from hyperflex.identification.fit import Loss, fit
from hyperflex.identification.model import PredictedChannels
from hyperflex.identification.options import How
from hyperflex.identification.uncertainty import profile as _profile
from hyperflex.identification.uncertainty.covariance import Basis, Interval, quantile
from hyperflex.identification.uncertainty.profile import Profile, all_intervals, profiled, skewed, threshold
from hyperflex.model import Rope
from hyperflex.recording import Recording
from tests.identification.linear import Line, autoregressive, fitted, waves
from tests.identification.twins import recorded
from tests.refusals import left_by, refuses

NOISE = 0.01  # rad
PAPER = Rope(length=[0.2] * 5, mass=[1.53e-3] * 5, inertia=1.43e-7, friction=6.31e-4)
PAIR = Rope(length=[0.3, 0.25], mass=[0.1, 0.05], com=[0.14, 0.12], inertia=[8e-4, 3e-4], friction=[2e-4, 1e-4])
FREE = ["inertia:shared", "friction:shared"]


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded(PAPER, [0.9, 1.0, 1.1, 1.2, 1.3], np.arange(22) / 7.5, NOISE, seed=1)


def swung(recording: Recording, rope: Rope, free: list[str], **options: object) -> Identification:
    return identify(recording, rope, free, options=FitOptions(window=np.inf, train=np.inf, **options))


@pytest.fixture(scope="module")
def found(recording: Recording) -> Identification:
    return swung(recording, PAPER, FREE)


# ---- limits


@pytest.mark.parametrize("freedom", [8.0, 100.0, 1e9])
def test_away_from_bounds_the_limit_is_that_of_f(freedom):
    expected = f.ppf(0.95, 1, freedom)
    assert quantile(freedom) == pytest.approx(expected, rel=1e-5)  # 1e9 is taken as infinite
    assert threshold(freedom, np.inf) == threshold(freedom, 2.0) == quantile(freedom)


@pytest.mark.parametrize("above", [0.0, 0.3, 1.0, 1.7, 3.0])
def test_beside_its_own_bound_intervals_hold_the_truth_as_often_as_they_say(above):
    """One parameter of std 1, the truth at `above`; estimates u below 0 become 0.

    The rise at the truth is (u - above)^2 for u >= 0, else above^2 - 2 u above.
    """

    def held(limit):
        root = np.sqrt(limit)
        if root <= above:
            return float(2.0 * norm.cdf(root) - 1.0)
        if above == 0.0:
            return float(norm.cdf(root))
        return float(norm.cdf(root) - norm.cdf(-0.5 * (above**2 + limit) / above))

    expected = brentq(lambda limit: held(limit) - 0.95, 0.5, 4.0)
    limit = threshold(1e9, above)
    assert held(limit) == pytest.approx(0.95, abs=1e-6)
    assert limit == pytest.approx(expected, rel=1e-6)


def test_the_limit_joins_the_usual_one_where_the_bound_is_no_longer_felt():
    """Just below that place rounding leaves no root between the two, and the usual limit is right to 1e-6."""
    usual = quantile(np.inf)
    for below in (2e-8, 1e-9, 1e-12, 2.2e-16):
        assert threshold(np.inf, np.sqrt(usual) * (1.0 - below)) == pytest.approx(usual, rel=1e-6)


@pytest.mark.parametrize("tied", [1.33, -0.58, -3.04])  # correlations of -0.8, 0.5 and 0.95
@pytest.mark.parametrize("above", [0.0, 0.5, 2.0])
def test_a_bound_of_another_parameter_leaves_intervals_about_as_often_right(tied, above):
    """The truth of the other is so many std above its bound; the first's limit holds in draws of both, in std."""
    random = np.random.default_rng(2)
    basis = fitted(waves(1000, tied=tied), random.standard_normal((1000, 1)))
    covariance = basis.information.covariance
    std = np.sqrt(np.diag(covariance))
    limit = threshold(basis.information.freedom, (basis.fit.x[0] - basis.plant.parameters.lower[0]) / std[0])
    r = covariance[0, 1] / (std[0] * std[1])
    u, v = np.linalg.cholesky([[1.0, r], [r, 1.0]]) @ random.standard_normal((2, 40_000))
    least = np.minimum(v + above, 0.0) ** 2  # both free, the second at its bound
    second = np.maximum(v - r * u, -above)  # its estimate with the first at its truth
    held = (u**2 - 2.0 * r * u * (v - second) + (v - second) ** 2) / (1.0 - r**2)
    assert 0.94 < np.mean(held - least <= limit) < 0.98


# ---- profiles


def last_intervals(basis: Basis, how: How) -> tuple[dict[str, Interval], list[Finding]]:
    """The intervals when all profiles are done, and what these show besides."""
    *_, last = all_intervals(basis, how)
    return last


def first(basis: Basis) -> Profile:
    """The profile of the first parameter."""
    return profiled(basis, 0)


def test_a_linear_problem_has_the_interval_of_its_covariance():
    basis = fitted(waves(60), np.random.default_rng(4).standard_normal((60, 1)))
    plain, _ = last_intervals(basis, "covariance")
    for k, (label, one) in enumerate(plain.items()):
        found = profiled(basis, k)
        width = one.high - one.low
        assert (found.low, found.high) == pytest.approx((one.low, one.high), abs=0.005 * width)  # CLOSE
        scale = 0.5 * width / np.sqrt(found.limit[0])
        middle = basis.plant.parameters.values(basis.fit.x)[k]
        np.testing.assert_allclose(found.rise, ((found.values - middle) / scale) ** 2, atol=1e-6)  # a parabola
        assert found.values.size >= 3
        assert label == found.name
    assert skewed(basis) == []


def test_profiles_are_of_noise_alone_and_intervals_of_all():
    plain = fitted(waves(60), np.random.default_rng(4).standard_normal((60, 1)))
    information, std = plain.information, np.sqrt(np.diag(plain.information.covariance))
    scaled = np.append(2.0 * std, 1.0)  # of x by a factor on all lengths, and of its logarithm
    errors = replace(information, model=np.diag(std**2), scaled=np.outer(scaled, scaled))
    basis = replace(plain, information=errors)
    by_std, _ = last_intervals(basis, "covariance")
    for k, (label, one) in enumerate(last_intervals(basis, "profile")[0].items()):
        alone, same = profiled(basis, k), profiled(plain, k)
        assert (alone.low, alone.high) == (same.low, same.high)
        # 1 + 1 + 2^2, of which 2^2 was declared: Welch and Satterthwaite's degrees of freedom are those over (2 / 6)^2
        freedom = information.freedom
        student = np.sqrt(quantile(9.0 * freedom) / quantile(freedom))
        assert one.high - one.low == pytest.approx(np.sqrt(6.0) * student * (alone.high - alone.low), rel=0.01)
        assert one.high - one.low == pytest.approx(by_std[label].high - by_std[label].low, rel=0.01)


@pytest.mark.parametrize("at", [True, False])
def test_an_estimate_at_its_bound_or_near_it_has_it_as_its_end(at):
    plant = waves(60, truth=np.array([0.0, 10.0]))
    draws = (fitted(plant, np.random.default_rng(k).standard_normal((60, 1))) for k in range(99))
    basis = next(b for b in draws if (b.fit.x[0] == 0.0) == at and b.fit.x[0] ** 2 < b.information.covariance[0, 0])
    one = first(basis)
    assert one.low == 0.0
    assert one.high > 0.0


def test_what_is_tied_to_a_parameter_beside_its_bound_is_skewed():
    noise = np.random.default_rng(4).standard_normal((60, 1))
    beside = np.array([0.1, 10.0])
    tied, apart = (fitted(waves(60, truth=beside, tied=tied), noise) for tied in (0.8, 0.0))
    assert skewed(tied) == [0, 1]
    assert skewed(apart) == [0]


def test_coloured_noise_widens_a_profile_as_it_does_the_covariance():
    basis = fitted(waves(120), autoregressive(np.random.default_rng(4), (120, 1), 0.8))
    assert basis.information.correlation > 1.0
    one, found = last_intervals(basis, "covariance")[0]["inertia[0]"], first(basis)
    assert (found.low, found.high) == pytest.approx((one.low, one.high), abs=0.005 * (one.high - one.low))


class Dipped(Line):
    """The same, and a third wave that acts near one value of the first parameter only: another optimum there."""

    def __init__(self, plain: Line, at: float, width: float) -> None:
        super().__init__(plain.shared, plain.own, plain.truth)
        self.at, self.width = at, width
        self.third = np.cos(50.0 * np.linspace(0.0, 1.0, plain.shared.shape[0]))[:, None]

    def dip(self, x: Array) -> float:
        return float(np.exp(-(((x[0] - self.at) / self.width) ** 2)))

    def predict(self, x: Array, t: Array, state: Array) -> Array | None:
        return super().predict(x, t, state) + self.dip(x) * self.third

    def jacobian(self, x: Array, t: Array, state: Array) -> PredictedChannels | None:
        shared = self.shared.copy()
        shared[:, :, 0] -= 2.0 * (x[0] - self.at) / self.width**2 * self.dip(x) * self.third
        return PredictedChannels(self.predict(x, t, state), self.own, shared)


def test_a_better_optimum_on_the_way_is_told():
    noise = np.random.default_rng(4).standard_normal((60, 1))
    plain = fitted(waves(60), noise)
    std = float(np.sqrt(plain.information.covariance[0, 0]))
    dipped = Dipped(waves(60), plain.fit.x[0] + 2.0 * std, 0.4 * std)
    data = noise + dipped.third  # the third wave is there
    basis = fitted(dipped, data)
    assert basis.fit.x[0] == pytest.approx(dipped.at, abs=std)  # the search itself finds it, near as it is
    stuck = replace(
        plain,
        plant=dipped,
        windows=basis.windows,
        fit=fit(dipped, basis.windows, plain.fit.x, plain.fit.states, held=0, enough=1e-9),
    )
    one = first(stuck)
    assert one.gain > 1.0
    inertia = dipped.parameters.all[0]
    assert one.better.inertia[0] == pytest.approx(inertia.value(dipped.at), abs=inertia.value(std))
    assert (one.rise >= 0.0).all()
    _, remarks = last_intervals(stuck, "profile")
    assert (remarks[0].kind, remarks[0].values["name"]) == (Kind.BETTER_OPTIMUM, "inertia[0]")
    honest = first(plain)
    assert honest.gain < 0.01  # what the fit left, in residual variances
    assert honest.better is None


def test_a_profile_that_is_too_dear_leaves_the_covariance_and_says_so(monkeypatch):
    basis = fitted(waves(60), np.random.default_rng(4).standard_normal((60, 1)))
    monkeypatch.setattr(_profile, "WALK", replace(_profile.WALK, most_rounds=0))
    one, plain = first(basis), last_intervals(basis, "covariance")[0]["inertia[0]"]
    assert (one.low, one.high, one.kind) == (plain.low, plain.high, "covariance")
    every, remarks = last_intervals(basis, "profile")
    assert (every["inertia[0]"].kind, every["inertia[0]"].low) == ("covariance", plain.low)
    assert remarks[0].kind is Kind.PROFILE_GIVEN_UP


def test_robust_losses_profile_what_their_covariance_says():
    random = np.random.default_rng(4)
    noise = random.standard_normal((300, 1)) * np.where(random.uniform(size=(300, 1)) < 0.05, 10.0, 1.0)
    basis = fitted(waves(300), noise, "huber")
    one, found = last_intervals(basis, "covariance")[0]["inertia[0]"], first(basis)
    assert Loss("huber", 2.0, fixed=True).scaled([noise.ravel()]).scale == 2.0  # costs along it are of one kind
    # Huber's formula takes the mean of psi', the profile each residual's own: alike to some 1 / sqrt(300)
    assert found.high - found.low == pytest.approx(one.high - one.low, rel=0.15)


def test_the_papers_inertia_ends_at_0_and_at_a_value_that_the_data_refuse(recording, found):
    one = profile(found, "inertia:shared")
    assert one.low == 0.0
    assert found.intervals["inertia:shared"].kind == "profile"
    assert found.intervals["inertia:shared"].high == pytest.approx(one.high)
    assert found.intervals["friction:shared"].kind == "profile"  # it correlates with the inertia by some -0.5
    assert PAPER.inertia[0] in found.intervals["inertia:shared"]
    # By another way: with the inertia held there, friction and state alone are fitted.
    held = swung(recording, PAPER.replace(inertia=one.high), ["friction:shared"], intervals=None)
    squares = [(r.residuals**2).sum() for r in (held, found)]
    freedom = recording.data.size - 10 - 2
    information = found.basis.information  # squares count by the noise's correlation between channels and instants
    alike = information.plain[0, 0] / information.covariance[0, 0]
    rise = alike * (squares[0] - squares[1]) / (squares[1] / freedom)
    assert rise == pytest.approx(
        np.interp(one.high, one.values, one.limit), rel=0.02
    )  # ends are found to CLOSE, 0.01 of 2 std
    assert (np.diff(one.values) > 0.0).all()


def test_what_cannot_be_known_has_no_limits():
    rope = Rope(length=[0.3], mass=[0.1], com=[0.14], friction=2e-4)
    recording = recorded(rope, [0.9], np.arange(61) / 20.0, NOISE)
    found = swung(recording, rope, ["inertia", "com", "friction"], intervals="profile")
    for name in found.parameters:
        assert found.intervals[name].kind == "unknown"
        assert np.isinf(found.intervals[name].high)
        one = profile(found, name)
        assert np.isinf(one.high)
    low, high = (
        found.ratios["J/p1"] - 3.0 * found.ratio_std["J/p1"],
        found.ratios["J/p1"] - 1.5 * found.ratio_std["J/p1"],
    )
    assert low[0] < found.intervals["J/p1[0]"].low < high[0]
    assert "p/p1[0]" not in found.intervals  # 1 by definition


def test_fits_that_do_not_converge_are_no_points_of_a_profile(found, monkeypatch):
    """Their squares are too large, and the interval would be too short."""

    def unfinished(*given, **options):
        return replace(fit(*given, **options), converged=options.get("held") is None)

    monkeypatch.setattr(_profile, "fit", unfinished)
    assert profile(found, "friction:shared").kind == "covariance"


# ---- what a result tells


def test_results_hold_the_intervals_by_name(found, tmp_path):
    found.to_json(tmp_path / "fit.json")
    content = json.loads((tmp_path / "fit.json").read_text())["intervals"]
    one = found.intervals["inertia:shared"]
    assert content["inertia:shared"] == {"low": 0.0, "high": one.high, "kind": "profile"}
    found.to_toml(tmp_path / "fit.toml")
    assert files.read_toml(tmp_path / "fit.toml")["identification"]["intervals"]["inertia:shared"]["high"] == one.high
    assert "95 % inertia:shared 0 to " in str(found)


def test_intervals_are_found_as_asked(recording):
    assert swung(recording, PAPER, FREE, intervals=None).intervals == {}
    plain = swung(recording, PAPER, FREE, intervals="covariance").intervals
    assert {plain[name].kind for name in FREE} == {"covariance"}
    assert plain["inertia:shared"].low == 0.0
    refuses("intervals", swung, recording, PAPER, FREE, intervals="exact")


def test_refusals(found):
    refuses("no such parameter.*inertia:shared", profile, found, "inertia")
    refuses("no longer has its fit", profile, replace(found, _basis=None), FREE[0])


def test_ctrl_c_leaves_the_covariance_for_what_is_not_profiled(recording, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(_profile, "profiled", interrupted)
    result = left_by(lambda: swung(recording, PAPER, FREE))
    assert {result.intervals[name].kind for name in FREE} == {"covariance"}
    assert result.status == "interrupted"
