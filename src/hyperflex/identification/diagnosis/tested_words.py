"""Words, as in ``free``, for what a fit has held and what its score tests ask about."""

import numpy as np

from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.plant import ANGLES, Plant
from hyperflex.model import DAMPING, RESISTANCES
from hyperflex.sensors import Markers

FEW_LINKS = 4  # links, up to which each has its own value in a test: of more, values of neighbours act alike
TAPER, CURL = "mass:taper", "rest_angle:shared"  # of ropes of many links: growth of the mass along it, bend at rest
ARCS = "arc"  # where markers are along the rope
INNER = "stiffness:inner"  # springs in all joints but the first, as in an elastic rope that hangs on a hinge


def words_for_tests(plant: Plant, *, angles: bool) -> list[list[str]]:
    """Return words for what is held, those that are tested in one linearisation together."""
    rope, names = plant.parameters.guess, {each.name for each in plant.parameters.all}
    many = rope.n_links > FEW_LINKS
    whole = ["gravity_angle", "gravity_scale", *[ANGLES] * angles] if np.any(rope.gravity) else []
    resistances = [each.name + (":shared" if many else "") for each in RESISTANCES if each.name not in names]
    resistances += [INNER] * (many and not rope.stiffness.any())
    masses = ["tip_mass", TAPER] if many else ["mass", "com", "inertia"]
    masses += [CURL] * (many and ("stiffness" in names or bool(rope.stiffness.any())))
    delay = ["delay"] * (plant.motion is not None) + ["arm_inertia", "arm_friction"] * (plant.motor is not None)
    lengths = [["length"]] if not many and rope.n_links > 1 and names.isdisjoint({"length", "com", "inertia"}) else []
    words = [each for each in [*whole, *delay, *resistances, *masses] if each.partition(":")[0] not in names]
    places = [ARCS] * (isinstance(plant.sensor, Markers) and names.isdisjoint({ARCS, "length"}))
    return [[*words, *_uneven(plant.parameters), *places], *lengths]


def _uneven(parameters: Parameters) -> list[str]:
    """Return by what a resistance may differ along the rope that is one value, or one factor, of all links.

    The first joint often is a bearing, the others are none. Two joints differ by that alone.
    """
    labels, n = set(parameters.labels), parameters.guess.n_links
    words = []
    for name in DAMPING:
        if n > 1 and labels & {f"{name}:shared", f"{name}:factor"}:
            words += [f"{name}:pivot"] * (name != "drag")
            words += [f"{name}:taper"] * (n > 2 or name == "drag")
    return [word for word in words if word not in labels]


def as_free(*names: str) -> str:
    """Return names of tests as a sentence has them: quoted, as of ``free``, where "pivot" is the first joint's own."""
    return " and ".join(repr(name.replace(":pivot", "[0]")) for name in names)
