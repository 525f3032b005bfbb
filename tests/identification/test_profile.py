"""Profile likelihood: closed forms of linear problems, bounds that are felt, and what a result keeps and tells."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares
from scipy.stats import f, norm

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification import Finding, FitOptions, Identification, Kind, identify, profile
from hyperflex.identification.fit import Loss, Target, fit
from hyperflex.identification.model import PredictedChannels
from hyperflex.identification.options import How
from hyperflex.identification.uncertainty import profile as _profile
from hyperflex.identification.uncertainty.covariance import Basis, Interval, quantile
from hyperflex.identification.uncertainty.profile import Coordinate, all_intervals, profiled, skewed, threshold
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
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
    assert quantile(0.95, freedom) == pytest.approx(expected, rel=1e-5)  # 1e9 is taken as infinite
    assert threshold(0.95, freedom, np.inf) == threshold(0.95, freedom, 2.0) == quantile(0.95, freedom)


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
    limit = threshold(0.95, 1e9, above)
    assert held(limit) == pytest.approx(0.95, abs=1e-6)
    assert limit == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("level", [0.68, 0.9, 0.95])
def test_the_limit_joins_the_usual_one_where_the_bound_is_no_longer_felt(level):
    """Just below that place rounding leaves no root between the two, and the usual limit is right to 1e-6."""
    usual = quantile(level, np.inf)
    for below in (2e-8, 1e-9, 1e-12, 2.2e-16):
        assert threshold(level, np.inf, np.sqrt(usual) * (1.0 - below)) == pytest.approx(usual, rel=1e-6)


@pytest.mark.parametrize("tied", [1.33, -0.58, -3.04])  # correlations of -0.8, 0.5 and 0.95
@pytest.mark.parametrize("above", [0.0, 0.5, 2.0])
def test_a_bound_of_another_parameter_leaves_intervals_about_as_often_right(tied, above):
    """The truth of the other is so many std above its bound; the first's limit holds in draws of both, in std."""
    random = np.random.default_rng(2)
    basis = fitted(waves(1000, tied=tied), random.standard_normal((1000, 1)))
    covariance, x = basis.information.covariance, basis.fit.x.copy()
    std = np.sqrt(np.diag(covariance))
    x[1] = basis.plant.parameters.lower[1] + above * std[1]
    limit = Coordinate(basis, "inertia[0]").limit(x, 0.95)
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


def test_a_linear_problem_has_the_interval_of_its_covariance():
    basis = fitted(waves(60), np.random.default_rng(4).standard_normal((60, 1)))
    plain, _ = last_intervals(basis, "covariance")
    for k, (label, one) in enumerate(plain.items()):
        found = profiled(Coordinate(basis, label), 0.95, points=3)
        width = one.high - one.low
        assert (found.low, found.high) == pytest.approx((one.low, one.high), abs=0.005 * width)  # CLOSE
        assert found.ends == ("crossed", "crossed")
        scale = 0.5 * width / np.sqrt(found.limit[0])
        middle = basis.plant.parameters.values(basis.fit.x)[k]
        np.testing.assert_allclose(found.rise, ((found.values - middle) / scale) ** 2, atol=1e-6)  # a parabola
        assert found.values.size >= 9
        assert label == found.name
    assert skewed(basis) == []


def test_profiles_are_of_noise_alone_and_intervals_of_all():
    plain = fitted(waves(60), np.random.default_rng(4).standard_normal((60, 1)))
    information, std = plain.information, np.sqrt(np.diag(plain.information.covariance))
    scaled = np.append(2.0 * std, 1.0)  # of x by a factor on all lengths, and of its logarithm
    errors = replace(information, model=np.diag(std**2), scaled=np.outer(scaled, scaled))
    basis = replace(plain, information=errors)
    by_std, _ = last_intervals(basis, "covariance")
    for label, one in last_intervals(basis, "profile")[0].items():
        alone, same = (profiled(Coordinate(basis, label), 0.95), profiled(Coordinate(plain, label), 0.95))
        assert (alone.low, alone.high) == (same.low, same.high)
        # 1 + 1 + 2^2, of which 2^2 was declared: Welch and Satterthwaite's degrees of freedom are those over (2 / 6)^2
        freedom = information.freedom
        student = np.sqrt(quantile(0.95, 9.0 * freedom) / quantile(0.95, freedom))
        assert one.high - one.low == pytest.approx(np.sqrt(6.0) * student * (alone.high - alone.low), rel=0.01)
        assert one.high - one.low == pytest.approx(by_std[label].high - by_std[label].low, rel=0.01)


@pytest.mark.parametrize("at", [True, False])
def test_an_estimate_at_its_bound_or_near_it_has_it_as_its_end(at):
    plant = waves(60, truth=np.array([0.0, 10.0]))
    draws = (fitted(plant, np.random.default_rng(k).standard_normal((60, 1))) for k in range(99))
    basis = next(b for b in draws if (b.fit.x[0] == 0.0) == at and b.fit.x[0] ** 2 < b.information.covariance[0, 0])
    one = profiled(Coordinate(basis, "inertia[0]"), 0.95)
    assert (one.low, one.ends) == (0.0, ("bound", "crossed"))
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
    one, found = last_intervals(basis, "covariance")[0]["inertia[0]"], profiled(Coordinate(basis, "inertia[0]"), 0.95)
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
    kept = Target(lambda x: float(x[0]), lambda _: np.eye(2)[0], float(plain.fit.x[0]), 1e6 / std)
    stuck = replace(
        plain,
        plant=dipped,
        windows=basis.windows,
        fit=fit(dipped, basis.windows, plain.fit.x, plain.fit.states, target=kept, enough=1e-9),
    )
    one = profiled(Coordinate(stuck, "inertia[0]"), 0.95)
    assert one.gain > 1.0
    first = dipped.parameters.all[0]
    assert one.better.inertia[0] == pytest.approx(first.value(dipped.at), abs=first.value(std))
    assert (one.rise >= 0.0).all()
    _, remarks = last_intervals(stuck, "profile")
    assert (remarks[0].kind, remarks[0].values["name"]) == (Kind.BETTER_OPTIMUM, "inertia[0]")
    honest = profiled(Coordinate(plain, "inertia[0]"), 0.95)
    assert honest.gain < 0.01  # what the fit left, in residual variances
    assert honest.better is None


def test_a_profile_that_is_too_dear_leaves_the_covariance_and_says_so(monkeypatch):
    basis = fitted(waves(60), np.random.default_rng(4).standard_normal((60, 1)))
    monkeypatch.setattr(_profile, "WALK", replace(_profile.WALK, most_rounds=0))
    one, plain = profiled(Coordinate(basis, "inertia[0]"), 0.95), last_intervals(basis, "covariance")[0]["inertia[0]"]
    assert (one.low, one.high, one.kind) == (plain.low, plain.high, "covariance")
    every, remarks = last_intervals(basis, "profile")
    assert (every["inertia[0]"].kind, every["inertia[0]"].low) == ("covariance", plain.low)
    assert remarks[0].kind is Kind.PROFILE_GIVEN_UP


def test_robust_losses_profile_what_their_covariance_says():
    random = np.random.default_rng(4)
    noise = random.standard_normal((300, 1)) * np.where(random.uniform(size=(300, 1)) < 0.05, 10.0, 1.0)
    basis = fitted(waves(300), noise, "huber")
    one, found = last_intervals(basis, "covariance")[0]["inertia[0]"], profiled(Coordinate(basis, "inertia[0]"), 0.95)
    assert Loss("huber", 2.0, fixed=True).scaled([noise.ravel()]).scale == 2.0  # costs along it are of one kind
    # Huber's formula takes the mean of psi', the profile each residual's own: alike to some 1 / sqrt(300)
    assert found.high - found.low == pytest.approx(one.high - one.low, rel=0.15)


def test_the_papers_inertia_ends_at_0_and_at_a_value_that_the_data_refuse(recording, found):
    one = profile(found, "inertia:shared", points=2)
    assert (one.low, one.ends) == (0.0, ("bound", "crossed"))
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
        assert one.ends[1] == "open"
    low, high = (
        found.ratios["J/p1"] - 3.0 * found.ratio_std["J/p1"],
        found.ratios["J/p1"] - 1.5 * found.ratio_std["J/p1"],
    )
    assert low[0] < found.intervals["J/p1[0]"].low < high[0]
    one = profile(found, "J/p1[0]")  # known all the same, though the rope's scale is not
    assert one.ends == ("crossed", "crossed")
    std = Coordinate(found.basis, "J/p1[0]").std  # of noise alone, as the profile
    half = std * np.sqrt(quantile(0.95, found.basis.information.freedom))
    middle = found.ratios["J/p1"][0]
    assert (one.low, one.high) == pytest.approx((middle - half, middle + half), abs=0.02 * half)
    assert "p/p1[0]" not in found.intervals  # 1 by definition


def test_ends_of_a_ratio_are_those_of_least_squares_with_the_ratio_held():
    """By another way: scipy's least squares over state and parameters, the ratio put in by elimination."""
    rope, t = PAIR, np.arange(31) / 15.0
    run = simulate(rope, duration=t[-1], t_eval=t, q0=[0.9, 1.1], tol=1e-9)
    data = run.q + 0.05 * np.random.default_rng(3).standard_normal(run.q.shape)
    found = swung(Recording(t, data), rope, ["inertia", "friction"], intervals=None)
    one = profile(found, "J/p1[1]", points=1)
    assert one.ends == ("crossed", "crossed")
    p1 = rope.mass[0] * rope.com[0] + rope.length[0] * rope.mass[1]
    moment = rope.mass[1] * rope.com[1] ** 2

    def squares(ratio):
        def residual(z):
            first, second = 1e-4 * z[4], ratio * p1 - moment
            tried = rope.replace(inertia=[first, second], friction=1e-4 * z[5:])
            ahead = simulate(tried, duration=t[-1], t_eval=t, q0=z[:2], qd0=z[2:4], tol=1e-9)
            return np.asarray((ahead.q - data).ravel())

        begun = np.concatenate([run.q[0], [0.0, 0.0], [8.0], [2.0, 1.0]])
        least = np.append(np.full(4, -np.inf), np.zeros(3))
        return float(2.0 * least_squares(residual, begun, x_scale="jac", diff_step=1e-5, bounds=(least, np.inf)).cost)

    best = float((found.residuals**2).sum())
    unit = Coordinate(found.basis, "J/p1[1]").unit  # of white residuals: their variance
    weight = found.basis.windows[0].weight.max()
    for end in (one.low, one.high):
        rise = (squares(end) - best) * weight**2 / unit
        limit = float(np.interp(end, one.values, one.limit))
        assert np.sqrt(rise) == pytest.approx(np.sqrt(limit), abs=0.03)  # CLOSE, and both fits' own ends
    assert one.low < found.ratios["J/p1"][1] < one.high


@pytest.mark.nightly
def test_a_ratio_is_followed_where_another_parameter_is_at_its_bound():
    """With a stiffness at 0 the squares rise far more steeply than the ratio's standard deviation has it."""
    rope = Rope(length=[0.2] * 3, mass=[0.1, 0.08, 0.05], friction=[1e-4] * 3, stiffness=[0.0, 2e-3, 1e-3])
    recording = recorded(rope, [0.5, 0.9, 1.2], np.arange(61) / 20.0, NOISE, seed=1)
    free = ["inertia", "com", "friction", "mass", "stiffness"]
    found = swung(recording, rope, free, intervals=None)
    assert found.values["stiffness"][0] == 0.0
    one = profile(found, "J/p1[0]")
    assert one.ends == ("crossed", "crossed")  # drawn less firmly it stays short of its aim, as if at a bound
    assert np.sqrt(one.rise[one.values == one.low]) == pytest.approx(np.sqrt(one.limit[0]), abs=0.05)  # a few CLOSE


def test_fits_that_do_not_converge_are_no_points_of_a_profile(found, monkeypatch):
    """Their squares are too large, and the interval would be too short."""

    def unfinished(*given, **options):
        return replace(fit(*given, **options), converged=options.get("target") is None)

    monkeypatch.setattr(_profile, "fit", unfinished)
    for name in ("c/p1[4]", "friction:shared"):
        assert profile(found, name).kind == "covariance"


def test_a_ratio_whose_parameter_is_at_its_bound_ends_there(found):
    """The inertia of the paper's rope is 0: J of the last link has no less than its mass and centre of mass give."""
    assert found.values["inertia"][0] == 0.0
    one, inertia = profile(found, "J/p1[4]"), profile(found, "inertia:shared")
    assert one.ends == ("bound", "crossed")
    assert one.low == pytest.approx(found.ratios["J/p1"][4], rel=1e-9)
    p1 = PAPER.mass[0] * PAPER.com[0] + PAPER.length[0] * PAPER.mass[1:].sum()
    assert one.high == pytest.approx(one.low + inertia.high / p1, rel=1e-3)  # nothing else that is free moves it
    assert np.interp(one.high, one.values, one.limit) == pytest.approx(
        np.interp(inertia.high, inertia.values, inertia.limit), rel=0.02
    )


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
    assert (plain["inertia:shared"].low, plain["inertia:shared"].ends[0]) == (0.0, "bound")
    refuses("intervals", swung, recording, PAPER, FREE, intervals="exact")


def test_refusals(found):
    refuses(r"no such parameter.*inertia:shared.*J/p1\[0\]", profile, found, "inertia")
    with pytest.raises(InvalidInput, match=r"no free one moves such a ratio: got .p/p1\[1\]"):
        profile(found, "p/p1[1]")  # masses and centres of mass were held
    for level in (0.0, 1.0, np.nan):
        refuses("level", profile, found, FREE[0], level)
    refuses("no longer has its fit", profile, replace(found, _basis=None), FREE[0])


def test_ctrl_c_leaves_the_covariance_for_what_is_not_profiled(recording, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(_profile, "profiled", interrupted)
    result = left_by(lambda: swung(recording, PAPER, FREE))
    assert {result.intervals[name].kind for name in FREE} == {"covariance"}
    assert result.status == "interrupted"
