"""Casts behind pegs: the rope's way from the arm to its target, strikes on these pegs, files, and a planned cast."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.cli.app import run
from hyperflex.cli.plan import Source
from hyperflex.errors import InvalidInput
from hyperflex.planning import Accuracy, Uncertainty, build_whip_map, check_feasibility, read_plan, verify_cast
from hyperflex.planning.clearance import way_gaps
from hyperflex.planning.outcome import evaluate_cast
from hyperflex.planning.rollouts import RolloutBatch, simulate_contact
from hyperflex.planning.verification import verified_setup
from hyperflex.report import CastReport
from hyperflex.winding import TOUCH
from tests.planning.known import CABLE, PEG, WINDS, planned, problem, simulated_strikes
from tests.refusals import refuses

CORD = hf.Rope.uniform(length=1.2, mass=0.06, n_links=30, radius=0.003, friction=2e-4)
ARM, TARGET, BEFORE = hf.Arm(length=0.2), hf.Peg(-0.5, -0.7, 0.03), hf.Peg(-0.25, -0.35, 0.03)

ROD = hf.Rope.uniform(length=1.0, mass=0.1, n_links=5, radius=0.01, friction=0.0)
STRAIGHT = np.zeros((3, 5)), np.zeros((3, 2))  # three samples of a rope that hangs straight down


def beside(down: float, gap: float = 0.0) -> hf.Peg:
    """Return a peg at the side of a rope that hangs straight down, `gap`, m, from its surface."""
    return hf.Peg(0.03 + ROD.radius + gap, -down, 0.03)


def laid(*pegs: hf.Peg, target: hf.Peg) -> tuple[bool, ...]:
    gaps = way_gaps(ROD, target, pegs, STRAIGHT[0], ROD.joints(*STRAIGHT))
    return tuple((gaps < TOUCH).all(axis=0).tolist())


def test_a_rope_runs_behind_what_it_touches_between_arm_and_target():
    assert laid(beside(0.3), target=beside(0.7)) == (True,)
    assert laid(beside(0.7), target=beside(0.3)) == (False,)  # beyond the target
    assert laid(beside(0.3, gap=0.001), target=beside(0.7)) == (False,)
    assert laid(beside(0.3), beside(0.5, gap=0.01), beside(0.1), target=beside(0.7)) == (True, False, True)
    assert laid(target=beside(0.7)) == ()


def test_the_place_along_the_rope_counts_within_a_link_too():
    assert laid(beside(0.45), target=beside(0.55)) == (True,)  # both beside the third link
    assert laid(beside(0.55), target=beside(0.45)) == (False,)


def test_a_touch_that_does_not_last_is_none():
    q = np.zeros((3, 5))
    q[1] = -0.01  # away from the peg
    joints = ROD.joints(q, np.zeros((3, 2)))
    gaps = way_gaps(ROD, beside(0.7), [beside(0.3)], q, joints)[:, 0]
    np.testing.assert_allclose(gaps[[0, 2]], 0.0, atol=1e-12)
    assert gaps[1] == pytest.approx(0.3 * 0.01, rel=0.2)  # where the target is not touched, the way ends at the tip


def test_a_cast_that_does_not_run_behind_a_peg_fails_and_reports_which():
    run = planned().run
    stop = float(planned().motion.breaks[-1])
    taut = run.joints[-1, 0] + 0.5 * (np.array([PEG.x, PEG.y]) - run.joints[-1, 0])
    lies = run.joints[-1][np.hypot(*(run.joints[-1] - taut).T).argmin()]
    for aside, behind in ((0.0, True), (0.1, False)):  # m; the rope sways by 1 cm
        peg = hf.Peg(float(lies[0]) + aside, float(lies[1]), 0.03)
        seen = evaluate_cast(replace(problem(), criteria=hf.WindCriteria(behind=[peg])), PEG, run, stop)
        assert seen.runs_behind == (behind,)
        assert seen.success == behind
        place = f"({peg.x:.4g}, {peg.y:.4g}) m"
        assert seen.message == ("" if behind else f"the rope does not run behind the peg at {place}")


def test_pegs_to_run_behind_are_simulated_and_links_cut_near_them():
    before = hf.Peg(-0.4, -0.5, 0.01)
    setup = verified_setup(replace(problem(), criteria=hf.WindCriteria(behind=[before])), hf.hold_arm(0.0), 1.0, (PEG,))
    assert setup.pegs == (PEG, before)
    assert setup.rope.n_links > verified_setup(problem(), hf.hold_arm(0.0), 1.0, (PEG,)).rope.n_links


def test_a_swing_strikes_the_peg_that_it_meets_first():
    free = simulated_strikes(problem(), PEG, [WINDS])
    before, never = hf.Peg(0.5 * PEG.x, 0.5 * PEG.y, 0.03), hf.Peg(0.0, 1.9, 0.03)
    alone = simulated_strikes(problem(), before, [WINDS])
    assert alone.t[0] < free.t[0]
    first = simulated_strikes(replace(problem(), criteria=hf.WindCriteria(behind=[before])), PEG, [WINDS])
    assert first.t[0] == alone.t[0]
    np.testing.assert_array_equal(first.q, alone.q)
    assert first.score[0] < alone.score[0]  # less rope is left for the target
    same = simulated_strikes(replace(problem(), criteria=hf.WindCriteria(behind=[never])), PEG, [WINDS])
    assert (same.t[0], same.score[0]) == (free.t[0], free.score[0])


def test_turns_of_a_throw_that_misses_a_peg_do_not_count():
    free = simulated_strikes(problem(), PEG, [WINDS])
    motion = WINDS.motion(problem().limits).shifted(-free.t[0])
    one = RolloutBatch([CABLE], [PEG], [motion], free.q, free.qd)
    loose = replace(problem(), clearance=-np.inf)
    on = simulate_contact(loose, one, free.t, Budget(threads=1))
    near, far = (
        simulate_contact(
            replace(loose, criteria=hf.WindCriteria(behind=[hf.Peg(0.3, y, 0.03)])), one, free.t, Budget(threads=1)
        )
        for y in (0.5, 1.5)
    )
    assert on.turns[0] >= 1.25
    assert far.turns[0] == near.turns[0] < 1.25
    assert 0.0 < far.score[0] < near.score[0] < on.score[0]


@pytest.mark.parametrize("asked", [("whip", "--target", -0.5, -0.7), ("insert", "--slot", -0.5, -0.7)])
def test_commands_that_do_not_know_these_pegs_refuse_them(asked, tmp_path, capsys):
    path = tmp_path / "setup.toml"
    path.write_text(hf.Setup(CORD, arm=ARM).dumps() + "\n[behind]\nx = -0.25\ny = -0.35\nradius = 0.03\n", "utf-8")
    assert run([str(each) for each in (*asked, path, "--output", tmp_path / "out")]) == 2
    assert "takes no pegs that the rope is to run behind" in " ".join(capsys.readouterr().err.split())


def test_pegs_to_run_behind_go_with_a_plan_through_its_files(tmp_path):
    pegs = (BEFORE, hf.Peg(-0.4, -0.5, 0.01, 0.2))
    obstacles = hf.Peg(1.2, -1.2, 0.2), hf.Wall(-1.6, -1.8, -1.3, -0.4), hf.Ground(0.0, -2.5, 0.3, 1.0)
    who = replace(problem(), criteria=hf.WindCriteria(behind=pegs), obstacles=obstacles)
    known = replace(planned(), problem=who, outcome=replace(planned().outcome, runs_behind=(True, False)))
    known.to_toml(tmp_path / "cast.toml")
    again = read_plan(tmp_path / "cast.toml")
    assert again.problem == known.problem
    assert again.outcome.runs_behind == (True, False)
    assert hf.Setup.from_toml(tmp_path / "cast.toml").pegs == (PEG, *pegs, *obstacles)
    task = Source(out=tmp_path, setup=tmp_path / "cast.toml", limits={}).read({}, {})
    assert (task.criteria.behind, task.targets["peg"]) == (pegs, PEG)
    assert task.conditions.obstacles == obstacles
    report = CastReport(known)
    story, said = " ".join(report.story), report.texts.text("setup")
    assert "it runs behind a peg at (-0.25, -0.35) m, radius 30 mm, and not behind a peg at (-0.4, -0.5) m" in story
    assert "on its way from the arm to the target: a peg at (-0.25, -0.35) m, radius" in said


def test_a_setup_file_tells_what_to_run_behind(tmp_path):
    path = tmp_path / "setup.toml"
    text = hf.Setup(CORD, arm=ARM, pegs=[TARGET]).dumps()
    path.write_text(text + "\n[behind]\nx = -0.25\ny = -0.35\nradius = 0.03\n", "utf-8")
    source = Source(out=tmp_path, setup=path, limits={})
    assert source.read({}, {}).criteria.behind == (BEFORE,)
    with pytest.warns(UserWarning, match="links of 40 mm near the peg"):
        assert hf.Setup.from_toml(path).pegs == (TARGET,)  # a run leaves it alone
    path.write_text(text + "\n[behind]\nx = -0.25\nspeed = 1.0\n", "utf-8")
    refuses("speed", source.read, {}, {})


def test_what_cannot_be_run_behind_is_refused():
    who = replace(problem(), criteria=hf.WindCriteria(behind=[BEFORE]))
    for each in (hf.Wall(-0.3, -0.3, -0.3, -0.5), hf.Peg(-0.3, -0.4, 0.03, inertia=1e-4)):
        refuses("led behind fixed pegs alone", hf.WindCriteria, behind=[each])
    refuses("behind holds something else", hf.WindCriteria, behind=BEFORE)
    with pytest.raises(InvalidInput, match="turning arm hits the peg"):
        hf.plan_cast(CORD, ARM, TARGET, criteria=hf.WindCriteria(behind=[hf.Peg(0.1, 0.1, 0.01)]))
    with pytest.raises(InvalidInput, match=r"begins in the peg at \(-0.2, -0.5\) m and the peg at \(0.2, -0.5\) m"):
        hf.plan_cast(
            CORD, ARM, TARGET, criteria=hf.WindCriteria(behind=[hf.Peg(side, -0.5, 0.03) for side in (-0.2, 0.2)])
        )
    refuses("is given twice", replace, who, criteria=hf.WindCriteria(behind=[BEFORE, BEFORE]))
    refuses("is an obstacle, too", replace, who, obstacles=[BEFORE])
    asked = {"criteria": hf.WindCriteria(behind=[BEFORE]), "uncertainty": Uncertainty()}
    for words, call in (
        ("a plan with an uncertainty", lambda: hf.plan_cast(CORD, ARM, TARGET, **asked)),
        (
            "a holding force",
            lambda: hf.plan_cast(CORD, ARM, TARGET, criteria=hf.WindCriteria(behind=[BEFORE], holding_force=1.0)),
        ),
        ("an uncertainty", lambda: Uncertainty().sample(1, who, PEG)),
        ("a reach map", lambda: hf.build_reach_map(CORD, ARM, criteria=hf.WindCriteria(behind=[BEFORE]))),
        ("a plan that is followed", lambda: hf.follow_plan(replace(planned(), problem=who), None)),
        ("a whip", lambda: build_whip_map(who, swings=1)),
    ):
        refuses(f"^{words} takes no pegs that the rope is to run behind", call)


def test_the_way_round_counts_as_the_way_to_the_target():
    who = replace(problem(), rope=CORD, arm=ARM)
    straight, beside_it = (
        check_feasibility(replace(who, criteria=hf.WindCriteria(behind=[peg])), TARGET)
        for peg in (BEFORE, hf.Peg(-0.45, -0.1, 0.02))
    )
    assert straight.available_turns == pytest.approx(check_feasibility(who, TARGET).available_turns)
    way = np.hypot(0.45, 0.1) + np.hypot(0.05, 0.6) - np.hypot(0.5, 0.7) - 2.0 * 0.023
    assert straight.available_turns - beside_it.available_turns == pytest.approx(way / (2.0 * np.pi * 0.033))
    assert check_feasibility(replace(who, criteria=hf.WindCriteria(behind=[TARGET])), TARGET).message.startswith(
        "the target lies in the peg"
    )
    tight = check_feasibility(
        replace(who, criteria=hf.WindCriteria(behind=[hf.Peg(-0.46, -0.65, 0.03)])), TARGET
    ).message
    assert "from the target, the rope needs 6" in tight
    wide = replace(
        who, criteria=hf.WindCriteria(behind=[hf.Peg(-0.43, -0.62, 0.03)]), clearance=0.1
    )  # from obstacles alone, not from these
    assert check_feasibility(wide, TARGET).message == check_feasibility(replace(wide, clearance=0.0), TARGET).message
    far = hf.plan_cast(CORD, ARM, hf.Peg(-0.5, -1.0, 0.03), criteria=hf.WindCriteria(behind=[hf.Peg(-0.5, 0.0, 0.03)]))
    assert far.status == "infeasible"
    assert not any("arm" in each for each in far.remedies)  # a longer one would hit the peg


def test_a_cast_behind_a_peg_is_found_and_touches_both():
    plan = hf.plan_cast(
        CORD,
        ARM,
        TARGET,
        criteria=hf.WindCriteria(behind=[BEFORE], contact=0.0),
        on_plan=lambda plan: True,
        time_budget=300.0,
        options=hf.SearchOptions(threads=1),
    )
    assert plan.success, plan.message
    assert plan.outcome.runs_behind == plan.finer_outcome.runs_behind == (True,)
    seen = plan.run
    assert seen.setup.pegs == (TARGET, BEFORE)
    share = np.linspace(0.0, 1.0, 51)[:, None]
    links = zip(seen.joints[-1, :-1], seen.joints[-1, 1:], strict=True)
    points = np.concatenate([a * (1.0 - share) + b * share for a, b in links])
    at = []
    for peg in (BEFORE, TARGET):
        gap = np.hypot(*(points - [peg.x, peg.y]).T) - peg.radius - CORD.radius
        assert abs(gap.min()) < 2e-4
        at.append(int((gap < 2e-4).argmax()))
    assert at[0] < at[1]
    finer = verify_cast(plan.problem.cut(2), TARGET, plan.motion, accuracy=Accuracy(0.2 * hf.model.DEFAULT_TOL, 1e-4))
    assert finer.success, finer.message
    assert finer.runs_behind == (True,)
