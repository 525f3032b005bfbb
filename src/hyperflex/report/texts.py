"""Texts from templates: documents in named parts, each of paragraphs or of rows of cells."""

import math
import re
from typing import Any

import numpy as np

from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.report.page import TextTable, environment
from hyperflex.report.units import length


class Texts:
    """The parts of a filled-in template.

    A part begins with ``# name`` in its own line. Empty lines part its paragraphs, bars the cells of a row.
    """

    def __init__(self, template: str, **content: Any) -> None:
        made = environment(finalize=lambda value: value.replace("\n", " ") if isinstance(value, str) else value)
        made.globals |= {"length": length, "degrees": np.degrees, "arctan2": np.arctan2}
        made.globals |= {"isfinite": math.isfinite, "hypot": math.hypot, "nan": math.nan}
        made.filters |= {"described": described, "fixed": "{:.2f}".format}
        text = made.get_template(template).render(**content)
        heads = re.split(r"^# (\w+)\n", text, flags=re.MULTILINE)[1:]
        self._parts = dict(zip(heads[::2], heads[1::2], strict=True))

    def paragraphs(self, name: str) -> tuple[str, ...]:
        """Return the paragraphs of a part, without line breaks; none if there is no such part."""
        parts = re.split(r"\n\s*\n", self._parts.get(name, ""))
        return tuple(filter(None, (re.sub(r"[ \n]+", " ", each).strip(" ") for each in parts)))

    def text(self, name: str) -> str:
        """Return a part in one line."""
        return " ".join(self.paragraphs(name))

    def rows(self, name: str) -> tuple[tuple[str, ...], ...]:
        """Return the rows of a part as cells."""
        lines = self._parts.get(name, "").splitlines()
        return tuple(tuple(cell.strip(" ") for cell in line.split(" | ")) for line in lines if line.strip())

    def table(self, name: str) -> TextTable:
        """Return the rows of a part as a table; the first one is its header."""
        header, *rows = self.rows(name)
        return TextTable(header, tuple(rows))


def described(each: Obstacle) -> str:
    """Return kind, place and size of an obstacle."""
    place = f"({each.x:.4g}, {each.y:.4g})"
    if isinstance(each, Peg):
        return f"a peg at {place} m, radius {length(each.radius)}"
    if isinstance(each, Wall):
        return f"a wall from {place} to ({each.x2:.4g}, {each.y2:.4g}) m"
    return f"a ground through {place} m"
