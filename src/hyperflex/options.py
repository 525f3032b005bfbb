"""Options: dataclass fields that carry their unit, sign and help.

:func:`check` validates them, a set-up file's table and the command line are made from them: an option is declared once.
"""

import math
from dataclasses import Field, field, fields
from functools import cache
from typing import Any, get_args

from hyperflex import checks
from hyperflex.checks import ByName, Sign
from hyperflex.errors import InvalidInput


def option(
    default: Any, text: str, unit: str = "", *, sign: Sign = "any", infinite: bool = False, shown: str = ""
) -> Any:
    """Return a dataclass field for an option.

    Parameters
    ----------
    default
        Its default; None if the option may be absent.
    text : str
        What it is: a phrase without a full stop, which the command line shows with unit and default.
    unit, sign, infinite
        As of :func:`hyperflex.checks.number`. An option without a unit may be a text, a flag or a count.
    shown : str
        What the command line shows in place of the default ("any", "five periods").
    """
    metadata = {"help": text, "unit": unit, "sign": sign, "infinite": infinite, "shown": shown}
    return field(default=default, metadata=metadata)


@cache
def options_of(kind: type) -> tuple[Field[Any], ...]:
    """Return the fields of a dataclass that are options."""
    return tuple(each for each in fields(kind) if "help" in each.metadata)


@cache
def _rules(kind: type) -> tuple[tuple[str, Any, int, ByName], ...]:
    """Return name, default, length (-1: any) and the rule for its number or numbers, of each option of a dataclass."""
    return tuple(
        (
            each.name,
            each.default,
            len(each.default) if isinstance(each.default, tuple) and Ellipsis not in get_args(each.type) else -1,
            {key: each.metadata[key] for key in ("sign", "unit", "infinite")},
        )
        for each in options_of(kind)
    )


def check(instance: Any, name: str) -> None:
    """Validate the options of a dataclass that are numbers, flags or counts; for its ``__post_init__``.

    Numbers become float, sequences of numbers tuples of float. A count without a sign is left to its class. `name`
    comes before the option's name in messages. Raises InvalidInput for a value that is not a number, not finite, of the
    wrong sign, or a direction of more than a turn, and for a sequence that is empty or of the wrong length.
    """
    for field_name, default, length, rule in _rules(type(instance)):  # type: ignore[arg-type]
        value, where = getattr(instance, field_name), f"{name} {field_name}".lstrip()
        if isinstance(default, bool):
            value = checks.flag(where, value)
        elif isinstance(default, int):
            if rule["sign"] == "any":
                continue
            value = checks.count(where, value, least=int(rule["sign"] == "positive"))
        elif isinstance(default, tuple):
            value = tuple(checks.array(where, value, (length,), **rule).tolist())
            if not value:
                raise InvalidInput(f"{where} is empty", got=value, allowed="one number or more")
        elif isinstance(default, float) or (rule["unit"] and value is not None):
            value = checks.number(where, value, **rule)
            if rule["unit"] == "rad" and rule["sign"] != "nonnegative" and abs(value) > math.tau:
                raise InvalidInput(
                    f"{where} is more than a turn",
                    got=value,
                    allowed="up to 2 pi, in rad",
                    fix=f"If these are degrees, give {math.radians(value):.4g}",
                )
        object.__setattr__(instance, field_name, value)
