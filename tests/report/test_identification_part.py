"""Figs. 3, 5, 6 and Tables I, II on identification: what they show, and what their files hold."""

from __future__ import annotations

import numpy as np
import pytest

from hyperflex import files
from hyperflex.paper import Claim
from hyperflex.paper import identification as results
from hyperflex.paper.identification import SMALL, SWINGS, WIDE, Swing, methods, record, revised
from hyperflex.paper.report import identification
from hyperflex.paper.report.part import verdicts, write_part
from hyperflex.paper.report.reproduce import reproduce


@pytest.fixture
def few_counts(monkeypatch):
    """Fig. 6 with two counts in place of nine, and no finer chain: seconds in place of half a minute."""
    monkeypatch.setattr(results, "COUNTS", (22, 81))
    monkeypatch.setattr(results, "CURVES", SWINGS)
    monkeypatch.setattr(identification, "CURVES", SWINGS)


def test_fig3_shows_both_starts_of_every_link():
    figure = identification.fig3()
    assert len(figure.axes) == 2 * len(SWINGS)
    table = results.fig3()
    for axis, swing in zip(figure.axes[::2], SWINGS, strict=True):
        drawn = {line.get_label(): line.get_ydata() for line in axis.get_lines()}
        for name in ("measured", "optimised"):
            away = 1e3 * (table.columns[f"{name}_{swing.key}"] - swing.angle)
            np.testing.assert_allclose(drawn[name], away, rtol=1e-12)
    labels = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert f"E = {revised(SMALL).best.measured_start:.4f} rad²" in labels
    assert f"E = {revised(SMALL).error:.4f} rad²" in labels


def test_fig5_shows_circles_where_it_was_measured_and_what_is_left():
    top, below = identification.fig5().axes
    circles = next(line for line in top.get_lines() if line.get_label() == "measured")
    assert circles.get_linestyle() == "None"
    np.testing.assert_array_equal(circles.get_ydata(), record(SMALL).data[:, -1])
    left = {line.get_color(): np.sqrt(np.mean(line.get_ydata() ** 2)) for line in below.get_lines()}
    revised_left, guessed_left = left[identification.BLUE], left[identification.RED]
    assert revised_left < 12.0 < guessed_left  # mrad; the noise is 10
    table = results.fig5()
    away = table.columns["measured_5"] - table.columns["calculated_5"]
    assert 1e3 * np.sqrt(np.mean(away**2)) == pytest.approx(revised_left, rel=1e-3)


def test_fig6_has_a_curve_for_each_swing_and_the_papers_two_values(few_counts):
    axis = identification.fig6().axes[0]
    drawn = {line.get_label(): line for line in axis.get_lines()}
    table = results.fig6()
    for swing in SWINGS:
        np.testing.assert_array_equal(drawn[swing.title].get_ydata(), table.columns[f"error_{swing.key}"])
    np.testing.assert_array_equal(drawn["the paper"].get_xydata(), [[22, 0.046], [81, 0.040]])
    assert axis.get_ylim()[0] == 0.0


@pytest.mark.nightly
def test_tables_hold_the_rounds_and_the_methods():
    rounds, compared = results.table1(), results.table2()
    own = (rounds.columns["angle"] == SMALL.angle) & (rounds.columns["data_links"] == SMALL.links)
    np.testing.assert_array_equal(rounds.columns["inertia"][own], [each.inertia for each in revised(SMALL).rounds])
    own = (compared.columns["angle"] == SMALL.angle) & (compared.columns["data_links"] == SMALL.links)
    np.testing.assert_array_equal(compared.columns["error"][own], [each.error for each in methods(SMALL)])
    assert compared.notes["methods"].startswith("0: NF; 1: CM; 2: IR")
    assert "1.61 s" in compared.notes["periods"]
    cells = identification.rounds_table().rows
    assert cells[0] == ("the paper", "0", "5.09", "1.26", "", "4.64")
    assert any(row[1] == "std" for row in cells)
    assert ("the paper", "NF", "102", "", "16.3") in identification.methods_table().rows


def test_files_say_that_they_are_simulated(tmp_path):
    written = []
    done = write_part(identification.PART, ["fig5"], tmp_path, lambda _: None, written.append)
    assert written == [tmp_path / "fig5.png", tmp_path / "fig5.csv"]
    notes = files.read_table(tmp_path / "fig5.csv").notes
    assert notes["source"] == "simulated"
    assert "inferred" in notes["parameters"]
    names, values, *_ = files.read_table(tmp_path / "fig5.csv")
    assert names[0] == "t"
    assert values.shape == (81, 11)
    assert {claim.name for claim in done.claims} == {"C6", "C7"}


def test_both_parts_go_to_one_page_in_the_papers_order(tmp_path):
    result = reproduce(["fig9", "fig3"], tmp_path)
    assert [path.name for path in result.files][:4] == ["fig3.png", "fig3.csv", "fig9.png", "fig9.csv"]
    text = (tmp_path / "claims.md").read_text("utf-8")
    assert 0 <= text.index("# Claims of the paper on identification") < text.index("# Claims of the paper on casting")
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Claims: identifying a rope" in page
    assert "Claims: casting a rope" in page


def test_a_claim_of_several_measurements_holds_where_all_of_them_do():
    def claim(swing: Swing, measured: float) -> Claim:
        return Claim("C6", "a statement", swing, measured, 1.0)

    (sentence,) = verdicts([claim(SMALL, 2.0), claim(WIDE, 2.0), claim(SMALL, 0.0), claim(WIDE, 2.0)])
    assert sentence == f"C6 holds in 1 of 2 swings ({WIDE.title}), not in the others ({SMALL.title})."
