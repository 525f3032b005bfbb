"""Whole-or-nothing writing, and reading of number tables (CSV) and settings (TOML): the ground floor, beside errors.

A file is written under a temporary name in the same folder, forced to the disk and then renamed, so that whoever looks
sees the earlier file or the complete new one, never a part: not after a full disk, a crash or Ctrl-C either.
"""

from __future__ import annotations

from hyperflex.files.json import dumps_json, plain, write_json
from hyperflex.files.reading import read_bytes, read_text
from hyperflex.files.tables import read_notes, read_table, write_table
from hyperflex.files.toml import dumps_toml, loads_toml, read_toml, write_toml
from hyperflex.files.writing import PathLike, as_path, atomic, atomic_path, write_text

__all__ = [
    "PathLike",
    "as_path",
    "atomic",
    "atomic_path",
    "dumps_json",
    "dumps_toml",
    "loads_toml",
    "plain",
    "read_bytes",
    "read_notes",
    "read_table",
    "read_text",
    "read_toml",
    "write_json",
    "write_table",
    "write_text",
    "write_toml",
]
