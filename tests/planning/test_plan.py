"""Plans: found, refused, interrupted, the same with the same seed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import winding
from hyperflex.errors import InvalidInput
from hyperflex.planning import MotorLimits, Problem, SuccessProbability, Uncertainty, check_feasibility
from hyperflex.planning.clearance import Clearance
from hyperflex.planning.outcome import TOO_LONG
from hyperflex.planning.robust.refinement import DOUBT
from hyperflex.planning.search import strikes
from hyperflex.planning.search.candidates import Swing
from hyperflex.planning.search.contact_phase import WindingScores
from hyperflex.planning.search.throw_search import LATER, MAX_FAILED, TRIED, ThrowSearch
from hyperflex.planning.throw import MOVES
from hyperflex.planning.verification import spare_clearance
from hyperflex.planning.wind import casting, robust_phase
from hyperflex.planning.wind import planner as cast_planner
from hyperflex.planning.wind.robust_phase import EARLY_GAIN
from hyperflex.planning.wind.verified import Asked, failure, foreseen, steady, succeeds, with_margin
from hyperflex.simulation import Deadline
from tests.faults.interrupting import left_by
from tests.planning.known import planned

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
ARM = hf.Arm(length=0.105)
EASY = hf.Peg(1.36 * np.sin(-0.66), -1.36 * np.cos(-0.66), 0.04, 0.3)


@pytest.mark.nightly
def test_a_target_in_reach_is_wound_and_held() -> None:
    """And by an independent run: half the step, and links that the planner did not know."""
    found = hf.plan_cast(CABLE, ARM, EASY, time_budget=300.0)  # as long as it takes on a busy machine
    assert found.success, found.message
    assert found.motion is not None
    fine = hf.Rope.uniform(length=2.0, mass=0.125, n_links=125, radius=0.0025, friction=5e-4 * 2.5)
    stop = float(found.motion.breaks[-1])
    run = hf.simulate(fine, found.motion, arm=ARM, duration=stop + 3.0, pegs=[EASY], contact_step=5e-4)
    turns = np.abs(winding.turns(run, EASY)[run.t > stop + 1.0])
    assert turns.min() >= 1.25
    t = np.linspace(0.0, stop, 5000)
    limits = found.problem.limits
    assert np.abs(found.motion.rate(t)).max() <= limits.speed * (1 + 1e-9)
    assert np.abs(found.motion.acceleration(t)).max() <= limits.acceleration * (1 + 1e-9)


@pytest.mark.parametrize(
    ("target", "told"),
    [
        (hf.Peg(2.5, 0.0, 0.03), "short of the target"),
        (hf.Peg(0.02, 0.05, 0.02), "inside the arm's circle"),
        (hf.Peg(0.0, -0.9, 0.03), "too little energy"),
    ],
)
def test_out_of_reach_is_said_before_searching(target: hf.Peg, told: str) -> None:
    found = hf.plan_cast(CABLE, ARM, target)
    assert not found.success
    assert told in found.message
    assert (found.runs, found.motion, found.outcome) == (0, None, None)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"target": hf.Ground(0.0, -1.0)}, "target is not a peg"),
        ({"time_budget": 0.0}, "time_budget"),
        ({"time_budget": np.nan}, "time_budget"),
        ({"holding_force": -1.0}, "holding_force"),
        ({"time_limit": -1.0}, "time"),
        ({"time_limit": 0.0}, "time_limit"),
        ({"time_limit": 0.02}, "too short for any cast"),
        ({"seed": -1}, "seed"),
        ({"limits": "fast"}, "limits"),
        ({"rope": CABLE.replace(gravity=(0.0, 0.0))}, "no weight"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], told: str) -> None:
    given: dict[str, object] = {"rope": CABLE, "arm": ARM, "target": EASY, "time_budget": 0.01} | change
    with pytest.raises(InvalidInput, match=told):
        hf.plan_cast(given.pop("rope"), given.pop("arm"), given.pop("target"), **given)  # type: ignore[arg-type]


def test_a_search_that_finds_nothing_says_so() -> None:
    found = hf.plan_cast(CABLE, ARM, hf.Peg(0.0, -0.9, 0.03), time_budget=2.0, skip_feasibility=True, time_limit=1.0)
    assert not found.success
    assert found.message
    assert found.runs > 0


def test_an_interrupted_plan_leaves_its_best(monkeypatch: pytest.MonkeyPatch) -> None:
    landed = cast_planner.Candidate(2.0, 2.0, 1, np.zeros(3), "a throw", confirmed=True)  # type: ignore[arg-type]

    def swing(self: ThrowSearch, *_: float) -> float:
        if self.candidates:
            raise KeyboardInterrupt
        self.candidates.append(landed)
        return 1.0

    def verified(self: cast_planner.CastPlanner, found: cast_planner.Candidate) -> object:
        return SimpleNamespace(success=False, turns=2.0, slip=9e-3, message="it slips"), None

    monkeypatch.setattr(ThrowSearch, "beam_search", swing)
    monkeypatch.setattr(ThrowSearch, "evolve_swings", swing)
    monkeypatch.setattr(ThrowSearch, "try_last_moves", lambda self, **_: None)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify_twice", verified)
    found = left_by(lambda: hf.plan_cast(CABLE, ARM, EASY))
    assert found.interrupted
    assert found.throw == "a throw"
    assert found.message == "it slips"


def test_the_same_seed_searches_alike() -> None:
    searches = [ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, seed) for seed in (4, 4, 5)]
    scores = [search.evolve_swings() for search in searches]
    assert scores[0] == scores[1] != scores[2]
    assert np.array_equal(searches[0].swings[0].x, searches[1].swings[0].x)


@pytest.mark.parametrize(
    ("fails", "planned"),
    [
        ({"throw 2"}, "throw 1"),  # the most robust one that stands when it is verified
        ({"throw 2", "throw 1"}, "throw 0"),
        ({"throw 0", "throw 1", "throw 2"}, "throw 2"),  # the most robust one, if none stands
    ],
)
@pytest.mark.parametrize("slip", [1e-3, 3e-3])  # with something in hand and without
def test_with_uncertainty_the_throw_that_wins_most_often_is_planned_and_its_success_stated(
    monkeypatch: pytest.MonkeyPatch, fails: set[str], planned: str, slip: float
) -> None:
    """The course of things alone: what is raced, verified and stated is made up."""
    landed = [cast_planner.Candidate(3.0 - k, 2.0, 1, np.full(3, float(k)), f"throw {k}") for k in range(3)]  # type: ignore[arg-type]
    seen: dict[str, object] = {}

    def go(self: cast_planner.CastPlanner, report: object) -> None:
        self.search.candidates += landed
        self.check(landed[:1])

    def verified(self: cast_planner.CastPlanner, found: cast_planner.Candidate) -> object:
        good = found.throw not in fails
        cast = SimpleNamespace(
            success=good,
            turns=2.0,
            slip=slip,
            load_ratio=0.5,
            tip_hangs=True,
            spare_clearance=0.1,
            touch_time=5.0,
            folded=False,
            message="" if good else "it slips",
            completed=True,
        )
        return cast, cast if good else None

    def race(self: robust_phase.RobustRefinement, found: list, seeded: list) -> None:
        seen["seeded"] = [one.throw for one in seeded]
        seen["raced"] = [one.throw for one in found]
        self.order = [robust_phase.RobustCandidate(landed[k], values=16 * [0.5 * k]) for k in (2, 1)]

    def estimate_success_probability(
        problem: object, peg: object, throw: object, *_: object, **__: object
    ) -> SuccessProbability:
        seen["stated"] = throw
        return SuccessProbability(30, 40)

    monkeypatch.setattr(cast_planner.CastPlanner, "run", go)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify", verified)
    monkeypatch.setattr(robust_phase.RobustRefinement, "halve", race)
    monkeypatch.setattr(robust_phase.RobustRefinement, "run", no_generation)
    monkeypatch.setattr(robust_phase.RobustRefinement, "best", lambda self, count: self.order[:count])
    monkeypatch.setattr(casting, "estimate_success_probability", estimate_success_probability)
    found = hf.plan_cast(CABLE, ARM, EASY, uncertainty=Uncertainty())
    assert seen["seeded"] == ["throw 0"]
    assert sorted(seen["raced"]) == ["throw 0", "throw 1", "throw 2"]  # type: ignore[arg-type, call-overload]
    assert seen["stated"] == planned
    assert (found.throw, found.success, found.success_probability) == (
        planned,
        planned not in fails,
        SuccessProbability(30, 40),
    )
    nominal = hf.plan_cast(CABLE, ARM, EASY)
    assert (nominal.throw, nominal.success_probability) == ("throw 0", None)


def no_generation(self: robust_phase.RobustRefinement, until: float, report: object) -> None:
    """As a refinement that has no time for any."""
    self.left = lambda: 0.0


class Race(robust_phase.RobustRefinement):
    """Throws that win in so many of the common worlds; nothing is simulated."""

    wins = (16, 10, 8)

    def halve(self, found: list, seeded: object = ()) -> None:
        self.order = [
            robust_phase.RobustCandidate(found[k], values=[m < self.wins[k] for m in range(16)]) for k in range(3)
        ]

    def evaluate(self, runners: object, scenarios: list) -> None:
        assert not scenarios

    run = no_generation


def hardened(
    monkeypatch: pytest.MonkeyPatch, time_budget: float = 60.0, hear: object = None, **told: dict[str, object]
) -> cast_planner.CastPlanner:
    """A plan that was made robust, of throws a, b and c; what is `told` of each: what its verification says.

    `hear` is called with the planner when it tells a plan.
    """
    good = {
        "success": True,
        "turns": 2.0,
        "slip": 1e-3,
        "load_ratio": 0.5,
        "tip_hangs": True,
        "spare_clearance": 0.1,
        "touch_time": 5.0,
        "folded": False,
        "completed": True,
    }
    landings = [
        cast_planner.Candidate(1.0, 2.0, 1, np.full(26, float(k)), SimpleNamespace(name=name, count=5))
        for k, name in enumerate("abc")
    ]

    def verified(self: cast_planner.CastPlanner, found: cast_planner.Candidate) -> object:
        cast = SimpleNamespace(**(good | told.get(found.throw.name, {})))  # type: ignore[attr-defined]
        return cast, cast if cast.success else None

    monkeypatch.setattr(robust_phase, "RobustRefinement", Race)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify", verified)
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=2)
    search.candidates = landings
    work = cast_planner.CastPlanner(search, robust_phase.NOMINAL * time_budget, enough=np.inf)
    nominal = SimpleNamespace(**(good | told.get("nominal", {})))
    work.best = ("nominal", nominal, nominal)  # type: ignore[assignment]
    work.hear = hear and (lambda: hear(work))  # type: ignore[operator]
    robust_phase.refine_robustly(work, Uncertainty(), None)
    return work


FAILS, LOOSE, LATE = (
    {"success": False, "turns": 0.5},
    {"folded": True},
    {"success": False, "turns": 0.0, "completed": False},
)


@pytest.mark.parametrize(
    ("told", "time_budget", "planned"),
    [
        ({}, 60.0, "a"),
        ({"a": FAILS}, 60.0, "b"),  # what does not stand is dropped, and the rest refined
        ({"a": FAILS, "b": FAILS}, 60.0, "c"),
        ({"a": FAILS, "b": FAILS}, 1e-9, "nominal"),  # no time for a third
        ({"a": FAILS, "b": FAILS, "c": FAILS}, 60.0, "nominal"),
        ({"a": FAILS, "b": FAILS, "c": FAILS, "nominal": FAILS}, 60.0, "a"),
        ({"a": LATE, "b": FAILS, "c": FAILS, "nominal": FAILS}, 60.0, "b"),  # of which it is known why it fails
        ({"a": LOOSE}, 60.0, "a"),  # nothing in hand, but it wins so much more often
    ],
)
def test_the_race_goes_on_without_throws_that_do_not_stand(
    monkeypatch: pytest.MonkeyPatch, told: dict, time_budget: float, planned: str
) -> None:
    """Two throws are verified at once."""
    work = hardened(monkeypatch, time_budget, **told)
    assert getattr(work.best[0], "name", work.best[0]) == planned


def test_a_throw_with_something_in_hand_is_planned_if_it_wins_nearly_as_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Race, "wins", (16, 12, 8))
    assert hardened(monkeypatch, a=LOOSE).best[0].name == "b"  # type: ignore[union-attr]


@pytest.mark.parametrize(("told", "verified"), [({"a": LOOSE}, "ab"), ({"a": FAILS, "b": FAILS}, "abc")])
def test_what_cannot_be_the_plan_is_not_verified(monkeypatch: pytest.MonkeyPatch, told: dict, verified: str) -> None:
    monkeypatch.setattr(Race, "wins", (16, 9, 8))  # of 16; what has nothing in hand counts as 5 fewer
    told = told | {"b": FAILS, "c": FAILS}
    assert "".join(one.throw.name for one in hardened(monkeypatch, **told).checked) == verified  # type: ignore[attr-defined]


def test_what_was_verified_before_the_race_is_not_verified_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    go, outcomes = Race.run, cast_planner.CastPlanner.outcomes

    def first(self: Race, until: float, report: object) -> None:
        asked.append("go " + " ".join(one.candidate.throw.name for one in self.order))  # type: ignore[attr-defined]
        go(self, until, report)

    def told(self: cast_planner.CastPlanner, some: list) -> object:
        asked.append("verify " + " ".join(one.throw.name for one in some))
        return outcomes(self, some)

    monkeypatch.setattr(Race, "run", first)
    monkeypatch.setattr(cast_planner.CastPlanner, "outcomes", told)
    init = cast_planner.CastPlanner.__init__

    def begun(self: cast_planner.CastPlanner, search: ThrowSearch, *more: object, **how: object) -> None:
        init(self, search, *more, **how)  # type: ignore[arg-type]
        failed = SimpleNamespace(success=False, turns=1.0, completed=True)
        late = SimpleNamespace(success=False, turns=0.0, completed=False)
        self.verified = [(search.candidates[0].throw, failed, None), (search.candidates[1].throw, late, None)]  # type: ignore[list-item]

    monkeypatch.setattr(cast_planner.CastPlanner, "__init__", begun)
    assert hardened(monkeypatch).best[0].name == "b"  # type: ignore[union-attr]
    assert asked == ["go b c", "verify b c", "go b c"]  # the one that failed is not refined; the one not told is tried


def test_while_there_is_time_one_throw_is_verified_that_is_much_better_than_those_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limits: list[float] = []

    def run(self: Race, until: float, report: object) -> None:
        """At first c is the best; then a wins more often, which takes all the time."""
        limits.append(until)
        self.order.sort(key=lambda one: one.candidate.throw.name != "ca"[min(len(limits), 2) - 1])  # type: ignore[attr-defined]
        self.left = (lambda: 9.0) if len(limits) == 1 else lambda: 0.0

    monkeypatch.setattr(Race, "run", run)
    work = hardened(monkeypatch)
    assert "".join(one.throw.name for one in work.checked) == "ca"  # type: ignore[attr-defined]
    doubted = [0.0, 8.0 / (16.0 + DOUBT), 16.0 / (16.0 + DOUBT)]  # of none, of c and of a, which win in 8 and in 16
    assert limits == pytest.approx([each + EARLY_GAIN for each in doubted])


def test_a_throw_is_compared_with_what_is_known_of_others_after_the_refinement(monkeypatch: pytest.MonkeyPatch) -> None:
    """In more scenarios a, which is known to stand, wins less often than b, which has not been verified."""
    rounds: list[str] = []

    def run(self: Race, until: float, report: object) -> None:
        rounds.append("".join(one.candidate.throw.name for one in self.order))  # type: ignore[attr-defined]
        if len(rounds) == 1:
            self.left = lambda: 9.0
            return
        self.left = lambda: 0.0
        a, b, c = sorted(self.order, key=lambda one: one.candidate.throw.name)  # type: ignore[attr-defined]
        a.values, b.values = [float(m < 8) for m in range(16)], [float(m < 12) for m in range(16)]
        self.order = [b, a, c]

    monkeypatch.setattr(Race, "run", run)
    assert hardened(monkeypatch).best[0].name == "b"  # type: ignore[union-attr]


def test_a_throw_without_a_margin_is_refined_on_until_no_time_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    refined: list[str] = []

    def run(self: Race, until: float, report: object) -> None:
        refined.append("".join(one.candidate.throw.name for one in self.order))  # type: ignore[attr-defined]
        self.left = (lambda: 9.0) if len(refined) == 1 else lambda: 0.0

    monkeypatch.setattr(Race, "run", run)
    assert hardened(monkeypatch, a=LOOSE).best[0].name == "a"  # type: ignore[union-attr]
    assert refined[:3] == ["abc", "abc", "bc"]  # verified after the first, dropped after the second


@pytest.mark.parametrize(("ends", "heard"), [(False, "ca"), (True, "c")])
def test_each_better_robust_plan_is_told_and_may_end_the_search(
    monkeypatch: pytest.MonkeyPatch, ends: bool, heard: str
) -> None:
    """Of the throws c is verified first, while there is time, then a, which wins more often."""
    told: list[str] = []
    orders = iter(("cab", "acb", "acb"))

    def run(self: Race, until: float, report: object) -> None:
        order = next(orders)
        self.order.sort(key=lambda one: order.index(one.candidate.throw.name))  # type: ignore[attr-defined]
        self.left = (lambda: 9.0) if order == "cab" else lambda: 0.0

    def hear(work: cast_planner.CastPlanner) -> bool:
        told.append(work.best[0].name)  # type: ignore[union-attr]
        return ends

    monkeypatch.setattr(Race, "run", run)
    work = hardened(monkeypatch, hear=hear)
    assert told == list(heard)
    assert work.best[0].name == told[-1]  # type: ignore[union-attr]
    assert work.ended == ends


def test_a_second_interrupt_keeps_what_was_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 0
    go = Race.run

    def broken_off(self: Race, until: float, report: object) -> None:
        nonlocal count
        count += 1
        go(self, until, report)
        if count == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(Race, "run", broken_off)
    best: list[object] = []
    harden = robust_phase.refine_robustly

    def caught(self: cast_planner.CastPlanner, *more: object) -> None:
        with pytest.raises(KeyboardInterrupt):
            harden(self, *more)  # type: ignore[arg-type]
        best.append(self.best[0])

    monkeypatch.setattr(robust_phase, "refine_robustly", caught)
    hardened(monkeypatch, a=FAILS)
    assert best[0].name == "b"  # type: ignore[attr-defined]


def test_an_interrupt_while_robust_throws_are_verified_leaves_the_best_until_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    landed = cast_planner.Candidate(1.0, 2.0, 1, np.zeros(3), "nominal")  # type: ignore[arg-type]

    def go(self: cast_planner.CastPlanner, report: object) -> None:
        self.best = ("nominal", SimpleNamespace(success=True, turns=2.0, slip=1e-3, message=""), None)  # type: ignore[assignment]

    def verified(self: cast_planner.CastPlanner, found: cast_planner.Candidate) -> object:
        raise KeyboardInterrupt

    def race(self: robust_phase.RobustRefinement, found: list, seeded: list) -> None:
        self.order = [robust_phase.RobustCandidate(landed, values=16 * [1.0])]

    monkeypatch.setattr(cast_planner.CastPlanner, "run", go)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify", verified)
    monkeypatch.setattr(robust_phase.RobustRefinement, "halve", race)
    monkeypatch.setattr(robust_phase.RobustRefinement, "run", no_generation)
    found = left_by(lambda: hf.plan_cast(CABLE, ARM, EASY, uncertainty=Uncertainty()))
    assert found.interrupted
    assert (found.throw, found.success_probability) == ("nominal", None)


@pytest.mark.parametrize(
    ("first", "second", "enough"),
    [
        ({}, {}, True),
        ({"turns": 1.54}, {"turns": 1.36}, False),  # and 1.25 are asked: more of a difference than is to spare
        ({"turns": 1.41}, {"turns": 1.38}, True),
        ({"turns": 1.34}, {"turns": 1.34}, False),  # hardly more than are asked
        ({"slip": 3e-3}, {}, False),  # 5 mm are allowed
        # on top of the peg, from where it may fall to either side
        ({"turns": 2.2}, {"turns": 2.2, "tip_hangs": False}, False),
        (
            {"turns": 2.3},
            {"turns": 2.3, "tip_hangs": False},
            True,
        ),  # a turn more than are needed is left then
        ({"folded": True}, {}, False),  # flat: what a real rope does then is left to chance
        ({"spare_clearance": 1e-3}, {}, False),  # with shorter links it may go through its arm
        ({}, {"load_ratio": 1.2}, False),  # pulled with more than the capstan equation lets it bear
        ({}, {"contact_angle": 5.0}, False),  # the rope is long enough for a full turn of contact
        ({}, {"turns": 1.3}, False),  # one turn fewer with finer links: left to chance
        ({}, {"success": False}, False),
    ],
)
def test_the_search_goes_on_while_the_best_has_nothing_in_hand(first: dict, second: dict, enough: bool) -> None:
    search = SimpleNamespace(problem=Problem(CABLE, ARM, hf.MotorLimits()), peg=EASY, candidates=[])
    work = cast_planner.CastPlanner(search, 1.0)  # type: ignore[arg-type]
    good = {
        "success": True,
        "turns": 2.3,
        "slip": 1e-3,
        "load_ratio": 0.8,
        "tip_hangs": True,
        "spare_clearance": 0.1,
        "touch_time": 5.0,
        "folded": False,
        "contact_angle": 11.0,
    }
    pair = [SimpleNamespace(**(good | change)) for change in (first, second)]
    work.best = ("a throw", *pair)  # type: ignore[assignment]
    assert work.done() is enough


def test_while_a_better_plan_is_sought_it_is_said_that_one_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    search, told = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY), []
    work = cast_planner.CastPlanner(search, 1e3)
    good = {
        "success": True,
        "turns": 2.3,
        "slip": 3e-3,
        "load_ratio": 0.8,
        "tip_hangs": True,
        "spare_clearance": 0.1,
        "touch_time": 5.0,
        "folded": False,
        "contact_angle": 11.0,
    }
    stands = SimpleNamespace(**good)

    def swing(self: cast_planner.CastPlanner) -> float:
        search.runs += 1
        if search.runs == 2:
            self.best = ("a throw", stands, stands)  # type: ignore[assignment]
        stands.slip = 3e-3 if search.runs < 4 else 1e-3
        return 1.0

    monkeypatch.setattr(cast_planner.CastPlanner, "swing", swing)
    monkeypatch.setattr(ThrowSearch, "try_last_moves", lambda self, **_: None)
    work.run(lambda spent, words: told.append(words))
    assert told == ["planning", *3 * [cast_planner.STANDS]]


def pass_time_in_swings(monkeypatch: pytest.MonkeyPatch, clock: SimpleNamespace, began: list[float]) -> None:
    """Let a planner make free swings alone, of a second each, and tell when its search begins anew."""

    def swing(self: cast_planner.CastPlanner) -> float:
        clock.spent += 1.0
        return 0.0

    monkeypatch.setattr(cast_planner.CastPlanner, "swing", swing)
    monkeypatch.setattr(cast_planner.CastPlanner, "contact_due", lambda *_: False)
    monkeypatch.setattr(ThrowSearch, "begin_anew", lambda self: began.append(clock.spent))


def test_a_search_with_a_plan_does_not_begin_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(spent=0.0)
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY)
    work, began = cast_planner.CastPlanner(search, 100.0, clock=clock, enough=np.inf), []  # type: ignore[arg-type]
    pass_time_in_swings(monkeypatch, clock, began)
    good = SimpleNamespace(success=True, turns=2.3, slip=3e-3, load_ratio=0.8, tip_hangs=True, spare_clearance=1.0)
    good.folded, good.contact_angle = False, 11.0
    work.best = ("a throw", good, good)  # type: ignore[assignment]
    work.run(None)
    assert not began


def test_a_search_that_begins_anew_forgets_what_it_found_and_draws_other_numbers() -> None:
    """But for the number of runs; the best candidates are taken back when it is over."""
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=1)
    swings: list[list[np.ndarray]] = []
    found = []
    for _ in range(2):
        search.beam_search(0.1)
        search.try_last_moves()
        swings.append([one.x for one in search.swings])
        found.append(search.candidates[0])
        runs = search.runs
        search.begin_anew()
        assert search.runs == runs > 0
        assert (search.swings, search.candidates, search.climbing) == ([], [], False)
        search.swings = [Swing(1.0, 1, swings[-1][0], 5.0)]
        assert search.untried(0.0)  # again
        search.swings.clear()
    assert not any(np.array_equal(x, y) for x in swings[0] for y in swings[1])
    search.remember()
    assert all(any(one.x is each.x for each in search.candidates) for one in found)
    scores = [one.score for one in search.candidates]
    assert scores == sorted(scores, reverse=True)


def test_where_ropes_may_fold_flat_all_swings_are_tried_again() -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=1)
    search.beam_search(0.1)
    search.swings = search.swings[:1]
    search.try_last_moves()
    for allow, again in ((False, False), (True, True)):
        search.allow_folding(allow)
        assert search.untried(-np.inf) is again
    search.try_last_moves()
    search.allow_folding(True)
    assert not search.untried(-np.inf)


@pytest.mark.parametrize(("longer", "times"), [(1.0, [16.0, 32.0, 48.0, 64.0]), (1.5, [34.0]), (2.2, [])])
def test_a_search_for_a_later_strike_begins_anew_later(
    monkeypatch: pytest.MonkeyPatch, longer: float, times: list[float]
) -> None:
    """By the square of the time until the strike, over the usual one."""
    clock, usual = SimpleNamespace(spent=0.0), Problem(CABLE, ARM, hf.MotorLimits())
    search, began = ThrowSearch(replace(usual, time=longer * usual.time), EASY), []
    pass_time_in_swings(monkeypatch, clock, began)
    cast_planner.CastPlanner(search, 100.0, clock=clock, enough=np.inf).run(None)  # type: ignore[arg-type]
    assert began == times


@pytest.mark.parametrize(("spent", "enough"), [(3.7, False), (3.8, True)])
def test_a_full_turn_that_nobody_asked_for_is_sought_for_a_quarter_more_than_the_first_plan_took(
    spent: float, enough: bool
) -> None:
    search = SimpleNamespace(problem=Problem(CABLE, ARM, hf.MotorLimits()), peg=EASY, candidates=[])
    work = cast_planner.CastPlanner(search, 60.0, clock=SimpleNamespace(spent=spent))  # type: ignore[arg-type]
    cast = SimpleNamespace(
        success=True,
        turns=1.3,
        slip=1e-3,
        load_ratio=0.8,
        tip_hangs=True,
        spare_clearance=0.1,
        touch_time=5.0,
        folded=False,
        contact_angle=3.0,
    )
    work.best, work.first = ("a throw", cast, cast), 3.0  # type: ignore[assignment]
    assert work.done() is enough
    cast.slip = 3e-3  # nothing in hand: sought as long, or until a time that is given
    assert work.done() is enough
    work.enough = np.inf
    assert not work.done()


def test_a_plan_that_stands_ends_a_search_at_the_time_that_is_enough() -> None:
    work = cast_planner.CastPlanner(ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY), 50.0, enough=30.0)
    assert work.until == np.inf  # while none stands
    for first, until in ((10.0, 30.0), (40.0, 40.0)):
        work.first = first
        assert work.until == until
    work.enough = None
    assert work.until == cast_planner.BETTER * 40.0


@pytest.mark.parametrize("ends", [False, True])
def test_each_better_plan_that_stands_is_told_and_may_end_the_search(
    monkeypatch: pytest.MonkeyPatch, ends: bool
) -> None:
    landed = [cast_planner.Candidate(1.0, 2.0, 1, np.full(3, float(k)), f"throw {k}") for k in range(4)]  # type: ignore[arg-type]
    turns = {"throw 0": 0.4, "throw 1": 1.4, "throw 2": 1.3, "throw 3": 1.6}
    heard: list[object] = []

    def verified(self: cast_planner.CastPlanner, found: cast_planner.Candidate) -> object:
        told = {
            "slip": 3e-3,
            "load_ratio": 0.5,
            "tip_hangs": True,
            "spare_clearance": 0.1,
            "touch_time": 5.0,
            "folded": False,
            "contact_angle": 3.0,
            "message": "",
        }
        cast = SimpleNamespace(success=turns[found.throw] > 1.0, turns=turns[found.throw], **told)  # type: ignore[index]
        return cast, cast

    def go(self: cast_planner.CastPlanner, report: object) -> None:
        for one in landed:
            if not self.done():
                self.check([one])

    def on_plan(plan: hf.CastPlan) -> bool:
        heard.append(plan.throw)
        return ends

    monkeypatch.setattr(cast_planner.CastPlanner, "run", go)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify", verified)
    monkeypatch.setattr(casting, "Clock", lambda: SimpleNamespace(spent=1.0))
    plan = hf.plan_cast(CABLE, ARM, EASY, on_plan=on_plan)
    assert heard == (["throw 1"] if ends else ["throw 1", "throw 3"])
    assert (plan.throw, plan.success) == (heard[-1], True)


def test_the_best_of_the_throws_that_two_verifications_bear_out_without_a_margin_is_verified_further(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The one whose verification ends sooner, where none has a margin; not those that fail."""
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=8)
    throws = [SimpleNamespace(name=name, count=2) for name in "abcd"]
    points = [np.full(2 * search.parametrizations[1].strokes + 4, float(k)) for k in range(4)]
    search.candidates = [
        cast_planner.Candidate(3.0, 2.0, 1, x, throw, confirmed=True)  # type: ignore[arg-type]
        for x, throw in zip(points, throws, strict=True)
    ]
    told = {"a": {"turns": 3.0}, "b": {"success": False}, "c": {"turns": 3.5}, "d": {"turns": 2.5}}
    asked: list[str] = []

    def twice(self: cast_planner.CastPlanner, found: cast_planner.Candidate) -> object:
        good = {
            "success": True,
            "slip": 1e-3,
            "load_ratio": 1.5,
            "tip_hangs": True,
            "touch_time": 5.0,
            "folded": False,
            "spare_clearance": 1.0,
        }
        seen = SimpleNamespace(**(good | {"turns": 2.0, "contact_angle": 9.0} | told[found.throw.name]))  # type: ignore[attr-defined]
        return seen, seen if seen.success else None

    def verified(self: cast_planner.CastPlanner, found: cast_planner.Candidate, seen: object) -> object:
        asked.append(found.throw.name)  # type: ignore[attr-defined]
        return seen[1], SimpleNamespace(**(vars(seen[2]) | {"success": False, "turns": 0.3}))  # type: ignore[index]

    monkeypatch.setattr(cast_planner.CastPlanner, "verify_twice", twice)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify", verified)
    spent = SimpleNamespace(spent=0.0)
    work = cast_planner.CastPlanner(search, 60.0, clock=spent)  # type: ignore[arg-type]
    work.verify_new()
    assert asked == []  # at first another with a margin is looked for
    spent.spent = 10.0
    for _ in range(3):
        work.verify_new()
    assert asked == ["d", "a", "c"]
    assert {one.throw.name for one in work.checked} == set("abcd")  # type: ignore[attr-defined]
    told |= {"e": {"load_ratio": 0.5}}
    fifth = search.candidates[0]._replace(
        score=3.0, x=np.full(points[0].size, 9.0), throw=SimpleNamespace(name="e", count=2)
    )
    search.candidates = [fifth]
    work.verify_new()
    assert (work.best[0].name, work.done()) == ("e", True)  # type: ignore[union-attr] # a margin in two is enough
    assert asked == ["d", "a", "c"]


@pytest.mark.parametrize(("touch", "holds"), [(5.04, True), (5.3, False), (4.7, False)])
def test_a_throw_that_touches_at_another_time_with_shorter_links_does_not_stand(
    monkeypatch: pytest.MonkeyPatch, touch: float, holds: bool
) -> None:
    first = planned().outcome
    assert first is not None
    first = replace(first, touch_time=5.0)
    finer = foreseen(first, replace(first, touch_time=touch))
    assert finer.success is holds
    assert holds or ("sooner" if touch < 5.0 else "later") in failure(first, finer, False)
    search, seen = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY), [first, replace(first, touch_time=touch)]
    work = cast_planner.CastPlanner(search, 60.0)
    monkeypatch.setattr(work, "run_once", lambda problem, *_: seen[problem.rope.n_links > CABLE.n_links])
    _, second = work.verify_twice(cast_planner.Candidate(2.0, 2.0, 1, np.zeros(3), None))  # type: ignore[arg-type]
    assert second is not None
    assert second.success is holds


@pytest.mark.parametrize(
    ("given", "shorter", "holds"),
    [(3.3, 1.3, False), (3.3, 2.0, True), (0.2, 5.5, False), (0.1, 0.16, True), (92.7, 29.5, True)],
)
def test_a_throw_that_passes_its_arm_by_less_than_two_runs_differ_does_not_stand(
    given: float, shorter: float, holds: bool
) -> None:
    """All in mm, beyond the distance asked."""
    first = planned().outcome
    assert first is not None
    first = replace(first, spare_clearance=1e-3 * given)
    finer = foreseen(first, replace(first, spare_clearance=1e-3 * shorter))
    assert finer.success is holds
    assert holds or f"with {shorter:.1f} mm to spare, not {given:.1f} mm" in failure(first, finer, False)


def test_what_may_be_passed_closely_leaves_nothing_to_chance() -> None:
    """An arm that the rope may go through is near, or inside it; obstacles are looked at on their own."""
    arm, far, narrow = (Clearance(value, 1.0, "") for value in (5e-4, 0.2, 1e-3))
    free = Problem(CABLE, ARM, hf.MotorLimits(), clearance=-np.inf)
    assert spare_clearance(free, (arm,)) == np.inf
    assert spare_clearance(free, (arm._replace(value=-0.01), narrow)) == 1e-3
    asked = replace(free, clearance=0.03)
    assert spare_clearance(asked, (arm._replace(value=0.031), far)) == pytest.approx(1e-3)
    outcome = planned().outcome
    assert outcome is not None
    close = [replace(outcome, clearance=each, spare_clearance=np.inf) for each in (1e-3, 6e-3)]
    assert foreseen(*close).success
    asked = Asked(free.turns)
    assert steady(close[0], asked) is steady(outcome, asked) is True


def test_a_throw_without_a_margin_is_simulated_once_with_links_of_each_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its first two runs are not made again where a third tells whether it stands."""
    outcome = planned().outcome
    assert outcome is not None
    work = cast_planner.CastPlanner(ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY), 60.0)
    links: list[int] = []

    def run_once(problem: Problem, *_: object) -> object:
        links.append(problem.rope.n_links)
        return replace(outcome, slip=3e-3, tip_hangs=True)

    monkeypatch.setattr(work, "run_once", run_once)
    one = cast_planner.Candidate(2.0, 2.0, 1, np.zeros(3), None)  # type: ignore[arg-type]
    first, second = work.verify_twice(one)
    assert not with_margin((None, first, second), work.asked)
    assert succeeds((None, *work.verify(one, (None, first, second))))
    assert sorted(links) == [CABLE.n_links, 2 * CABLE.n_links, 3 * CABLE.n_links]


def test_where_no_plan_stands_a_throw_without_a_margin_is_verified_before_others_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=2)
    size = 2 * search.parametrizations[1].strokes + 4
    search.candidates = [
        cast_planner.Candidate(3.0 - k, 2.0, 1, np.full(size, float(k)), SimpleNamespace(name=name, count=2), True)  # type: ignore[arg-type]
        for k, name in enumerate("ab")
    ]
    outcome = planned().outcome
    assert outcome is not None
    outcome, asked = replace(outcome, slip=3e-3), []

    def twice(found: cast_planner.Candidate) -> object:
        asked.append(f"look at {found.throw.name}")  # type: ignore[attr-defined]
        return outcome, outcome

    def verify(found: cast_planner.Candidate, seen: object) -> object:
        asked.append(f"verify {found.throw.name}")  # type: ignore[attr-defined]
        return outcome, replace(outcome, message="it slips")

    work = cast_planner.CastPlanner(search, 60.0, clock=SimpleNamespace(spent=10.0))  # type: ignore[arg-type]
    monkeypatch.setattr(work, "verify_twice", twice)
    monkeypatch.setattr(work, "verify", verify)
    work.verify_new()
    assert asked[:3] == ["look at a", "verify a", "look at b"]


def test_throws_that_barely_wind_are_verified_later() -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=20)
    x, throw = np.zeros(2 * search.parametrizations[1].strokes + 4), SimpleNamespace(count=2)
    told = [(2.6, 2.3), (1.6, 1.3), (1.4, 1.4), (1.1, 2.0), (0.9, 2.0)]  # score, turns
    search.candidates = [
        cast_planner.Candidate(score, turns, 1, x + k, throw, confirmed=True)  # type: ignore[arg-type]
        for k, (score, turns) in enumerate(told)
    ]
    spent = SimpleNamespace(spent=0.0)
    work = cast_planner.CastPlanner(search, 60.0, clock=spent)  # type: ignore[arg-type]
    assert [one.x[0] for one in work.fresh()] == [0.0, 1.0, 2.0]  # given throws
    search.swings = [Swing(1.0, 1, x, 5.0)]
    for time, count in ((0.0, 1), (4.0, 3), (31.0, 4)):
        spent.spent = time
        assert [one.x[0] for one in work.fresh()] == list(range(count))


def test_of_two_throws_the_one_that_more_verifications_bear_out_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    search = SimpleNamespace(
        problem=Problem(CABLE, ARM, hf.MotorLimits()),
        peg=EASY,
        holding_force=0.0,
        workers=2,
        correct=lambda *_: None,
    )
    work = cast_planner.CastPlanner(search, 1.0)  # type: ignore[arg-type]
    ends = {"slips": [(False, 3.2)], "stands": [(True, 1.4), (True, 1.4)], "once": [(True, 2.3), (False, 2.3)]}
    casts: list[object] = []

    def verify_cast(*_: object, **__: object) -> object:
        success, turns = casts.pop(0) if len(casts) > 1 else casts[0]  # type: ignore[misc]
        told = {
            "slip": 0.0,
            "load_ratio": 0.5,
            "tip_hangs": True,
            "spare_clearance": 0.1,
            "touch_time": 5.0,
            "folded": False,
            "contact_angle": 7.0,
            "completed": True,
        }
        return SimpleNamespace(success=success, turns=turns, **told)

    monkeypatch.setattr(cast_planner, "verify_cast", verify_cast)
    kept = []
    for name in ("slips", "once", "slips", "stands", "slips", "once"):
        casts[:] = ends[name]
        throw = SimpleNamespace(name=name, motion=lambda limits: None)
        work.check([cast_planner.Candidate(1.0, 2.0, 1, np.zeros(3), throw)])  # type: ignore[arg-type]
        kept.append(work.best[0].name)  # type: ignore[union-attr]
    assert kept == ["slips", "once", "once", "stands", "stands", "stands"]
    assert work.done()


@pytest.mark.parametrize(
    ("scores", "late", "worth"),
    [([], False, False), ([0.5], False, True), ([0.5], True, False), ([1.0], True, True)],
)
def test_poor_throws_are_refined_only_where_swings_do_not_lack_time(
    scores: list[float], late: bool, worth: bool
) -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY)
    search.candidates = [cast_planner.Candidate(score, 1.0, 1, np.zeros(3), None) for score in scores]  # type: ignore[arg-type]
    assert cast_planner.CastPlanner(search, 60.0).worth_refining(late) is worth


@pytest.mark.parametrize(
    ("threads", "ends", "told", "most"),
    [
        *((threads, [1.6, 1.5, 1.6, 1.8], 1.8, 5) for threads in (1, 2)),  # the one that differs most
        (1, [1.6, 1.7, 1.0, 1.6], 1.0, 3),  # one turn fewer: it fails
        (2, [1.6, 1.7, 1.0, 1.6], 1.0, None),  # the last, beside it, may have begun
        (1, [1.6, 1.5, None, 1.6], 0.0, 3),  # no time for the third, and so for the last
        *(
            (threads, [1.6, 1.5, 1.6, None], 0.0, 5) for threads in (1, 2)
        ),  # none for the last, which an end on top of the peg needs
        (1, [1.6, None, 1.5, 1.5], 0.0, 3),
        (1, [1.6, 0.4, 1.5, 1.5], 0.4, 3),  # the first that fails
        (1, [2.4, 1.0, 2.5, 1.0], 2.5, 3),  # an end that falls loses a turn at most, and enough are left
    ],
)
def test_a_throw_that_ends_on_top_of_the_peg_is_verified_with_shorter_and_shorter_links(
    monkeypatch: pytest.MonkeyPatch, threads: int, ends: list[float | None], told: float, most: int | None
) -> None:
    search, links = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=threads), set()

    def verify_cast(problem: Problem, *_: object, time_budget: Deadline, **__: object) -> object:
        pieces, ended = problem.rope.n_links // CABLE.n_links, time_budget.left() < 0.0
        links.update(() if ended else (pieces,))
        turns = None if ended else ends[min(pieces, 4) - 1]
        success, completed = turns is not None and turns > 1.25, turns is not None
        more = {
            "slip": 1e-3,
            "load_ratio": 0.5,
            "contact_angle": 3.0,
            "tip_hangs": False,
            "spare_clearance": 0.1,
            "touch_time": 5.0,
            "folded": False,
        }
        return SimpleNamespace(success=success, turns=turns or 0.0, completed=completed, **more)

    monkeypatch.setattr(cast_planner, "verify_cast", verify_cast)
    throw = SimpleNamespace(motion=lambda limits: None)
    _, finer = cast_planner.CastPlanner(search, 60.0).verify(cast_planner.Candidate(1.0, 2.0, 1, np.zeros(3), throw))  # type: ignore[arg-type]
    assert finer is not None
    assert finer.turns == told
    assert max(links) == (most or max(links))


def test_a_throw_without_a_margin_fails_where_its_third_verification_takes_too_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def verify_cast(problem: Problem, *_: object, **__: object) -> object:
        completed = problem.rope.n_links // CABLE.n_links != 2
        told = {"slip": 3e-3, "load_ratio": 0.5, "contact_angle": 3.0, "tip_hangs": True, "spare_clearance": 0.1}
        more = told | {"touch_time": 5.0, "folded": False, "message": "" if completed else TOO_LONG}
        return SimpleNamespace(success=completed, turns=1.6 if completed else 0.0, completed=completed, **more)

    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY)
    monkeypatch.setattr(cast_planner, "verify_cast", verify_cast)
    throw = SimpleNamespace(motion=lambda limits: None)
    found = cast_planner.CastPlanner(search, 60.0).verify(cast_planner.Candidate(1.0, 2.0, 1, np.zeros(3), throw))  # type: ignore[arg-type]
    assert failure(*found, False) == f"with shorter links {TOO_LONG}"


def test_of_candidates_verified_at_once_none_is_told_after_the_search_was_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    some = [cast_planner.Candidate(1.0, 2.0, 1, np.full(3, float(k)), f"throw {k}") for k in range(2)]  # type: ignore[arg-type]
    told = {"slip": 1e-3, "load_ratio": 0.5, "contact_angle": 3.0, "tip_hangs": True, "spare_clearance": 0.1}
    more = told | {"touch_time": 5.0, "folded": False, "success": True, "completed": True, "message": ""}
    work = cast_planner.CastPlanner(ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=4), 60.0)

    def verify_twice(one: cast_planner.Candidate) -> object:
        cast = SimpleNamespace(turns=1.5 + one.x[0], **more)
        return cast, cast

    heard: list[object] = []

    def hear() -> bool:
        heard.append(work.best[0])
        return len(heard) == 1

    monkeypatch.setattr(work, "verify_twice", verify_twice)
    work.hear = hear
    work.look(some)
    assert (heard, work.best[0], work.done()) == (["throw 0"], "throw 0", True)
    work.tell()
    assert work.done()


def test_what_is_in_reach_is_asked_for_the_time_that_the_search_takes() -> None:
    """A short arm swings a rope up in more than five periods."""
    high = hf.Peg(1.2 * np.sin(np.radians(80.0)), -1.2 * np.cos(np.radians(80.0)), 0.03)
    short = hf.Arm(length=0.04)
    assert not check_feasibility(Problem(CABLE, short, hf.MotorLimits()), high).feasible
    plan = hf.plan_cast(CABLE, short, high, time_budget=1e-3)
    assert plan.feasibility == check_feasibility(plan.problem, high)
    assert plan.feasibility.feasible
    assert "out of reach" not in plan.message


def test_a_throw_that_a_verification_refutes_leads_the_search_no_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=2)
    motion, strokes = SimpleNamespace(motion=lambda limits: None, count=2), search.parametrizations[1].strokes
    points = [np.full(2 * strokes + 4, float(k)) for k in range(3)]
    search.candidates = [
        cast_planner.Candidate(3.0 - k, 2.0, 1, x, motion, confirmed=True) for k, x in enumerate(points)
    ]  # type: ignore[arg-type]
    second, third = search.candidates[1:]
    work = cast_planner.CastPlanner(search, 1.0)
    failed = SimpleNamespace(
        success=False,
        turns=0.4,
        slip=np.nan,
        load_ratio=np.nan,
        tip_hangs=True,
        spare_clearance=0.1,
        touch_time=5.0,
        folded=False,
        completed=True,
    )
    monkeypatch.setattr(cast_planner, "verify_cast", lambda *_, **__: failed)
    assert work.fresh() == search.candidates[:1]  # one for two threads
    unsure = [one._replace(confirmed=k > 0) for k, one in enumerate(search.candidates)]
    monkeypatch.setattr(search, "candidates", unsure)
    assert work.fresh() == unsure[1:2]  # throws that were run with shorter links
    monkeypatch.undo()
    monkeypatch.setattr(cast_planner, "verify_cast", lambda *_, **__: failed)
    work.check(search.candidates[:1])
    assert search.candidates[0] is second
    assert search.candidates[1] is third
    assert (search.candidates[2].turns, search.candidates[2].score < third.score) == (0.4, True)
    assert [one.x[0] for one in work.fresh()] == [1.0]


def test_a_high_target_gets_time_to_swing_the_rope_up_to_it_unless_the_user_says_how_long() -> None:
    """A target above the shaft needs more strokes than five periods have, one below it does not."""
    usual, high = Problem(CABLE, ARM, hf.MotorLimits()).time, hf.Peg(1.1, 0.5, 0.03)
    asked = {"time_budget": 1e-3, "skip_feasibility": True}
    assert hf.plan_cast(CABLE, ARM, high, **asked).problem.time > 1.4 * usual
    assert hf.plan_cast(CABLE, ARM, hf.Peg(0.05, -1.3, 0.03), **asked).problem.time == usual
    assert hf.plan_cast(CABLE, ARM, high, time_limit=6.0, **asked).problem.time == 6.0
    slow = hf.MotorLimits(speed=0.05, acceleration=0.1)
    assert hf.plan_cast(CABLE, ARM, high, slow, **asked).problem.time == pytest.approx(11.0 / 5.0 * usual)


def test_other_directions_of_gravity_are_refused() -> None:
    with pytest.raises(InvalidInput, match="gravity along -y"):
        hf.plan_cast(CABLE.replace(gravity=(9.81, 0.0)), ARM, hf.Peg(1.1, 0.5, 0.03))


def test_sides_are_those_from_which_the_motor_can_begin() -> None:
    """A rope that hangs from the arm at half a radian, not at a quarter turn."""
    limits, arm = MotorLimits(angles=(-0.5, 0.5)), hf.Arm(length=0.5)
    who = Problem(CABLE, arm, limits)
    assert set(ThrowSearch(who, hf.Peg(0.5, -0.6, 0.03)).parametrizations) == {-1, 1}
    assert set(ThrowSearch(who, hf.Peg(0.5 * np.sin(0.5), -1.2, 0.03)).parametrizations) == {-1}


def test_rounds_of_swings_are_stroke_by_stroke_and_in_whole_by_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    work, made = cast_planner.CastPlanner(ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY), 60.0), []
    monkeypatch.setattr(ThrowSearch, "beam_search", lambda self, _: made.append("stroke by stroke") or 0.5)
    monkeypatch.setattr(ThrowSearch, "evolve_swings", lambda self: made.append("whole") or 0.7)
    assert [work.swing() for _ in range(4)] == [0.5, 0.5, 0.7, 0.5]
    whole = ["whole"] * cast_planner.GENERATIONS
    assert made == ["stroke by stroke", "stroke by stroke", *whole, "stroke by stroke"]


def test_many_swings_are_tried_with_a_few_last_moves_before_some_with_more(monkeypatch: pytest.MonkeyPatch) -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), hf.Peg(0.9, -0.4, 0.03), threads=1)
    x, tried = search.parametrizations[1].centre(), []
    search.swings = [Swing(1.0 - 0.1 * k, 1, x + 0.2 * k, 5.0) for k in range(TRIED + 1)]
    search.swings.append(Swing(-0.2, 1, x - 0.2, 5.0))  # with shorter links it does not strike

    def evaluate(points: list[tuple[int, np.ndarray]], until: float) -> None:
        assert until == 5.0 + LATER
        tried.append([(round((point[0] - x[0]) / 0.2), *point[-4:-1].tolist()) for _, point in points])

    monkeypatch.setattr(search, "evaluate", evaluate)
    for _ in range(4):
        assert search.untried(0.0) == (len(tried) < 2)
        search.try_last_moves()
    moves = [[(more, end, rest) for more, end, rest in some] for some in MOVES]
    assert tried[0] == [(k, *move) for k in range(TRIED) for move in moves[0]]
    assert tried[1] == [(TRIED, *move) for move in moves[0]]
    assert tried[2] == [(k, *move) for k in range(TRIED) for move in moves[1]]
    assert tried[3] == [(TRIED, *move) for move in moves[1]]
    for _ in range(99):
        search.try_last_moves()
    assert len(tried) == 2 * len(MOVES)
    assert {point[1:] for some in tried for point in some} == {move for some in moves for move in some}


def test_swings_that_were_tried_get_other_moves_though_there_are_fresh_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), hf.Peg(0.9, -0.4, 0.03), threads=1)
    x, tried = search.parametrizations[1].centre(), []
    monkeypatch.setattr(search, "evaluate", lambda points, until: tried.append([p[-4:-1].tolist() for _, p in points]))
    search.swings = [Swing(1.0, 1, x, 5.0)]
    search.try_last_moves()
    search.swings.append(Swing(0.9, 1, x + 0.2, 5.0))
    search.try_last_moves(fresh=False)
    assert tried == [list(map(list, MOVES[0])), list(map(list, MOVES[1]))]
    assert search.untried(0.0)


@pytest.mark.parametrize(("winds", "calls"), [(False, [True, False]), (True, [True])])
def test_other_moves_are_tried_while_no_throw_winds(
    winds: bool, calls: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=1)
    work, told = cast_planner.CastPlanner(search, 1e3), list[bool]()

    def tries(self: ThrowSearch, *, fresh: bool = True) -> None:
        told.append(fresh)
        if winds:
            self.candidates = [cast_planner.Candidate(0.5, 1.5, 1, np.zeros(3), None)]  # type: ignore[arg-type]

    monkeypatch.setattr(ThrowSearch, "try_last_moves", tries)
    monkeypatch.setattr(cast_planner.CastPlanner, "verify_new", lambda self: None)
    work.try_worthy()
    assert told == calls


def test_last_moves_end_towards_the_targets_side(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = {}
    for x in (-0.9, 0.9):
        search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), hf.Peg(x, -0.4, 0.03), threads=1)
        search.swings = [Swing(1.0, 1, search.parametrizations[1].centre(), 5.0)]
        monkeypatch.setattr(search, "evaluate", lambda points, until, x=x: ends.update({x: [p[-3] for _, p in points]}))
        search.try_last_moves()
    assert ends[-0.9] == [-end for end in ends[0.9]]


def test_where_no_throw_winds_shorter_links_are_tried() -> None:
    """With links as long as the peg is thick, throws that wind may seem not to."""
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=1)
    x = search.parametrizations[1].centre()
    search.swings = [Swing(1.0, 1, x + 0.2 * k, 5.0) for k in range(2 * TRIED)]
    links: list[int] = []

    def wind(problem: Problem, throws: list, struck: object) -> WindingScores:
        links.append(problem.rope.n_links)
        return WindingScores(np.zeros(len(throws)), np.full(len(throws), 0.3))

    found = strikes.Strikes(*np.zeros((3, 99)), np.full(99, 5.0), *np.zeros((2, 99, 1)), np.full(99, 9))
    search._wind, search._strikes = wind, lambda problem, throws, until: found  # type: ignore[method-assign,assignment]
    for _ in range(MAX_FAILED + 3):
        search.try_last_moves()
    assert links == MAX_FAILED * [CABLE.n_links] + 3 * [2 * CABLE.n_links]


@pytest.mark.parametrize(("strike", "tries"), [(0.9, 1), (0.2, 5)])
def test_late_swings_are_tried_beside_the_peg_once_they_are_worth_it(
    monkeypatch: pytest.MonkeyPatch, strike: float, tries: int
) -> None:
    """Those that strike early are tried at once."""
    search = ThrowSearch(Problem(CABLE, ARM, hf.MotorLimits()), EASY, threads=1)
    work, tried = cast_planner.CastPlanner(search, 1e3), list[float]()
    scores = [part * work.worthy for part in (0.62, 0.69, 0.75, 0.81, 1.0)]
    all_scores = scores.copy()

    def swing(self: cast_planner.CastPlanner) -> float:
        search.runs += 1
        search.swings[:] = [Swing(scores[0], 1, np.zeros(3), strike * search.problem.time)]
        return scores.pop(0)

    monkeypatch.setattr(cast_planner.CastPlanner, "swing", swing)

    def tries_best(self: ThrowSearch, *, fresh: bool = True) -> None:
        if not fresh:
            return
        tried.append(self.swings[0].score)
        self._tried = self.swings[:1]

    monkeypatch.setattr(ThrowSearch, "try_last_moves", tries_best)
    monkeypatch.setattr(cast_planner.CastPlanner, "done", lambda self: not scores)
    work.run(None)
    assert tried == all_scores[-tries:]
