"""Experiment design: predicted deviations against many fits, scaling laws, ranking, advice if no experiment
suffices."""

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE

from hyperflex import Arm, Experiment, Recording, Rope, arm_swings, design_experiment, identify, simulate
from hyperflex.budget import Budget
from hyperflex.errors import InvalidInput
from hyperflex.identification import FitOptions, RecordingSetup
from hyperflex.identification import experiment_design as _design
from hyperflex.identification.experiment_design import default_experiments, expected_information, variations
from tests.identification.twins import WHOLE
from tests.refusals import left_by, refuses

SINGLE = Rope(length=[0.3], mass=[0.1], com=[0.14], friction=2e-4)
SHORT = Experiment("short", q0=0.8, rate=40.0, duration=3.0)
NOISE = 2e-3


@pytest.mark.nightly
def test_predicted_deviations_are_those_of_many_fits():
    """40 twins: a deviation from 40 draws is known to 1 / sqrt(78) = 11 %; 3.5 of these. Stated ones agree better."""
    planned = design_experiment(SINGLE, ["inertia", "friction"], [SHORT], noise=NOISE).plans[0]
    run = simulate(SINGLE, duration=3.0, t_eval=SHORT.t, q0=[0.8], tol=1e-9)
    values, stated = [], []
    for seed in range(40):
        noise = NOISE * np.random.default_rng(seed).standard_normal(run.q.shape)
        found = identify(Recording(SHORT.t, run.q + noise), SINGLE, ["inertia", "friction"], options=WHOLE)
        values.append([float(found.values[name][0]) for name in ("inertia", "friction")])
        parts = [(found.std[name][0], found.model_std[name][0]) for name in ("inertia", "friction")]
        stated.append([float(np.sqrt(std**2 - model**2)) for std, model in parts])  # what noise does
    predicted = np.array(list(planned.std.values()))
    np.testing.assert_allclose(np.std(values, axis=0, ddof=1), predicted, rtol=0.39)
    # The fits estimate the noise from some 115 values (6 % each, 1 % on the mean) and differ in curvature by the noise
    np.testing.assert_allclose(np.mean(stated, axis=0), predicted, rtol=0.05)


def test_markers_are_predicted_as_in_a_fit_of_positions():
    """One fit: its std follows from 720 values' noise, known to 1 / sqrt(1440) = 3 %; three and a half of these."""
    look = Experiment("markers", q0=[0.8, 1.2], rate=40.0, duration=3.0, markers=3)
    planned = design_experiment(DOUBLE, "inertia", [look], noise=1e-3).plans[0]
    run = simulate(DOUBLE, duration=3.0, t_eval=look.t, q0=[0.8, 1.2], tol=1e-9)
    places = run.joints[:, [0, 1, 2]].copy()
    arc_lengths = np.linspace(0.0, 0.55, 3)  # the middle marker sits on the first link, 25 mm before its end
    along = np.stack([np.sin(run.q[:, 0]), -np.cos(run.q[:, 0])], axis=1)
    places[:, 1] = arc_lengths[1] * along
    seen = places.reshape(look.t.size, -1) + 1e-3 * np.random.default_rng(0).standard_normal((look.t.size, 6))
    recording = Recording(look.t, seen, kind="markers", noise=1e-3)
    exact = {"length_std": 0.0, "clock_std": 0.0}
    setup = RecordingSetup(arc_lengths=arc_lengths)
    found = identify(recording, DOUBLE, ["inertia", "friction"], setup=setup, options=FitOptions(train=np.inf, **exact))
    np.testing.assert_allclose(found.std["inertia"], list(planned.std.values()), rtol=0.1)


def test_noise_and_frame_rate_scale_as_they_must():
    """Deviations are exactly proportional to the noise; four times the frames halve them, except for the effect of the
    ends."""
    noisy = [
        design_experiment(SINGLE, "friction", [SHORT], noise=size).plans[0].std["friction[0]"] for size in (1e-3, 3e-3)
    ]
    assert noisy[1] / noisy[0] == pytest.approx(3.0, rel=1e-9)
    often = [Experiment("", q0=0.8, rate=rate, duration=4.0) for rate in (50.0, 200.0)]
    slow, fast = (design_experiment(SINGLE, "friction", [each]).plans[0].std["friction[0]"] for each in often)
    assert slow / fast == pytest.approx(2.0, rel=0.1)
    own = Experiment("own noise", q0=0.8, rate=40.0, duration=3.0, noise=3e-3)
    assert design_experiment(SINGLE, "friction", [own], noise=1e-3).plans[0].std["friction[0]"] == pytest.approx(
        noisy[1]
    )


def test_candidates_are_ranked_and_the_best_is_named():
    small = Experiment("small", q0=0.1, rate=40.0, duration=3.0)
    impossible = Experiment("impossible", q0=[0.1, 0.2, 0.3])
    still = Experiment("still", rate=40.0, duration=3.0)
    found = design_experiment(SINGLE, "friction", [small, impossible, still, SHORT])
    assert [plan.experiment.name for plan in found.plans[:2]] == ["short", "small"]
    assert found.best is found.plans[0]
    assert "Make: short" in found.recommendation
    assert "Not sufficient: still" in found.recommendation
    assert "wrong shape" in next(plan.reason for plan in found.plans if plan.experiment is impossible)
    assert found.success


def test_the_table_and_the_file_hold_what_was_found(tmp_path):
    found = design_experiment(DOUBLE, ["friction", "J/p1"], [Experiment("a swing", q0=0.8, rate=40.0, duration=3.0)])
    plan = found.plans[0]
    assert list(plan.std) == ["friction[0]", "friction[1]", "J/p1[0]", "J/p1[1]"]
    assert plan.score == max(plan.relative.values())
    assert plan.relative["friction[1]"] == pytest.approx(plan.std["friction[1]"] / 1e-4)
    assert "a swing" in str(found)
    found.to_json(tmp_path / "design.json")
    content = json.loads((tmp_path / "design.json").read_text("utf-8"))
    assert content["plans"][0]["std"]["J/p1[1]"] == plan.std["J/p1[1]"]
    assert content["plans"][0]["markers"] is None


def test_by_default_motions_are_tried_first_and_the_best_is_varied():
    found = design_experiment(DOUBLE, "inertia", arm=Arm(length=0.1))
    names = [plan.experiment.name for plan in found.plans]
    first = [each.name for each in default_experiments(DOUBLE, Arm(length=0.1))]
    assert len(first) == 7
    assert set(first) < set(names)
    assert found.best is not None
    motion = next(name for name in names if name in first)  # the best one as in the first evaluation
    by_name = {plan.experiment.name: plan.score for plan in found.plans}
    assert by_name[f"{motion}, 120 frames/s"] < by_name[motion] < by_name[f"{motion}, 7.5 frames/s"]
    assert by_name[f"{motion}, 20 s"] < by_name[motion] < by_name[f"{motion}, 5 s"]
    assert [each.markers for each in variations(Experiment("", markers=11))[4:]] == [3, 6]
    assert [each.markers for each in variations(Experiment("", markers=6))[4:]] == [3]


def test_a_common_factor_is_reported_to_need_scales_or_a_torque():
    swing = Experiment("swing", arm_swings(t_move=0.7, t_rest=0.4), rate=40.0, duration=4.0)
    free = ["inertia", "mass", "friction"]
    found = design_experiment(DOUBLE, "inertia", [swing], arm=Arm(length=0.1), free=free)
    assert found.best is None
    assert np.isinf(found.plans[0].score)
    assert "No candidate determines inertia[0], inertia[1]: no known force or torque acts" in found.recommendation
    # and what it promises is so
    assert "Weigh the links and leave mass out of free" in found.recommendation
    assert design_experiment(DOUBLE, "inertia", [swing], arm=Arm(length=0.1)).best is not None
    assert "Or measure the torque" in found.recommendation
    driven = replace(swing, torque_noise=1e-3)
    assert design_experiment(DOUBLE, "inertia", [driven], arm=Arm(length=0.1), free=free).best is not None
    assert "want=('J/p1', 'p/p1', 'c/p1')" in found.recommendation
    ratios = ("J/p1", "p/p1", "c/p1")
    assert design_experiment(DOUBLE, ratios, [swing], arm=Arm(length=0.1), free=free).best is not None


def test_an_effect_that_is_absent_is_distinguished_from_a_common_factor():
    found = design_experiment(SINGLE, "length", [SHORT], free=["inertia", "com", "length"])
    assert found.best is None
    assert "No candidate determines length[0]: it has no effect in these motions" in found.recommendation


def test_a_measured_torque_is_predicted():
    move = arm_swings(t_move=0.7, t_rest=0.4, profile="minimum-jerk")
    looks = [Experiment(f"{noise:g}", move, duration=4.0, rate=40.0, torque_noise=noise) for noise in (0.02, 0.08)]
    found = design_experiment(
        DOUBLE, "mass", looks, arm=Arm(length=0.1), free=["mass", "inertia", "friction", "arm_inertia"]
    )
    assert [plan.experiment.name for plan in found.plans] == ["0.02", "0.08"]
    # Beside a torque as noisy as this the angles tell the ratios exactly: the scale is as uncertain as the torque
    assert found.plans[1].score / found.plans[0].score == pytest.approx(4.0, rel=0.1)
    still = design_experiment(DOUBLE, "friction", [Experiment("", q0=0.8, duration=3.0, torque_noise=1e-3)])
    assert "the torque of no motor" in still.plans[0].reason
    assert still.best is None
    assert still.recommendation == "No candidate could be simulated."


def test_ctrl_c_keeps_the_finished_candidates(monkeypatch):
    def second_stops(rope, experiment, *others):
        if experiment.name == "second":
            raise KeyboardInterrupt
        return expected_information(rope, experiment, *others)

    monkeypatch.setattr(_design, "expected_information", second_stops)
    second = Experiment("second", q0=0.5)
    found = left_by(lambda: design_experiment(SINGLE, "friction", [SHORT, second]))
    assert found.status == "interrupted"
    assert [plan.experiment.name for plan in found.plans] == ["short"]
    with pytest.raises(KeyboardInterrupt):
        design_experiment(SINGLE, "friction", [second])


def test_out_of_time_it_ranks_what_was_simulated():
    seconds = iter(range(100))
    budget = Budget(4.5, clock=lambda: float(next(seconds)))
    found = design_experiment(SINGLE, "friction", [SHORT] * 20, time_budget=budget)
    assert found.status == "out of time"
    assert 0 < len(found.plans) < 20


def test_wrong_questions_are_refused():
    refuses("want has names that are not free", design_experiment, SINGLE, "mass", [SHORT])
    refuses("unknown name", design_experiment, SINGLE, "friction", [SHORT], free=["colour"])
    refuses("no experiments", design_experiment, SINGLE, "friction", [])
    refuses("no experiments", design_experiment, SINGLE, "friction", [arm_swings()])
    for wrong in ({"rate": 0.0}, {"duration": -1.0}, {"markers": 1}, {"noise": 0.0}, {"torque_noise": -1.0}):
        with pytest.raises(InvalidInput):
            Experiment("wrong", **wrong)
    refuses("too few frames", Experiment, "wrong", rate=1.0, duration=1.0)
    refuses("noise", design_experiment, SINGLE, "friction", [SHORT], noise=-1.0)
