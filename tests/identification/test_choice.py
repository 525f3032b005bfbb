"""Model choice: whiteness under projection, BIC against its definition, twins whose model is known, disagreement."""

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.identification import comparison as _choice
from hyperflex.identification.comparison import FittedModel, candidates, criteria, predicts_as_well, recommend
from hyperflex.identification.model import lumped
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.uncertainty import covariance
from hyperflex.identification.uncertainty.noise import Piece, whiteness
from tests.identification.twins import recorded
from tests.refusals import left_by, refuses

NOISE = 2e-3  # rad
STIFF = DOUBLE.replace(stiffness=[0.0, 4e-3])
GUESS = DOUBLE.replace(inertia=5e-4, friction=1e-3)
MODELS = {"viscous": ["inertia", "friction"], "viscous + stiffness": ["inertia", "friction", "stiffness"]}


def swing(rope: hf.Rope, duration: float = 9.0, seed: int = 1) -> hf.Recording:
    return recorded(rope, [0.8, 1.2], np.arange(round(100 * duration) + 1) / 100, NOISE, seed)


# ---- whiteness


def smooth(m: int, channels: int, degree: int) -> Array:
    """Orthonormal polynomials (m C, k) in each channel, which represent a fit of states."""
    powers = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, m), degree))[0]
    return np.einsum("mk,cd->mckd", powers, np.eye(channels)).reshape(m * channels, -1)


def remains(noise: Array, there: Array, basis: Array) -> Piece:
    """The remainder of noise (m, C) after the basis is projected out of the present samples."""
    basis = np.linalg.qr(basis * there.reshape(-1, 1))[0]
    flat = (noise * there).ravel()
    return Piece((flat - basis @ (basis.T @ flat)).reshape(noise.shape) * there, there, basis.reshape(*noise.shape, -1))


def drawn(rng: np.random.Generator, colour: float = 0.0, windows: int = 8) -> float:
    """p of one draw: correlated channels, gaps, a state of four numbers a channel in each short window."""
    mix = np.array([[1.0, 0.0], [-0.5, 0.8]])
    parts = []
    for _ in range(windows):
        noise = rng.standard_normal((31, 2)) @ mix.T
        noise = noise[1:] + colour * noise[:-1]
        there = (rng.uniform(size=noise.shape) > 0.1).astype(float)
        parts.append(remains(noise, there, smooth(30, 2, 4)))
    return whiteness(parts)


def test_white_noise_passes_as_often_as_it_should_whatever_a_fit_took_out():
    """200 draws: p is uniform (Kolmogorov and Smirnov, to one in a thousand), and so at its low end, where it matters:

    the part below 0.05 has a standard deviation of 1.5 %; 3.5 of them.
    """
    from scipy.stats import kstest

    rng = np.random.default_rng(0)
    p = np.array([drawn(rng, windows=6) for _ in range(200)])
    assert kstest(p, "uniform").pvalue > 1e-3
    assert abs((p < 0.05).mean() - 0.05) < 0.054


def test_coloured_noise_is_seen():
    """Neighbours correlated by 0.44, over some 400 values: z = 0.44 sqrt(400 / 1.2) = 8 of the first lag alone."""
    rng = np.random.default_rng(1)
    assert max(drawn(rng, 0.6) for _ in range(20)) < 0.01


def test_one_channel_without_a_fit_is_the_test_of_ljung_and_box():
    """Their statistic, written out; it differs by how N and the variance are counted, parts of 1 / N."""
    from scipy.stats import chi2

    e = np.random.default_rng(2).standard_normal(2000)
    r = np.array([(e[k:] * e[:-k]).sum() / (e**2).sum() for k in range(1, 11)])
    statistic = 2000 * 2002 * (r**2 / (2000 - np.arange(1, 11))).sum()
    p = whiteness([Piece(e[:, None], np.ones((2000, 1)), np.zeros((2000, 1, 0)))])
    assert p == pytest.approx(chi2.sf(statistic, 10), abs=2e-3)


# ---- criterion


def test_bic_is_schwarz_s_with_states_counted_in_their_own_window():
    recording = swing(DOUBLE)
    fits = [
        basis
        for free in MODELS.values()
        if (basis := hf.identify(recording, GUESS, free, options=hf.FitOptions(window=1.0))._basis)
    ]
    simple, rich = criteria(fits)
    tau = min(each.information.correlation for each in fits)
    for one, bic, parameters in ((fits[0], simple, 4), (fits[1], rich, 6)):
        residuals = np.concatenate(one.fit.residuals)
        each = [window.y.size for window in one.windows]
        count = sum(each) / tau
        states = sum(4 * np.log(size / tau) for size in each)
        by_hand = count * np.log((residuals**2).mean()) + parameters * np.log(count) + states
        assert bic == pytest.approx(by_hand, rel=1e-12)
    fewer = replace(fits[1], windows=fits[1].windows[1:])
    assert criteria([fits[0], fewer])[1] is None  # other samples: no comparison


# ---- twins


def test_the_true_model_is_preferred_where_the_simpler_one_misses_something(tmp_path):
    """A candidate that fails is reported with its reason; the table is kept."""
    stiff = hf.compare_models(swing(STIFF), GUESS, MODELS | {"nonsense": ["colour"]})
    assert stiff.success
    assert stiff.preferred == "viscous + stiffness"
    assert stiff.best is stiff["viscous + stiffness"].identification
    assert stiff["viscous"].whiteness < 1e-6
    assert stiff["viscous + stiffness"].whiteness > 0.01
    assert stiff["viscous + stiffness"].held_out_rms < 0.6 * stiff["viscous"].held_out_rms
    assert "by BIC and by held-out prediction" in stiff.recommendation
    assert stiff["nonsense"].identification is None
    assert "unknown name" in stiff["nonsense"].reason
    assert all(words in str(stiff) for words in ("failed: free has an unknown name", *MODELS))
    with pytest.raises(KeyError):
        stiff["no such"]
    stiff.to_json(tmp_path / "models.json")
    content = json.loads((tmp_path / "models.json").read_text("utf-8"))
    assert (content["preferred"], content["unit"]) == ("viscous + stiffness", "rad")
    assert [each["name"] for each in content["models"]] == [*MODELS, "nonsense"]
    assert (content["models"][2]["bic"], content["models"][2]["held_out_rms"]) == (None, None)
    assert content["models"][1]["free"] == MODELS["viscous + stiffness"]


def test_the_simpler_model_is_preferred_where_it_is_true_and_both_are_cut_alike(monkeypatch):
    """The usual length of windows depends on the fastest link, and so on how many links there are."""
    windows: list[object] = []

    def noted(*arguments, **options):
        windows.append(options["options"].window)
        return hf.identify(*arguments, **options)

    monkeypatch.setattr(_choice, "identify", noted)
    found = hf.compare_models(swing(DOUBLE), GUESS, MODELS)
    assert found.preferred == "viscous"
    richer = found["viscous + stiffness"]
    # Two idle parameters cost 2 ln N = 14.5 (N = 1442 values) and gain 0 at their bounds, else a chi squared's 2: at
    # most 10 with a probability of 7e-3
    assert 4.5 < richer.bic - found["viscous"].bic < 14.6
    assert windows == [None, found["viscous"].identification.settings["window"]]


@pytest.mark.parametrize("dry", [1.5e-3, 0.0])
@pytest.mark.nightly
def test_dry_friction_is_preferred_where_there_is_some_and_not_where_there_is_none(dry):
    """A rod whose bearing also grips: the dry torque, N m, takes as much of its swing as the viscous one does."""
    rod = hf.Rope(length=[0.3], mass=[0.1], com=[0.14], inertia=[8e-4], friction=[3e-4], dry_friction=[dry])
    recording = recorded(rod, [0.8], np.arange(641) / 80, NOISE, seed=1)
    found = hf.compare_models(recording, rod.replace(friction=1e-3, inertia=5e-4))
    assert found.preferred == ("viscous + dry" if dry else "viscous")
    assert found.best is not None
    assert found["viscous + dry"].identification is not None
    value, std = (getattr(found["viscous + dry"].identification, name)["dry_friction"][0] for name in ("values", "std"))
    assert abs(value - dry) < 4.0 * std or (dry == 0.0 and np.isinf(std))


def test_nothing_that_can_be_fitted_prefers_nothing():
    found = hf.compare_models(swing(DOUBLE), GUESS, {"one": ["colour"], "two": ["taste"]})
    assert found.preferred is None
    assert found.best is None
    assert found.recommendation == "No candidate could be fitted."


def test_ctrl_c_keeps_the_candidates_that_are_done(monkeypatch):
    stops = [hf.identify, hf.identify, None]

    def second_stops(*arguments, **options):
        if stops.pop() is not None:
            raise KeyboardInterrupt
        return hf.identify(*arguments, **options)

    monkeypatch.setattr(_choice, "identify", second_stops)
    found = left_by(lambda: hf.compare_models(swing(DOUBLE), GUESS, MODELS))
    assert (found.status, [model.name for model in found.models]) == ("interrupted", ["viscous"])
    assert found.preferred == "viscous"
    assert "there is no comparison" in found.recommendation
    with pytest.raises(KeyboardInterrupt):  # now in the first one
        hf.compare_models(swing(DOUBLE), GUESS, MODELS)


def test_out_of_time_it_compares_what_is_done(monkeypatch):
    budget = Budget()

    def only_one(*arguments, **options):
        budget.cancel()
        return hf.identify(*arguments, **options | {"time_budget": None})

    monkeypatch.setattr(_choice, "identify", only_one)
    found = hf.compare_models(swing(DOUBLE), GUESS, MODELS, time_budget=budget)
    assert (found.status, [model.name for model in found.models]) == ("out of time", ["viscous"])


def test_a_candidate_that_is_cut_early_leaves_the_others_as_they_are(monkeypatch):
    """Nothing is known of its deviations, and it got to short windows only, which others do not take over."""
    windows: list[object] = []

    def first_is_cut(*arguments, **options):
        windows.append(options["options"].window)
        if len(windows) == 1:
            options["progress"] = lambda _: options["time_budget"].cancel()
        return hf.identify(*arguments, **options)

    monkeypatch.setattr(_choice, "identify", first_is_cut)
    monkeypatch.setattr(covariance, "GRACE", 0.0)
    found = hf.compare_models(swing(DOUBLE), GUESS, MODELS)
    assert windows == [None, None]
    assert (found.status, found.preferred) == ("out of time", "viscous + stiffness")
    assert (found["viscous"].bic, "before its standard deviations" in found["viscous"].reason) == (None, True)
    assert "p <" not in next(line for line in str(found).splitlines() if line.startswith("  viscous "))


def test_models_are_compared_by_a_robust_loss():
    recording = swing(DOUBLE, 4.0)
    data = recording.data.copy()
    data[::50] += 0.5  # rad
    found = hf.compare_models(hf.Recording(recording.t, data), GUESS, MODELS, options=hf.FitOptions(loss="cauchy"))
    assert found.preferred == "viscous"
    simple, rich = (found[name].bic for name in MODELS)
    assert simple < rich  # two idle parameters cost, and gain nothing


# ---- candidates


def test_default_candidates_are_the_ones_that_resist():
    guess = GUESS.replace(dry_friction=1e-3, stiffness=2e-3)
    found = {each.name: each for each in candidates(guess, ["inertia", "friction:shared"], None, [])}
    pairs = {"viscous", "viscous + dry", "viscous + stiffness", "viscous + drag", "dry", "drag", "dry + drag"}
    triples = {"viscous + dry + stiffness", "viscous + dry + drag", "viscous + stiffness + drag"}
    assert set(found) == pairs | triples
    assert found["viscous + dry"].free[1:] == ("friction:shared", "dry_friction:shared")
    assert found["dry + drag"].free[1:] == ("dry_friction:shared", "drag:shared")
    for name, each in found.items():
        assert each.guess.friction.any() == ("viscous" in name)
        assert float(each.guess.stiffness[0]) == (2e-3 if "stiffness" in name else 0.0)
        assert float(each.guess.dry_friction[0]) == (1e-3 if "dry" in name else 0.0)
    started = candidates(GUESS, ["inertia", "friction"], None, [])[1].guess.dry_friction
    np.testing.assert_allclose(started, 1e-3 * 9.81 * lumped(GUESS)[0])
    own = candidates(guess, ["inertia", "friction", "stiffness[1]"], None, [])
    assert own[2].free == ("inertia", "friction", "stiffness[1]")
    held = candidates(guess, ["inertia", "stiffness[0]", "stiffness[1]"], None, [])
    assert [each.name for each in held if "viscous" not in each.name] == []
    assert held[2].free == ("inertia", "stiffness[0]", "stiffness[1]")


def test_dividing_a_rope_again_keeps_its_mass_and_its_hanging_shape():
    rope = hf.Rope(length=[0.2, 0.3, 0.1], mass=[0.02, 0.06, 0.05], friction=[1e-3, 2e-4, 4e-4], tip_mass=0.01)
    fine = hf.with_links(rope, 6)  # its cuts hold the old joints, so a straight rope is the same body
    for one in (lumped(fine), lumped(hf.with_links(rope, 4))):
        moment = one[0][0] + float((one[0][1:]).sum())
        assert moment == pytest.approx(float(lumped(rope)[0].sum()), rel=1e-12)  # first moment of the straight rope
    assert fine.total_mass == pytest.approx(rope.total_mass)
    straight = [_about_the_joint(each) for each in (rope, fine)]
    assert straight[1] == pytest.approx(straight[0], rel=1e-12)
    assert fine.friction[0] == rope.friction[0]
    same = hf.with_links(hf.Rope.uniform(1.0, 0.1, 5, friction=2e-4), 10)
    np.testing.assert_allclose(same.friction[1:], 4e-4)  # twice as many joints in series, each twice as stiff
    np.testing.assert_allclose(same.mass, 0.01)
    np.testing.assert_allclose(same.inertia, hf.Rope.uniform(1.0, 0.1, 10, friction=0.0).inertia)


def _about_the_joint(rope: hf.Rope) -> float:
    """Moment of inertia of the straight rope about its first joint, kg m^2."""
    starts = np.cumsum(rope.length) - rope.length
    return float((rope.inertia + rope.mass * (starts + rope.com) ** 2).sum() + rope.tip_mass * rope.total_length**2)


def test_numbers_of_links_are_compared_by_the_places_of_markers():
    """Data of 4 links, markers at 5 places: 4 links explain them, 2 do not."""
    true = hf.Rope.uniform(0.6, 0.05, 4, friction=1e-4)
    t = np.arange(151) / 30
    run = hf.simulate(true, duration=5.0, t_eval=t, q0=np.linspace(0.5, 1.0, 4), tol=1e-9)
    places = run.joints.reshape(t.size, -1) + 1e-3 * np.random.default_rng(0).standard_normal((t.size, 10))
    recording = hf.Recording(t, places, kind="markers", noise=1e-3)
    guess = true.replace(friction=3e-4)
    found = hf.compare_models(
        recording, guess, {"4 links": ["friction:shared"]}, links=[2, 4], options=hf.FitOptions(train=4.0)
    )
    assert found.preferred == "4 links"
    assert [model.links for model in found.models] == [4, 2]
    assert found.unit == "m"
    assert found.models[0].bic < found.models[1].bic
    refuses("only with markers", hf.compare_models, swing(DOUBLE), GUESS, MODELS, links=[3])


@pytest.mark.parametrize("models", [{}, ["inertia"], {"one": "inertia"}, {"one": 3}])
def test_candidates_that_cannot_be_read_are_refused(models):
    with pytest.raises(hf.InvalidInput):
        hf.compare_models(swing(DOUBLE, 2.0), GUESS, models)


# ---- evidence that disagrees


def held(errors: list[float]) -> HeldOut:
    none = np.zeros(0)
    rms = np.array(errors)[:, None]
    return HeldOut(rms.mean(axis=0), rms, np.arange(len(errors)) * 1.0, 0.5, 1.0, none, none, none, none)


def model(name: str, unknowns: float, bic: float, errors: list[float] | None, whiteness: float = 0.5) -> FittedModel:
    held_out = None if errors is None else held(errors)
    return FittedModel(name, GUESS, (), unknowns=unknowns, bic=bic, held_out=held_out, whiteness=whiteness)


def test_what_is_recommended_where_evidence_disagrees_is_weak_or_misses_something():
    simple = model("simple", 4, 0.0, [0.010, 0.011, 0.009, 0.010])
    rich = model("rich", 6, -40.0, [0.015, 0.016, 0.014, 0.015], 1e-5)
    name, words = recommend([simple, rich])  # prediction decides where BIC trusts coloured residuals
    assert (name, "BIC prefers rich" in words, "prediction prefers simple" in words) == ("simple", True, True)
    assert recommend([simple, replace(rich, whiteness=0.4)])[0] == "rich"
    simple = model("simple", 4, 3.0, [0.0101, 0.0099, 0.0100])
    rich = model("rich", 6, 0.0, [0.0100, 0.0100, 0.0099])
    name, words = recommend([simple, rich])  # the simplest where evidence is weak
    assert (name, words.count("not clearly worse: rich")) == ("simple", 2)
    assert recommend([replace(simple, bic=7.0), rich])[0] == "rich"
    name, words = recommend([model("one", 4, 0.0, None, 1e-9), model("two", 4, 30.0, None, 1e-9)])
    assert name == "one"
    assert "there is no held-out prediction" in words
    assert "all candidates omit an effect" in words
    assert recommend([model("one", 4, 0.0, [np.inf]), model("two", 4, 30.0, [np.inf])])[0] == "one"


def test_a_prediction_is_worse_beyond_its_scatter_only():
    best = held([0.010, 0.020, 0.010, 0.020])
    assert predicts_as_well(held([0.012, 0.019, 0.012, 0.019]), best)  # here better, there worse
    assert not predicts_as_well(held([0.012, 0.022, 0.012, 0.022]), best)
    assert not predicts_as_well(held([0.012, 0.022, np.inf, 0.022]), best)
    assert predicts_as_well(held([0.0101, 0.0201, 0.0101, 0.0201]), best)  # sure, and too small to matter
    assert not predicts_as_well(held([0.0112]), held([0.010]))  # one stretch: 10 %
    assert predicts_as_well(held([0.0109]), held([0.010]))
    assert FittedModel("none", GUESS, ()).held_out_rms == np.inf
