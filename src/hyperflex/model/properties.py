"""Table of physical properties: name, unit, bounds, kernel field, parametrisation in a fit.

A new property of the links is a row here, an argument of :class:`hyperflex.model.Rope` and a field of
``core.chain.Chain``; files, identification, the comparison of models, derivatives and reports read the row.
"""

import math
import re
from dataclasses import dataclass
from typing import Literal, NamedTuple

from hyperflex.checks import Sign

Owner = Literal["link", "rope", "motion", "camera", "view", "marker", "encoder", "arm", "motor"]
Form = Literal["log", "linear", "nonnegative"]
Cut = Literal["shared", "alike", "joint", "bending", "limit", "stays"]


@dataclass(frozen=True)
class Property:
    """A property and its treatment.

    Attributes
    ----------
    name : str
        In the API, in files and in ``free``.
    words : str
        In texts.
    unit : str
        SI.
    field : str
        In :class:`hyperflex.core.chain.articulated_body.Chain`; for a resistance also its word in the names of
        candidate models.
    owner : str
        Owner: each ``link`` (or its joint), the whole ``rope``, of the ``motion``, the ``camera``, its ``view`` (camera
        or encoder that is not level), each ``marker``, the ``encoder`` of the angles, the ``arm`` or each ``motor``.
    sign : str
        Allowed values, see :mod:`hyperflex.checks`.
    default : float or None
        Value without an effect (which allows inf as well), from which a fit starts if no object has the property; None:
        the property must be given, or follows from others.
    form : str or None
        Variable of a fit: its logarithm, the value itself, or a value kept >= 0; None: it cannot be free.
    power : int
        Power of the unknown common factor of a free swing with which it scales.
    cut : str
        Rule when a rope is divided into other links: ``shared`` out among the pieces of a link, or ``alike`` in all of
        them; for a joint ``joint``, equal at any joint, ``bending``, inversely proportional to the length that the
        joint represents, or ``limit``, which preserves the least bend radius; or it ``stays`` at its joint. Empty: it
        follows from the others.
    symbol, ratio : str
        For a resistance to the motion: its symbol, and the unit of its ratio to the first moment p1.
    least : float
        Smallest value of a fit, as a fraction of its scale, for an effect that a run without it omits completely and
        therefore gives no derivative of.
    """

    name: str
    words: str
    unit: str
    field: str = ""
    owner: Owner = "link"
    sign: Sign = "nonnegative"
    default: float | None = 0.0
    form: Form | None = "nonnegative"
    power: int = 0
    cut: Cut | Literal[""] = ""
    symbol: str = ""
    ratio: str = ""
    least: float = 0.0


_TABLE = (
    Property("length", "length", "m", "length", sign="positive", default=None, form="log", cut="shared"),
    Property("mass", "mass", "kg", "mass", default=None, form="log", power=1, cut="shared"),
    Property("com", "centre of mass, from its joint", "m", "com", sign="any", default=None, form="linear"),
    Property("inertia", "moment of inertia about the centre of mass", "kg m^2", "inertia", default=None, power=1),
    Property("friction", "viscous friction", "N m s/rad", "viscous", power=1, cut="bending", symbol="c", ratio="m/s"),
    Property(
        "dry_friction", "dry friction", "N m", "dry", power=1, cut="joint", symbol="tau_d", ratio="m/s^2", least=1e-9
    ),
    Property("stiffness", "stiffness", "N m/rad", "stiffness", power=1, cut="bending", symbol="k", ratio="m/s^2"),
    Property("rest_angle", "angle at which it is at rest", "rad", "rest", sign="any", form="linear", cut="stays"),
    Property("drag", "air drag", "kg/m^2", "drag", power=1, cut="alike", symbol="d", ratio="1/m^3", least=1e-9),
    Property("max_bend", "joint limit", "rad", "max_bend", sign="positive", default=math.inf, form=None, cut="limit"),
    Property("tip_mass", "mass at the tip", "kg", "tip_mass", owner="rope", power=1),
    Property(
        "gravity_angle",
        "turn of gravity (a camera that is not level), which the rope's file leaves out",
        "rad",
        owner="view",
        form="linear",
    ),
    Property(
        "gravity_scale",
        "gravity over what it was taken to be (a wrong clock or lengths)",
        "1",
        owner="rope",
        default=1.0,
        form="log",
    ),
    Property("delay", "delay of the motion", "s", owner="motion", form="linear"),
    Property("origin_x", "origin of the motion as the camera sees it, x", "m", owner="camera", form="linear"),
    Property("origin_y", "origin of the motion as the camera sees it, y", "m", owner="camera", form="linear"),
    Property("arc", "place along the rope", "m", owner="marker", form="linear"),
    Property(
        "angle_factor", "angles as read over angles", "1", owner="encoder", sign="positive", default=1.0, form=None
    ),
    Property("arm_inertia", "moment of inertia of arm and rotor", "kg m^2", owner="arm"),
    Property("arm_friction", "viscous friction of the shaft", "N m s/rad", owner="arm"),
    Property("arm_dry_friction", "dry friction of the shaft", "N m", owner="arm"),
    Property(
        "torque_constant",
        "torque of a motor over its reading (over a current: the torque constant)",
        "N m",
        owner="motor",
        sign="positive",
        default=1.0,
        form="log",
    ),
    Property(
        "arm_length",
        "length of the arm over what was declared",
        "1",
        owner="motion",
        sign="positive",
        default=1.0,
        form=None,
    ),
)
PROPERTIES = {each.name: each for each in _TABLE}
LINK_PROPERTIES = tuple(each for each in _TABLE if each.owner == "link")
LINK_NAMES = tuple(each.name for each in LINK_PROPERTIES)
RESISTANCES = tuple(each for each in LINK_PROPERTIES if each.ratio)  # linear in the torques, like masses and inertias
DAMPING = tuple(each.name for each in RESISTANCES if each.unit != "N m/rad")  # without springs: these dissipate energy
FREE_PROPERTIES = {each.name: each for each in _TABLE if each.form}  # properties that can be fitted


class Ratio(NamedTuple):
    """Ratio to p of link 0 that a motion without known forces determines: its description and unit."""

    words: str
    unit: str


RATIOS = {"J/p1": Ratio("inertia about the joint", "m"), "p/p1": Ratio("first moment about the joint", "")}
RATIOS |= {f"{each.symbol}/p1": Ratio(each.words, each.ratio) for each in RESISTANCES}

_LABEL = re.compile(r"(?P<name>[A-Za-z_]+)(?:\[(?P<place>\d+)\])?(?::(?P<law>shared|inner|factor|taper))?\Z")


class Label(NamedTuple):
    """A number of a property: ``friction[2]`` of one link, ``friction:shared`` of all, ``friction:inner`` of all but 0.

    Factor and taper are laws along all of them.
    """

    name: str
    place: int | None
    law: str


def parse_label(text: object) -> Label | None:
    """Return the meaning of a label, or None if it has none; an index and a law exclude each other."""
    match = _LABEL.match(text) if isinstance(text, str) else None
    if match is None or (match["place"] and match["law"]):
        return None
    return Label(match["name"], int(match["place"]) if match["place"] else None, match["law"] or "")
