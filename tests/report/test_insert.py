"""Report of a planned insertion: what a reader must find, on the page, in the film and in a notebook."""

from __future__ import annotations

import html
from dataclasses import replace

import hyperflex as hf
from hyperflex.planning import SuccessProbability
from hyperflex.report import InsertReport, plan_html
from hyperflex.report import plan as plan_report
from tests.planning.known_insert import far_insert, planned_insert
from tests.report.test_whip import words_of


def test_the_page_names_slot_strokes_and_clearance(tmp_path):
    plan = planned_insert()
    files = InsertReport(plan).write(tmp_path / "out")
    page = words_of(files["page"])
    for told in (
        "a slot at x = -0.35 m, y = -0.85 m, 25 mm wide",
        "40 mm beyond the walls at 2.00 s",
        f"{1e3 * plan.outcome.wall_clearance:.1f} mm",
        "2 strokes: to 141 degrees from 0.33 s on",
        "Success probability: 90 %",
        "2.5 times the links 40",
        "standard deviation of 4 mm",
    ):
        assert told in page, told
    assert set(files) == {"motion", "plan", "run", "page", "entry", "gap", "course"}


def test_the_page_tells_a_great_torque(tmp_path, monkeypatch):
    plan = planned_insert()
    words = "Give --torque to plan for a weaker motor"
    assert words not in words_of(InsertReport(plan).write(tmp_path / "calm")["page"])
    monkeypatch.setattr(plan_report, "GREAT_TORQUE", 0.0)
    rope, arm = plan.problem.rope, plan.problem.arm
    heavy = replace(plan, problem=replace(plan.problem, rope=rope.replace(tip_mass=0.5)))
    page = html.unescape(words_of(InsertReport(heavy).write(tmp_path / "heavy")["page"]))
    assert words in page
    assert f"The rope's weight at the arm makes {(rope.mass.sum() + 0.5) * 9.81 * arm.length:.2g} N m" in page


def test_a_probability_that_knows_no_torque_says_so():
    plan = planned_insert()
    weak = replace(plan, problem=replace(plan.problem, limits=hf.MotorLimits(torque=10.0)))
    for shown, said in ((plan, False), (weak, True)):
        assert any("the torque of the motor is not checked" in told for _, told in InsertReport(shown).tiles) is said


def test_a_probability_that_there_was_no_time_for_is_called_so():
    report = InsertReport(replace(planned_insert(), success_probability=SuccessProbability(0, 0)))
    assert any(value == "?" and "not estimated, no time was left" in told for value, told in report.tiles)
    assert "Success probability: not estimated, no time was left." in report.story


def test_a_plan_without_strokes_is_a_page_with_the_reason(tmp_path):
    files = InsertReport(far_insert()).write(tmp_path / "out")
    assert list(files) == ["page"]
    assert "out of reach: the rope ends" in words_of(files["page"])


def test_the_film_tells_the_course():
    note = InsertReport(planned_insert()).film_note
    assert "2 strokes to come" in note(0.0)
    assert "stroke 1 of 2" in note(0.5)
    assert "inside" not in note(1.5)
    assert "inside at 2.00 s" in note(2.05)
    assert "FAILS: the rope touches" in InsertReport(planned_insert(enters=False)).film_note(2.2)


def test_a_notebook_shows_it():
    assert "A planned insertion" in plan_html(planned_insert())
