"""Report of a planned whip: what a reader must find, in the film and on the page."""

from __future__ import annotations

import html
import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import hyperflex as hf
from hyperflex.report import Overlay, WhipReport, animate, png, strobe_figure
from tests.planning.known_whip import far_whip, planned_whip


def course_figure(plan):
    return WhipReport(plan).figures()["course"]


def passing_figure(plan):
    return WhipReport(plan).figures()["passing"]


def peak_figure(plan):
    return WhipReport(plan).figures()["peak"]


def words_of(path):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>|src=\"data:[^\"]*\"", " ", path.read_text("utf-8")))


def test_the_page_names_target_strokes_peak_and_impact(tmp_path):
    plan = planned_whip()
    impact = plan.impact()
    files = WhipReport(plan, impact).write(tmp_path / "out")
    page = words_of(files["page"])
    for told in (
        "x = {:.4g} m, y = {:.4g} m".format(*plan.target.point),
        "within 17.2 degrees of the direction 179 (0 is",
        "3 strokes",
        "speed peaks at 1.29 m/s",
        "0.5 mm from the target",
        f"takes up {1e3 * impact.impulse:.1f} mN s",
        "5.7 degrees",
        "standard deviation of 4 mm",
        "links of half the length",
        f"{1e3 * plan.finer_outcome.miss:.2g} mm",
        "8.61 rad/s",
        "simulated",
    ):
        assert told in page, told


def test_a_plan_without_strokes_is_a_page_with_the_reason(tmp_path):
    files = WhipReport(far_whip(), None).write(tmp_path / "out")
    assert list(files) == ["page"]
    assert "out of reach: the rope ends" in words_of(files["page"])


def test_what_the_finer_run_lacks_is_a_warning_of_a_plan_that_succeeds(tmp_path):
    plan, message = planned_whip(), "the tip's speed is 4.20 m/s, and 5 is asked"
    assert WhipReport(plan, None).warning == ""
    short = replace(plan, finer_outcome=replace(plan.finer_outcome, message=message))
    assert WhipReport(short, None).warning == f"With links of half the length {message}."
    page = words_of(WhipReport(short, None).write(tmp_path)["page"])
    assert f"With links of half the length {message}." in html.unescape(page)
    assert WhipReport(replace(short, message="it misses"), None).warning == ""


def test_the_film_tells_the_course():
    plan = planned_whip()
    note = WhipReport(plan, None).film_note
    assert "3 strokes to come" in note(0.01)
    assert "stroke 1 of 3" in note(0.2)
    assert "m/s or more" in note(0.0)
    assert "passes it" not in note(1.5)
    assert "passes it at 1.90 s: 1.3 m/s, 0.5 mm off" in note(1.95)
    assert "FAILS: the tip misses" in WhipReport(planned_whip(meets=False), None).film_note(1.95)


def test_the_way_past_the_target_is_centred_on_it():
    figure = passing_figure(planned_whip(meets=False))
    axis = figure.axes[0]
    target, tip = (line for line in axis.get_lines() if line.get_marker() == "o")
    assert (target.get_xdata()[0], target.get_ydata()[0]) == (0.0, 0.0)
    np.testing.assert_allclose([tip.get_xdata()[0], tip.get_ydata()[0]], [-18.0, -24.0], atol=1e-9)  # mm
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any("30 mm off" in word for word in words)
    assert any("required direction" in word for word in words)
    free = passing_figure(planned_whip(any_direction=True)).legends[0].get_texts()
    assert not any("required direction" in text.get_text() for text in free)


def test_the_course_marks_the_peak_and_counts_the_strokes():
    plan = planned_whip()
    figure = course_figure(plan)
    arm, speed = figure.axes[:2]
    assert [text.get_text() for text in arm.texts] == ["1", "2", "3"]
    assert any(line.get_xdata()[0] == plan.outcome.t for line in speed.get_lines())
    assert any("peak at 1.90 s" in text.get_text() for text in speed.texts)


@pytest.mark.parametrize("meets", [True, False])
def test_pictures(meets):
    plan = planned_whip(meets)
    for figure in (peak_figure(plan), passing_figure(plan), course_figure(plan)):
        assert png(figure, dpi=40).startswith(b"\x89PNG")


def test_a_ring_stands_round_the_target(tmp_path):
    run = planned_whip().run
    far = np.array([[1.5, 0.5]])  # beyond all that the rope reaches: the view must grow
    animate(run, tmp_path / "a.gif", end=0.1, frame_rate=10, width=300, overlay=Overlay(targets=far))
    frame = np.asarray(Image.open(io.BytesIO((tmp_path / "a.gif").read_bytes())).convert("RGB"))
    rows, columns = np.nonzero((frame[..., 0] > 150) & (frame[..., 1] < 120))
    assert 18 <= np.ptp(columns) + 1 <= 26  # a ring of 15 points and its line at 100 dots an inch: 23 pixels
    assert columns.min() > 200
    assert rows.max() < 0.4 * frame.shape[0]
    axis = strobe_figure(run, start=0.5, end=1.0, count=4, overlay=Overlay(targets=far)).axes[0]
    assert axis.get_xlim()[1] > 1.5


def test_a_tall_picture_is_widened():
    run = planned_whip().run
    figure = strobe_figure(run, start=0.0, end=0.05, count=4)
    width, height = figure.get_size_inches()
    assert height == pytest.approx(1.15 * width)


def test_the_page_tells_what_the_rope_touches_after_the_peak(tmp_path):
    plan = planned_whip()
    assert "After the peak" not in " ".join(WhipReport(plan, None).story)
    later = replace(plan, outcome=replace(plan.outcome, touches_later="the wall at (0.3, -1.5) m at 1.95 s"))
    told = "After the peak the rope touches the wall at (0.3, -1.5) m at 1.95 s, if nothing stops it."
    assert told in WhipReport(later, None).story
    assert told in html.unescape(words_of(WhipReport(later, None).write(tmp_path)["page"]))


def test_obstacles_are_drawn_beside_the_target():
    plan = planned_whip()
    x, y = plan.target.point
    walls = (hf.Wall(x + 0.05, y - 1.0, x + 0.05, y + 0.02), hf.Peg(x, y - 0.05, 0.01), hf.Ground(0.0, y - 0.1))
    for each, name in zip(walls, ("wall", "peg", "ground"), strict=True):
        beside = replace(plan, problem=replace(plan.problem, obstacles=(each,)))
        words = [text.get_text() for text in passing_figure(beside).legends[0].get_texts()]
        assert f"{name}, an obstacle" in words
        far = replace(each, y=each.y - 9.0, **({"y2": each.y2 - 9.0} if name == "wall" else {}))
        beside = replace(plan, problem=replace(plan.problem, obstacles=(far,)))
        words = [text.get_text() for text in passing_figure(beside).legends[0].get_texts()]
        assert f"{name}, an obstacle" not in words
