"""What results say of themselves when printed: short, and nothing of what was held."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import hyperflex as hf
from hyperflex.budget import Budget, OutOfTime
from hyperflex.errors import InvalidInput
from hyperflex.identification import Kind, Severity, pipeline, text
from hyperflex.identification.declarations.faults import swapped, uneven_scale
from hyperflex.identification.declarations.mistakes import ShortFit
from hyperflex.identification.declarations.score_tests import ScoreTest
from hyperflex.identification.fit import Loss
from hyperflex.identification.measurements import measure
from hyperflex.identification.multi_start import search_delay
from hyperflex.identification.prediction import HeldOut, predict
from hyperflex.identification.symptoms import _far, _of_prediction, score_findings
from tests.identification.twins import QUICK, WHOLE_QUICK, recorded
from tests.refusals import left_by

PAIR = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06], friction=[3e-4, 1e-4])
T = np.arange(0.0, 4.0, 0.02)


def swing(rope: hf.Rope = PAIR) -> hf.Recording:
    return recorded(rope, np.full(rope.n_links, 0.8), T, 2e-3)


def fitted(rope: hf.Rope, free: list[str], **others: Any) -> hf.Identification:
    return hf.identify(swing(rope), rope, free, options=hf.FitOptions(**others))


def test_what_all_links_share_is_printed_once():
    rope = hf.Rope.uniform(length=0.6, mass=0.1, n_links=16, friction=5e-4)
    short = swing(rope).window(0.0, 1.2)
    said = str(hf.identify(short, rope, ["friction:shared", "gravity_angle"], options=WHOLE_QUICK))
    line = next(line for line in said.splitlines() if "value friction" in line)
    assert line.count("std") == 1
    assert line.endswith("each")
    assert "gravity_angle " in said
    assert max(len(line) for line in said.splitlines() if line.startswith("  value")) < 300
    assert "and 4 more" in next(line for line in said.splitlines() if "fit error" in line)
    assert "std 0)" not in said


def test_linear_algebra_keeps_to_one_thread_and_gives_the_others_back():
    def threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    inside: list[set[int]] = []
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        hf.identify(swing(), PAIR, ["friction"], options=QUICK, progress=lambda _: inside.append(threads()))
        hf.iterative_revision(swing(), PAIR, rounds=1, max_evaluations=3, progress=lambda _: inside.append(threads()))
        assert threads() == before
    assert len(inside) > 1
    assert all(each == {1} for each in inside)


@pytest.mark.parametrize("late", [0.5, -0.4])
def test_a_delay_far_off_is_found(late):
    drive = {"motion": hf.arm_swings(t_move=0.7, t_rest=0.4), "arm": hf.Arm(length=0.1)}
    seen = recorded(PAIR, None, T, 2e-3, seed=1, **drive)
    guess, setup = PAIR.replace(friction=1e-3), hf.RecordingSetup(**drive)
    found = hf.identify(hf.Recording(T + late, seen.data), guess, ["friction", "delay"], setup=setup)
    assert found.success
    assert abs(found.values["delay"] - late) < 4.0 * found.std["delay"] < 4e-3
    assert abs(found.settings["delay_from"] - late) < 0.1  # the grid's step is a sixteenth of a window


STIFF = PAIR.replace(stiffness=[0.0, 4e-3])


def stopped(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_lengths_count_only_where_they_were_tested(monkeypatch):
    assert fitted(PAIR, ["friction"], intervals=None).settings["length_std"] == 0.01
    monkeypatch.setattr(pipeline, "score_tests", stopped)
    found = left_by(lambda: fitted(PAIR, ["friction"], intervals=None))
    assert found.status == "interrupted"
    assert found.settings["length_std"] == 0.0


def test_a_richer_fit_whose_tests_are_interrupted_leaves_the_tested_one(monkeypatch):
    tests = [pipeline.score_tests, stopped]
    monkeypatch.setattr(pipeline, "score_tests", lambda *asked, **how: tests.pop(0)(*asked, **how))
    found = left_by(lambda: hf.identify(swing(STIFF), PAIR, options=QUICK))
    assert tests == []
    assert found.status == "interrupted"
    assert found.settings["free"] == ["inertia", "friction"]
    assert found.score_tests
    assert found.settings["length_std"] == 0.01


def test_a_richer_fit_that_is_refused_leaves_the_first_one(monkeypatch):
    """As with a lack of memory or samples: it was not requested."""
    fit, tried = pipeline.MultiStart, list[int]()

    def once(plant, *asked):
        tried.append(len(plant.parameters))
        if len(tried) > 1:
            raise InvalidInput("too few samples")
        return fit(plant, *asked)

    monkeypatch.setattr(pipeline, "MultiStart", once)
    found = hf.identify(swing(STIFF), PAIR, options=QUICK)
    assert tried == [4, 6]
    assert (found.converged, found.ended, found.settings["free"]) == (True, None, ["inertia", "friction"])


@pytest.mark.parametrize("ended", ["interrupted", "out of time"])
def test_a_fit_that_converged_before_its_intervals_were_cut_may_be_used(ended):
    budget = Budget()

    def end(entry):
        if "phase" in entry:
            budget.cancel()
            if ended == "interrupted":
                raise KeyboardInterrupt

    how = hf.FitOptions(intervals="profile")
    try:
        found = hf.identify(swing(), PAIR, ["friction"], options=how, time_budget=budget, progress=end)
    except hf.Interrupted as stop:
        found = stop.partial
    assert (found.status, found.converged, found.grade) == (ended, True, "usable for ratios")
    assert found.message.startswith(f"The fit has converged, but work ended early ({ended}).")
    assert not found.has(Kind.NOT_CONVERGED)


def test_what_comes_after_the_fit_keeps_to_its_time():
    basis, budget = fitted(PAIR, ["friction"], intervals=None).basis, Budget()
    measured = measure(swing(), PAIR, None)
    budget.cancel()
    for work in (
        lambda: predict(basis, measured, hf.FitOptions(), budget),
        lambda: search_delay(basis.plant, measured, 0.5, Loss(), budget),
        lambda: ShortFit(PAIR, ["friction"], hf.RecordingSetup(), Loss(), budget)(swing()),
    ):
        with pytest.raises(OutOfTime):
            work()


def test_ratios_of_which_none_is_known_are_not_to_be_used():
    """Half a second of strong noise: intervals contain the truth and 0, and are useless."""
    q = hf.simulate(PAIR, duration=4.0, t_eval=T, q0=[0.8, 0.8]).q[:30]
    q = q + 0.15 * np.random.default_rng(0).standard_normal(q.shape)
    found = hf.identify(hf.Recording(T[:30], q), PAIR, ["inertia", "com"], options=WHOLE_QUICK)
    assert found.converged
    assert (found.ratio_std["J/p1"] > 0.3 * found.ratios["J/p1"]).all()
    assert found.has(Kind.NOTHING_KNOWN)
    assert (found.success, found.status) == (False, "failed")
    assert found.message == text(found.findings[0])


def test_predictions_are_compared_as_far_as_their_band_is_narrow():
    """Once it has grown beyond a fifth of what keeping still errs by, what lies behind does not count."""
    t = np.linspace(0.1, 1.0, 10)
    measured = np.append(t, t)[:, None]
    predicted = measured + np.where(np.append(t, t) > 0.55, 3.0, 0.0)[:, None]
    std = np.full((20, 1), 0.01)
    std[5] = 0.5  # of the first prediction alone
    starts = np.array([0.0, 1.0])
    rms = np.array([1.0])
    held = HeldOut(rms, np.ones((2, 1)), starts, 0.5, 1.0, np.append(t, t + 1.0), measured, predicted, std)
    kept = held.foreseeable
    np.testing.assert_allclose(kept.t, np.append(t[:5], t + 1.0))
    assert kept.rms[0] == pytest.approx(3.0 * np.sqrt(5 / 15))
    assert [each.kind for each in _of_prediction(held, ())] == [Kind.PREDICTION_POOR]
    std[15] = 0.5
    assert list(_of_prediction(replace(held, std=std), ())) == []


def test_a_prediction_outside_its_band_names_what_a_refit_explains_most_with():
    t = np.linspace(0.1, 1.0, 10)
    measured, std = np.sin(t)[:, None], np.full((10, 1), 0.01)
    held = HeldOut(np.array([0.05]), np.full((1, 1), 0.05), np.zeros(1), 0.5, 1.0, t, measured, measured + 0.05, std)
    tests = [
        ScoreTest("drag", 0.5, np.zeros(1), moved=0.1, excess_gain=0.5),  # as noise may explain
        ScoreTest("gravity_angle", 0.2, np.zeros(1), moved=0.0, excess_gain=0.97),
        ScoreTest("dry_friction", 0.1, np.zeros(1), moved=0.0, excess_gain=0.97),
    ]
    (found,) = _of_prediction(held, tests)
    assert found.kind is Kind.PREDICTION_OUTSIDE
    assert "as declared: most is explained with 'gravity_angle' free. " in str(found)
    (found,) = _of_prediction(held, tests[:1])
    assert "is not as declared. " in str(found)


def test_a_link_whose_mass_lies_far_beyond_it_is_not_to_be_used():
    """As a frame rate that is far too low makes it: times are stretched, and with them inertia over first moment."""
    rope = hf.Rope(length=[0.17, 0.23], mass=[0.21, 0.16], com=[0.11, 0.09])
    known = np.zeros(2)
    assert list(_far(rope, rope, known)) == []
    for link, inertia, severity in (
        (0, [0.0225, rope.inertia[1]], Severity.WRONG),
        (1, [rope.inertia[0], 0.05], Severity.WRONG),
        (1, [rope.inertia[0], 1.2 * 0.16 * 0.09 * 0.23 - 0.16 * 0.09**2], Severity.DOUBT),  # 1.2 times its length
    ):
        (far,) = _far(rope.replace(inertia=inertia), rope, known)
        assert (far.kind, far.severity, far.values["link"]) == (Kind.MASS_FAR, severity, link)
    assert list(_far(rope.replace(inertia=inertia), rope, np.array([0.0, 0.02]))) == []  # m, of J/p1: it may be chance
    string = hf.Rope(length=[0.6, 0.25], mass=[0.06, 0.04], com=[0.6, 0.125], inertia=[0.0, 2e-4], friction=1e-4)
    (far,) = _far(string.replace(inertia=[0.029, 1.8e-3]), string, np.full(2, 1e-4))
    assert far.values["link"] == 0  # 80 % beyond the end of its string; a rod may seem so far away


def test_markers_swapped_in_two_intervals_are_reported_with_both():
    rope = hf.Rope(length=[0.3, 0.25], mass=[0.1, 0.06])
    t, q = np.arange(400) / 50.0, np.full((400, 2), [0.3, 0.8])
    places = np.stack([rope.joints(row, np.zeros(2)) for row in q])
    away = (t >= 1.0) & (t < 2.0) | (t >= 5.0) & (t < 5.5)
    places[away] = places[away][:, [0, 2, 1]]
    recording = hf.Recording(t, places.reshape(t.size, -1), kind="markers")
    (found,) = swapped(recording, rope)
    assert (found.values["first"], found.values["second"]) == (1, 2)
    assert found.values["times"] == [[1.0, 1.98], [5.0, 5.48]]
    assert "from t = 1 to 1.98, 5 to 5.48 s." in text(found)


@pytest.mark.parametrize(("factor", "turn"), [(1.0, 0.0), (1.1, 0.0), (1.1, 0.6)])
def test_a_picture_that_is_wider_than_high_is_reported(factor, turn):
    run = hf.simulate(PAIR, duration=T[-1], t_eval=T, q0=[1.2, 0.9], tol=1e-7)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    places = run.joints @ (axes @ np.diag([factor, 1.0]) @ axes.T)
    places = places + 1e-3 * np.random.default_rng(0).standard_normal(places.shape)
    found = uneven_scale(hf.Recording(T, places.reshape(T.size, -1), kind="markers"), PAIR)
    assert [each.kind for each in found] == [Kind.PICTURE_SCALE] * (factor > 1.0)
    for each in found:
        assert each.values["factor"] == pytest.approx(factor, rel=0.02)
        assert each.values["angle"] == pytest.approx(turn, abs=0.1)


def test_more_links_are_recommended_where_they_help_and_nothing_explains_more():
    """A rope that is bent at rest looks like one of finer links; these would explain little, and a bend more."""
    links = ScoreTest("links", 0.3, np.array([32.0]), excess_gain=0.7, ratio_sensitivity=0.2)
    bent = ScoreTest("rest_angle:shared", 0.8, np.array([0.1]), moved=0.0)

    def kinds(*tests):
        return [each.kind for each in score_findings(tests, odd=False, known=True, wrong=False)]

    assert kinds(links) == [Kind.LINKS_TOO_LONG]
    assert kinds(replace(links, gain=0.02)) == []
    assert kinds(bent, links) == [Kind.REST_BEND]


@pytest.mark.nightly
@pytest.mark.parametrize(("noise", "told"), [(2e-3, False), (1.2e-3, False), (6e-4, True), (None, False)])
def test_a_fit_that_leaves_far_more_than_the_declared_noise_is_a_doubt_without_a_cause(noise, told):
    def doubts(found: hf.Identification) -> bool:
        every = {each.kind: each.severity for each in found.findings}
        return every.get(Kind.NOISE_UNDERSTATED) is Severity.DOUBT

    data = swing().data
    free = ["inertia", "com", "friction"]
    found = hf.identify(hf.Recording(T, data, noise=noise), PAIR, free, options=QUICK)
    assert doubts(found) is told
    slow = hf.identify(hf.Recording(1.03 * T, data, noise=noise), PAIR, free, options=QUICK)
    assert slow.findings[0].kind is Kind.CLOCK
    assert not doubts(slow)
