"""Uncertainty of rope, target and motor, and scenarios sampled from it (domain randomization)."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.hardware import DriveFit
from hyperflex.identification import perturbed
from hyperflex.model import DAMPING, PROPERTIES, Peg, Rope, parse_label
from hyperflex.motion import Motion, arm_moves, lagged
from hyperflex.planning.moves import MIN_REST
from hyperflex.planning.options import check_tilt, refuse_behind
from hyperflex.planning.problem import Problem

if TYPE_CHECKING:
    from hyperflex.identification import Identification

MOVES = 32  # sampled delays; a plan of more moves uses them again
RELATIVE = ("length", "mass", "friction", "mu")
# Fitted properties that replace a factor. A motion shows friction over mass: with either fitted the mass is omitted.
REPLACED_BY = {"length": ("length",), "mass": ("mass", "inertia", *DAMPING), "friction": DAMPING}
OTHER = 0.1  # part by which lengths of two ropes differ that are not one; usually a length is known to 1 %
TABLE = ("parameters", "values", "std", "covariance", "length_covariance")  # of an identification


@dataclass(frozen=True, eq=False)
class Scenario:
    """One sample of rope, target and motor.

    `lag` is the time constant of the motor's first-order lag, s; `delays` (MOVES,), s, are those of each move's start,
    < 0 for an early one; `tilt` is the rope's angle out of the plane at the start, rad.
    """

    rope: Rope
    peg: Peg
    lag: float
    delays: Array
    tilt: float = 0.0

    def executed_motion(self, motion: Motion) -> Motion:
        """Return the arm's motion when a motion of moves and rests is commanded."""
        spec = motion.spec
        if spec.get("kind") != "moves" or spec.get("delay", 0.0):
            raise InvalidInput(
                "motion is not made of moves", got=spec.get("kind", "pieces"), allowed="hyperflex.arm_moves(...)"
            )
        rests, durations = (np.array(spec[name]) for name in ("rests", "durations"))
        count = durations.size
        starts = _delayed(rests[:count], durations, np.resize(self.delays, count))
        return lagged(arm_moves(spec["angles"], [*starts, *rests[count:]], durations, spec["ramps"]), self.lag)


def _delayed(rests: Array, durations: Array, delays: Array) -> Array:
    """Return the rests (k,) of moves with delays (k,); none starts before the last one has ended."""
    if not delays.any():
        return rests
    starts = np.cumsum(rests) + np.cumsum(durations) - durations
    found, ended = np.empty_like(rests), 0.0
    for k, start in enumerate(starts + delays):
        found[k] = max(0.0, start - ended)
        if found[k] < MIN_REST:
            found[k] = 0.0
        ended += found[k] + durations[k]
    return found


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
        """Read it from a rope file that identify wrote; None if the file has no covariance.

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
        parts = (np.array(table[name], dtype=np.float64) for name in ("covariance", "length_covariance"))
        covariance, border = np.atleast_2d(*parts)
        count = len(names)
        if covariance.shape == (count, count) and border.shape == (1, count + 1) and border[0, -1] > 0.0:
            # The error of a factor on all lengths, which others depend on
            names, covariance = (*names, "length:factor"), np.block([[covariance, border[:, :-1].T], [border]])
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

    def replaced(self, names: Iterable[str]) -> dict[str, Any]:
        """Return 0 for those of some factors of an :class:`Uncertainty` that no undetermined property leaves open."""
        undetermined = set(self.undetermined_properties)
        return {name: 0.0 for name in names if not undetermined & set(REPLACED_BY[name])}

    def sample(self, rng: np.random.Generator) -> Rope:
        """Sample a rope; where parameters would be negative that cannot be, the nearest draw that leaves them at 0."""
        std = np.sqrt(np.diag(self.covariance))
        scale = np.where(std > 0.0, std, 1.0)
        sizes, directions = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        root = scale[:, None] * directions * np.sqrt(np.maximum(sizes, 0.0))
        root /= np.array([self.factors.get(label, 1.0) for label in self.parameters])[:, None]
        return perturbed(self.rope, dict(zip(self.parameters, root, strict=True)), rng.standard_normal(std.size))


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


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations of rope, target and motor; by default those of a realistic identification.

    Parameters
    ----------
    length, mass, friction : float
        Relative standard deviation of the rope's length, its mass, and its friction of all kinds; one factor for
        all links, log-normal with mean 1.
    mu : float
        The same of the peg's friction coefficient.
    lag : float
        The motor follows with a first-order lag. Its time constant, s, is half-normal; this is the standard deviation
        of that normal distribution. With a `drive` it is not used.
    timing : float
        Standard deviation of each move's start, s; normal, independent; no move starts before the last one has ended.
    place : float
        Standard deviation of each coordinate of the target's place, m; normal, independent.
    tilt : float
        Standard deviation of the rope's angle out of the plane at the start, rad, at most 5 degrees; normal. It is used
        if the criteria have a `max_sideways`. A recording in space gives it: ``recording.tilt``.
    posterior : RopePosterior, optional
        Identified rope: ropes are sampled from its covariance, and then multiplied by the factors above.
    drive : DriveFit, optional
        Identified drive: the lag is normal, with its value and standard deviation.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.planning import Problem, MotorLimits, Uncertainty
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> problem = Problem(cable, hf.Arm(length=0.105), MotorLimits())
    >>> scenarios = Uncertainty().sample(200, problem, hf.Peg(0.9, -0.8, 0.03))
    >>> round(float(np.std([each.rope.total_length for each in scenarios])), 2)
    0.02
    """

    length: float = 0.01
    mass: float = 0.02
    friction: float = 0.20
    mu: float = 0.10
    lag: float = 0.010
    timing: float = 0.002
    place: float = 0.0
    tilt: float = math.radians(1.0)
    posterior: RopePosterior | None = None
    drive: DriveFit | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name not in ("posterior", "drive"):
                value = checks.number(f"uncertainty of {field.name}", getattr(self, field.name), sign="nonnegative")
                object.__setattr__(self, field.name, value)
        check_tilt(self.tilt)
        if self.posterior is not None and not isinstance(self.posterior, RopePosterior):
            fix = "Give Uncertainty.from_identification(what identify returned)"
            raise InvalidInput("posterior is no RopePosterior", got=self.posterior, fix=fix)
        if self.drive is not None and checks.instance("drive", self.drive, DriveFit).message:
            raise InvalidInput(f"the identified drive must not be used: {self.drive.message}")

    @classmethod
    def from_identification(cls, fit: "Identification", **others: Any) -> "Uncertainty":
        """Take the rope's uncertainty from the covariance of a `fit`; `others` are parameters of the class.

        Those of the rope are 0 by default, but for properties that the fit could not determine: these have the usual
        default.
        """
        posterior = RopePosterior.from_identification(fit)
        return cls(**{**posterior.replaced(REPLACED_BY), **others}, posterior=posterior)

    @classmethod
    def from_rope_file(cls, path: str | Path) -> "Uncertainty":
        """Take the rope's uncertainty from a rope file, at `path`, that identify wrote.

        Properties that were not fitted, or that the fit could not determine, have the usual default; without a
        covariance all have.
        """
        posterior = RopePosterior.from_toml(path)
        if posterior is None:
            return cls()
        fitted = [name for name, each in REPLACED_BY.items() if set(each) & set(posterior.fitted_properties)]
        return cls(**posterior.replaced(fitted), posterior=posterior)

    def describe(self) -> str:
        """Return the uncertainties and their source as text."""
        usual = [f"{name} {100 * getattr(self, name):.2g} %" for name in RELATIVE if getattr(self, name)]
        times = ("timing",) if self.drive else ("lag", "timing")
        usual += [f"{name} {1e3 * getattr(self, name):.2g} ms" for name in times if getattr(self, name)]
        usual += [f"place {1e3 * self.place:.2g} mm"] if self.place else []
        usual += [f"tilt {math.degrees(self.tilt):.2g} degrees"] if self.tilt else []
        assumed = f"typical of an identification: {', '.join(usual)}" if usual else ""
        assumed = "; ".join(filter(None, (self.drive.describe() if self.drive else "", assumed)))
        if self.posterior is None:
            return assumed or "nothing"
        parts = [f"{', '.join(self.posterior.fitted_properties)} by the covariance in the rope's file"]
        if self.posterior.undetermined_properties:
            parts.append(f"not fully determined by the fit: {', '.join(self.posterior.undetermined_properties)}")
        return "; ".join([*parts, assumed] if assumed else parts)

    def sample(self, count: int, problem: Problem, peg: Peg, *, seed: int | Sequence[int] = 0) -> list[Scenario]:
        """Return `count` scenarios sampled for a `problem` and a `peg`.

        Scenario number m of a `seed`, an integer or several, is the same for any `count`.
        """
        refuse_behind(problem.criteria.behind, "an uncertainty")
        stem = [seed] if isinstance(seed, int | np.integer) else list(seed)
        rngs = [np.random.default_rng([*stem, m]) for m in range(checks.count("samples", count))]
        return [self._sample(rng, problem, peg) for rng in rngs]

    def _sample(self, rng: np.random.Generator, problem: Problem, peg: Peg) -> Scenario:
        """Sample a scenario; numbers are drawn in a fixed order, so that leaving out one part changes no other."""
        spreads = np.array([self.length, self.mass, self.friction, self.mu])
        sigma = np.sqrt(np.log1p(spreads**2))
        factors = np.exp(sigma * rng.standard_normal(4) - 0.5 * sigma**2)
        drawn = float(rng.standard_normal())
        lag = self.lag * abs(drawn) if self.drive is None else max(0.0, self.drive.lag + self.drive.lag_std * drawn)
        delays = self.timing * rng.standard_normal(MOVES)
        rope = problem.rope if self.posterior is None else self.posterior.sample(rng)
        planned, known = problem.rope, rope if self.posterior is None else self.posterior.rope
        if known.n_links != planned.n_links or abs(known.total_length / planned.total_length - 1.0) > OTHER:
            got, required = (f"{each.n_links} links, {each.total_length:.3g} m" for each in (known, planned))
            raise InvalidInput("posterior is of another rope", got=got, allowed=f"{required}, as cast")
        if rope.radius != planned.radius:  # which no recording shows
            rope = rope.replace(radius=planned.radius)
        x, y = peg.point + self.place * rng.standard_normal(2)
        target = replace(peg, x=float(x), y=float(y), mu=peg.mu * float(factors[3]))
        tilt = self.tilt * float(rng.standard_normal())
        return Scenario(scaled_rope(rope, *factors[:3]), target, lag, delays, tilt)


def scaled_rope(rope: Rope, length: float, mass: float, friction: float) -> Rope:
    """Return a rope with lengths, masses and friction multiplied by factors; inertias scale with them."""
    changes: dict[str, Any] = {
        "length": rope.length * length,
        "com": rope.com * length,
        "mass": rope.mass * mass,
        "tip_mass": rope.tip_mass * mass,
        "inertia": rope.inertia * mass * length**2,
    }
    changes |= {name: getattr(rope, name) * friction for name in DAMPING}
    return rope.replace(**changes)
