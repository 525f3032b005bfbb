"""Figs. 3, 5, 6 and Tables I, II on identification: what they show, and what their files hold."""

import numpy as np
import pytest

from hyperflex import files
from hyperflex.paper import READINGS, Claim, casting, identification, reproduce, verdicts
from hyperflex.paper.identification import PART, SMALL, SWINGS, WIDE, methods, record, revised, settles
from hyperflex.report import BLUE, RED


@pytest.fixture
def few_counts(monkeypatch):
    """Fig. 6 with two counts in place of nine, and no finer chain: seconds in place of half a minute."""
    monkeypatch.setattr(identification, "COUNTS", (22, 81))
    monkeypatch.setattr(identification, "CURVES", {SMALL: BLUE, WIDE: RED})


def test_fig5_shows_circles_where_it_was_measured_and_what_is_left():
    top, below = identification.draw_fig5().axes
    circles = next(line for line in top.get_lines() if line.get_label() == "measured")
    assert circles.get_linestyle() == "None"
    np.testing.assert_array_equal(circles.get_ydata(), record(SMALL).data[:, -1])
    left = {line.get_color(): np.sqrt(np.mean(line.get_ydata() ** 2)) for line in below.get_lines()}
    revised_left, guessed_left = left[BLUE], left[RED]
    assert revised_left < 12.0 < guessed_left  # mrad; the noise is 10
    table = identification.fig5()
    away = table.columns["measured_5"] - table.columns["calculated_5"]
    assert 1e3 * np.sqrt(np.mean(away**2)) == pytest.approx(revised_left, rel=1e-3)


@pytest.mark.nightly
def test_fig6_has_a_curve_for_each_swing_and_the_papers_two_values(few_counts):
    axis = identification.draw_fig6().axes[0]
    drawn = {line.get_label(): line for line in axis.get_lines()}
    table = identification.fig6()
    for swing in SWINGS:
        np.testing.assert_array_equal(drawn[swing.title].get_ydata(), table.columns[f"error_{swing.key}"])
    np.testing.assert_array_equal(drawn["the paper"].get_xydata(), [[22, 0.046], [81, 0.040]])
    assert axis.get_ylim()[0] == 0.0


@pytest.mark.nightly
def test_tables_hold_the_rounds_and_the_methods():
    rounds, compared = identification.table1(), identification.table2()
    own = (rounds.columns["angle"] == SMALL.angle) & (rounds.columns["data_links"] == SMALL.links)
    np.testing.assert_array_equal(rounds.columns["inertia"][own], [each.inertia for each in revised(SMALL).rounds])
    own = (compared.columns["angle"] == SMALL.angle) & (compared.columns["data_links"] == SMALL.links)
    np.testing.assert_array_equal(compared.columns["error"][own], [each.error for each in methods(SMALL)])
    assert compared.notes["methods"].startswith("0: NF; 1: CM; 2: IR")
    assert "1.61 s" in compared.notes["periods"]
    cells = PART.items["table1"].sections()[0].table.rows
    assert cells[0] == ("the paper", "0", "5.09", "1.26", "", "4.64")
    assert any(row[1] == "std" for row in cells)
    assert ("the paper", "NF", "102", "", "", "16.3") in PART.items["table2"].sections()[0].table.rows


def test_both_parts_go_to_one_page_in_the_papers_order(tmp_path, monkeypatch):
    """Of each part one claim is measured; tests/claims measures all."""
    for part, claim, case in ((PART, settles, SMALL), (casting.PART, casting.linearized, READINGS[0])):
        monkeypatch.setitem(vars(part), "measures", {claim: [case]})
    result = reproduce(["fig9", "fig3"], tmp_path)
    assert [path.name for path in result.files][:4] == ["fig3.csv", "fig3.png", "fig9.csv", "fig9.png"]
    notes = files.read_table(tmp_path / "fig3.csv").notes
    assert notes["source"] == "simulated"
    assert "inferred" in notes["parameters"]
    text = (tmp_path / "claims.md").read_text("utf-8")
    assert 0 <= text.index("# Identifying a rope") < text.index("# Casting a rope")
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Claims: Identifying a rope" in page
    assert "Claims: Casting a rope" in page


def test_a_claim_of_several_measurements_holds_where_all_of_them_do():
    def claim(swing, measured):
        return Claim("C6", "a statement", swing, measured, 1.0)

    (sentence,) = verdicts([claim(SMALL, 2.0), claim(WIDE, 2.0), claim(SMALL, 0.0), claim(WIDE, 2.0)])
    assert sentence == f"C6 holds in 1 of 2 cases, not in these: {SMALL.title}."
