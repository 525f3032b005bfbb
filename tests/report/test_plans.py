"""Reports of plans: required contents of the page, the film and the figures."""

import html
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.text import Text

import hyperflex as hf
from hyperflex.planning import FallbackTarget
from hyperflex.report import CastReport, InsertReport, WhipReport
from hyperflex.report import plan as plan_report
from hyperflex.report.cast import tug_figure
from hyperflex.report.maps import target_map
from tests.planning.known import PEG, held, late, planned, stopped, unreachable
from tests.planning.known_insert import far_insert, planned_insert
from tests.planning.known_whip import far_whip, planned_whip


def words_of(path):
    text = re.sub(r"<style>.*?</style>|<[^>]*>|src=\"data:[^\"]*\"", " ", path.read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(text))


def course_of(report):
    """The time course; of a cast it alone is drawn."""
    return report._course() if isinstance(report, CastReport) else report.figures()["course"]


def later_touch():
    """A whip after whose peak the rope touches a wall."""
    plan = planned_whip()
    touched = replace(plan.outcome, touches_later="the wall at (0.3, -1.5) m at 1.95 s")
    return WhipReport(replace(plan, outcome=touched), plan.impact())


PAGES = {  # a report, its figures, and what the page says
    "cast": (
        lambda: CastReport(planned(), held()),
        {"strike", "course", "sideways", "tug"},
        (
            "x = -0.834 m, y = -1.07 m; radius 40 mm; 6 swings; begun at 0.48, 1.73, 2.85, 4.35, 5.65, 6.74 s; 616°; "
            "strikes the target at 7.65 s; "
            "If the rope begins 1 degree out of the plane, it strikes; 10.7; clear of the arm; "
            "withstood ; In short The rope winds 2.36 turns"
        ),
    ),
    "whip": (
        later_touch,
        {"peak", "passing", "course"},
        (
            "within 17.2 degrees of the direction 179; 3 strokes; speed peaks at 1.29 m/s; 0.5 mm from the target; "
            "standard deviation of 4 mm; After the peak the rope touches the wall at (0.3, -1.5) m at 1.95 s"
        ),
    ),
    "insertion": (
        lambda: InsertReport(planned_insert()),
        {"entry", "gap", "course"},
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
    assert "Where the target is" not in page  # the pictures of the run show that
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
        axis = course_of(report).axes[1]
        assert any(f"{turns} turns are required" in text.get_text() for text in axis.get_legend().get_texts())
        assert any(line.get_ydata()[0] == problem.criteria.turns == line.get_ydata()[-1] for line in axis.get_lines())
        (green,) = [span.get_x() for span in axis.patches]
        assert green == pytest.approx(plan.motion.breaks[-1] + problem.criteria.settle)


def test_the_rest_with_which_a_cast_ends_is_named():
    plan = replace(planned(), moves=planned().moves.waiting(1.25))
    report, stop = CastReport(plan), planned().motion.end
    assert f"it stops at {stop:.2f} s and waits 1.25 s, in which" in " ".join(report.story)
    assert "waits" not in " ".join(CastReport(planned()).story)
    assert report.stop == pytest.approx(stop)
    assert plan.summary()["stop"] == pytest.approx(stop)
    assert plan.summary()["moves"]["dwell"] == 1.25
    (green,) = [span.get_x() for span in course_of(report).axes[1].patches]
    assert green == pytest.approx(stop + 1.25 + plan.problem.criteria.settle)


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


def test_a_plan_without_a_run_shows_where_its_target_is(tmp_path):
    plan = unreachable()
    page = CastReport(plan).write(tmp_path)["page"].read_text("utf-8")
    assert page.count("data:image/png") == 1
    (axis,) = target_map(plan, "nearest").axes
    (target, nearest) = axis.patches
    assert target.center == (2.5, 0.0)
    assert nearest.center == (plan.fallback.target.x, plan.fallback.target.y)
    assert min(target.radius, nearest.radius) >= 0.02  # m: they can be seen
    rope, _, reach, arm = (line.get_xydata() for line in axis.get_lines()[:4])
    np.testing.assert_allclose(np.hypot(*reach.T), 2.105, rtol=1e-12)  # rounding
    np.testing.assert_allclose(np.hypot(*arm.T), 0.105, rtol=1e-12)  # rounding
    np.testing.assert_allclose(rope, [[-0.105, 0.0], [-0.105, -2.0]], atol=1e-12)  # rounding of cos(pi / 2)
    low, high = axis.get_xlim()
    assert low < -2.105 < 2.53 < high
    walls = (hf.Wall(1.0, -1.0, 1.0, 1.0), hf.Peg(9.0, 0.0, 0.1))
    past = replace(plan, problem=replace(plan.problem, obstacles=walls))
    words = [text.get_text() for text in target_map(past, "nearest").legends[0].get_texts()]
    assert [word for word in words if "obstacle" in word] == ["wall, an obstacle"]  # the peg is beyond the picture


@pytest.mark.parametrize(
    ("report", "moves", "event"),
    [
        (lambda: CastReport(planned()), ["1", "2", "3", "4", "5", "6", "last"], "strikes at 7.65 s"),
        (lambda: WhipReport(planned_whip()), ["1", "2", "3"], "peak at 1.90 s"),
        (lambda: InsertReport(planned_insert()), ["1", "2"], "inside at 2.00 s"),
    ],
    ids=["cast", "whip", "insert"],
)
def test_the_time_course_numbers_the_moves_and_marks_the_event(report, moves, event):
    arm, upper, *_ = course_of(report()).axes
    assert [text.get_text().strip() for text in arm.texts] == moves
    assert any(event in text.get_text() for text in upper.get_legend().get_texts())
    (marked,) = (line for line in upper.get_lines() if line.get_linestyle() == "--" and line.get_color() == "#d1483a")
    assert f"{marked.get_xdata()[0]:.2f} s" in event


def test_the_path_past_the_target_is_centred_on_it():
    figure = WhipReport(planned_whip(meets=False)).figures()["passing"]
    target, tip = (line for line in figure.axes[0].get_lines() if line.get_marker() == "o")
    assert (target.get_xdata()[0], target.get_ydata()[0]) == (0.0, 0.0)
    np.testing.assert_allclose([tip.get_xdata()[0], tip.get_ydata()[0]], [-18.0, -24.0], atol=1e-9)  # mm
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any("30 mm off" in word for word in words)
    assert any("required direction" in word for word in words)
    free = WhipReport(planned_whip(any_direction=True)).figures()["passing"].legends[0].get_texts()
    assert not any("required direction" in text.get_text() for text in free)


def test_a_pull_that_did_not_slip_is_a_lower_bound():
    firm = replace(held(), tug=replace(held().tug, slipped=False))
    report = CastReport(planned(), firm)
    assert "or more (tug)" in report.film_note(11.0)
    assert any(f"at least {firm.force:.2f}" in value for value, _ in report.tiles)
    assert any("so it holds more" in line for line in report.story)
    for each, least in ((held(), ""), (firm, "at least ")):
        labels = [text.get_text() for text in tug_figure(each).axes[0].get_legend().get_texts()]
        assert f"hold force {least}{firm.force:.2f} N" in labels


def overlapping(figure):
    """Return the texts of a figure that lie on each other, in pairs; ticks beyond an axis' ends are not drawn."""
    figure.canvas.draw()
    beyond = set()
    for axis in (each for axes in figure.axes for each in (axes.xaxis, axes.yaxis)):
        low, high = axis.get_view_interval()
        beyond |= {tick.label1 for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high}
    drawn = [each for each in figure.findobj(Text) if each.get_visible() and each.get_text().strip()]
    boxes = [(each.get_text(), each.get_window_extent()) for each in drawn if each not in beyond]
    return [(a, b) for k, (a, box) in enumerate(boxes) for b, other in boxes[k + 1 :] if box.overlaps(other)]


def test_labels_do_not_lie_on_each_other():
    for strike in (0.3, 5.0, 10.8):
        plan = replace(planned(), outcome=replace(planned().outcome, strike_time=strike))
        assert overlapping(course_of(CastReport(plan))) == []
    for report in (CastReport(planned(winds=False)), WhipReport(planned_whip()), InsertReport(planned_insert())):
        assert overlapping(course_of(report)) == []
    firm = replace(held(), tug=replace(held().tug, slip=0.05 * held().tug.slip, slipped=False))
    for each in (held(), firm):
        assert overlapping(tug_figure(each)) == []


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
