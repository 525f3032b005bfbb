"""Report of a planned cast: what a reader must find, in the film and on the page."""

from __future__ import annotations

import dataclasses
import io
import re

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

import hyperflex as hf
from hyperflex.planning import FallbackTarget
from hyperflex.planning.outcome import TOO_LONG
from hyperflex.report.cast import CastReport, tug_figure
from hyperflex.report.maps import target_map
from hyperflex.report.pictures import animate
from hyperflex.report.scene import Overlay
from hyperflex.report.style import png
from tests.planning.known import PEG, late, planned, stopped, unreachable


def opened(path):
    return Image.open(io.BytesIO(path.read_bytes()))


def write_cast(folder, plan, held=None):
    return CastReport(plan, held).write(folder)


def course_figure(plan):
    return CastReport(plan).figures()["course"]


def strike_figure(plan):
    return CastReport(plan).figures()["strike"]


def words_of(path):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>|src=\"data:[^\"]*\"", " ", path.read_text("utf-8")))


@pytest.fixture(scope="module")
def held():
    return planned().measure_holding_force()


def test_the_page_names_target_swings_turns_and_hold(tmp_path, held):
    files = write_cast(tmp_path / "out", planned(), held)
    page = words_of(files["page"])
    for told in (
        "x = -0.834 m, y = -1.07 m",
        "radius 40 mm",
        "6 swings",
        "begun at 0.48, 1.73, 2.85, 4.35, 5.65, 6.74 s",
        "strikes the target at 7.65 s",
        "2.36 turns",
        "616°",
        "contact: the angle of the target that the rope covers, 10.7",  # rad; 11.23 at the end
        f"{1e3 * planned().clearance:.1f} mm",
        "clear of the arm",
        "clockwise",
        f"withstood {held.force:.2f} N",
        f"{held.capstan_force:.2f} N",
        "simulated",
        "8.61 rad/s",
        "shorter links",
    ):
        assert told in page, told
    assert "counterclockwise" not in page
    assert "Where the target is" not in page  # the pictures of the run show that
    assert "In short The rope winds 2.36 turns" in page


def test_the_page_tells_the_turns_and_the_watch_that_were_asked_where_they_are_not_usual():
    asked = dataclasses.replace(planned().problem, turns=2.0, settle=1.5)
    for known, turns, watch in (
        (planned().problem, "1.25", ""),
        (asked, "2", ", from 1.5 s after the arm's stop on,"),
    ):
        plan = dataclasses.replace(planned(), problem=known)
        told = CastReport(plan, None)
        assert any(line.endswith(f"end; {turns} are required") for _, line in told.tiles)
        assert any(f"In the last 2 s{watch} the rope slips" in line for line in told.story)
        turned = course_figure(plan).axes[1]
        assert any(text.get_text() == f" {turns} turns are required" for text in turned.texts)
        assert any(line.get_ydata()[0] == known.turns == line.get_ydata()[-1] for line in turned.get_lines())
        (green,) = [span.get_x() for span in turned.patches]
        assert green == pytest.approx(plan.motion.breaks[-1] + known.settle)


def test_a_plan_without_a_throw_is_a_page_with_the_reason(tmp_path):
    assert unreachable().measure_holding_force() is None
    files = write_cast(tmp_path / "out", unreachable())
    assert list(files) == ["page"]
    assert "out of reach: the rope ends" in words_of(files["page"])


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (late, "the verification took longer than the time allowed for it."),
        (stopped, "interrupted before any throw was verified."),
        (unreachable, "out of reach: the rope ends 0.36 m short of the target."),
        (lambda: planned(winds=False), "the rope does not touch the peg."),
    ],
    ids=["late", "stopped", "unreachable", "misses"],
)
def test_a_plan_that_fails_says_so_first(tmp_path, made, told):
    page = words_of(write_cast(tmp_path / "out", made())["page"])
    assert page.index("No cast found round a target at x") < page.index("In short")
    after = page[page.index("In short") + len("In short") :].strip()
    assert after.startswith(f"No cast that winds and holds was found: {told}")
    assert "A planned cast" not in page
    assert "verified by simulation" not in page


@pytest.mark.parametrize("made", [late, stopped], ids=["late", "stopped"])
def test_what_was_not_run_to_its_end_is_not_known(tmp_path, made):
    path = write_cast(tmp_path / "out", made())["page"]
    page = words_of(path)
    assert "not known strike, turns and hold" in page
    assert 'class="bad"' not in path.read_text("utf-8")
    for invented in ("never", "0.00", "does not stay"):
        assert invented not in page
    assert "does is not known" in page


@pytest.mark.parametrize("made", [late, stopped, lambda: stopped(None)], ids=["late", "stopped", "no throw"])
def test_a_target_in_reach_that_is_not_to_blame_comes_with_advice(tmp_path, made):
    plan = made()
    page = words_of(write_cast(tmp_path / "out", plan)["page"])
    assert "the target itself is in reach" in page
    assert "another --seed" in page
    assert "Nearest" not in page
    assert "No place was found" not in page
    assert f"took {plan.seconds:.0f} s and 4321 simulated runs" in page


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"held": False, "slip": 0.077}, "winds but slips: it would hold with more friction"),
        ({"torque": 0.4}, "needs a motor of 0.4 N m; 0.3 N m are given"),
        ({"wound": False}, "another --seed may help"),
    ],
)
def test_advice_is_about_what_failed(change, told):
    plan = planned()
    who = dataclasses.replace(plan.problem, limits=hf.MotorLimits(torque=0.3))
    cast = dataclasses.replace(plan.outcome, **({"torque": 0.1} | change))
    failed = dataclasses.replace(plan, problem=who, outcome=cast, message="it fails", fallback=FallbackTarget(PEG, 0.0))
    given = " ".join(CastReport(failed, None).advice)
    assert told in given
    assert ("--seed" in given) == ("--seed" in told)


def test_a_graze_and_a_fold_are_told(tmp_path):
    plan = planned()
    assert "grazes" not in " ".join(CastReport(plan, None).story)
    assert CastReport(plan, None).warning == ""
    cast = dataclasses.replace(plan.outcome, touch_time=plan.outcome.strike_time - 2.0, max_bend=2.2, folded=True)
    plan = dataclasses.replace(plan, outcome=cast)
    told = " ".join(CastReport(plan, None).story)
    assert f"grazes the target at {plan.outcome.touch_time:.2f} s and comes off again. The rope strikes" in told
    assert "folds flat, by 126 degrees" in told


def test_files_of_an_earlier_cast_go_with_it(tmp_path, held):
    write_cast(tmp_path, planned(), held)
    assert (tmp_path / "motion.csv").exists()
    (tmp_path / "notes.txt").write_text("mine")
    write_cast(tmp_path, stopped(None))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "report.html"]


def test_a_target_in_reach_that_no_throw_winds_is_not_said_to_be_out_of_reach():
    plan = dataclasses.replace(planned(winds=False), fallback=FallbackTarget(PEG, 0.0))
    told = " ".join(CastReport(plan, None).advice)
    assert "Nearest target that should be easier" in told
    assert "this target is in reach, too" in told


def test_what_the_rule_of_thumb_says_is_said_to_be_that():
    rope, arm = planned().problem.rope, planned().problem.arm
    asked = CastReport(hf.plan_cast(rope, arm, PEG, holding_force=20.0), None)
    assert "out of reach by a rule of thumb: its holding force is 2.94 N at most" in asked.verdict
    assert (
        "found: out of reach: the rope ends" in CastReport(unreachable(), None).verdict
    )  # no rule of thumb but geometry


def test_a_plan_without_a_run_shows_where_its_target_is(tmp_path):
    plan = unreachable()
    page = write_cast(tmp_path / "out", plan)["page"].read_text("utf-8")
    assert page.count("data:image/png") == 1
    figure = target_map(plan, "nearest")
    (axis,) = figure.axes
    discs = [(patch.center, patch.radius) for patch in axis.patches]
    assert discs[0][0] == (2.5, 0.0)
    assert discs[1][0] == (plan.fallback.target.x, plan.fallback.target.y)
    assert all(radius >= 0.03 for _, radius in discs)
    reach, arm = (line.get_xydata() for line in axis.get_lines()[:2])
    np.testing.assert_allclose(np.hypot(*reach.T), 2.105, rtol=1e-12)  # rounding
    np.testing.assert_allclose(np.hypot(*arm.T), 0.105, rtol=1e-12)  # rounding
    rope = axis.get_lines()[2].get_xydata()
    np.testing.assert_allclose(rope, [[-0.105, 0.0], [-0.105, -2.0]], atol=1e-12)  # rounding of cos(pi / 2)
    low, high = axis.get_xlim()
    assert low < -2.105 < 2.53 < high
    walls = (hf.Wall(1.0, -1.0, 1.0, 1.0), hf.Peg(9.0, 0.0, 0.1))
    past = dataclasses.replace(plan, problem=dataclasses.replace(plan.problem, obstacles=walls))
    words = [text.get_text() for text in target_map(past, "nearest").legends[0].get_texts()]
    assert [word for word in words if "obstacle" in word] == ["wall, an obstacle"]  # the peg is beyond the picture


def test_the_film_tells_the_course(held):
    note = CastReport(planned(), held).film_note
    assert "6 swings to come" in note(0.2)
    assert "arm: swing 1 of 6" in note(0.8)
    assert "arm: rests after swing 1 of 6" in note(1.4)
    assert "rope: in the air" in note(7.5)
    assert "turns round the target" in note(8.5)
    assert "x = -0.834 m, y = -1.07 m, radius 40 mm" in note(0.0)
    assert f"wound and held; hold force {held.force:.2f} N (tug)" in note(11.0)
    assert "2.36 turns" in note(11.0)
    assert "hold force" not in note(8.5)


def test_the_film_of_a_miss_says_why():
    note = CastReport(planned(winds=False), None).film_note
    assert "FAILS: the rope does not touch the peg" in note(planned(winds=False).run.t[-1])


def test_the_target_is_drawn_as_large_as_it_is(tmp_path):
    run = planned(winds=False).run
    animate(run, tmp_path / "a.gif", end=0.1, frame_rate=10, width=300, overlay=Overlay(lambda _: "one\ntwo"))
    frame = np.asarray(opened(tmp_path / "a.gif").convert("RGB"))
    _, columns = np.nonzero((frame[..., 0] > 180) & (frame[..., 1] < 120))
    across = np.ptp(columns) + 1
    seen = np.concatenate([run.joints.reshape(-1, 2), [[PEG.x - 0.04, PEG.y - 0.04], [PEG.x + 0.04, PEG.y + 0.04]]])
    wide, tall = np.ptp(seen, axis=0)
    margin = 0.06 * max(wide, tall)  # on each side, and twice above
    view = max(wide + 2.0 * margin, (tall + 3.0 * margin) / 1.15)  # a tall view is widened
    assert across == pytest.approx(300 * 0.08 / view, abs=1.5)  # whole pixels


def test_a_film_has_room_for_its_words(tmp_path):
    run = planned(winds=False).run
    heights = []
    for note in (None, lambda _: "one", lambda _: "one\ntwo\nthree"):
        animate(run, tmp_path / "a.gif", end=0.1, frame_rate=10, width=200, overlay=Overlay(note))
        heights.append(opened(tmp_path / "a.gif").height)
    assert heights == [heights[0], heights[0] + 36, heights[0] + 72]


def test_the_course_marks_the_strike_and_counts_the_swings():
    figure = course_figure(planned())
    arm, turns = figure.axes[:2]
    texts = [text.get_text() for text in arm.texts]
    assert texts == ["1", "2", "3", "4", "5", "6", "last"]
    assert any(line.get_xdata()[0] == planned().outcome.strike_time for line in arm.get_lines())
    assert any("1.25 turns" in text.get_text() for text in turns.texts)
    assert turns.get_lines()[0].get_ydata()[-1] == pytest.approx(2.36, abs=0.005)


def test_pictures_of_a_miss_and_of_a_tug(held):
    miss = planned(winds=False)
    for figure in (strike_figure(miss), course_figure(miss), tug_figure(held)):
        assert png(figure, dpi=40).startswith(b"\x89PNG")
    labels = [text.get_text() for text in tug_figure(held).axes[0].get_legend().get_texts()]
    assert f"hold force {held.force:.2f} N" in labels


def test_a_pull_that_did_not_slip_is_a_lower_bound(held):
    firm = dataclasses.replace(held, tug=dataclasses.replace(held.tug, slipped=False))
    assert "or more (tug)" in CastReport(planned(), firm).film_note(11.0)
    labels = [text.get_text() for text in tug_figure(firm).axes[0].get_legend().get_texts()]
    assert f"hold force at least {held.force:.2f} N" in labels
    assert any(f"at least {held.force:.2f}" in value for value, _ in CastReport(planned(), firm).tiles)
    assert any("so it holds more" in told for told in CastReport(planned(), firm).story)


def test_a_long_reason_has_room_in_a_film():
    plan = dataclasses.replace(planned(), message=f"with shorter links {TOO_LONG}")
    lines = CastReport(plan, None).film_note(11.0).split("\n")
    assert "the time allowed for it" in " ".join(lines)
    assert max(len(line) for line in lines) <= 90


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


@pytest.mark.parametrize("strike", [0.3, 1.0, 5.0, 9.0, 10.8])
def test_labels_of_the_course_do_not_lie_on_each_other(strike):
    plan = planned()
    plan = dataclasses.replace(plan, outcome=dataclasses.replace(plan.outcome, strike_time=strike))
    assert overlapping(course_figure(plan)) == []


def test_labels_of_a_miss_and_of_a_tug_do_not_lie_on_each_other(held):
    assert overlapping(course_figure(planned(winds=False))) == []
    assert overlapping(tug_figure(held)) == []
    firm = dataclasses.replace(held, tug=dataclasses.replace(held.tug, slip=0.05 * held.tug.slip, slipped=False))
    figure = tug_figure(firm)
    assert overlapping(figure) == []
    (note,) = figure.axes[1].texts
    assert figure.axes[1].get_window_extent().y1 > note.get_window_extent().y1  # within its panel
