"""Tables and pages: complete in one file, escaped, and true to what was measured."""

import re

import pytest

from hyperflex import files
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.paper import READINGS, Claim, reproduce
from hyperflex.report.page import Picture, Section, TextTable, markdown, write_page

PNG = b"\x89PNG\r\n\x1a\n"


def test_markdown_is_aligned_and_escapes_bars():
    text = markdown(TextTable(("a", "long name"), (("|x|", "1"), ("2", "3"))))
    assert text == "| a     | long name |\n|-------|-----------|\n| \\|x\\| | 1         |\n| 2     | 3         |"


def test_a_claim_may_bound_from_above():
    assert Claim("C9", "s", READINGS[0], 0.5, 1.0, relation="<=").holds
    assert not Claim("C9", "s", READINGS[0], 1.5, 1.0, relation="<=").holds


def test_a_page_is_one_file_that_escapes_and_fetches_nothing(tmp_path):
    table = TextTable(("name", "verdict"), (("<script>", "holds"),))
    sections = [Section("A & B", text=("x < y",), pictures=(Picture(PNG, 'say "cheese"'),), table=table, notes=("n",))]
    write_page(tmp_path / "page.html", "Title", "Lead", "simulated", sections)
    text = (tmp_path / "page.html").read_text("utf-8")
    assert "A &amp; B" in text
    assert "x &lt; y" in text
    assert "<script>" not in text
    assert 'class="good"' in text
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    assert "http" not in text


def test_on_a_phone_charts_scroll_and_other_pictures_fit(tmp_path):
    pictures = (Picture(PNG, "a chart"), Picture(PNG, "a strobe", chart=False))
    write_page(tmp_path / "page.html", "Title", "Lead", "simulated", [Section("A", pictures=pictures)])
    text = (tmp_path / "page.html").read_text("utf-8")
    assert re.findall(r'<figure( class="chart")?><img.*alt="(.*?)"', text) == [
        (' class="chart"', "a chart"),
        ("", "a strobe"),
    ]
    assert ".chart { overflow-x: auto; }" in text


def test_a_page_goes_whole_or_not_at_all(tmp_path):
    with pytest.raises(FileProblem, match="does not exist"):
        write_page(tmp_path / "no" / "page.html", "Title", "Lead", "simulated", [])


def test_reproduce_writes_pictures_tables_claims_and_a_page(tmp_path):
    told = []
    result = reproduce(["fig10", "fig9"], tmp_path / "new" / "folder", progress=told.append)
    names = [path.name for path in result.files]
    assert names == ["fig9.csv", "fig9.png", "fig10.csv", "fig10.png", "claims.md", "report.html"]
    assert all(path.stat().st_size > 500 for path in result.files)
    columns, values, *_ = files.read_table(tmp_path / "new" / "folder" / "fig10.csv")
    assert columns[:3] == ["t", "x_under_relative_success", "y_under_relative_success"]
    assert values.shape == (1401, 17)
    assert files.read_table(tmp_path / "new" / "folder" / "fig10.csv").notes["source"] == "simulated"
    text = (tmp_path / "new" / "folder" / "claims.md").read_text("utf-8")
    assert text.count("| C") == 16
    assert text.count("does not hold") == sum(not each.holds for each in result.claims)
    assert told[0] == "simulating the casts"


def test_reproduce_refuses_unknown_figures_and_files_in_the_way(tmp_path):
    with pytest.raises(InvalidInput, match="fig14"):
        reproduce(["fig14"], tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "taken").write_text("x")
    with pytest.raises(FileProblem, match="not a folder"):
        reproduce(["fig9"], tmp_path / "taken")
