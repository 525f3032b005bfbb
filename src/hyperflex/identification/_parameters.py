"""What is free, how it is scaled and bounded for the fitter, and how a rope is made of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope

Form = Literal["log", "linear", "nonnegative"]

FORMS: dict[str, Form] = {
    "inertia": "nonnegative",
    "mass": "log",
    "length": "log",
    "com": "linear",
    "friction": "nonnegative",
    "dry_friction": "nonnegative",
    "stiffness": "nonnegative",
    "tip_mass": "nonnegative",
    "gravity_angle": "linear",
}
SCALARS = ("tip_mass", "gravity_angle")
TORQUES = ("friction", "dry_friction", "stiffness", "tip_mass")  # with small scales, see SHARE
SHARE = 0.01  # size of an unknown small torque, as a part of gravity's, in the scale of a friction that starts from 0
_NAME = re.compile(r"(?P<name>[a-z_]+)(?:\[(?P<link>\d+)\])?(?P<shared>:shared)?\Z")


@dataclass(frozen=True)
class Parameter:
    """One free number.

    The fitter works on x: the logarithm of the value (``log``), or the value over `scale`, kept >= 0 where its form
    is ``nonnegative``.
    """

    name: str
    links: tuple[int, ...]  # which links take it; empty for a property of the whole rope
    label: str
    start: float
    scale: float

    @property
    def form(self) -> Form:
        """How the fitter sees it."""
        return FORMS[self.name]

    @property
    def step(self) -> float:
        """Difference in x for derivatives: effects well above the rollout's tolerance, well below their curvature."""
        return 1e-2 if self.name in TORQUES else 1e-4

    def value(self, x: float) -> float:
        """Return the value in SI units."""
        return float(np.exp(x)) if self.form == "log" else self.scale * x

    def slope(self, x: float) -> float:
        """Return d value / d x."""
        return float(np.exp(x)) if self.form == "log" else self.scale


class Parameters:
    """The free parameters of a rope, in the order of `free`."""

    def __init__(self, guess: Rope, free: Sequence[str]) -> None:
        self.guess = guess
        self.all = tuple(_parse(guess, free))

    def __len__(self) -> int:
        return len(self.all)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the single numbers, e.g. ``friction[1]``."""
        return tuple(p.label for p in self.all)

    @property
    def steps(self) -> Array:
        """Steps of the differences (P,)."""
        return np.array([p.step for p in self.all])

    @property
    def start(self) -> Array:
        """First guess x (P,)."""
        return np.array([np.log(p.start) if p.form == "log" else p.start / p.scale for p in self.all])

    @property
    def lower(self) -> Array:
        """Lower bounds of x (P,)."""
        return np.array([0.0 if p.form == "nonnegative" else -np.inf for p in self.all])

    def values(self, x: Array) -> Array:
        """Return the values (P,) in SI units."""
        return np.array([p.value(each) for p, each in zip(self.all, x, strict=True)])

    def slopes(self, x: Array) -> Array:
        """Return d value / d x (P,)."""
        return np.array([p.slope(each) for p, each in zip(self.all, x, strict=True)])

    @property
    def widths(self) -> Array:
        """Return the changes of x (P,) by which parameters are compared when judging what can be known.

        A factor of e, a link's length, its whole inertia, a torque of 1 % of gravity's, 0.1 rad.
        """
        return np.array([0.1 if p.name == "gravity_angle" else 1.0 for p in self.all])

    def rope(self, x: Array) -> Rope:
        """Return the guess with the free parameters set to x."""
        changes: dict[str, object] = {}
        for parameter, value in zip(self.all, self.values(x), strict=True):
            if parameter.name == "gravity_angle":
                changes["gravity"] = _turned(self.guess.gravity, value)
            elif parameter.name == "tip_mass":
                changes["tip_mass"] = value
            else:
                column = changes.setdefault(parameter.name, getattr(self.guess, parameter.name).copy())
                column[list(parameter.links)] = value  # type: ignore[index]
        return self.guess.replace(**changes)

    def possible(self, x: Array) -> Rope | None:
        """Return the rope, or None where x describes none (a link without any inertia, a mass beyond all numbers)."""
        try:
            return self.rope(x)
        except InvalidInput:
            return None


def lumped(rope: Rope) -> tuple[Array, Array]:
    """Return what the motion depends on besides lengths and friction: first and second moments about the joints.

    Returns
    -------
    p : (n,) kg m
        m_i a_i + l_i (all mass beyond).
    inertia : (n,) kg m^2
        J_i + m_i a_i^2 + l_i^2 (all mass beyond).
    """
    beyond = np.append(np.cumsum(rope.mass[::-1])[::-1][1:], 0.0) + rope.tip_mass
    p = rope.mass * rope.com + rope.length * beyond
    inertia = rope.inertia + rope.mass * rope.com**2 + rope.length**2 * beyond
    return p, inertia


def _turned(gravity: Array, angle: float) -> Array:
    """Return gravity turned by `angle`, so that the rope hangs at its former angle plus `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * gravity[0] - s * gravity[1], s * gravity[0] + c * gravity[1]])


def _parse(guess: Rope, free: Sequence[str]) -> list[Parameter]:
    """Return the parameters that the names in `free` stand for."""
    if isinstance(free, str) or len(free) == 0:
        raise InvalidInput("free names no parameters", got=free, allowed="a list such as ['inertia', 'friction']")
    result: list[Parameter] = []
    for word in free:
        match = _NAME.match(word) if isinstance(word, str) else None
        if match is None or match["name"] not in FORMS or (match["link"] and match["shared"]):
            raise InvalidInput(
                "free has an unknown name",
                got=word,
                allowed=f"{', '.join(FORMS)}; 'friction[2]' for one link, 'friction:shared' for one value of all links",
            )
        result += _one(guess, match["name"], match["link"], bool(match["shared"]))
    taken = [(p.name, link) for p in result for link in p.links or (-1,)]
    twice = sorted({f"{name}[{link}]" if link >= 0 else name for name, link in taken if taken.count((name, link)) > 1})
    if twice:
        raise InvalidInput("free names the same thing twice", got=list(free), allowed=f"{', '.join(twice)} only once")
    return result


def _one(guess: Rope, name: str, link: str | None, shared: bool) -> list[Parameter]:
    """Return the parameters of one word in `free`."""
    if name in SCALARS:
        if link or shared:
            raise InvalidInput(f"{name} belongs to the whole rope", got=f"{name}[{link}]", allowed=name)
        start, scale = (guess.tip_mass, SHARE * guess.total_mass) if name == "tip_mass" else (0.0, 1.0)
        return [Parameter(name, (), name, start, max(start, scale))]
    n = guess.n_links
    if link is not None and int(link) >= n:
        raise InvalidInput(
            "free names a link that the rope does not have", got=f"{name}[{link}]", allowed=f"0 to {n - 1}"
        )
    starts, scales = _starts(guess, name)
    if shared:
        return [Parameter(name, tuple(range(n)), f"{name}:shared", float(starts.mean()), float(scales.mean()))]
    chosen = range(n) if link is None else (int(link),)
    return [Parameter(name, (k,), f"{name}[{k}]", float(starts[k]), float(scales[k])) for k in chosen]


def _starts(guess: Rope, name: str) -> tuple[Array, Array]:
    """Return start values and scales (n,) of a per-link property; what starts from 0 gets a typical size as scale."""
    value = np.array(getattr(guess, name))
    p, inertia = lumped(guess)
    weight = np.abs(p) * (float(np.hypot(*guess.gravity)) or 1.0)
    if FORMS[name] == "log":
        if not (value > 0.0).all():
            raise InvalidInput(f"{name} is free but starts from 0", got=value, allowed=f"a guess of {name} > 0")
        return value, value
    if name in ("com", "inertia"):
        return value, guess.length if name == "com" else inertia
    typical = SHARE * (np.sqrt(weight * inertia) if name == "friction" else weight)
    return value, np.maximum(value, typical)
