"""Reports of plans: required contents of the page, the film and the figures."""

import html
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.planning import FallbackTarget
from hyperflex.report import CastReport, InsertReport, WhipReport
from hyperflex.report import plan as plan_report
from tests.planning.known import PEG, held, late, planned, stopped, unreachable
from tests.planning.known_insert import far_insert, planned_insert
from tests.planning.known_whip import far_whip, planned_whip


def words_of(path):
    text = re.sub(r"<style>.*?</style>|<[^>]*>|src=\"data:[^\"]*\"", " ", path.read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(text))


def later_touch():
    """A whip after whose peak the rope touches a wall."""
    plan = planned_whip()
    touched = replace(plan.outcome, touches_later="the wall at (0.3, -1.5) m at 1.95 s")
    return WhipReport(replace(plan, outcome=touched), plan.impact())


PAGES = {  # a report, its figures, and what the page says
    "cast": (
        lambda: CastReport(planned(), held()),
        {"strike", "sideways"},
        (
            "x = -0.834 m, y = -1.07 m; radius 40 mm; 6 swings; begun at 0.48, 1.73, 2.85, 4.35, 5.65, 6.74 s; 616°; "
            "strikes the target at 7.65 s; "
            "If the rope begins 1 degree out of the plane, it strikes; 10.7; clear of the arm; "
            "withstood ; In short The rope winds 2.36 turns"
        ),
    ),
    "whip": (
        later_touch,
        {"peak", "passing"},
        (
            "within 17.2 degrees of the direction 179; 3 strokes; speed peaks at 1.29 m/s; 0.5 mm from the target; "
            "standard deviation of 4 mm; After the peak the rope touches the wall at (0.3, -1.5) m at 1.95 s"
        ),
    ),
    "insertion": (
        lambda: InsertReport(planned_insert()),
        {"entry", "gap"},
        (
            "a slot at x = -0.35 m, y = -0.85 m, 25 mm wide; 40 mm beyond the walls at 2.00 s; 2.5 times the links 40; "
            "2 strokes: to 141 degrees from 0.33 s on; Success probability: 90 %; standard deviation of 4 mm"
        ),
    ),
}


@pytest.fixture
def unseen(monkeypatch):
    """Figures are made, but not turned into pixels, nor the run into a film: the test of pages does that."""
    monkeypatch.setattr(plan_report, "png", lambda _: b"\x89PNG")
    monkeypatch.setattr(plan_report, "player_html", lambda *_, **__: "<p>film</p>")


@pytest.mark.parametrize(("made", "figures", "values"), PAGES.values(), ids=PAGES.keys())
def test_the_page_of_a_plan_states_its_kind(tmp_path, made, figures, values):
    files = made().write(tmp_path)
    page = words_of(files["page"])
    assert [value for value in values.split("; ") if value not in page] == []
    assert set(files) == {"motion", "plan", "run", "page"} | figures


@pytest.mark.parametrize(
    ("kind", "made"), [(CastReport, unreachable), (WhipReport, far_whip), (InsertReport, far_insert)]
)
def test_a_plan_without_moves_is_a_page_with_the_reason(tmp_path, kind, made):
    files = kind(made()).write(tmp_path)
    assert list(files) == ["page"]
    assert "out of reach: the rope ends" in words_of(files["page"])
    assert unreachable().measure_holding_force() is None


@pytest.mark.usefixtures("unseen")
@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (late, "the verification took longer than the time allowed for it."),
        (stopped, "interrupted before any moves were verified."),
        (unreachable, "out of reach: the rope ends 0.36 m short of the target."),
        (lambda: planned(winds=False), "the rope does not touch the peg."),
    ],
    ids=["late", "stopped", "unreachable", "misses"],
)
def test_a_plan_that_fails_reports_it_first(tmp_path, made, reason):
    page = words_of(CastReport(made()).write(tmp_path)["page"])
    assert page.index("No cast found round a target at x") < page.index("In short")
    assert f"In short No cast that winds and holds was found: {reason}" in page
    assert "A planned cast" not in page
    assert "verified by simulation" not in page


@pytest.mark.usefixtures("unseen")
@pytest.mark.parametrize("made", [late, stopped, lambda: stopped(None)], ids=["late", "stopped", "no throw"])
def test_a_search_that_did_not_end_invents_no_results_and_advises_to_continue(tmp_path, made):
    plan = made()
    path = CastReport(plan).write(tmp_path)["page"]
    page = words_of(path)
    assert ("not known strike, turns and hold" in page) == (plan.moves is not None)
    assert 'class="bad"' not in path.read_text("utf-8")
    for invented in ("never", "0.00", "does not stay", "Nearest", "No place was found"):
        assert invented not in page
    assert "the target itself is in reach" in page
    assert "another --seed" in page
    assert f"took {plan.seconds:.0f} s and 4321 simulated runs" in page


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        ({"held": False, "slip": 0.077}, "more friction on the target"),
        ({"torque": 0.4}, "a motor of 0.4 N m; 0.3 N m are given"),
        ({"wound": False}, "another --seed may help"),
    ],
)
def test_advice_is_about_what_failed(change, advice):
    plan = planned()
    problem = replace(plan.problem, limits=hf.MotorLimits(torque=0.3))
    cast = replace(plan.outcome, **({"torque": 0.1} | change))
    near = FallbackTarget(PEG, 0.0)
    failed = replace(plan, problem=problem, outcome=cast, message="it fails", fallback=near)
    given = " ".join(CastReport(failed).advice)
    assert advice in given
    assert ("--seed" in given) == ("--seed" in advice)


def test_criteria_that_are_not_the_usual_ones_are_named():
    required = replace(planned().problem, criteria=hf.WindCriteria(turns=2.0, settle=1.5))
    for problem, turns, watch in (
        (planned().problem, "1.25", ""),
        (required, "2", ", from 1.5 s after the motion's end on,"),
    ):
        plan = replace(planned(), problem=problem)
        report = CastReport(plan)
        assert any(words.endswith(f"{turns} are required") for _, words in report.tiles)
        assert any(f"In the last 2 s{watch} the rope slips" in line for line in report.story)
        (plot,) = report.overlay().plots
        assert (plot.title, plot.level) == (f"turns, clockwise ({turns} required)", problem.criteria.turns)


def test_the_rest_with_which_a_cast_ends_is_named():
    plan = replace(planned(), moves=planned().moves.waiting(1.25))
    report, stop = CastReport(plan), planned().motion.end
    assert f"it stops at {stop:.2f} s and waits 1.25 s, in which" in " ".join(report.story)
    assert "waits" not in " ".join(CastReport(planned()).story)
    assert report.stop == pytest.approx(stop)
    assert plan.summary()["stop"] == pytest.approx(stop)
    assert plan.summary()["moves"]["dwell"] == 1.25


def test_warnings(monkeypatch):
    plan, whip = planned(), planned_whip()
    assert [CastReport(plan).warning, WhipReport(whip).warning] == ["", ""]
    assert any("no limit was given" in words for _, words in CastReport(plan).tiles)
    assert "grazes" not in " ".join(CastReport(plan).story)
    cast = replace(plan.outcome, touch_time=plan.outcome.strike_time - 2.0, max_bend=2.2, folded=True)
    story = " ".join(CastReport(replace(plan, outcome=cast)).story)
    assert f"grazes the target at {cast.touch_time:.2f} s and comes off again. The rope strikes" in story
    assert "folds flat, by 126 degrees" in story
    message = "the tip's speed is 4.20 m/s, and 5 is asked"
    short = replace(whip, finer_outcome=replace(whip.finer_outcome, message=message))
    assert WhipReport(short).warning == f"With links of half the length {message}."
    assert WhipReport(replace(short, message="it misses")).warning == ""
    early = SimpleNamespace(success=False, message="link 29 touches the peg first")
    assert "not struck by the tip at its peak: link 29" in WhipReport(whip, early).verdict
    monkeypatch.setattr(plan_report, "GREAT_TORQUE", 0.0)
    rope, arm = whip.problem.rope, whip.problem.arm
    for report in (CastReport(plan), WhipReport(whip), InsertReport(planned_insert())):
        assert "Give --torque to plan for a weaker motor" in " ".join(report.story)
    weight = rope.total_mass * 9.81 * arm.length
    assert f"weight at the arm makes {weight:.2g} N m" in WhipReport(whip).warning


@pytest.mark.usefixtures("unseen")
def test_a_plan_that_failed_with_shorter_links_first_shows_that_run(tmp_path):
    fails = replace(planned(winds=False), finer_outcome=planned(winds=False).outcome)
    plan = replace(fails, outcome=None)
    assert plan.run is fails.run
    report = CastReport(plan)
    assert report.verdict == CastReport(fails).verdict
    assert "film" in report.pictures()
    page = report.write(tmp_path)["page"].read_text("utf-8")
    assert page.count("not known") >= 7  # the run as planned, in the table of checks


def test_a_pull_that_did_not_slip_is_a_lower_bound():
    firm = replace(held(), tug=replace(held().tug, slipped=False))
    report = CastReport(planned(), firm)
    assert "or more (tug)" in report.film_note(11.0)
    assert any(f"at least {firm.force:.2f}" in value for value, _ in report.tiles)
    assert any("so it holds more" in line for line in report.story)


@pytest.mark.parametrize(
    ("report", "failing", "notes"),
    [
        (
            lambda: CastReport(planned(), held()),
            lambda: CastReport(planned(winds=False)),
            {0.2: "6 swings to come", 0.8: "arm: swing 1 of 6", 7.5: "in the air", 11.0: "wound and held; hold force"},
        ),
        (
            lambda: WhipReport(planned_whip()),
            lambda: WhipReport(planned_whip(meets=False)),
            {0.01: "3 strokes to come", 0.2: "stroke 1 of 3", 1.95: "passes it at 1.90 s: 1.3 m/s, 0.5 mm off"},
        ),
        (
            lambda: InsertReport(planned_insert()),
            lambda: InsertReport(planned_insert(enters=False)),
            {0.0: "2 strokes to come", 0.5: "stroke 1 of 2", 2.05: "inside at 2.00 s"},
        ),
    ],
    ids=["cast", "whip", "insert"],
)
def test_the_film_of_a_plan_has_notes(report, failing, notes):
    note, failed = report().film_note, failing()
    for t, text in notes.items():
        assert text in note(t)
    assert list(notes.values())[-1][:6] not in note(1.5)
    assert "FAILS: the" in failed.film_note(failed.plan.run.t[-1])


def test_the_player_of_a_plan_marks_the_event_and_what_is_required():
    for report, title, event in (
        (CastReport(planned()), "turns, clockwise (1.25 required)", 7.65),
        (WhipReport(planned_whip()), "distance of the tip from the target", 1.90),
        (InsertReport(planned_insert()), "depth of the tip beyond the walls (40 mm required)", 2.00),
    ):
        shown = report.overlay()
        assert [plot.title for plot in shown.plots] == [title]
        assert shown.marks == (pytest.approx(event, abs=5e-3),)


def test_close_pictures_are_centred_on_the_target_and_on_the_gap():
    missed, insert = WhipReport(planned_whip(meets=False)), InsertReport(planned_insert())
    for report, name in ((missed, "passing"), (insert, "gap")):
        (axis,) = report.figures()[name].axes
        centre = np.mean([axis.get_xlim(), axis.get_ylim()], axis=1)
        np.testing.assert_allclose(centre, report.plan.target.point, atol=1e-12)
    assert np.ptp(missed.figures()["passing"].axes[0].get_xlim()) >= 2.0 * missed.outcome.miss
