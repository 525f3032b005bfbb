"""Time budgets are kept by the clock: what is at work when the time ends is cut short, whatever the processor did."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.planning import SuccessProbability, Uncertainty, estimate_success_probability
from hyperflex.planning.outcome import TOO_LONG, require_holding_force
from hyperflex.planning.robust import scenario_rollouts
from hyperflex.planning.search.beam import BeamSearch
from hyperflex.planning.search.candidates import Candidate
from hyperflex.planning.search.contact_phase import WindingScores, run_budget, simulate_contact
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.wind import casting
from hyperflex.planning.wind.planner import CastPlanner
from hyperflex.report import CastReport
from hyperflex.simulation import OUT_OF_TIME, Deadline
from tests.planning.known import CABLE, PEG, WINDS, planned, problem, simulated_strikes

OVER = Deadline(math.inf, lambda: -1.0)  # processor time enough, and none by the clock


def test_a_run_ends_when_no_time_is_left() -> None:
    left = iter([1.0, 1.0, 1.0, 0.0])
    cut = hf.simulate(
        planned().setup(), time_budget=Deadline(math.inf, lambda: next(left)), throw=False, t_eval=[0.0, 11.0]
    )
    assert cut.status == OUT_OF_TIME
    assert 0.0 < cut.state.t < 11.0
    assert next(left, None) is None
    for budget, words in (
        (OVER, "its time budget is over"),
        (Deadline(1e-9, lambda: 1.0), "its time budget is over"),
    ):
        with pytest.raises(SimulationError, match=words):
            hf.simulate(planned().setup(), time_budget=budget)


def test_verifications_do_not_outlast_the_time() -> None:
    work = CastPlanner(ThrowSearch(problem(), PEG), 60.0)
    work.clock = SimpleNamespace(spent=60.1)  # type: ignore[assignment]
    outcome, finer = work.verify(Candidate(2.0, 2.0, 1, np.zeros(3), WINDS))
    assert (outcome.completed, finer) == (False, None)
    assert outcome.message == TOO_LONG
    held = require_holding_force(planned().outcome, PEG, 0.1, OVER)
    assert (held.message, held.completed) == (TOO_LONG, False)  # not: refuted


def test_the_time_counts_from_the_call_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before a search begins, kernels are loaded."""
    begun: list[CastPlanner] = []
    monkeypatch.setattr(casting, "Clock", lambda: SimpleNamespace(spent=59.9))
    monkeypatch.setattr(CastPlanner, "run", lambda self, report: begun.append(self))
    plan = hf.plan_cast(CABLE, problem().arm, PEG, time_budget=60.0)
    assert (plan.seconds, begun[0].late) == (59.9, True)
    assert begun[0].left() < 0.0


def test_a_time_that_is_over_before_the_search_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(casting, "Clock", lambda: SimpleNamespace(spent=60.1))
    plan = hf.plan_cast(CABLE, problem().arm, PEG, time_budget=60.0)
    assert (plan.message, plan.runs) == ("the time budget was over before the search began", 0)
    assert plan.status == 2  # nothing found; not: infeasible


def test_runs_of_a_search_do_not_outlast_it() -> None:
    budget = run_budget(lambda: -1.0, 2 / 16)
    assert isinstance(budget, Deadline)
    assert budget.left() == -1.0
    strike = simulated_strikes(problem(), PEG, [WINDS])
    motions = [WINDS.motion(problem().limits).shifted(-float(strike.t[0]))]
    batch = RolloutBatch([CABLE], [PEG], motions, strike.q, strike.qd)
    cut = simulate_contact(batch, strike.t, problem(), time_budget=budget)
    assert cut.turns[0] == 0.0  # with the time that it takes: 2.4


@pytest.mark.parametrize("threads", [0, -1, 2000])
def test_threads_that_cannot_be_used_are_refused(threads: int) -> None:
    with pytest.raises(InvalidInput, match="threads"):
        ThrowSearch(problem(), PEG, threads=threads).beam_search()


def test_free_swings_of_a_search_do_not_outlast_it() -> None:
    search = ThrowSearch(problem(), PEG)
    struck = search._strikes(search.problem, [WINDS])
    assert np.isfinite(struck.t).all()
    search.left = lambda: -1.0
    assert np.isnan(search._strikes(search.problem, [WINDS]).t).all()
    beam = BeamSearch(problem(), PEG, [-1], np.random.default_rng(0))
    left = iter([1.0])  # to begin with a stroke; then none
    assert beam.extend(3.0, 8, lambda: next(left, -1.0)) == []
    assert not beam.ready(3.0, 8)  # no swing that was cut short is gone on with


def test_a_probability_counts_the_samples_that_there_was_time_for(monkeypatch: pytest.MonkeyPatch) -> None:
    now, left = [0.0], []

    def scores(_: object, pairs: list, *, time_budget: Deadline, threads: object) -> WindingScores:
        left.append(time_budget.left())
        now[0] += 4.0
        return WindingScores(np.ones(len(pairs)), np.full(len(pairs), 2.0))

    monkeypatch.setattr(scenario_rollouts, "scenario_scores", scores)
    monkeypatch.setattr(scenario_rollouts, "Clock", lambda: SimpleNamespace(spent=0.0))
    given = (problem(), PEG, WINDS, Uncertainty())
    assert estimate_success_probability(*given, samples=40).samples == 40

    class Now:
        @property
        def spent(self) -> float:
            return now[0]

    monkeypatch.setattr(scenario_rollouts, "Clock", Now)
    for time_budget, lots, lefts in ((10.0, 2, [10.0, 6.0, 2.0]), (3.0, 0, [3.0]), (0.0, 0, [])):
        now[0] = 0.0
        left.clear()
        found = estimate_success_probability(*given, samples=40, time_budget=time_budget)
        assert found.samples == lots * scenario_rollouts.COUNTED  # in 10 s: the third lot ends after 12
        assert left == lefts
        assert found.successes == found.samples


def test_a_probability_is_not_estimated_beyond_the_time() -> None:
    given = (problem(), PEG, WINDS, Uncertainty())
    estimate_success_probability(*given, samples=1)  # so that kernels are loaded
    clock = Clock()
    found = estimate_success_probability(*given, time_budget=0.1)
    assert clock.spent < 1.0
    assert (found.samples, str(found)) == (0, "not estimated, no time was left")


def test_a_plan_says_that_no_time_was_left_for_its_probability(monkeypatch: pytest.MonkeyPatch) -> None:
    stands = (WINDS, planned().outcome, planned().outcome)
    monkeypatch.setattr(casting, "Clock", lambda: SimpleNamespace(spent=60.1))
    monkeypatch.setattr(CastPlanner, "run", lambda self, report: setattr(self, "best", stands))
    monkeypatch.setattr(casting, "refine_robustly", lambda *_: None)
    plan = hf.plan_cast(CABLE, problem().arm, PEG, uncertainty=Uncertainty(), time_budget=60.0)
    assert plan.success
    assert plan.success_probability == SuccessProbability(0, 0)
    assert plan.summary()["success_probability"]["interval"] == (0.0, 1.0)
    assert "Success probability: not estimated, no time was left." in CastReport(plan, None).story
