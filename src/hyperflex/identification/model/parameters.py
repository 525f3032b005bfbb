"""Free parameters: their scales and bounds for the fit, and the rope with given values."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import PROPERTIES, Form, Property, Rope, growth, stretched

Law = Literal["own", "factor", "taper", "pivot"]
Part = dict[str, Array]

ARM = tuple(each.name for each in PROPERTIES.values() if each.owner == "arm")
LED = ("com", "inertia")  # what goes with a uniform link's length
MOVING = ("link", "rope", "motion")  # whose properties move the rope; the others are looked at
GRAVITY = ("gravity_angle", "gravity_scale")
SMALL = 0.1  # rad, and parts of a time or place scale, by which such parameters are compared


@dataclass(frozen=True)
class Parameter:
    """One free number.

    The fit works on x: the logarithm of the value (``log``), or the value over `scale`, kept >= 0 where its form
    is ``nonnegative``. Of a law along the rope x is the logarithm of a factor on all links' guesses (``factor``), of
    its growth from the motor to the tip (``taper``) or of a factor on the first joint's alone (``pivot``). Tapers and
    pivots multiply what others of the name make.
    """

    name: str
    links: tuple[int, ...]  # which links (or markers, of an arc) take it; empty for a property of the whole
    label: str
    start: float
    scale: float
    law: Law = "own"

    @property
    def kind(self) -> Property:
        """The property that it is a number of."""
        return PROPERTIES[self.name]

    @property
    def form(self) -> Form:
        """How the fitter sees it."""
        if self.law == "own":
            return self.kind.form or "linear"
        return "linear" if self.law == "taper" else "log"

    @property
    def first(self) -> float:
        """The x that it starts from."""
        return float(np.log(self.start)) if self.form == "log" else max(self.start / self.scale, self.least)

    @property
    def least(self) -> float:
        """The least x."""
        return self.kind.least if self.form == "nonnegative" else -np.inf

    @property
    def width(self) -> float:
        """Change of x that makes parameters comparable when judging what can be known.

        A factor of e, a length, a whole inertia, 1 % of gravity's torque, 0.1 rad, 0.1 of a time or place scale.
        """
        return SMALL if self.form == "linear" and self.law == "own" and self.name != "com" else 1.0

    def value(self, x: float) -> float:
        """Return the value in SI units; of a law the factor, or the logarithm of the growth."""
        return float(np.exp(x)) if self.form == "log" else self.scale * x

    def derivative(self, x: float) -> float:
        """Return d value / d x."""
        return float(np.exp(x)) if self.form == "log" else self.scale


class Parameters:
    """The free parameters of a rope and of its measurement.

    Where a length is free and the guess uniform, centre of mass and inertia follow unless they are free themselves.
    """

    def __init__(self, guess: Rope, chosen: Sequence[Parameter]) -> None:
        self.guess = guess
        self.all = tuple(chosen)
        self.labels = tuple(p.label for p in self.all)  # e.g. ``friction[1]``
        self.names = frozenset(p.name for p in self.all)
        self.lower = np.array([p.least for p in self.all])  # bounds of x
        self.widths = np.array([p.width for p in self.all])  # comparable changes of x
        self.led = {name: np.ones(guess.n_links, dtype=bool) for name in LED}  # which links' are not free themselves
        for parameter in self.all:
            if parameter.name in LED:
                self.led[parameter.name][list(parameter.links)] = False
        self.middle = (np.cumsum(guess.length) - 0.5 * guess.length) / guess.total_length - 0.5

    def __len__(self) -> int:
        return len(self.all)

    @property
    def start(self) -> Array:
        """First guess x (P,)."""
        return np.array([p.first for p in self.all])

    def rounded(self, x: Array) -> Array:
        """Return x (P,) with 0 for what is left at its bound."""
        return np.where((x > 0.0) & (x <= self.lower), 0.0, x)

    def values(self, x: Array) -> Array:
        """Return the values (P,) in SI units."""
        return np.array([p.value(each) for p, each in zip(self.all, x, strict=True)])

    def derivatives(self, x: Array) -> Array:
        """Return d value / d x (P,)."""
        return np.array([p.derivative(each) for p, each in zip(self.all, x, strict=True)])

    def scaled(self, x: Array, factors: Array) -> Array:
        """Return x (P,) with the values multiplied by positive factors (P,)."""
        return np.array(
            [x + np.log(f) if p.form == "log" else f * x for p, x, f in zip(self.all, x, factors, strict=True)]
        )

    def single(self, name: str, x: Array, held: float = 0.0) -> float:
        """Return the value of a parameter of the whole, `held` where it is not free."""
        return next((p.value(each) for p, each in zip(self.all, x, strict=True) if p.name == name), held)

    def rope(self, x: Array) -> Rope:
        """Return the guess with the free parameters set to x."""
        changes: dict[str, Any] = {}
        columns: dict[str, Array] = {}
        for parameter, each in zip(self.all, x, strict=True):
            name, value = parameter.name, parameter.value(each)
            if name in GRAVITY:
                before = changes.get("gravity", self.guess.gravity)
                changes["gravity"] = value * before if name == "gravity_scale" else rotated_gravity(before, value)
            elif parameter.kind.owner == "rope":
                changes[name] = value
            elif parameter.kind.owner == "link":
                column = columns.setdefault(name, getattr(self.guess, name).copy())
                if parameter.law == "own":
                    column[list(parameter.links)] = value
                else:
                    column *= np.exp(each * self.shape(parameter.law))
        if "length" in columns:
            longer = stretched(self.guess, columns["length"])
            for name in LED:
                column = columns.setdefault(name, getattr(self.guess, name).copy())
                column[self.led[name]] = getattr(longer, name)[self.led[name]]
        return self.guess.replace(**changes, **columns)

    def possible(self, x: Array) -> Rope | None:
        """Return the rope, or None where x describes none (a link without any inertia, a mass beyond all numbers)."""
        try:
            return self.rope(x)
        except InvalidInput:
            return None

    def shape(self, law: str) -> Array:
        """Return what a law multiplies the links' values by (n,), as logarithms by its x."""
        one = np.ones(self.guess.n_links)
        return {"taper": self.middle, "pivot": np.where(np.arange(one.size) == 0, 1.0, 0.0)}.get(law, one)

    def parts(self, x: Array, rope: Rope) -> list[tuple[int, Part]]:
        """Return which parameters move the rope, and by how much each property changes with their x.

        `rope` is that of x. A part maps a property to its change, as in :func:`hyperflex.sensitivities`; ``delay``
        stands for the motion's.
        """
        found = []
        for k, (parameter, each) in enumerate(zip(self.all, x, strict=True)):
            if parameter.kind.owner in MOVING:
                found.append((k, self._part(parameter, float(each), rope)))
        return found

    def _part(self, parameter: Parameter, x: float, rope: Rope) -> Part:
        name = parameter.name
        if name == "gravity_scale":
            return {"gravity": rope.gravity.copy()}  # x is its logarithm
        if name == "gravity_angle":
            gx, gy = rope.gravity
            return {"gravity": np.array([-gy, gx]) * parameter.scale}
        if parameter.kind.owner != "link":
            return {name: np.array([parameter.derivative(x)])}
        if parameter.law != "own":
            change = getattr(rope, name) * self.shape(parameter.law)
        else:
            change, links, value = np.zeros(rope.n_links), list(parameter.links), parameter.value(x)
            uneven = getattr(rope, name)[links] / value if value != 0.0 else 1.0  # by a taper or a pivot
            change[links] = parameter.derivative(x) * uneven
        return {name: change} | (self._follow(rope, change) if name == "length" else {})

    def _follow(self, rope: Rope, change: Array) -> Part:
        """Return what goes with a change of the lengths (n,): centres of mass and inertias that are not free."""
        found = zip(LED, growth(self.guess, rope.length, change), strict=True)
        led = {name: np.where(self.led[name], own, 0.0) for name, own in found}
        return {name: own for name, own in led.items() if own.any()}


def lumped(rope: Rope) -> tuple[Array, Array]:
    """Return first moments p (n,), kg m, and moments of inertia about the joints J (n,), kg m^2.

    p_i = m_i a_i + l_i (all mass beyond); J_i = inertia_i + m_i a_i^2 + l_i^2 (all mass beyond).
    """
    beyond = np.append(np.cumsum(rope.mass[::-1])[::-1][1:], 0.0) + rope.tip_mass
    p = rope.mass * rope.com + rope.length * beyond
    inertia = rope.inertia + rope.mass * rope.com**2 + rope.length**2 * beyond
    return p, inertia


def rotated_gravity(gravity: Array, angle: float) -> Array:
    """Return gravity turned by `angle`, so that the rope hangs at its former angle plus `angle`."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * gravity[0] - s * gravity[1], s * gravity[0] + c * gravity[1]])
