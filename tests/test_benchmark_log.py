"""Rows of long benchmarks: what a killed run leaves is read, gone on with, and not mixed up."""

import json

import pytest
from benchmarks import log, throws

from hyperflex.core.cache import SOURCE_HASH


@pytest.mark.parametrize(
    ("tail", "kept"),
    [
        ("", [1, 2]),
        ('{"n": 3, "of": {"a": 1}', [1, 2]),  # ends as a row does
        ('{"n": 3', [1, 2]),
        ("[3]", [1, 2]),
        ('{"n": 3}', [1, 2, 3]),  # lacks nothing but the end of its line
    ],
)
def test_half_a_line_is_cut_off_before_the_next(tmp_path, tail, kept):
    path = tmp_path / "rows.jsonl"
    path.write_text('{"n": 1}\n{"n": 2}\n' + tail)
    assert [row["n"] for row in log.read(path)] == kept
    log.append(path, {"n": 9})
    assert [json.loads(line)["n"] for line in path.read_text().splitlines()] == [*kept, 9]


def test_a_first_row_makes_the_file_and_rows_that_ran_together_are_left_out(tmp_path):
    path = tmp_path / "new" / "rows.jsonl"
    assert log.read(path) == log.read(None) == []
    log.append(path, {"n": 1})
    assert log.read(path) == [{"n": 1}]
    path.write_text('{"n": 1}\n{"n": 2, "na{"n": 3}\n\n{"n": 4}\n')
    assert [row["n"] for row in log.read(path)] == [1, 4]


def test_rows_of_other_kernels_or_another_planner_are_told(capsys):
    rows = [{"kernels": SOURCE_HASH, "planner": log.planner()}, {"kernels": SOURCE_HASH}]
    log.told(rows)
    assert capsys.readouterr().err == ""
    log.told(rows, planned=True)
    assert capsys.readouterr().err == "1 of 2 rows used again come from other planner: None\n"
    log.told([*rows, {"kernels": "0ld"}])
    assert capsys.readouterr().err == "1 of 3 rows used again come from other kernels: 0ld\n"


def test_throws_with_other_links_are_not_used_again(tmp_path):
    path = tmp_path / "throws.jsonl"
    log.append(path, {"index": 0, "kernels": "0ld"})  # as rows were before they said it
    log.append(path, {"index": 1, "fine": True, "kernels": SOURCE_HASH})
    log.append(path, {"index": 2, "max_bend": 0.8, "kernels": SOURCE_HASH})
    kinds = [{"fine": fine, "max_bend": limit} for fine, limit in ((False, None), (True, None), (False, 0.8))]
    assert [[row["index"] for row in throws.done(path, kind)] for kind in kinds] == [[0], [1], [2]]
