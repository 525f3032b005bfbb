"""The timing rule, pumping, regulating and the loop, on a short rope of few links."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import control
from hyperflex.control import AmplitudeRule, CrossingRule, PumpingRule, SwingModel, TrueState, run_closed_loop
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=6, radius=0.003, friction=1e-3)
ARM = hf.Arm(length=0.08)
MODEL = SwingModel(ROPE, ARM, t_move=0.5)


def reach(motion: hf.Motion, duration: float) -> tuple[np.ndarray, np.ndarray]:
    run = hf.simulate(ROPE, motion, arm=ARM, duration=duration, tol=1e-6)
    return run.t, np.abs(run.tip[:, 0])


def test_the_period_is_that_of_a_rod():
    rod = hf.Rope(length=[0.7], mass=[0.2], com=[0.35], inertia=[0.2 * 0.7**2 / 12.0])
    # Textbook: 2 pi sqrt(2 L / 3 g).
    assert SwingModel(rod, ARM).period == pytest.approx(2.0 * math.pi * math.sqrt(2.0 * 0.7 / (3.0 * 9.81)), rel=1e-12)


def test_a_crossing_is_where_the_tip_passes_the_shaft():
    now = RopeState(2.0, np.full(6, 0.3), np.zeros(6))
    crossing = MODEL.crossing(now, MODEL.motion([]), after=now.t + 1e-6, until=now.t + MODEL.period)
    still = hf.simulate(ROPE, MODEL.motion([]), arm=ARM, duration=crossing - 2.0, q0=now.q, t_eval=[crossing - 2.0])
    assert abs(still.tip[-1, 0]) < 1e-4  # two runs at the default tolerance


@pytest.mark.parametrize("lead", [0.0, 0.05, -0.05, -0.25])
def test_the_papers_rule_starts_that_long_before_the_crossing(lead):
    swung = run_closed_loop(TrueState(ROPE, ARM), CrossingRule(MODEL, lead), MODEL, duration=3.0)
    for k in range(1, swung.starts.size):
        came = swung.starts[k - 1] + MODEL.t_move
        resting = hf.simulate(
            ROPE,
            MODEL.motion(swung.starts[:k]),
            arm=ARM,
            duration=came + 2.0,
            until=hf.tip_crosses((0.0, 0.0), (1.0, 0.0), sense=0, after=came + min(lead, 0.0) + 1e-6),
        )
        # Default tolerances on both sides: some 1e-5 m at some 1 m/s, grown over 3 s.
        assert swung.starts[k] == pytest.approx(max(came, resting.event[1] - lead), abs=1e-3)


def test_predicted_reach_is_that_of_a_run():
    now = RopeState(0.0, np.zeros(6), np.zeros(6))
    t, foreseen = MODEL.predict(now, 0, [[0.0, 0.2], [0.1, 0.4]], 1.6)
    for row, rests in zip(foreseen, ([0.0, 0.2], [0.1, 0.4]), strict=True):
        first = rests[0]
        second = first + 0.5 + rests[1]
        starts = [s for s in (first, second, second + 0.5 + MODEL.usual_rest) if s < 1.6]
        run = hf.simulate(ROPE, MODEL.motion(starts), arm=ARM, duration=t[-1], t_eval=t)
        np.testing.assert_allclose(row, np.abs(run.tip[:, 0]), atol=2e-3)  # planning tolerance 1e-4 m, ten times that


def test_a_regulated_swing_does_not_overshoot():
    swung = run_closed_loop(TrueState(ROPE, ARM), AmplitudeRule(MODEL, 0.4), MODEL, duration=10.0)
    t, x = reach(swung.motion, 10.0)
    # Foreseen every 20 ms at 1e-4 m; beyond the horizon nothing is promised, so 3 % for what comes after it.
    assert x.max() < 1.03 * 0.4
    assert x[t > 5.0].max() > 0.8 * 0.4


def test_a_plan_is_followed_where_nothing_disturbs():
    plan = np.full(6, MODEL.usual_rest)
    motion = MODEL.motion(np.cumsum(np.append(0.0, plan + 0.5)))
    t, x = reach(motion, 5.0)
    wanted = 0.98 * x.max()
    reached = float(control.arrival_time(t, x[None], wanted)[0])
    rule = PumpingRule(MODEL, wanted, rests=plan, arrival_time=reached)
    swung = run_closed_loop(TrueState(ROPE, ARM), rule, MODEL, duration=reached)
    t, x = reach(swung.motion, 6.0)
    # not later than planned, within planning's tolerance
    assert control.arrival_time(t, x[None], wanted)[0] < reached + 0.02


def test_bad_input():
    refuses("target", PumpingRule, MODEL, 0.0)
    with pytest.raises(InvalidInput, match="no weight"):
        _ = SwingModel(ROPE.replace(gravity=(0.0, 0.0)), ARM).period
    refuses("lead", CrossingRule, MODEL, math.nan)
