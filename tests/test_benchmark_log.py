"""Rows of long benchmarks: those of a killed run are read, continued and kept intact."""

import json

import pytest
from benchmarks import log

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


def test_rows_of_other_kernels_or_another_planner_are_reported(capsys):
    rows = [{"kernels": SOURCE_HASH, "planner": log.planner()}, {"kernels": SOURCE_HASH}]
    log.warn_of_others(rows)
    assert capsys.readouterr().err == ""
    log.warn_of_others(rows, planned=True)
    assert capsys.readouterr().err == "1 of 2 reused rows were made with other planner: None\n"
    log.warn_of_others([*rows, {"kernels": "0ld"}])
    assert capsys.readouterr().err == "1 of 3 reused rows were made with other kernels: 0ld\n"
