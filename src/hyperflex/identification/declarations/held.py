"""What a score test says of: one object for each quantity that a fit holds, or that was declared."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import Plant

FEW_LINKS = 4  # links, up to which each has its own value in a test: of more, values of neighbours act alike


@dataclass(frozen=True)
class HeldQuantity:
    """A quantity that a fit holds and that the data may contradict.

    Attributes
    ----------
    kind : Kind
        Of its finding.
    words : callable
        Returns what a fit frees to test it, as in ``free``, for a model and whether angles were recorded; empty where
        there is nothing to test.
    values : callable
        Returns the values of its finding from a test's name and values.
    name : str
        Of its test, as in ``free``, where it has a name of its own.
    factor : bool
        Whether its value is a factor.
    declared : bool
        Whether it stands for a recording that is not as declared, and not for a property of the rope.
    farthest : float
        Factor beyond which something else is wrong.
    enough : float
        Size from which it matters whatever the ratios do: of the logarithm of a factor, or of the value itself.
    slight : float
        The same, up to which it does not matter: instruments err by so much.
    reported : bool
        Whether it is reported with its value as soon as it is significant.
    """

    kind: Kind
    words: Callable[[Plant, bool], list[str]]
    values: Callable[[str, Array], dict[str, Any]]
    name: str = ""
    factor: bool = False
    declared: bool = False
    farthest: float = np.inf
    enough: float = np.inf
    slight: float = 0.0
    reported: bool = False
    apart: bool = False  # tested in a linearisation of its own: it acts much as others do

    def size(self, value: float) -> float:
        """Return how far a value is from what was held: the logarithm of a factor, or the value."""
        return abs(float(np.log(max(value, 1e-9)))) if self.factor else abs(value)


def free_names(plant: Plant) -> set[str]:
    """Return the names of the properties that are free."""
    return {each.name for each in plant.parameters.all}


def many_links(plant: Plant) -> bool:
    """Whether a rope has so many links that they are tested together."""
    return plant.parameters.guess.n_links > FEW_LINKS
