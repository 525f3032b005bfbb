"""Keys of a set-up file: what each table may hold, and where a key that stands in the wrong one belongs."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model.arm import Arm
from hyperflex.model.obstacles import KINDS
from hyperflex.model.rope import Rope
from hyperflex.model.rope_table import keys_of
from hyperflex.motion import motion_keys


def check_tables(name: str, content: Mapping[str, Any], top: Sequence[str]) -> None:
    """Refuse tables that are none, and keys that are not known where they stand, with where they belong.

    `top` are the keys of the file's top, `name` the file.
    """
    known: dict[str, Sequence[str]] = {
        "rope": keys_of([f.name for f in fields(Rope)]),
        "arm": [f.name for f in fields(Arm)],
        **{table: [f.name for f in fields(kind)] for table, kind in KINDS.items()},
    }
    for table in ("motion", "torque"):
        spec = content.get(table)
        known[table] = motion_keys(spec.get("kind") if isinstance(spec, Mapping) else None)
    places = {f"in the table [{table}]": keys for table, keys in known.items()}
    places["at the top, above all tables"] = [each for each in top if each not in known]
    checks.keys(f"{name}", content, (*known, *top), needed=("rope",), elsewhere=places)
    for table, keys in known.items():
        if table in content and not isinstance(content[table], Mapping):
            raise InvalidInput(f"{name}: {table} is not a table", got=content[table], allowed=f"[{table}]")
        if table in content:
            checks.keys(f"{name}, table [{table}]", content[table], keys, elsewhere=places)
