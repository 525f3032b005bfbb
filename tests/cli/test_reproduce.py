"""``hyperflex reproduce``: files, verdicts, and errors as JSON."""

import operator
from pathlib import Path

import pytest

from hyperflex.paper import casting
from hyperflex.paper.part import Item


def test_reproduce_writes_files_and_verdicts(hyperflex, hyperflex_json, tmp_path):
    code, out, _ = hyperflex("reproduce", "fig9", "-o", tmp_path / "paper")
    assert (code, "C2 holds in all 4 cases." in out) == (0, True)
    code, result = hyperflex_json("reproduce", "fig9", "-o", tmp_path / "paper")
    assert code == 0
    assert all(Path(path).exists() for path in result["files"])
    assert {claim["claim"] for claim in result["claims"]} == {"C1", "C2", "C3", "C4"}
    compare = {">=": operator.ge, "<=": operator.le}
    for claim in result["claims"]:
        assert claim["holds"] == compare[claim["relation"]](claim["measured"], claim["threshold"])


def test_an_unknown_figure_is_refused(hyperflex_json, tmp_path):
    code, result = hyperflex_json("reproduce", "fig14", "-o", tmp_path / "paper")
    assert code == 2
    assert "fig14" in result["error"]
    assert not (tmp_path / "paper").exists()


def test_ctrl_c_while_drawing_leaves_the_figures_that_are_done(hyperflex_json, tmp_path, monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setitem(casting.PART.items, "fig10", Item(casting.PART.items["fig10"].table, interrupted))
    (tmp_path / "report.html").write_text("an earlier run's")
    code, result = hyperflex_json("reproduce", "fig9", "fig10", "-o", tmp_path)
    assert (code, result["error"]) == (130, "interrupted")
    assert sorted(result["files"]) == sorted(path.name for path in tmp_path.iterdir()) == ["fig9.csv", "fig9.png"]
    assert "the claims" in result["missing"]
    assert str(tmp_path / "fig9.png") in result["message"]


@pytest.mark.nightly
def test_a_figure_on_identification_comes_with_its_own_claims(hyperflex_json, tmp_path):
    code, result = hyperflex_json("reproduce", "fig3", "-o", tmp_path / "paper")
    assert code == 0
    assert {claim["claim"] for claim in result["claims"]} == {"C6", "C7"}
    assert {claim["in"] for claim in result["claims"]} == {
        "swing of 0.15 rad, data from 5 links",
        "swing of 1 rad, data from 5 links",
    }
    assert all("path" not in claim for claim in result["claims"])
    names = {path.name for path in (tmp_path / "paper").iterdir()}
    assert names == {"fig3.png", "fig3.csv", "claims.md", "report.html"}
