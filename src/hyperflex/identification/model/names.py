"""The words in which a user names what is free."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.model.parameters import ARM, FORMS, SCALARS, Parameter, lumped
from hyperflex.model import Arm, Rope

SHARE = 0.01  # size of an unknown small torque, as a part of gravity's, in the scale of a friction that starts from 0
DELAY = 0.05  # s, scale of the time between camera and motor
ORIGIN = 0.1  # scale of the place of the first joint, in lengths of the rope
_NAME = re.compile(r"(?P<name>[a-z_]+)(?:\[(?P<link>\d+)\])?(?::(?P<law>shared|factor|taper))?\Z")


def parse(
    guess: Rope, free: Sequence[str], arcs: Array | None = None, *, moved: bool = False, arm: Arm | None = None
) -> list[Parameter]:
    """Return the parameters that the words in `free` stand for.

    Parameters
    ----------
    guess : Rope
    free : sequence of str
        A property, for each link's own value; ``friction[2]`` of one link; ``friction:shared`` one value for all;
        ``friction:factor`` one factor on all links' guesses; ``friction:taper`` its logarithmic growth along the rope;
        ``tip_mass``, ``gravity_angle``, ``delay``, ``origin_x``, ``origin_y``, ``arm_inertia``, ``arm_friction`` of the
        whole; ``arc[2]`` of a marker.
    arcs : (K,) array, m, optional
        Where markers sit along the rope.
    moved : bool
        Whether the first joint is moved, so that a delay means something.
    arm : Arm, optional
        The arm whose motor's torque is measured, if it is.
    """
    if isinstance(free, str) or len(free) == 0:
        raise InvalidInput("free names no parameters", got=free, allowed="a list such as ['inertia', 'friction']")
    result: list[Parameter] = []
    for word in free:
        match = _NAME.match(word) if isinstance(word, str) else None
        if match is None or match["name"] not in FORMS or (match["link"] and match["law"]):
            raise InvalidInput(
                "free has an unknown name",
                got=word,
                allowed=f"{', '.join(FORMS)}; 'friction[2]' for one link, 'friction:shared' for one value of all "
                "links, 'friction:factor' and 'friction:taper' for laws along the rope",
            )
        result += _one(guess, match["name"], match["link"], match["law"] or "", arcs, moved, arm)
    _refuse_twice(result, free)
    return result


def _refuse_twice(chosen: list[Parameter], free: Sequence[str]) -> None:
    """Refuse words that free one number twice."""
    twice: set[str] = set()
    for k, one in enumerate(chosen):
        for other in chosen[:k]:
            if one.name != other.name:
                continue
            both = one.law == other.law == "own"
            if both and one.links and not set(one.links) & set(other.links):
                continue
            if one.law == other.law or "own" in (one.law, other.law):
                shared = sorted(set(one.links) & set(other.links)) if both else []
                twice |= {f"{one.name}[{link}]" for link in shared} or {one.name}
    if twice:
        raise InvalidInput(
            "free names the same thing twice", got=list(free), allowed=f"{', '.join(sorted(twice))} only once"
        )


def _one(
    guess: Rope, name: str, link: str | None, law: str, arcs: Array | None, moved: bool, arm: Arm | None
) -> list[Parameter]:
    """Return the parameters of one word in `free`."""
    if name in SCALARS:
        if link or law:
            raise InvalidInput(f"{name} belongs to the whole rope, or camera", got=f"{name}[{link}]", allowed=name)
        return [_of_arm(guess, name, arm) if name in ARM else _whole(guess, name, arcs, moved)]
    if name == "arc":
        return _arcs(guess, link, law, arcs)
    n = guess.n_links
    if link is not None and int(link) >= n:
        raise InvalidInput(
            "free names a link that the rope does not have", got=f"{name}[{link}]", allowed=f"0 to {n - 1}"
        )
    everyone = tuple(range(n))
    if law in ("factor", "taper"):
        if not getattr(guess, name).any():
            raise InvalidInput(f"{name}:{law} is free but starts from 0", allowed=f"a guess of {name} that is not 0")
        return [Parameter(name, everyone, f"{name}:{law}", 1.0 if law == "factor" else 0.0, 1.0, law)]  # type: ignore[arg-type]
    starts, scales = _starts(guess, name)
    if law == "shared":
        return [Parameter(name, everyone, f"{name}:shared", float(starts.mean()), float(scales.mean()))]
    chosen = everyone if link is None else (int(link),)
    return [Parameter(name, (k,), f"{name}[{k}]", float(starts[k]), float(scales[k])) for k in chosen]


def _whole(guess: Rope, name: str, arcs: Array | None, moved: bool) -> Parameter:
    """Return a parameter that belongs to no link."""
    if name == "delay" and not moved:
        raise InvalidInput("delay is free, but nothing moves the first joint", fix="Give motion=..., or leave it out")
    if name.startswith("origin") and arcs is None:
        raise InvalidInput(f"{name} is free, but no places are measured", fix="Give arcs=..., or leave it out")
    if name == "tip_mass":
        return Parameter(name, (), name, guess.tip_mass, max(guess.tip_mass, SHARE * guess.total_mass))
    scale = {"delay": DELAY, "gravity_angle": 1.0}.get(name, ORIGIN * guess.total_length)
    return Parameter(name, (), name, 0.0, scale)


def _of_arm(guess: Rope, name: str, arm: Arm | None) -> Parameter:
    """Return a property of the arm; what starts from 0 gets a small part of the level rope's as scale."""
    if arm is None:
        raise InvalidInput(
            f"{name} is free, but no torque is measured", fix="Give torque=... and arm=..., or leave it out"
        )
    level = SHARE * guess.total_mass * guess.total_length**2
    if name == "arm_inertia":
        return Parameter(name, (), name, arm.inertia, max(arm.inertia, level))
    typical = level * float(np.sqrt(np.hypot(*guess.gravity) / guess.total_length))
    return Parameter(name, (), name, arm.friction, max(arm.friction, typical or level))


def _arcs(guess: Rope, marker: str | None, law: str, arcs: Array | None) -> list[Parameter]:
    """Return the places of markers along the rope."""
    if arcs is None:
        raise InvalidInput("arc is free, but no places are measured", fix="Give a first guess, arcs=...")
    if law or (marker is not None and int(marker) >= arcs.size):
        raise InvalidInput("arc names no marker", got=marker or law, allowed=f"arc, or arc[0] to arc[{arcs.size - 1}]")
    chosen = range(arcs.size) if marker is None else (int(marker),)
    scale = ORIGIN * guess.total_length
    return [Parameter("arc", (k,), f"arc[{k}]", float(arcs[k]), scale) for k in chosen]


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
