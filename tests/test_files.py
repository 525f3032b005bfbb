"""files: whole-or-nothing writing, CSV tables, TOML."""

import math
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperflex import files
from hyperflex.errors import FileProblem, InvalidInput
from tests.refusals import fails, refuses


def listing(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir()}


# ---- writing


@pytest.mark.parametrize("raised", [KeyboardInterrupt, ValueError])
@pytest.mark.parametrize("before", [None, "earlier"])
def test_nothing_changes_when_the_block_raises(tmp_path, raised, before):
    path = tmp_path / "out.txt"
    if before:
        path.write_text(before)

    def spoil():
        with files.atomic(path) as file:
            file.write("half of it")
            file.flush()
            raise raised

    with pytest.raises(raised):
        spoil()
    assert listing(tmp_path) == ({"out.txt"} if before else set())
    assert not before or path.read_text() == before


def test_permissions_and_links_stay(tmp_path):
    path, link = tmp_path / "out.txt", tmp_path / "link.txt"
    path.write_text("earlier")
    path.chmod(0o640)
    link.symlink_to(path)
    files.write_text(link, "later")
    assert link.is_symlink()
    assert path.read_text() == "later"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    (tmp_path / "plain").write_text("")
    files.write_text(tmp_path / "ours", "")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_targets_that_cannot_be_written_are_named(tmp_path):
    fails(FileProblem, "is a folder", files.write_text, tmp_path, "")
    fails(FileProblem, r"does not exist\. Create it", files.write_text, tmp_path / "no" / "out.txt", "")
    os.mkfifo(tmp_path / "pipe")
    fails(FileProblem, "device or pipe", files.write_text, tmp_path / "pipe", "")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_reasons_that_name_the_temporary_file_name_the_users(tmp_path):
    def lock():
        with files.atomic_path(tmp_path / "out.nc") as part:
            raise OSError(f"cannot lock {part.name}")  # as HDF5 puts it

    fails(FileProblem, r"written: cannot lock out\.nc\. Nothing was", lock)


def test_another_file_missing_within_the_block_is_named(tmp_path):
    with (
        pytest.raises(FileProblem, match=r"out\.txt could not be written.*other\.txt"),
        files.atomic(tmp_path / "out.txt"),
    ):
        (tmp_path / "other.txt").read_text()


@pytest.mark.parametrize("path", [None, 3, b"out.txt", "out\0.txt"])
def test_what_is_no_path_is_refused(path):
    for use in (files.read_text, lambda path: files.write_text(path, "text")):
        refuses("is no path", use, path)


# ---- tables


def table(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "table.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def numbers(path: Path) -> np.ndarray:
    return files.read_table(path).values


BAD_TABLES = {
    "empty": ("", FileProblem, "is empty"),
    "blank": ("\n\n", InvalidInput, "contains no table"),
    "header only": ("t,th1\n", InvalidInput, "no rows"),
    "no header": ("0.0,1.0\n0.1,1.1\n", InvalidInput, "has no header"),
    "unnamed": ("t,\n0.0,1.0\n", InvalidInput, "without a name"),
    "brackets": ("[(\n0.0,1.0\n", InvalidInput, "header's number of cells"),
    "repeated": ("t,th1,th1\n0.0,1.0,1.0\n", InvalidInput, "same name.*'th1'"),
    "binary": (b"\x89HDF\r\n\x1a\n\x00\xff", FileProblem, "not a text table"),
    "null bytes": (b"t,th1\n\x00,1\n", FileProblem, "binary"),
    "utf-16": ("t,th1\n0,1\n".encode("utf-16")[:-1], FileProblem, "UTF-16 text that cannot be read"),
}


@pytest.mark.parametrize(("text", "error", "match"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_bad_tables_are_refused_with_their_place(tmp_path, text, error, match):
    with pytest.raises(error, match=match):
        _ = files.read_table(table(tmp_path, text)).values


FULL = {
    "fixed": ["0.474113", "-0.480021", "10.500000", "-0.474113"],
    "exponents": ["4.741130e-01", "-1.200000e-05", "3.000000e+00", "-4.741130e-01"],
    "shortest": ["0.4741130012345", "0.1", "12.48002100071", "-0.380021987001", "0.47411"],
    "varying": ["0", "0.25", "0.5", "0.75", "1"],
    "whole": ["640", "639", "97", "64"],
    "gap": ["0.25", "", "0.50", "nan"],
}


@pytest.mark.parametrize("cells", FULL.values(), ids=FULL.keys())
def test_a_full_last_cell_needs_no_line_feed(tmp_path, cells):
    text = "t,th1\n" + "\n".join(f"{k},{cell}" for k, cell in enumerate(cells))
    values = files.read_table(table(tmp_path, text)).values
    np.testing.assert_array_equal(values[:, 1], [float(cell or "nan") for cell in cells])


CUT = {
    "fixed": ([f"{0.474113 - 0.01 * k:.6f}" for k in range(60)], "-0.474113"),
    "exponents": (["4.741130e-01", "-1.200000e-05", "3.000000e+00"], "-4.741130e-01"),
    "whole": (["640", "639", "638", "-641"], "-640"),
}


@pytest.mark.parametrize(("cells", "last"), CUT.values(), ids=CUT.keys())
def test_a_number_cut_off_anywhere_is_refused(tmp_path, cells, last):
    text = "t,th1\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells)) + "9,"
    for length in range(1, len(last)):
        refuses(f"line {len(cells) + 2}.*cut off", numbers, table(tmp_path, text + last[:length]))
        whole = last[:length].rstrip("-e.+")
        if whole:  # with a line feed it is what it is
            assert numbers(table(tmp_path, f"{text}{whole}\n"))[-1, 1] == float(whole)
    assert numbers(table(tmp_path, text + last))[-1, 1] == float(last)


def test_a_long_number_cut_off_in_a_column_of_shortest_forms_is_refused(tmp_path):
    text, last = "t,th1\n" + "".join(f"{k},{math.sin(k)!r}\n" for k in range(200)), f"200,{math.sin(200)!r}"
    refuses(r"line 202.*add a line feed if it is whole", numbers, table(tmp_path, text + last[:12]))
    assert numbers(table(tmp_path, text + last))[-1, 1] == math.sin(200)


@given(st.lists(st.lists(st.floats(-1e100, 1e100) | st.just(math.nan), min_size=2, max_size=2), min_size=1, max_size=5))
def test_tables_come_back_bit_for_bit(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("t") / "table.csv"
    files.write_table(path, ["t", "x, y"], rows, notes={"unit": "m"})
    assert files.read_table(path).names == ["t", "x, y"]
    values = numbers(path)
    np.testing.assert_array_equal(values, np.array(rows))  # equal, not close: repr of a float is exact
    np.testing.assert_array_equal(np.signbit(values[values == 0.0]), np.signbit(np.array(rows)[values == 0.0]))


def test_table_that_does_not_fit_its_names_is_refused(tmp_path):
    refuses("any x 2", files.write_table, tmp_path / "t.csv", ["a", "b"], [[1.0, 2.0, 3.0]])
    refuses("same name", files.write_table, tmp_path / "t.csv", ["a", "a"], [[1.0, 2.0]])
    assert listing(tmp_path) == set()


# ---- TOML

KEYS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
)
VALUES = st.one_of(
    SCALARS,
    st.lists(st.floats(allow_nan=False), max_size=4),
    st.lists(st.dictionaries(KEYS, SCALARS, max_size=3), max_size=3),
)
TABLES = st.recursive(
    st.dictionaries(KEYS, VALUES, max_size=4), lambda inner: st.dictionaries(KEYS, VALUES | inner, max_size=4)
)


@given(TABLES)
def test_toml_comes_back_equal(content):
    assert files.loads_toml(files.dumps_toml(content)) == content  # floats equal, not close: repr is exact


def test_toml_takes_numpy_and_odd_numbers(tmp_path):
    path = tmp_path / "rope.toml"
    files.write_toml(path, {"rope": {"mass": np.array([0.1, 1e-16]), "n": np.int64(3), "limit": math.inf}})
    assert files.read_toml(path) == {"rope": {"mass": [0.1, 1e-16], "n": 3, "limit": math.inf}}


def test_toml_refuses_what_it_cannot_hold(tmp_path):
    refuses(r"rope\.mass cannot be written", files.write_toml, tmp_path / "a.toml", {"rope": {"mass": None}})
    assert listing(tmp_path) == set()


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [("", FileProblem, "empty"), ("mass = \n", InvalidInput, "line 1"), ("[rope\n", InvalidInput, "rope.toml")],
)
def test_bad_toml_is_refused(tmp_path, text, error, match):
    path = tmp_path / "rope.toml"
    path.write_text(text)
    fails(error, match, files.read_toml, path)
