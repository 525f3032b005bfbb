"""A rope as an identification left it, with the covariance of what was fitted; ropes drawn from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification import perturbed
from hyperflex.model import Rope
from hyperflex.model.properties import PROPERTIES, parsed

if TYPE_CHECKING:
    from hyperflex.identification import Identification


@dataclass(frozen=True, eq=False)
class Fitted:
    """What an identification says of a rope.

    Attributes
    ----------
    rope : Rope
    parameters : tuple of str
        Names of the P numbers that were fitted, as :class:`hyperflex.identification.Identification` has them.
    covariance : (P, P) float64
        Of these, SI units; 0 for what could not be known.
    factors : dict of str to float
        Fitted values of those of `parameters` that are a factor on all links.
    unknown : tuple of str
        Those of `parameters` that the fit could not tell: their standard deviation is not finite, or their row of the
        covariance is 0. Draws move them by what the covariance holds alone, so their spread must come from elsewhere.
    """

    rope: Rope
    parameters: tuple[str, ...]
    covariance: Array
    factors: dict[str, float]
    unknown: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.parameters)
        if self.covariance.shape != (count, count) or not np.isfinite(self.covariance).all():
            raise InvalidInput(
                "covariance does not fit its parameters", got=self.covariance.shape, allowed=f"({count}, {count})"
            )

    @classmethod
    def of(cls, fit: Identification) -> Fitted:
        """Take it from what identify gave back."""
        factors = {name: float(fit.values[name]) for name in fit.parameters if name.endswith(":factor")}
        covariance = np.asarray(fit.covariance)
        return cls(fit.rope, tuple(fit.parameters), covariance, factors, _unknown(fit.parameters, covariance, fit.sd))

    @classmethod
    def from_toml(cls, path: str | Path) -> Fitted | None:
        """Read it from a rope file that identify wrote; None where the file holds no covariance.

        Raises
        ------
        FileProblem, InvalidInput
            If the file cannot be read, or what it says of its identification does not fit together.
        """
        told: Any = files.read_toml(path).get("identification")
        if not isinstance(told, dict) or not {"parameters", "covariance"} <= told.keys():
            return None
        try:
            names = tuple(str(name) for name in told["parameters"])
            covariance = np.array(told["covariance"], dtype=np.float64)
            factors = {name: float(told["values"][name]) for name in names if name.endswith(":factor")}
            unknown = _unknown(names, covariance, told.get("sd", {}))
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"the identification in {path} is not whole", got=str(error), fix="Write it again with identify"
            ) from None
        return cls(Rope.from_toml(path), names, covariance, factors, unknown)

    @property
    def names(self) -> tuple[str, ...]:
        """Properties of the rope that were fitted."""
        return _properties(self.parameters)

    @property
    def untold(self) -> tuple[str, ...]:
        """Those of `names` of which a number could not be told."""
        return _properties(self.unknown)

    def draw(self, rng: np.random.Generator) -> Rope:
        """Draw a rope; numbers that cannot be below 0 are kept there."""
        sizes, directions = np.linalg.eigh(self.covariance)
        off = directions @ (np.sqrt(np.maximum(sizes, 0.0)) * rng.standard_normal(sizes.size))
        off /= [self.factors.get(label, 1.0) for label in self.parameters]
        return perturbed(self.rope, dict(zip(self.parameters, off.tolist(), strict=True)))


def _properties(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the properties of a rope among fitted numbers."""
    found = dict.fromkeys(each.name for label in labels if (each := parsed(label)))
    return tuple(name for name in found if PROPERTIES[name].owner in ("link", "rope"))


def _unknown(labels: Sequence[str], covariance: Array, sds: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the labels whose deviation is not a finite number, or whose row of the covariance (P, P) is 0."""
    rows = np.abs(np.atleast_2d(covariance)).max(axis=1)
    return tuple(label for label, row in zip(labels, rows, strict=True) if not (row > 0.0 and _told(label, sds)))


def _told(label: str, sds: Mapping[str, Any]) -> bool:
    """Whether a deviation is a number; what the table does not hold is left to the covariance."""
    parts = parsed(label)
    sd = sds.get(label, sds.get(parts.name) if parts else None)
    if sd is None:
        return True
    each = sd if np.ndim(sd) == 0 else sd[(parts.place or 0) if parts else 0]
    return not isinstance(each, str) and bool(np.isfinite(each))
