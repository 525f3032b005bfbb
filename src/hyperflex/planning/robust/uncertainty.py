"""What is not known exactly of a rope, a target and a motor when a cast is planned, and draws of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg, Rope
from hyperflex.model.properties import DAMPING
from hyperflex.motion import Motion, lagged, moves
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.robust.posterior import Fitted
from hyperflex.planning.wind.throw import LEAST_REST, Throw

if TYPE_CHECKING:
    from hyperflex.identification import Identification

MOVES = 32  # whose starts are drawn; a throw of more uses them again
PARTS, TIMES = ("length", "mass", "friction", "mu"), ("lag", "timing")  # relative, and in seconds
# What a fit tells of: friction over mass is what a motion shows, so with either fitted the mass counts no more.
TOLD = {"length": ("length",), "mass": ("mass", "inertia", *DAMPING), "friction": DAMPING}
LEAST_LAG = 2e-4  # s; a motor that lags less does not


@dataclass(frozen=True, eq=False)
class Draw:
    """One world that a throw may meet.

    Attributes
    ----------
    rope : Rope
    peg : Peg
    lag : float
        Time constant of the motor's first-order lag, s.
    late : (MOVES,) float64
        By how much each move starts late (or early, < 0), s.
    """

    rope: Rope
    peg: Peg
    lag: float
    late: Array

    def punctual(self) -> Draw:
        """Return the same world with moves that start in time."""
        return replace(self, late=np.zeros_like(self.late))

    def motion(self, throw: Throw, thrower: Thrower) -> Motion:
        """Return what the arm really does when this throw is asked of it."""
        return self.executed(throw.motion(thrower.limits))

    def executed(self, motion: Motion) -> Motion:
        """Return what the arm really does when a motion of moves and rests is asked of it."""
        spec = motion.spec
        if spec.get("kind") != "moves" or spec.get("delay", 0.0):
            raise InvalidInput("motion is not made of moves", got=spec.get("kind", "pieces"), allowed="that of a Throw")
        rests, durations = (np.array(spec[name]) for name in ("rests", "durations"))
        rests = _jittered(rests, durations, np.resize(self.late, rests.size))
        return lagged(moves(spec["angles"], rests, durations, spec["ramps"]), self.lag if self.lag > LEAST_LAG else 0.0)


def _jittered(rests: Array, durations: Array, late: Array) -> Array:
    """Return the rests (k,) of moves that start late by `late` (k,); none starts before the last one has ended."""
    if not late.any():
        return rests
    starts = np.cumsum(rests) + np.cumsum(durations) - durations
    found, ended = np.empty_like(rests), 0.0
    for k, start in enumerate(starts + late):
        found[k] = max(0.0, start - ended)
        if found[k] < LEAST_REST:
            found[k] = 0.0
        ended += found[k] + durations[k]
    return found


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How far rope, target and motor may be from what is known; by default a realistic identification's.

    Parameters
    ----------
    length, mass, friction : float
        Relative standard deviation of the rope's length, its mass, and its friction of all kinds; one factor for
        all links, log-normal with mean 1.
    mu : float
        The same of the peg's friction.
    lag : float
        The motor follows with a first-order lag. Its time constant, s, is half-normal, and this is that normal's
        standard deviation. (A plain delay of a throw from rest would change nothing.)
    timing : float
        Standard deviation of each move's start, s; normal, independent; no move starts before the last one has ended.
    fit : Fitted, optional
        What an identification says of the rope: ropes are drawn from its covariance, and the factors above come on top.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.planning import MotorLimits, Thrower, Uncertainty
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> thrower = Thrower(cable, hf.Arm(length=0.105), MotorLimits())
    >>> draws = Uncertainty().draws(200, thrower, hf.Peg(0.9, -0.8, 0.03))
    >>> round(float(np.std([draw.rope.total_length for draw in draws])), 2)
    0.02
    """

    length: float = 0.01
    mass: float = 0.02
    friction: float = 0.20
    mu: float = 0.10
    lag: float = 0.010
    timing: float = 0.002
    fit: Fitted | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "fit":
                value = checks.number(f"uncertainty of {field.name}", getattr(self, field.name), sign="nonnegative")
                object.__setattr__(self, field.name, value)
        if self.fit is not None and not isinstance(self.fit, Fitted):
            raise InvalidInput("fit is no Fitted", got=self.fit, fix="Give Uncertainty.of(what identify gave back)")

    @classmethod
    def of(cls, fit: Identification, **others: float) -> Uncertainty:
        """Take the rope's part from a fit's covariance; `others` as above.

        The rope's own are 0 unless given, but where the fit could not tell something: there they are as usual.
        """
        found = Fitted.of(fit)
        known = {name: 0.0 for name, words in TOLD.items() if not set(words) & set(found.untold)}
        return cls(**{**known, **others}, fit=found)

    @classmethod
    def of_file(cls, path: str | Path) -> Uncertainty:
        """Take the rope's part from a rope file that identify wrote; what it does not tell is as uncertain as usual.

        That is what was not fitted, and what the fit could not tell.

        Parameters
        ----------
        path : path-like
            TOML file with a rope. Where it holds no covariance, all is as usual.
        """
        fit = Fitted.from_toml(path)
        if fit is None:
            return cls()
        told, untold = set(fit.names), set(fit.untold)
        known = {name: 0.0 for name, words in TOLD.items() if set(words) & told and not set(words) & untold}
        return cls(**known, fit=fit)

    def words(self) -> str:
        """Say what is taken as uncertain, and where that comes from."""
        usual = [f"{name} {100 * getattr(self, name):.2g} %" for name in PARTS if getattr(self, name)]
        usual += [f"{name} {1e3 * getattr(self, name):.2g} ms" for name in TIMES if getattr(self, name)]
        taken = f"as a usual identification leaves it: {', '.join(usual)}" if usual else ""
        if self.fit is None:
            return taken or "nothing"
        told = [f"{', '.join(self.fit.names)} by the covariance in the rope's file"]
        told += [f"the fit could not tell all of {', '.join(self.fit.untold)}"] if self.fit.untold else []
        return "; ".join([*told, taken] if taken else told)

    def draws(self, count: int, thrower: Thrower, peg: Peg, *, seed: int | Sequence[int] = 0) -> list[Draw]:
        """Return worlds drawn about what is known.

        Parameters
        ----------
        count : int
        thrower : Thrower
        peg : Peg
        seed : int or sequence of int
            Draw number m is the same whatever `count` is.
        """
        stem = [seed] if isinstance(seed, int) else list(seed)
        rngs = [np.random.default_rng([*stem, m]) for m in range(checks.count("draws", count))]
        return [self._draw(rng, thrower, peg) for rng in rngs]

    def _draw(self, rng: np.random.Generator, thrower: Thrower, peg: Peg) -> Draw:
        """Draw one world; numbers are taken in a fixed order, so that worlds stay alike when one part is left out."""
        spreads = np.array([self.length, self.mass, self.friction, self.mu])
        sigma = np.sqrt(np.log1p(spreads**2))
        factors = np.exp(sigma * rng.standard_normal(4) - 0.5 * sigma**2)
        lag = self.lag * abs(float(rng.standard_normal()))
        late = self.timing * rng.standard_normal(MOVES)
        rope = thrower.rope if self.fit is None else self.fit.draw(rng)
        if rope.n_links != thrower.rope.n_links:
            links = f"{thrower.rope.n_links} links, as thrown"
            raise InvalidInput("fit is of another rope", got=rope.n_links, allowed=links)
        target = replace(peg, mu=peg.mu * float(factors[3]))
        return Draw(scaled(rope, *factors[:3]), target, lag, late)


def scaled(rope: Rope, length: float, mass: float, friction: float) -> Rope:
    """Return a rope with lengths, masses and friction times given factors; inertias go with them."""
    changes: dict[str, Any] = {
        "length": rope.length * length,
        "com": rope.com * length,
        "mass": rope.mass * mass,
        "tip_mass": rope.tip_mass * mass,
        "inertia": rope.inertia * mass * length**2,
    }
    changes |= {name: getattr(rope, name) * friction for name in DAMPING}
    return rope.replace(**changes)
