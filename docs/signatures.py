"""Extension of Griffe: parameters that share a line of a docstring have types and defaults of their own.

Griffe gives all of them what the first one has, and takes the first of some choices for the default.
"""

from collections.abc import Iterator
from itertools import groupby
from typing import Any

import griffe


class Signatures(griffe.Extension):
    """Takes defaults, and types that a docstring leaves out, from the signature."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Correct all docstrings of a package."""
        for each in _documented(pkg):
            for section in each.docstring.parsed if each.docstring else ():
                if section.kind is griffe.DocstringSectionKind.parameters:
                    _correct(section.value, each.parameters)


def _documented(parent: griffe.Object) -> Iterator[griffe.Function | griffe.Class]:
    """Give functions and classes, those within others as well."""
    for each in parent.members.values():
        if isinstance(each, griffe.Function | griffe.Class):
            yield each
        if isinstance(each, griffe.Module | griffe.Class):
            yield from _documented(each)


def _correct(listed: list[griffe.DocstringParameter], given: griffe.Parameters) -> None:
    """Correct the parameters of a docstring by those that a signature has."""
    known = [each for each in listed if each.name in given]
    for _, line in groupby(known, lambda each: id(each.annotation)):
        first, *others = line
        kinds = first.annotation
        for k, each in enumerate([first, *others]):
            found = given[each.name]
            several = found.kind in (griffe.ParameterKind.var_keyword, griffe.ParameterKind.var_positional)
            each.value = None if several or found.default is None else str(found.default)
            if kinds is not None and kinds is given[first.name].annotation:
                each.annotation = found.annotation
            elif isinstance(kinds, griffe.ExprTuple) and _classes(kinds) and len(kinds.elements) == 1 + len(others):
                each.annotation = kinds.elements[k]
            elif " - " in str(kinds):  # path-like and bang-bang are no differences
                each.annotation = str(kinds).replace(" - ", "-")


def _classes(kinds: griffe.ExprTuple) -> bool:
    """Tell whether all that stands in a line are classes, as in ``Rope, Arm``."""
    return all(isinstance(kind, griffe.ExprName) and kind.name[0].isupper() for kind in kinds.elements)
