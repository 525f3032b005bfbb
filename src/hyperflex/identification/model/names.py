"""The names in `free`, and the parameters that they stand for."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.model.parameters import Parameter, Parameters, lumped
from hyperflex.model import FREE_PROPERTIES, Arm, Label, Rope, parse_label

SHARE = 0.01  # size of an unknown small torque, as a part of gravity's, in the scale of a friction that starts from 0
DELAY = 0.05  # s, scale of the time between camera and motor
ORIGIN = 0.1  # scale of the place of the first joint, in lengths of the rope
NEEDS = {  # what must be measured for parameters that are not the rope's
    "motion": ("nothing moves the first joint", "motion=..."),
    "camera": ("no places are measured", "arc_lengths=..."),
    "marker": ("no places are measured", "arc_lengths=..."),
    "arm": ("no torque is measured", "torque=... and arm=..."),
}


def parse(
    guess: Rope, free: Sequence[str], arc_lengths: Array | None = None, *, moved: bool = False, arm: Arm | None = None
) -> list[Parameter]:
    """Return the parameters that the words in `free` (see :func:`hyperflex.identify`) stand for.

    `arc_lengths` (K,), m, are of the markers; `moved` tells whether the first joint moves, so that a delay has a
    meaning; `arm` is that whose motor torque is measured.
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
        result += _one(guess, label, arc_lengths, moved, arm)
    _refuse_twice(result, free)
    return result


def _refuse_twice(chosen: list[Parameter], free: Sequence[str]) -> None:
    """Refuse words that free one number twice."""
    twice: set[str] = set()
    for one, other in combinations(chosen, 2):
        both = one.law == other.law == "own"
        shared = set(one.links) & set(other.links) if both else set()
        apart = both and one.links and not shared
        if one.name == other.name and not apart and (one.law == other.law or "own" in (one.law, other.law)):
            twice |= {f"{one.name}[{link}]" for link in shared} or {one.name}
    if twice:
        raise InvalidInput(
            "free names the same thing twice", got=list(free), allowed=f"{', '.join(sorted(twice))} only once"
        )


def _one(guess: Rope, label: Label, arc_lengths: Array | None, moved: bool, arm: Arm | None) -> list[Parameter]:
    """Return the parameters of one word in `free`."""
    name, place, law = label
    owner = FREE_PROPERTIES[name].owner
    unseen = arc_lengths is None
    if {"motion": not moved, "camera": unseen, "marker": unseen, "arm": arm is None}.get(owner):
        why, fix = NEEDS[owner]
        raise InvalidInput(f"{name} is free, but {why}", fix=f"Give {fix}, or leave it out")
    if arc_lengths is not None and owner == "marker":
        return _arcs(guess, place, law, arc_lengths)
    if owner != "link":
        if place is not None or law:
            raise InvalidInput(f"{name} belongs to the whole rope, or camera", got=f"{name}[{place}]", allowed=name)
        return [_whole(guess, name, arm or Arm())]
    n = guess.n_links
    if place is not None and place >= n:
        raise InvalidInput(
            "free names a link that the rope does not have", got=f"{name}[{place}]", allowed=f"0 to {n - 1}"
        )
    everyone = tuple(range(n))
    if law in ("factor", "taper"):
        if not getattr(guess, name).any():
            raise InvalidInput(f"{name}:{law} is free but starts from 0", allowed=f"a guess of {name} that is not 0")
        return [Parameter(name, everyone, f"{name}:{law}", 1.0 if law == "factor" else 0.0, 1.0, law)]  # type: ignore[arg-type]
    starts, sizes = getattr(guess, name), scales(guess, name)
    if law == "inner" and n < 2:
        raise InvalidInput(f"{name}:inner is free, but there is one link", allowed=f"{name}")
    if law in ("shared", "inner"):
        own = slice(law == "inner", None)
        return [Parameter(name, everyone[own], f"{name}:{law}", float(starts[own].mean()), float(sizes[own].mean()))]
    chosen = everyone if place is None else (place,)
    return [Parameter(name, (k,), f"{name}[{k}]", float(starts[k]), float(sizes[k])) for k in chosen]


def _whole(guess: Rope, name: str, arm: Arm) -> Parameter:
    """Return a parameter that belongs to no link; what starts from 0 gets a typical size as scale."""
    level = SHARE * guess.total_mass * guess.total_length**2  # of the level rope
    typical = level * float(np.sqrt(np.hypot(*guess.gravity) / guess.total_length))
    place = (0.0, ORIGIN * guess.total_length)
    start, size = {
        "tip_mass": (guess.tip_mass, SHARE * guess.total_mass),
        "gravity_angle": (0.0, 1.0),
        "gravity_scale": (1.0, 1.0),
        "delay": (0.0, DELAY),
        "origin_x": place,
        "origin_y": place,
        "arm_inertia": (arm.inertia, level),
        "arm_friction": (arm.friction, typical or level),
    }[name]
    return Parameter(name, (), name, start, max(start, size))


def _arcs(guess: Rope, marker: int | None, law: str, arc_lengths: Array) -> list[Parameter]:
    if law or (marker is not None and marker >= arc_lengths.size):
        raise InvalidInput(
            "arc names no marker", got=law or marker, allowed=f"arc, or arc[0] to arc[{arc_lengths.size - 1}]"
        )
    chosen = range(arc_lengths.size) if marker is None else (marker,)
    scale = ORIGIN * guess.total_length
    return [Parameter("arc", (k,), f"arc[{k}]", float(arc_lengths[k]), scale) for k in chosen]


def scales(guess: Rope, name: str) -> Array:
    """Return the scales (n,) of a property of the links: its value, or what is typical by its unit, if that is more."""
    value: Array = np.array(getattr(guess, name))
    if FREE_PROPERTIES[name].form == "log":
        if not (value > 0.0).all():
            raise InvalidInput(f"{name} is free but starts from 0", got=value, allowed=f"a guess of {name} > 0")
        return value
    p, inertia = lumped(guess)
    weight = SHARE * np.abs(p) * (float(np.hypot(*guess.gravity)) or 1.0)
    typical: dict[str, Array | float] = {
        "m": guess.length,
        "kg m^2": inertia,
        "N m s/rad": np.sqrt(SHARE * weight * inertia),
        "N m": weight,
        "N m/rad": weight,
        "rad": 1.0,
        "kg/m^2": SHARE * guess.total_mass / guess.total_length**2,
    }
    return np.maximum(np.abs(value), typical[FREE_PROPERTIES[name].unit])


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
