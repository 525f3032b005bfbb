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


TABLE = ("parameters", "values", "std", "covariance", "length_covariance")  # of an identification


@dataclass(frozen=True, eq=False)
class RopePosterior:
    """An identified rope with the covariance of its parameters.

    Attributes
    ----------
    rope : Rope
    parameters : tuple of str
        Names of the P fitted parameters, as in :class:`hyperflex.identification.Identification`; after these
        ``length:factor`` where the lengths, as declared, have an error that others depend on.
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
        return cls._of(fit.rope, {name: getattr(fit, name) for name in TABLE})

    @classmethod
    def from_toml(cls, path: str | Path) -> "RopePosterior | None":
        """Read it from a rope file that identify wrote; None if the file holds no covariance.

        Raises FileProblem or InvalidInput if the file cannot be read, or its table of the identification is incomplete.
        """
        table: Any = files.read_toml(path).get("identification")
        if not isinstance(table, dict) or not {"parameters", "covariance"} <= table.keys():
            return None
        rope = Rope.from_toml(path)
        try:
            default = {"length_covariance": np.zeros(len(table["parameters"]) + 1), "std": {}}
            return cls._of(rope, default | table)
        except (AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
            missing = f"the key {str(error)[:60]}" if isinstance(error, KeyError) else "a value of the right kind"
            raise InvalidInput(
                f"the identification in {path} is not complete: it lacks {missing}", fix="Write it again with identify"
            ) from None

    @classmethod
    def _of(cls, rope: Rope, table: Mapping[str, Any]) -> "RopePosterior":
        """Return the posterior of a rope and a table of its identification."""
        names = tuple(str(name) for name in table["parameters"])
        factors = {name: float(table["values"][name]) for name in names if name.endswith(":factor")}
        names, covariance = _with_lengths(names, table["covariance"], table["length_covariance"])
        rows = np.abs(covariance).max(axis=1)
        known = [row > 0.0 and _finite(label, table["std"]) for label, row in zip(names, rows, strict=True)]
        undetermined = tuple(label for label, each in zip(names, known, strict=True) if not each)
        return cls(rope, names, covariance, factors, undetermined)

    @property
    def fitted_properties(self) -> tuple[str, ...]:
        """Properties of the rope that were fitted."""
        return _properties(self.parameters)

    @property
    def undetermined_properties(self) -> tuple[str, ...]:
        """Those of `fitted_properties` with an undetermined parameter."""
        return _properties(self.undetermined)

    def sample(self, rng: np.random.Generator) -> Rope:
        """Sample a rope; where parameters would be negative that cannot be, the nearest draw that leaves them at 0."""
        std = np.sqrt(np.diag(self.covariance))
        scale = np.where(std > 0.0, std, 1.0)
        sizes, directions = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        root = scale[:, None] * directions * np.sqrt(np.maximum(sizes, 0.0))
        root /= np.array([self.factors.get(label, 1.0) for label in self.parameters])[:, None]
        return perturbed(self.rope, dict(zip(self.parameters, root, strict=True)), rng.standard_normal(std.size))


def _with_lengths(labels: tuple[str, ...], covariance: Any, lengths: Any) -> tuple[tuple[str, ...], Array]:
    """Return labels and covariance (P, P), with those of a factor on all lengths, (P + 1,), if it has an error."""
    own, border = np.atleast_2d(np.array(covariance, dtype=np.float64)), np.array(lengths, dtype=np.float64)
    if own.shape != (len(labels),) * 2 or border.shape != (len(labels) + 1,) or not border[-1] > 0.0:
        return labels, own
    return (*labels, "length:factor"), np.block([[own, border[:-1, None]], [border[None, :]]])


def _properties(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the properties of a rope among labels of parameters."""
    found = dict.fromkeys(each.name for label in labels if (each := parse_label(label)))
    return tuple(name for name in found if PROPERTIES[name].owner in ("link", "rope"))


def _finite(label: str, stds: Mapping[str, Any]) -> bool:
    """Whether a standard deviation is finite, or not in the table."""
    parts = parse_label(label)
    std = stds.get(label, stds.get(parts.name) if parts else None)
    if std is None:
        return True
    last = parts is not None and parts.law == "inner"  # the first link's is held
    each = std if np.ndim(std) == 0 else std[-1 if last else (parts.place or 0) if parts else 0]
    return not isinstance(each, str) and bool(np.isfinite(each))
