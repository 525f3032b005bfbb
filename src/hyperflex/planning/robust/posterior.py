"""A rope with the covariance of its identified parameters, and ropes sampled from that posterior."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification import perturbed
from hyperflex.model import PROPERTIES, Rope, parse_label

if TYPE_CHECKING:
    from hyperflex.identification import Identification


@dataclass(frozen=True, eq=False)
class RopePosterior:
    """An identified rope with the covariance of its parameters.

    Attributes
    ----------
    rope : Rope
    parameters : tuple of str
        Names of the P fitted parameters, as in :class:`hyperflex.identification.Identification`.
    covariance : (P, P) float64
        Of the parameters, SI units; 0 for a parameter that could not be determined.
    factors : dict of str to float
        Fitted values of the `parameters` that are a factor on all links.
    undetermined : tuple of str
        Those of `parameters` whose standard deviation is not finite, or whose row of the covariance is 0. Their spread
        in samples must come from elsewhere.
    """

    rope: Rope
    parameters: tuple[str, ...]
    covariance: Array
    factors: dict[str, float]
    undetermined: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.parameters)
        if self.covariance.shape != (count, count) or not np.isfinite(self.covariance).all():
            raise InvalidInput(
                "covariance does not fit its parameters", got=self.covariance.shape, allowed=f"({count}, {count})"
            )

    @classmethod
    def from_identification(cls, fit: "Identification") -> "RopePosterior":
        """Return the posterior of a fit."""
        factors = {name: float(fit.values[name]) for name in fit.parameters if name.endswith(":factor")}
        covariance, labels = np.asarray(fit.covariance), tuple(fit.parameters)
        return cls(fit.rope, labels, covariance, factors, _undetermined(labels, covariance, fit.std))

    @classmethod
    def from_toml(cls, path: str | Path) -> "RopePosterior | None":
        """Read it from a rope file that identify wrote; None if the file holds no covariance.

        Raises FileProblem or InvalidInput if the file cannot be read, or its table of the identification is incomplete.
        """
        table: Any = files.read_toml(path).get("identification")
        if not isinstance(table, dict) or not {"parameters", "covariance"} <= table.keys():
            return None
        try:
            names = tuple(str(name) for name in table["parameters"])
            covariance = np.array(table["covariance"], dtype=np.float64)
            factors = {name: float(table["values"][name]) for name in names if name.endswith(":factor")}
            undetermined = _undetermined(names, covariance, table.get("std", {}))
        except (AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
            missing = f"the key {str(error)[:60]}" if isinstance(error, KeyError) else "a value of the right kind"
            raise InvalidInput(
                f"the identification in {path} is not whole: it lacks {missing}", fix="Write it again with identify"
            ) from None
        return cls(Rope.from_toml(path), names, covariance, factors, undetermined)

    @property
    def fitted_properties(self) -> tuple[str, ...]:
        """Properties of the rope that were fitted."""
        return _properties(self.parameters)

    @property
    def undetermined_properties(self) -> tuple[str, ...]:
        """Those of `fitted_properties` with an undetermined parameter."""
        return _properties(self.undetermined)

    def sample(self, rng: np.random.Generator) -> Rope:
        """Sample a rope; parameters that cannot be negative are clipped at 0."""
        sizes, directions = np.linalg.eigh(self.covariance)
        off = directions @ (np.sqrt(np.maximum(sizes, 0.0)) * rng.standard_normal(sizes.size))
        off /= [self.factors.get(label, 1.0) for label in self.parameters]
        return perturbed(self.rope, dict(zip(self.parameters, off.tolist(), strict=True)))


def _properties(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the properties of a rope among labels of parameters."""
    found = dict.fromkeys(each.name for label in labels if (each := parse_label(label)))
    return tuple(name for name in found if PROPERTIES[name].owner in ("link", "rope"))


def _undetermined(labels: Sequence[str], covariance: Array, stds: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the labels whose standard deviation is not finite, or whose row of the covariance (P, P) is 0."""
    rows = np.abs(np.atleast_2d(covariance)).max(axis=1)
    return tuple(label for label, row in zip(labels, rows, strict=True) if not (row > 0.0 and _finite(label, stds)))


def _finite(label: str, stds: Mapping[str, Any]) -> bool:
    """Whether a standard deviation is finite, or not in the table."""
    parts = parse_label(label)
    std = stds.get(label, stds.get(parts.name) if parts else None)
    if std is None:
        return True
    each = std if np.ndim(std) == 0 else std[(parts.place or 0) if parts else 0]
    return not isinstance(each, str) and bool(np.isfinite(each))
