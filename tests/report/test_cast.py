"""Report of a planned cast: what a reader must find, in the film and on the page."""

from __future__ import annotations

import dataclasses
import io
import re

import numpy as np
import pytest
from PIL import Image

from hyperflex.casting.hold import holding
from hyperflex.report.animation import animate
from hyperflex.report.cast import film_note, write_cast
from hyperflex.report.cast_figures import course_figure, strike_figure, tug_figure
from hyperflex.report.style import png
from tests.casting.known import PEG, planned, unreachable


def opened(path):
    return Image.open(io.BytesIO(path.read_bytes()))


def words_of(path):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>|src=\"data:[^\"]*\"", " ", path.read_text("utf-8")))


@pytest.fixture(scope="module")
def held():
    return holding(planned().cast.run, PEG)


def test_the_page_names_target_swings_turns_and_hold(tmp_path):
    files, held = write_cast(tmp_path / "out", planned())
    page = words_of(files["page"])
    for told in (
        "x = -0.834 m, y = -1.07 m",
        "radius 40 mm",
        "6 swings",
        "begun at 0.48, 1.73, 2.85, 4.35, 5.65, 6.74 s",
        "strikes the target at 7.65 s",
        "2.36 turns",
        "clockwise",
        f"bore {held.force:.2f} N",
        f"{held.rule:.2f} N",
        "simulated",
        "8.61 rad/s",
        "links of half the length",
    ):
        assert told in page, told
    assert "counterclockwise" not in page


def test_a_plan_without_a_throw_is_a_page_with_the_reason(tmp_path):
    files, held = write_cast(tmp_path / "out", unreachable())
    assert held is None
    assert list(files) == ["page"]
    assert "out of reach: the rope ends" in words_of(files["page"])


def test_the_film_tells_the_course(held):
    note = film_note(planned(), held)
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
    note = film_note(planned(winds=False), None)
    assert "FAILS: the rope does not touch the peg" in note(planned(winds=False).cast.run.t[-1])


def test_the_target_is_drawn_as_large_as_it_is(tmp_path):
    run = planned(winds=False).cast.run
    animate(run, tmp_path / "a.gif", end=0.1, frame_rate=10, width=300, note=lambda _: "one\ntwo")
    frame = np.asarray(opened(tmp_path / "a.gif").convert("RGB"))
    _, columns = np.nonzero((frame[..., 0] > 180) & (frame[..., 1] < 120))
    across = np.ptp(columns) + 1
    seen = np.concatenate([run.joints.reshape(-1, 2), [[PEG.x - 0.04, PEG.y - 0.04], [PEG.x + 0.04, PEG.y + 0.04]]])
    wide, tall = np.ptp(seen, axis=0)
    margin = 0.06 * max(wide, tall)  # on each side, and twice above
    view = max(wide + 2.0 * margin, (tall + 3.0 * margin) / 1.15)  # a tall view is widened
    assert across == pytest.approx(300 * 0.08 / view, abs=1.5)  # whole pixels


def test_a_film_has_room_for_its_words(tmp_path):
    run = planned(winds=False).cast.run
    heights = []
    for note in (None, lambda _: "one", lambda _: "one\ntwo\nthree"):
        animate(run, tmp_path / "a.gif", end=0.1, frame_rate=10, width=200, note=note)
        heights.append(opened(tmp_path / "a.gif").height)
    assert heights == [heights[0], heights[0] + 36, heights[0] + 72]


def test_the_course_marks_the_strike_and_counts_the_swings():
    figure = course_figure(planned())
    arm, turns = figure.axes[:2]
    texts = [text.get_text() for text in arm.texts]
    assert texts == ["1", "2", "3", "4", "5", "6", "last"]
    assert any(line.get_xdata()[0] == planned().cast.strike for line in arm.get_lines())
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
    assert "or more (tug)" in film_note(planned(), firm)(11.0)
