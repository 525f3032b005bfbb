"""Parameter directions: names and mappings, checked, as kernel arrays."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain, can_stick
from hyperflex.core.chain.drive import TORQUE, Drive
from hyperflex.core.read_only import read_only
from hyperflex.core.tangent import extrapolation as dr
from hyperflex.core.tangent import step as tg
from hyperflex.core.tangent.extrapolation import Directions
from hyperflex.errors import InvalidInput
from hyperflex.model import LINK_PROPERTIES, Arm, Setup
from hyperflex.motion import motion_derivatives, motion_parameters

DIFFERENTIABLE = tuple(each.name for each in LINK_PROPERTIES if each.form)
STATE_NAMES = ("q0", "qd0")
# parts of a direction that the user makes himself: how often it is told
PARTS = (*STATE_NAMES, *DIFFERENTIABLE, "tip_mass", "gravity", "arm_length", "breaks", "coef")
# of a torque-driven arm, the chain's first link: its own names, and those of the links
ARM_NAMES = {
    **{f"arm.{each.name}": each.name for each in fields(Arm) if each.name in DIFFERENTIABLE},
    "arm_angle0": "q0",
    "arm_rate0": "qd0",
}
ParameterChange = dict[str, Array]
Wrt = Iterable[str | Mapping[str, Mapping[str, npt.ArrayLike]]] | str
_MOMENTS = ("mass", "com", "inertia")  # they come in as moments about the joint
_SEED_OF = {
    each.name: getattr(tg, each.field.upper()) for each in LINK_PROPERTIES if each.form and each.name not in _MOMENTS
}
FAINT = 1e-300  # N m, kg/m^2: dry friction and drag that change no run, and are felt by its derivatives alone


@dataclass(frozen=True)
class ParameterDirections:
    """Directions of a derivative by name; each is a dict of changes per unit of its parameter, see PARTS."""

    names: tuple[str, ...]
    parts: tuple[ParameterChange, ...]

    def start(self, n: int) -> Array:
        """Derivatives of the start, angles above rates: (2 n, p), p even."""
        result = np.zeros((2 * n, self.width))
        for p, part in enumerate(self.parts):
            for row, name in enumerate(STATE_NAMES):
                if name in part:
                    result[row * n : (row + 1) * n, p] = part[name]
        return result

    @property
    def width(self) -> int:
        """Number of directions, padded to an even number."""
        return len(self.parts) + len(self.parts) % 2

    def lengths(self, n: int) -> Array:
        """Derivatives of the links' lengths (n, P), m."""
        return np.stack([part.get("length", np.zeros(n)) for part in self.parts], axis=1)

    def with_faint_terms(self, chain: Chain) -> Chain:
        """The chain, with FAINT dry friction or drag where a direction changes one that is zero."""
        for each in (each for each in LINK_PROPERTIES if each.least):
            now, faint = getattr(chain, each.field), np.zeros(chain.length.size)
            for part in self.parts:
                faint[part.get(each.name, faint) != 0.0] = FAINT
            if (faint > now).any():
                chain = chain._replace(**{each.field: np.maximum(now, faint)})
        return read_only(chain)

    def directions(self, chain: Chain, drive: Drive) -> Directions:
        """The same for the kernels, at the parameters of `chain` and for a drive."""
        n, pairs, pieces = chain.length.size, self.width // 2, drive.coef.shape[0]
        links, whole = np.zeros((self.width, n, tg.SEEDS)), np.zeros((self.width, 3))
        driven = np.full(self.width, -1, dtype=np.int64)
        rows: list[ParameterChange] = []
        for p, part in enumerate(self.parts):
            _link_seeds(part, chain, links[p])
            whole[p, dr.TIP_MASS] = part.get("tip_mass", np.zeros(1))[0]
            whole[p, dr.GRAVITY_X : dr.GRAVITY_Y + 1] = part.get("gravity", np.zeros(2))
            if part.keys() & {"breaks", "coef", "arm_length"}:
                driven[p] = len(rows)
                rows.append(part)
        if (
            can_stick(chain) and drive.coef[..., 1:].any()
        ):  # events move in every direction, and then the base with them
            driven[driven < 0] = len(rows)
            rows.append({})
        breaks, coef, arm = np.zeros((len(rows), pieces + 1)), np.zeros((len(rows), pieces, 4, 6)), np.zeros(len(rows))
        for m, part in enumerate(rows):
            breaks[m], coef[m] = part.get("breaks", 0.0), part.get("coef", 0.0)
            arm[m] = part.get("arm_length", np.zeros(1))[0]
        own = links.any(axis=(1, 2)) | ((driven >= 0) & drive.coef[:, TORQUE].any())
        return Directions(
            links.reshape(pairs, 2, n, tg.SEEDS),
            whole,
            np.asarray(own.reshape(pairs, 2).any(axis=1)),
            driven,
            breaks,
            coef,
            arm,
        )


def _link_seeds(part: ParameterChange, chain: Chain, out: Array) -> None:
    """Write a direction's changes of a chain's links, in the kernels' own parameters, to out (n, SEEDS)."""
    for name, slot in _SEED_OF.items():
        if name in part:
            out[:, slot] = part[name]
    mass, com, inertia = (part.get(name, 0.0) for name in _MOMENTS)
    out[:, tg.MASS] = mass
    out[:, tg.MA] = chain.com * mass + chain.mass * com
    out[:, tg.INERTIA] = inertia + chain.com**2 * mass + 2.0 * chain.mass * chain.com * com


def parameter_directions(setup: Setup, wrt: Wrt) -> ParameterDirections:
    """Check what a user wants derivatives with respect to; see :func:`hyperflex.sensitivities`."""
    entries = list(wrt) if isinstance(wrt, Iterable) and not isinstance(wrt, (str, Mapping)) else [wrt]
    names: list[str] = []
    parts: list[ParameterChange] = []
    for entry in entries:
        if isinstance(entry, str):
            found = _by_name(setup, entry)
        elif isinstance(entry, Mapping):
            found = {name: _own(setup, name, part) for name, part in entry.items()}
        else:
            raise InvalidInput("wrt holds neither a name nor a mapping", got=entry, allowed=_allowed(setup))
        names += found
        parts += found.values()
    if not names:
        fix = "Say what to differentiate by, as wrt='friction' or wrt=['q0', 'tip_mass']"
        raise InvalidInput("wrt is empty", allowed=_allowed(setup), fix=fix)
    if len(set(names)) != len(names):
        raise InvalidInput("wrt names something twice", got=names, allowed="each name once")
    if setup.torque_driven:
        parts = [_with_arm(part, setup.rope.n_links) for part in parts]
    return ParameterDirections(tuple(names), tuple(parts))


def _with_arm(part: ParameterChange, n: int) -> ParameterChange:
    """A direction of the rope's n links, and of the arm, as one of a chain that begins with the arm."""
    joined = {name: value for name, value in part.items() if name not in (*STATE_NAMES, *DIFFERENTIABLE, *ARM_NAMES)}
    if "arm_length" in joined:
        part = {**part, "arm.length": joined.pop("arm_length")}
    arm = {name: part[own] for own, name in ARM_NAMES.items() if own in part}
    for name in (*STATE_NAMES, *DIFFERENTIABLE):
        if name in part or name in arm:
            joined[name] = np.append(arm.get(name, 0.0), part.get(name, np.zeros(n)))
    return joined


def _allowed(setup: Setup) -> str:
    links = ", ".join((*STATE_NAMES, *DIFFERENTIABLE))
    moving = ", ".join(f"motion.{name}" for name in motion_parameters(setup.motion)[:8]) if setup.motion else ""
    if setup.torque is not None:
        moving = ", ".join(f"torque.{name}" for name in motion_parameters(setup.torque)[:8])
    arm = ", arm.length" if setup.arm is not None else ""
    if setup.torque_driven:
        arm = "".join(f", {name}" for name in ARM_NAMES)
    return (
        f"{links} (of all links as one, name[3] of one, name[:] of each; q0 and qd0 are always of each), tip_mass, "
        f"gravity[0], gravity[1]{arm}{moving and ', ' + moving}, or a mapping {{name: {{property: change}}}}"
    )


def _by_name(setup: Setup, name: str) -> dict[str, ParameterChange]:
    n = setup.rope.n_links
    match = re.fullmatch(r"([a-z_0-9]+)(?:\[(\d+|:)\])?", name)
    base, index = match.groups() if match else (name, None)
    if base in DIFFERENTIABLE or base in STATE_NAMES:
        if index is None and base in DIFFERENTIABLE:
            return {name: {base: np.ones(n)}}
        if index is None or index == ":":
            return {f"{base}[{i}]": {base: row} for i, row in enumerate(np.eye(n))}
        if int(index) < n:
            return {name: {base: np.eye(n)[int(index)]}}
    if name == "tip_mass":
        return {name: {"tip_mass": np.ones(1)}}
    if base == "gravity" and index in ("0", "1"):
        return {name: _gravity(setup, np.eye(2)[int(index)])}
    if name in ARM_NAMES and setup.torque_driven:
        return {name: {name: np.ones(1)}}
    if name == "arm.length" and setup.arm is not None:
        return {name: {"arm_length": np.ones(1)}}
    for prefix, source in (("motion.", setup.motion), ("torque.", setup.torque)):
        if name.startswith(prefix) and source is not None:
            breaks, coef = motion_derivatives(source, name.removeprefix(prefix))
            return {name: {"breaks": breaks, "coef": coef}}
    raise InvalidInput("wrt names what is not there", got=name, allowed=_allowed(setup))


def _gravity(setup: Setup, change: Array) -> ParameterChange:
    """Direction of a change of gravity; it also changes the start where that is the rope at rest."""
    part = {"gravity": change}
    gx, gy = setup.rope.gravity
    if setup.q0 is None and (gx or gy):
        part["q0"] = np.full(setup.rope.n_links, (gx * change[1] - gy * change[0]) / (gx * gx + gy * gy))
    return part


def _own(setup: Setup, name: str, given: Mapping[str, npt.ArrayLike]) -> ParameterChange:
    """Direction that the user gives as a mapping, checked."""
    n = setup.rope.n_links
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys((*STATE_NAMES, *DIFFERENTIABLE), (n,))
    shapes |= {"tip_mass": (1,), "gravity": (2,), "arm_length": (1,)}
    if setup.torque_driven:
        shapes |= dict.fromkeys(ARM_NAMES, (1,))
    source = setup.motion or setup.torque
    if source is not None:
        shapes |= {"breaks": source.breaks.shape, "coef": source.coef.shape}
    if not isinstance(given, Mapping) or not given or set(given) - set(shapes):
        got = sorted(given) if isinstance(given, Mapping) else given
        raise InvalidInput(f"direction {name!r} cannot be used", got=got, allowed=", ".join(shapes))
    return {key: checks.array(f"{name}: {key}", value, shapes[key], scalar=True) for key, value in given.items()}


def check_smooth(setup: Setup) -> None:
    """Refuse set-ups whose runs have no derivative that the kernels know."""
    if setup.method != "extrapolation":
        raise InvalidInput("sensitivities follow the extrapolation", got=setup.method, allowed="method='extrapolation'")
