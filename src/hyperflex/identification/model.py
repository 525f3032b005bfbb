"""Free parameters, with their scales and bounds for the fit, and predicted measurements with their derivatives."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import TORQUE as JOINTS
from hyperflex.core.chain.drive import Drive
from hyperflex.core.tangent.forward_sensitivity import Directions, place_changes
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.model import (
    FREE_PROPERTIES,
    PROPERTIES,
    RESISTANCES,
    Arm,
    Form,
    Label,
    Property,
    Rope,
    Setup,
    divided,
    parse_label,
    stretched,
)
from hyperflex.motion import TINY, Motion, hold_arm, torque_profile
from hyperflex.sensors import Angles, Markers, MotorTorque, PostureSensor
from hyperflex.simulation import ParameterDirections, Rollout, forward_derivatives

Law = Literal["own", "factor", "taper", "pivot"]
Part = dict[str, Array]

ARM = tuple(each.name for each in PROPERTIES.values() if each.owner == "arm")
LED = ("com", "inertia")  # what goes with a link's length
GRAVITY = ("gravity_angle", "gravity_scale")
SMALL = 0.1  # rad, parts of a time or place scale, by which such parameters are compared, and of the rope's length


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
    prior: float = np.inf  # standard deviation of its x about `start`, known beforehand; inf: none

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

    def value(self, x: Any) -> Any:
        """Return the value in SI units, real or complex as x; of a law the factor, or the logarithm of the growth."""
        return np.exp(x) if self.form == "log" else self.scale * x

    def derivative(self, x: float) -> float:
        """Return d value / d x."""
        return float(np.exp(x)) if self.form == "log" else self.scale


class Parameters:
    """The free parameters of a rope and of its measurement.

    Where a length is free, centre of mass and inertia follow unless they are free themselves.
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
        self.middle = guess.link_middles / guess.total_length - 0.5
        self.prior = np.diag([1.0 / p.prior for p in self.all])[[np.isfinite(p.prior) for p in self.all]]
        self.expected = self.prior @ self.start

    def __len__(self) -> int:
        return len(self.all)

    @property
    def start(self) -> Array:
        """First guess x (P,)."""
        return np.array([p.first for p in self.all])

    def rounded(self, x: Array) -> Array:
        """Return x (P,) with 0 for what is left at its bound."""
        return np.where((x > 0.0) & (x <= self.lower), 0.0, x)

    def prior_residual(self, x: Array) -> Array:
        """Return how far x (P,) is from what is known beforehand (r,), in standard deviations; `prior` (r, P) by x."""
        return np.asarray(self.prior @ x - self.expected)

    def constants(self, x: npt.NDArray[Any], held: Array) -> npt.NDArray[Any]:
        """Return the constants (k,) of the motors at x (P,), real or complex as x, where `held` are as declared."""
        found = held.astype(x.dtype)
        for parameter, each in zip(self.all, x, strict=True):
            if parameter.name == CONSTANT:
                own, factor = list(parameter.links), parameter.law == "factor"
                found[own] = parameter.value(each) * (found[own] if factor else 1.0)
        return found

    def starting(self, starts: Mapping[str, float]) -> "Parameters":
        """Return the same with other starts by name."""
        return Parameters(self.guess, [replace(each, start=starts.get(each.name, each.start)) for each in self.all])

    def values(self, x: Array) -> Array:
        """Return the values (P,) in SI units."""
        return np.array([p.value(each) for p, each in zip(self.all, x, strict=True)])

    def derivatives(self, x: Array) -> Array:
        """Return d value / d x (P,)."""
        return np.array([p.derivative(each) for p, each in zip(self.all, x, strict=True)])

    def single(self, name: str, x: Array, held: float = 0.0) -> float:
        """Return the value of a parameter of the whole, `held` where it is not free."""
        return next((p.value(each) for p, each in zip(self.all, x, strict=True) if p.name == name), held)

    @checks.derived()
    def rope(self, x: Array) -> Rope:
        """Return the guess with the free parameters set to x."""
        return self.guess.replace(**self._changed(x))

    def _changed(self, x: npt.NDArray[Any]) -> dict[str, Any]:
        """Return the properties of the rope that differ from the guess at x (P,), real or complex as x."""
        found: dict[str, Any] = {}
        for parameter, each in zip(self.all, x, strict=True):
            name, value = parameter.name, parameter.value(each)
            if name in GRAVITY:
                gravity, c, s = found.get("gravity", self.guess.gravity), np.cos(value), np.sin(value)
                # the rope hangs at its former angle plus the value
                found["gravity"] = value * gravity if name == "gravity_scale" else np.array([[c, -s], [s, c]]) @ gravity
            elif parameter.kind.owner == "rope":
                found[name] = value
            elif parameter.kind.owner == "link":
                column = found.setdefault(name, getattr(self.guess, name).astype(x.dtype))
                if parameter.law == "own":
                    column[list(parameter.links)] = value
                else:
                    column *= np.exp(each * self.shape(parameter.law))
        if "length" in found:
            longer = stretched(self.guess, found["length"])
            for name, led in self.led.items():
                found[name] = np.where(led, longer[name], found.get(name, getattr(self.guess, name)))
        return found

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

    def parts(self, x: Array, constants: Array | None = None) -> list[tuple[int, Part]]:
        """Return which parameters move the rope, and by how much each property changes with their x.

        `constants` (k,) are declared of the motors that drive it.

        A part maps a property to its change, as in :func:`hyperflex.sensitivities`; ``delay`` stands for the motion's.
        Changes are exact: imaginary parts of the properties at x with a tiny imaginary part (complex-step derivative).
        """
        found = list[tuple[int, Part]]()
        for k, parameter in enumerate(self.all):
            if parameter.kind.owner == "motion":
                found.append((k, {parameter.name: np.array([parameter.derivative(x[k])])}))
            elif parameter.name == CONSTANT and constants is not None:
                changed = self.constants(np.where(np.arange(x.size) == k, x + 1j * TINY, x), constants)
                found.append((k, {CONSTANT: changed.imag / TINY}))
            elif parameter.kind.owner in ("link", "rope", "view"):
                moved = self._changed(np.where(np.arange(x.size) == k, x + 1j * TINY, x))
                found.append((k, {name: np.atleast_1d(each.imag) / TINY for name, each in moved.items()}))
        return found


def lumped(rope: Rope) -> tuple[Array, Array]:
    """Return first moments p (n,), kg m, and moments of inertia about the joints J (n,), kg m^2.

    p_i = m_i a_i + l_i (all mass beyond); J_i = inertia_i + m_i a_i^2 + l_i^2 (all mass beyond).
    """
    beyond = np.append(np.cumsum(rope.mass[::-1])[::-1][1:], 0.0) + rope.tip_mass
    p = rope.mass * rope.com + rope.length * beyond
    inertia = rope.inertia + rope.mass * rope.com**2 + rope.length**2 * beyond
    return p, inertia


SHARE = 0.01  # size of an unknown small torque, as a part of gravity's, in the scale of a friction that starts from 0
DELAY = 0.05  # s, scale of the time between camera and motor
NEEDS = {  # what must be measured for parameters that are not the rope's
    "motion": ("nothing moves the first joint", "motion=..."),
    "camera": ("no places are measured", "arc_lengths=..."),
    "marker": ("no places are measured", "arc_lengths=..."),
    "arm": ("no torque of an arm's motor is measured", "torque=... and arm=..."),
    "motor": ("no torque is measured", "torque=..."),
}
CONSTANT = "torque_constant"


def parse(
    guess: Rope,
    free: Sequence[str],
    arc_lengths: Array | None = None,
    *,
    moved: bool = False,
    arm: Arm | None = None,
    constants: Array | None = None,
) -> list[Parameter]:
    """Return the parameters that the words in `free` (see :func:`hyperflex.identify`) stand for.

    `arc_lengths` (K,), m, are of the markers; `moved` tells whether something drives the rope, so that a delay has a
    meaning; `arm` is that whose motor torque is measured; `constants` (k,) are of the motors whose torque is.
    """
    if isinstance(free, str) or not isinstance(free, Iterable) or len(free := list(free)) == 0:
        raise InvalidInput("free names no parameters", got=free, allowed="a list such as ['inertia', 'friction']")
    result: list[Parameter] = []
    for word in free:
        label = parse_label(word)
        if label is None or label.name not in FREE_PROPERTIES:
            raise InvalidInput(
                "free has an unknown name",
                got=word,
                allowed=f"{', '.join(FREE_PROPERTIES)}; 'friction[2]' for one link, 'friction:shared' for one value of "
                "all links, 'friction:inner' for one of all but the first, 'friction:factor' and 'friction:taper' for "
                "laws along the rope",
            )
        result += _one(guess, label, arc_lengths, moved, arm, constants)
    slots: Counter[tuple[str, object]] = Counter()
    for p in result:
        taken: Sequence[object] = (p.links or (p.name,)) if p.law == "own" else (p.law,)
        slots.update((p.name, slot) for slot in taken)
    own, laws = ({p.name for p in result if (p.law == "own") == own} for own in (True, False))
    twice = own & laws | {f"{name}[{slot}]" for (name, slot), times in slots.items() if times > 1}
    if twice:
        allowed = f"{', '.join(sorted(twice))} only once"
        raise InvalidInput("free names the same thing twice", got=list(free), allowed=allowed)
    return result


def _one(
    guess: Rope, label: Label, arc_lengths: Array | None, moved: bool, arm: Arm | None, constants: Array | None
) -> list[Parameter]:
    """Return the parameters of a word in `free`, or of a tested factor; what no object holds starts at its default."""
    name, place, law = label
    about = PROPERTIES[name]
    owner, unseen = about.owner, arc_lengths is None
    missing = {"motion": not moved, "camera": unseen, "marker": unseen, "arm": arm is None, "motor": constants is None}
    if missing.get(owner):
        why, fix = NEEDS[owner]
        raise InvalidInput(f"{name} is free, but {why}", fix=f"Give {fix}, or leave it out")
    held = getattr(arm, name.removeprefix("arm_"), None) if owner == "arm" else getattr(guess, name, None)
    held = {"marker": arc_lengths, "motor": constants}.get(owner, held)
    known = about.default if held is None else held
    starts = np.atleast_1d(np.asarray(known, dtype=np.float64))
    every, whole = tuple(range(starts.size)), owner not in ("link", "marker", "motor")
    if (place is not None and (whole or place not in every)) or (law and owner not in ("link", "motor")):
        what = "belongs to the whole rope, or camera" if whole else f"names a {owner} that the rope does not have"
        raise InvalidInput(
            f"{name} {what}",
            got=f"{name}[{place}]" if law == "" else f"{name}:{law}",
            allowed=name if whole else f"{name}, or one of 0 to {every[-1]}",
        )
    if law in ("factor", "taper", "pivot"):
        if not starts[: 1 if law == "pivot" else None].any():
            raise InvalidInput(f"{name}:{law} is free but starts from 0", allowed=f"a guess of {name} that is not 0")
        return [Parameter(name, every, f"{name}:{law}", 0.0 if law == "taper" else 1.0, 1.0, law)]  # type: ignore[arg-type]
    if about.form is None:
        return [Parameter(name, (), name, float(starts[0]), 1.0, "factor")]
    sizes = scales(guess, name, starts)
    groups: dict[str, tuple[int, ...]] = {f"{name}[{k}]": (k,) for k in (every if place is None else (place,))}
    if whole or law:
        groups = {f"{name}:{law}" if law else name: every[law == "inner" :]}
    if () in groups.values():
        raise InvalidInput(f"{name}:inner is free, but there is one link", allowed=f"{name}")
    return [
        Parameter(name, () if whole else own, word, float(starts[list(own)].mean()), float(sizes[list(own)].mean()))
        for word, own in groups.items()
    ]


def scales(guess: Rope, name: str, starts: Array) -> Array:
    """Return the scales (N,) of values: what they start from, or what is typical by unit or name, if that is more."""
    if FREE_PROPERTIES[name].form == "log":
        if not (starts > 0.0).all():
            raise InvalidInput(f"{name} is free but starts from 0", got=starts, allowed=f"a guess of {name} > 0")
        return starts
    (p, inertia), gravity = lumped(guess), float(np.hypot(*guess.gravity)) or 1.0
    p = np.maximum(np.abs(p), SHARE * guess.mass * guess.length)  # a mass at its joint has no moment
    weight, mass, length = SHARE * p * gravity, SHARE * guess.total_mass, guess.total_length
    typical: dict[str, Array | float] = {
        "com": guess.length,
        "m": SMALL * length,
        "s": DELAY,
        "rad": 1.0,
        "kg": mass,
        "kg m^2": inertia,
        "N m s/rad": np.sqrt(SHARE * weight * inertia),
        "N m": weight,
        "N m/rad": weight,
        "kg/m^2": mass / length**2,
        "arm_inertia": mass * length**2,
        "arm_friction": mass * length**2 * np.sqrt(gravity / length),
    }
    return np.maximum(np.abs(starts), typical.get(name, typical.get(FREE_PROPERTIES[name].unit, 1.0)))


def perturbed(rope: Rope, moves: Mapping[str, Array], drawn: Array) -> Rope:
    """Return the rope with fitted parameters changed by what was drawn, kept within their bounds.

    Parameters
    ----------
    rope : Rope
        As fitted.
    moves : mapping of str to (k,) array
        Changes by labels such as ``friction[1]`` for each number drawn, SI units; of a factor relative. What is none of
        the rope's is left out.
    drawn : (k,) array
        Standard normal numbers. Where a parameter would cross its bound the nearest to them count that keep it: the
        others follow, and what is known of all together stays known.
    """
    owners = {label: FREE_PROPERTIES[parts.name].owner for label in moves if (parts := parse_label(label))}
    own = [label for label, owner in owners.items() if owner in ("link", "rope")]
    if not own:
        return rope
    parameters = Parameters(rope, parse(rope, own))
    x = parameters.start
    root = np.array([moves[label] for label in own]) / parameters.derivatives(x)[:, None]
    moved = np.maximum(x + root @ _nearest(drawn, root, parameters.lower - x), parameters.lower)
    return parameters.rope(parameters.rounded(moved))


def _nearest(z: Array, root: Array, least: Array) -> Array:
    """Return the point nearest to z (k,) with root (P, k) @ point >= least (P,), each at most 0.

    Least distance programming by non-negative least squares (Lawson, Hanson, Solving Least Squares Problems, ch. 23).
    """
    size = np.linalg.norm(root, axis=1)
    bounded = np.isfinite(least) & (size > 0.0)
    sides = root[bounded] / size[bounded, None]
    lacking = least[bounded] / size[bounded] - sides @ z
    if (lacking <= 0.0).all():
        return z
    from scipy.optimize import nnls

    both = np.vstack([sides.T, lacking])
    end = np.append(np.zeros(z.size), 1.0)
    left = both @ nnls(both, end)[0] - end
    return np.asarray(z - left[:-1] / left[-1])


PARALLEL = 0.1  # part of a direction that may lie outside of others for it to count as one of them
Mask = npt.NDArray[np.bool_]


def rope_derivatives(parameters: Parameters, x: Array, function: Callable[[Rope], Array]) -> Array:
    """Return the derivatives (.., P) of a function of the rope by x (P,): central differences, within bounds."""
    columns = []
    for k in range(x.size):
        up, down, step = x.copy(), x.copy(), 1e-6 * max(1.0, abs(x[k]))
        up[k] += step
        down[k] = max(x[k] - step, parameters.lower[k])
        columns.append((function(parameters.rope(up)) - function(parameters.rope(down))) / (up[k] - down[k]))
    return np.stack(columns, axis=-1)


def scaling(parameters: Parameters, x: Array) -> Array | None:
    """Return the direction (P,) in which all moments, frictions and stiffnesses grow alike, or None if there is none.

    In units of ``parameters.widths``, of length 1. It leaves the motion as it is where no known force acts: d/dx of p,
    J (about the joint) and each resistance equals their own value, the lengths between joints stay. Torques have low
    weights: one that is held hides no common factor of the moments.
    """
    now, fixed = _scaled(parameters.rope(x)), np.abs(_scaled(parameters.rope(x)))
    n = parameters.guess.n_links
    sizes = np.concatenate([np.full(n, part.max() or 1.0) for part in fixed.reshape(-1, n)])
    weights = np.where(np.arange(now.size) < 3 * n, 1.0, SHARE) / sizes
    target = np.where(np.arange(now.size) // n == 2, 0.0, now) * weights
    matrix = rope_derivatives(parameters, x, _scaled) * parameters.widths * weights[:, None]
    found: Array = np.linalg.lstsq(matrix, target, rcond=1e-8)[0]
    away = (matrix @ found - target)[: 3 * n]
    length = float(np.linalg.norm(found))
    if np.linalg.norm(away) > PARALLEL * np.linalg.norm(target[: 3 * n]) or length == 0.0:
        return None
    return found / length


def common_factor(parameters: Parameters, x: Array, unknown: Array) -> Array | None:
    """Return `scaling` where it lies among the `unknown` directions (P, k), less what does not; else None."""
    if unknown.shape[1] == 0:
        return None
    common = scaling(parameters, x)
    if common is None or np.linalg.norm(common - unknown @ (unknown.T @ common)) > PARALLEL:
        return None
    return common


def in_common_factor(parameters: Parameters, x: Array, unknown: Array) -> Mask:
    """Return which parameters (P,) stand in an unknown common factor, True also for those at 0.

    At 0 a parameter does not move along the factor, but its uncertainty grows with it: only its ratio is known.
    """
    if common_factor(parameters, x, unknown) is None:
        return np.zeros(len(parameters), dtype=bool)
    return np.array([p.kind.power == 1 and p.law not in ("taper", "pivot") for p in parameters.all])


def _scaled(rope: Rope) -> Array:
    """Return p, J, lengths between joints and all resistances in one row, (n,) of each."""
    between = np.append(rope.length[:-1], 0.0)
    return np.concatenate([*lumped(rope), between, *(getattr(rope, each.name) for each in RESISTANCES)])


# Factors that are tested, and cannot be free: of the angles and torque as read, and of the arm's length
ANGLES, TORQUE, ARM_LENGTH = "angle_factor", f"{CONSTANT}:factor", "arm_length"
PRECISION = 1e-7  # tolerance of a rollout over the rope's length, far below the errors of most measured angles
# Steps of a rollout, beyond which it counts as failed: real ropes take some tens a second. A rope whose last
# link has hardly an inertia turns it at 1e3 rad/s, and a fit that goes there would take minutes.
MOST_STEPS, MOST_STEPS_A_SECOND = 2000, 1000


@dataclass(frozen=True, eq=False)
class Motors:
    """Motors in joints of the rope whose measured torque drives its simulation, straight between the samples.

    joints (k,): joint of each motor, 0 the first. constant (k,): torque over the reading, N m. readings: a torque
    profile of the readings.
    """

    joints: tuple[int, ...]
    constant: Array
    readings: Motion

    @classmethod
    def of(cls, t: Array, readings: Array, joints: Sequence[int], constant: Array) -> "Motors":
        """Return motors from readings (T, k) at times t (T,), s, NaN in gaps, which are bridged by straight lines."""
        columns = np.zeros((t.size, max(joints) + 1))
        for joint, column in zip(joints, readings.T, strict=True):
            known = ~np.isnan(column)
            columns[:, joint] = np.interp(t, t[known], column[known])
        return cls(tuple(joints), constant, torque_profile(t, columns))

    def coef(self, constant: Array) -> Array:
        """Return the coefficients of the torque (pieces, channels, 6) for other constants (k,)."""
        coef = np.zeros_like(self.readings.coef)
        channels = JOINTS + np.array(self.joints)
        coef[:, channels] = self.readings.coef[:, channels] * constant[:, None]
        return coef

    def torque(self, constant: Array, delay: float) -> Motion:
        """Return the torque for constants (k,) and a `delay`, s."""
        source = self.readings
        return Motion(source.breaks + delay, self.coef(constant), source.switch)


@dataclass(frozen=True)
class _Evaluation:
    """All that follows from one x."""

    rope: Rope
    chain: Chain
    motion: Motion | None
    arm: Arm | None
    drive: Drive
    sensor: PostureSensor
    motor: MotorTorque | None
    moving: list[int]  # which parameters move the rope
    directions: ParameterDirections  # state first, then those
    seeds: Directions  # the same for the kernels


@dataclass(frozen=True)
class PredictedChannels:
    """Predicted channels (m, C), and their derivatives by the state (m, C, 2 n) and the parameters (m, C, P)."""

    channels: Array
    state: Array
    shared: Array


@dataclass(eq=False)
class Plant:
    """Predicts the channels of a window, those of `sensor` and, with `torque`, of the arm's motor as the last.

    `motion` and `arm` move the first joint; by default it is fixed. `motors` in the joints turn the links by their
    measured torque; of the arm's motor, whose motion is prescribed, the torque is a channel, and `constant` its torque
    over the reading. precision: tolerance of a rollout over the rope's length. angles: whether these were recorded.
    """

    parameters: Parameters
    sensor: PostureSensor = field(default_factory=Angles)
    motion: Motion | None = None
    arm: Arm | None = None
    torque: bool = False
    constant: float = 1.0
    motors: Motors | None = None
    precision: float = PRECISION
    angles: bool = False

    def __post_init__(self) -> None:
        guess = self.parameters.guess
        self.motor = MotorTorque(self.arm, self.constant) if self.torque and self.arm is not None else None
        self._setup = Setup(guess, self.motion, self.arm, tol=self.precision * guess.total_length)
        self._last: tuple[bytes | None, _Evaluation | None] = (None, None)
        # parameters that are values of the sensor or, numbered after those, of the motor: number, number of the value
        places = {"origin_x": 0, "origin_y": 1, ANGLES: 0}
        if self.motor is not None:
            places |= {name: self.sensor.values.size + k for k, name in enumerate((*ARM, CONSTANT))}
        own = [places.get(p.name, 2 + p.links[0] if p.name == "arc" else None) for p in self.parameters.all]
        self._own = [(k, place) for k, place in enumerate(own) if place is not None]

    @property
    def constants(self) -> Array | None:
        """Torque over reading of each motor (k,) as declared; None where no torque is measured."""
        if self.motors is not None:
            return self.motors.constant
        return None if self.motor is None else np.array([self.constant])

    @property
    def driven(self) -> bool:
        """Whether a motion or a torque drives the rope."""
        return self.motion is not None or self.motors is not None

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: not the last evaluation, whose arrays could be written to then; no kernel's may."""
        return vars(self) | {"_last": (None, None)}

    def cut(self, x: Array, pieces: int) -> "Plant":
        """Return the same at x, without free parameters, each link cut into pieces; InvalidInput where none can be."""
        at = self._at(x)
        if at is None:
            raise InvalidInput("the parameters describe no rope", got=x)
        return Plant(Parameters(divided(at.rope, pieces), []), at.sensor, at.motion, at.arm, precision=self.precision)

    def predict(self, x: Array, t: Array, state: Array) -> Array | None:
        """Return the channels (m, C) at times t (m,) from `state` (2n,) at t[0]; None where the rollout fails."""
        if (run := self._run(x, t, state)) is None:
            return None
        seen = self._channels(run[0], t, run[1])
        return seen if np.isfinite(seen).all() else None

    def propagate(self, x: Array, t: float, state: Array, until: float) -> Array | None:
        """Return the state (2n,) at `until`, s, from `state` at t; None where the rollout fails."""
        run = self._run(x, np.array([t, until]), state)
        return None if run is None or not np.isfinite(run[1][-1]).all() else run[1][-1, : state.size].copy()

    def jacobian(self, x: Array, t: Array, state: Array) -> PredictedChannels | None:
        """Return the same with exact derivatives, or None."""
        at = self._at(x)
        if at is None or not np.isfinite(state).all():
            return None
        n, start = at.rope.n_links, (state[: state.size // 2], state[state.size // 2 :])
        try:
            run = self._rollout(at, t, start, logged=True)
            run.complete()
            _, dy = forward_derivatives(run, at.directions, start, t, at.seeds)
        except SimulationError:
            return None
        y, dy = run.y[-t.size :], dy[:, :, : len(at.directions.names)]
        q = y[:, :n]
        dpivot = np.zeros((t.size, 2, at.directions.width))
        if self.sensor.placed:
            place_changes(at.drive, at.seeds, np.array(t), dpivot)
        seen, count = self._channels(at, t, y), self.sensor.values.size
        moved = at.sensor.jacobian(at.rope, q, dy[:, :n], dpivot[:, :, : dy.shape[2]], at.directions.lengths(n))
        own = np.zeros((*seen.shape, count + len(ARM) + 1))
        own[:, : moved.shape[1], :count] = at.sensor.value_jacobian(at.rope, q)
        if at.motor is not None:
            by_run = at.motor.jacobian(at.chain, at.drive, at.directions.parts[2 * n :], t, y, dy)
            moved = np.concatenate([moved, by_run[:, None]], axis=1)
            own[:, -1, count:] = at.motor.value_jacobian(at.chain, at.drive, t, y)
        shared = np.zeros((*moved.shape[:2], len(self.parameters)))
        shared[:, :, at.moving] = moved[:, :, 2 * n :]
        for k, place in self._own:
            parameter = self.parameters.all[k]
            slope = self._own_value(k, x[k]) if parameter.form == "log" else parameter.derivative(x[k])
            shared[:, :, k] = slope * own[:, :, place]
        if not (np.isfinite(seen).all() and np.isfinite(moved).all()):
            return None
        return PredictedChannels(seen, moved[:, :, : 2 * n], shared)

    def _own_value(self, k: int, x: float) -> float:
        """Return the value of the sensor or the motor that parameter k makes at its x."""
        parameter = self.parameters.all[k]
        held = self.constant if parameter.name == CONSTANT and parameter.law == "factor" else 1.0
        return float(held * parameter.value(x))

    def _rollout(self, at: _Evaluation, t: Array, start: tuple[Array, Array], logged: bool = False) -> Rollout:
        return Rollout(self._setup, t, start, chain=at.chain, drive=at.drive, logged=logged)

    def _run(self, x: Array, t: Array, state: Array) -> tuple[_Evaluation, Array] | None:
        """Return what follows from x, and the states at t (m,) from `state` (2n,); None where that fails."""
        at, n = self._at(x), state.size // 2
        if at is None or not np.isfinite(state).all():
            return None
        run = self._rollout(at, t, (state[:n], state[n:]))
        most = max(MOST_STEPS, MOST_STEPS_A_SECOND * float(t[-1] - t[0])) / run.limits.budget
        return (at, run.y) if run.finish(most=most) == status.OK else None

    def _channels(self, at: _Evaluation, t: Array, y: Array) -> Array:
        """Return the channels (m, C) of states y (m, 2n or more)."""
        moved = self.sensor.placed and (self.motion is not None or self.arm is not None)
        pivot = pivot_places(at.motion, at.arm, t) if moved else np.zeros((t.size, 2))
        seen = at.sensor.predict(at.rope, y[:, : at.rope.n_links], pivot)
        return seen if at.motor is None else np.column_stack([seen, at.motor.predict(at.chain, at.drive, t, y)])

    def _at(self, x: Array) -> _Evaluation | None:
        key = x.tobytes()
        if self._last[0] != key:
            self._last = (key, None)
            with suppress(InvalidInput):  # x describes no rope, or no arm
                self._last = (key, self._prepared(x))
        return self._last[1]

    def _prepared(self, x: Array) -> _Evaluation:
        """Return what follows from x."""
        rope = self.parameters.rope(x)
        motion, arm, drive = self.motion, self.arm, self._setup.drive()
        delay, longer = self.parameters.single("delay", x), self.parameters.single(ARM_LENGTH, x, 1.0)
        constants = None if self.motors is None else self.parameters.constants(x, self.motors.constant)
        if self.motors is not None and constants is not None:
            drive = Setup(self.parameters.guess, torque=self.motors.torque(constants, delay)).drive()
        elif motion is not None and (delay != 0.0 or longer != 1.0):
            arm = None if arm is None else replace(arm, length=longer * arm.length)
            motion = motion.shifted(delay)
            drive = Setup(self.parameters.guess, motion, arm).drive()
        own = np.append(self.sensor.values, [] if self.motor is None else self.motor.values)
        for k, place in self._own:
            own[place] = self._own_value(k, float(x[k]))
        sensor = self.sensor.with_values(own[: self.sensor.values.size])
        motor = None if self.motor is None else self.motor.with_values(own[self.sensor.values.size :])
        moving, unit = (
            self.parameters.parts(x, None if self.motors is None else self.motors.constant),
            np.eye(rope.n_links),
        )
        parts = [{name: row} for name in ("q0", "qd0") for row in unit]
        for _, part in moving:
            if "delay" in part:
                breaks = np.full(drive.breaks.size, part["delay"][0])
                part = {"breaks": breaks, "coef": np.zeros_like(drive.coef)}
            if ARM_LENGTH in part:
                part = {ARM_LENGTH: part[ARM_LENGTH] * drive.arm_length / longer}
            if CONSTANT in part and self.motors is not None:
                part = {"breaks": np.zeros_like(drive.breaks), "coef": self.motors.coef(part[CONSTANT])}
            parts.append(part)
        chain, directions = rope.chain(), ParameterDirections(tuple(map(str, range(len(parts)))), tuple(parts))
        seeds, freed = directions.directions(chain, drive), [k for k, _ in moving]
        return _Evaluation(rope, chain, motion, arm, drive, sensor, motor, freed, directions, seeds)


def pivot_places(motion: Motion | None, arm: Arm | None, t: Array) -> Array:
    """Return the places of the first joint (m, 2), m, in the frame of its motion."""
    motion = motion or hold_arm(0.0)
    place: Array = motion.point(t)
    return place if arm is None else place + arm.tip(motion.angle(t))


def extended(plant: Plant, x: Array, words: Sequence[str]) -> tuple[Plant, Array, dict[str, list[Parameter]]]:
    """Return the model at x (P,) with more free parameters, its x, and these by word; words that fail are out."""
    rope, groups = plant.parameters.rope(plant.parameters.rounded(x)), dict[str, list[Parameter]]()
    arcs = plant.sensor.arc_lengths if isinstance(plant.sensor, Markers) else None
    arm = None if plant.motor is None else plant.arm
    for word in words:
        name, _, law = word.partition(":")
        label = Label(name, None, law) if law == "pivot" else parse_label(word)
        if label is not None and label.name in PROPERTIES:
            with suppress(InvalidInput):  # a mass of 0 has no logarithm, say
                groups[word] = _one(rope, label, arcs, plant.driven, arm, plant.constants)
    extra = [each for group in groups.values() for each in group]
    parameters = Parameters(plant.parameters.guess, [*plant.parameters.all, *extra])
    return replace(plant, parameters=parameters), np.append(x, [each.first for each in extra]), groups


def scale_words(plant: Plant) -> dict[int, str]:
    """Return the words for what has a scale and is held, by number: links' lengths, gravity, the arm's length, torque.

    With lengths, centres of mass and inertias go along.
    """
    driven = plant.motion is not None and plant.arm is not None and plant.arm.length > 0.0
    heavy, names = plant.parameters.guess.gravity.any(), plant.parameters.names
    measured = plant.constants is not None and CONSTANT not in names
    held = ("length" not in names, heavy and "gravity_scale" not in names, driven, measured)
    words = ("length:factor", "gravity_scale", ARM_LENGTH, TORQUE)
    return {k: word for k, (word, own) in enumerate(zip(words, held, strict=True)) if own}
