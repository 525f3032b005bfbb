"""Rows of long benchmarks: those of a killed run are read, continued and kept intact."""

import json

import pytest
from benchmarks import log


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
