"""Uncertainty of rope, target and motor, and scenarios sampled from it (domain randomization)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import DAMPING, Peg, Rope
from hyperflex.motion import Motion, arm_moves, lagged
from hyperflex.planning.moves import MIN_REST, Moves
from hyperflex.planning.options import refuse_behind
from hyperflex.planning.posterior import RopePosterior
from hyperflex.planning.problem import Problem

if TYPE_CHECKING:
    from hyperflex.identification import Identification

MOVES = 32  # sampled delays; a throw of more moves uses them again
RELATIVE, TIMES = ("length", "mass", "friction", "mu"), ("lag", "timing")  # relative, and in seconds
# Fitted properties that replace a factor. A motion shows friction over mass: with either fitted the mass is left out.
REPLACED_BY = {"length": ("length",), "mass": ("mass", "inertia", *DAMPING), "friction": DAMPING}
OTHER = 0.1  # part by which lengths of two ropes differ that are not one; usually a length is known to 1 %
MIN_LAG = 2e-4  # s; smaller lags are left out


@dataclass(frozen=True, eq=False)
class Scenario:
    """One sample of rope, target and motor.

    `lag` is the time constant of the motor's first-order lag, s; `delays` (MOVES,), s, are those of each move's start,
    < 0 for an early one.
    """

    rope: Rope
    peg: Peg
    lag: float
    delays: Array

    def without_delays(self) -> "Scenario":
        """Return the same scenario with moves that start in time."""
        return replace(self, delays=np.zeros_like(self.delays))

    def motion(self, moves: Moves, problem: Problem) -> Motion:
        """Return the arm's motion when these moves are commanded."""
        return self.executed_motion(moves.motion(problem.limits))

    def executed_motion(self, motion: Motion) -> Motion:
        """Return the arm's motion when a motion of moves and rests is commanded."""
        spec = motion.spec
        if spec.get("kind") != "moves" or spec.get("delay", 0.0):
            raise InvalidInput("motion is not made of moves", got=spec.get("kind", "pieces"), allowed="that of a Throw")
        rests, durations = (np.array(spec[name]) for name in ("rests", "durations"))
        rests = _delayed(rests, durations, np.resize(self.delays, rests.size))
        return lagged(
            arm_moves(spec["angles"], rests, durations, spec["ramps"]), self.lag if self.lag > MIN_LAG else 0.0
        )


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
        of that normal distribution.
    timing : float
        Standard deviation of each move's start, s; normal, independent; no move starts before the last one has ended.
    place : float
        Standard deviation of each coordinate of the target's place, m; normal, independent.
    posterior : RopePosterior, optional
        Identified rope: ropes are sampled from its covariance, and then multiplied by the factors above.

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
    posterior: RopePosterior | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "posterior":
                value = checks.number(f"uncertainty of {field.name}", getattr(self, field.name), sign="nonnegative")
                object.__setattr__(self, field.name, value)
        if self.posterior is not None and not isinstance(self.posterior, RopePosterior):
            fix = "Give Uncertainty.from_identification(what identify returned)"
            raise InvalidInput("posterior is no RopePosterior", got=self.posterior, fix=fix)

    @classmethod
    def from_identification(cls, fit: "Identification", **others: float) -> "Uncertainty":
        """Take the rope's uncertainty from the covariance of a `fit`; `others` are parameters of the class.

        Those of the rope are 0 by default, but for properties that the fit could not determine: these have the usual
        default.
        """
        posterior = RopePosterior.from_identification(fit)
        undetermined = set(posterior.undetermined_properties)
        known = {name: 0.0 for name, properties in REPLACED_BY.items() if not set(properties) & undetermined}
        return cls(**{**known, **others}, posterior=posterior)

    @classmethod
    def from_rope_file(cls, path: str | Path) -> "Uncertainty":
        """Take the rope's uncertainty from a rope file, at `path`, that identify wrote.

        Properties that were not fitted, or that the fit could not determine, have the usual default; without a
        covariance all have.
        """
        posterior = RopePosterior.from_toml(path)
        if posterior is None:
            return cls()
        known = set(posterior.fitted_properties), set(posterior.undetermined_properties)
        zero = {n: 0.0 for n, each in REPLACED_BY.items() if set(each) & known[0] and not set(each) & known[1]}
        return cls(**zero, posterior=posterior)

    def describe(self) -> str:
        """Return in words what is uncertain, and where that comes from."""
        usual = [f"{name} {100 * getattr(self, name):.2g} %" for name in RELATIVE if getattr(self, name)]
        usual += [f"{name} {1e3 * getattr(self, name):.2g} ms" for name in TIMES if getattr(self, name)]
        usual += [f"place {1e3 * self.place:.2g} mm"] if self.place else []
        assumed = f"as a usual identification leaves it: {', '.join(usual)}" if usual else ""
        if self.posterior is None:
            return assumed or "nothing"
        parts = [f"{', '.join(self.posterior.fitted_properties)} by the covariance in the rope's file"]
        if self.posterior.undetermined_properties:
            parts.append(f"the fit could not tell all of {', '.join(self.posterior.undetermined_properties)}")
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
        lag = self.lag * abs(float(rng.standard_normal()))
        delays = self.timing * rng.standard_normal(MOVES)
        rope = problem.rope if self.posterior is None else self.posterior.sample(rng)
        thrown, known = problem.rope, rope if self.posterior is None else self.posterior.rope
        if known.n_links != thrown.n_links or abs(known.total_length / thrown.total_length - 1.0) > OTHER:
            got, asked = (f"{each.n_links} links, {each.total_length:.3g} m" for each in (known, thrown))
            raise InvalidInput("posterior is of another rope", got=got, allowed=f"{asked}, as thrown")
        if rope.radius != thrown.radius:  # which no recording tells
            rope = rope.replace(radius=thrown.radius)
        x, y = np.array([peg.x, peg.y]) + self.place * rng.standard_normal(2)
        target = replace(peg, x=float(x), y=float(y), mu=peg.mu * float(factors[3]))
        return Scenario(scaled_rope(rope, *factors[:3]), target, lag, delays)


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
