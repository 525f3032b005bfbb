"""Set-ups as MuJoCo's MJCF and back: plain hinges with explicit inertials, numbers to the last bit.

The text is written here and not by MjSpec, which writes six digits; it needs no MuJoCo. The world is x right, z up;
hinges turn about -y, so that angles agree with ours, and they are relative: joint i is link i against link i - 1.
"""

import math
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np

from hyperflex import checks, files
from hyperflex.core.chain.drive import X, Y
from hyperflex.errors import InvalidInput, located
from hyperflex.files import PathLike
from hyperflex.model import Ground, Peg, Rope, Setup, Wall
from hyperflex.motion import hold_arm

ROTOR = 1e5  # kg m^2, armature of an arm that follows a motion: the rope's pull then disturbs it by some 1e-5 rad/s^2
LEAST = 1e-15  # mjMINVAL: MuJoCo refuses moving bodies of less mass (kg) or inertia (kg m^2)
HALF_WIDTH = 0.1  # m, of pegs and grounds across the plane
TIMESTEP = 1e-4  # s
TEXT = "hyperflex"  # name of the custom text that holds the set-up
SOFT = {
    "dry friction": "dry friction becomes frictionloss, a soft constraint: a stuck joint creeps",
    "joint limits": "joint limits become soft constraints: joints pass them a little and bounce",
    "pegs": "contact in MuJoCo is soft: it has no restitution, and the rope sinks in a little and creeps",
}


def write_mjcf(setup: Setup, path: PathLike, *, timestep: float = TIMESTEP) -> None:
    """Write a set-up as an MJCF file, which MuJoCo and its MjSpec load.

    Parameters
    ----------
    setup : Setup
        Bodies and hinges are named arm and link0, joint0, link1, joint1 and so on, the site at the tip is tip, the
        state at t = 0 the key start. An arm that follows a motion is a heavy rotor with an actuator arm_acceleration,
        whose control is the arm's acceleration, rad/s^2; one that a torque drives has an actuator arm_torque, N m.
        Their course over time is for the caller to give: ``data.ctrl[0] = setup.motion.acceleration(data.time)``.
    path : path-like
        File to write, whole or not at all.
    timestep : float
        MuJoCo's step, s.

    Raises
    ------
    InvalidInput
        If the set-up holds what MuJoCo cannot say; the message names it.

    Warns
    -----
    UserWarning
        Where MuJoCo's model of dry friction, joint limits or contact differs.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import hyperflex as hf
    >>> setup = hf.Setup(hf.Rope.uniform(length=1.0, mass=0.1, n_links=5, friction=1e-3))
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "rope.xml"
    >>> hf.write_mjcf(setup, path)
    >>> hf.read_mjcf(path).rope == setup.rope
    True
    """
    checks.instance("setup", setup, Setup)
    step = checks.number("timestep", timestep, sign="positive", unit="s")
    _refuse(setup)
    present = {
        "dry friction": setup.rope.dry_friction.any() or (setup.torque_driven and setup.arm and setup.arm.dry_friction),
        "joint limits": setup.rope.limited,
        "pegs": bool(setup.pegs),
    }
    root = _tree(setup, step)
    ET.indent(root)
    files.write_text(path, ET.tostring(root, encoding="unicode") + "\n")
    for name, told in SOFT.items():
        if present[name]:
            warnings.warn(f"{path}: {told}.", UserWarning, stacklevel=2)


def read_mjcf(path: PathLike) -> Setup:
    """Read the set-up of an MJCF file that :func:`write_mjcf` wrote; the rope's numbers may have been edited since.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Setup
        Equal to the one written, bit for bit, where nothing was edited.

    Raises
    ------
    FileProblem
        If the file cannot be read.
    InvalidInput
        If it is no such file, or something was edited that is not the rope's; the message names the element.
    """
    source = files.read_text(path, "MJCF file")
    try:
        root = ET.fromstring(source)
    except (ET.ParseError, ValueError) as error:
        raise InvalidInput(f"{path} is no XML: {error}", fix="Write it again") from None
    text = root.find(f"custom/text[@name='{TEXT}']")
    if text is None or "data" not in text.attrib:
        fix = "Other models have no rope to read: build a hyperflex.Setup"
        raise InvalidInput(f"{path} was not written by hyperflex", allowed="files of hyperflex.write_mjcf", fix=fix)
    with located(str(path)):
        held = Setup.loads(text.attrib["data"], f"the set-up in {path}")
        _refuse(held)
        setup = held.replace(rope=_rope(root, held.rope))
        option = _part(root, "option")
        text.set("data", setup.dumps())  # what was edited stands in the rope now
        _compare(root, _tree(setup, _numbers(option, "timestep", 1)[0]))
    return setup


def _refuse(setup: Setup) -> None:
    """Refuse by name what MuJoCo cannot say."""
    rope, pivot = setup.rope, None if setup.motion is None else setup.motion.coef[:, [X, Y]]
    wrong = (
        ("one-sided joint friction", rope.friction_model != "relative", "friction_model='relative'"),
        ("this air drag, quadratic in a link's normal velocity", rope.drag.any(), "rope.replace(drag=0.0)"),
        ("a pivot that moves", pivot is not None and pivot[..., 1:].any() | np.ptp(pivot, axis=0).any(), "an arm"),
        ("a constant tip force", any(setup.tip_force), "tip_force=(0, 0), and data.xfrc_applied in MuJoCo"),
        ("a wall without thickness", any(isinstance(each, Wall) for each in setup.pegs), "pegs and grounds"),
        ("a peg that turns on an axle", setup.pegs_turn, "pegs without inertia"),
        ("restitution", any(each.restitution for each in setup.pegs), "restitution=0"),
        ("contact of a rope without a radius", setup.pegs and not rope.radius, "a rope with radius > 0"),
    )
    for what, present, allowed in wrong:
        if present:
            raise InvalidInput(f"MuJoCo cannot say {what}", allowed=allowed)
    bodies = [(f"link {k}", rope.mass[k], rope.inertia[k]) for k in range(rope.n_links)]
    if setup.torque_driven and setup.arm is not None:
        bodies.append(("the arm", setup.arm.mass, setup.arm.inertia))
    for name, mass, inertia in bodies:
        if not min(mass, inertia) > LEAST:
            got = {"mass": float(mass), "inertia": float(inertia)}
            raise InvalidInput(f"MuJoCo cannot move {name}", got=got, allowed=f"both above {LEAST:g}, in SI units")


def _tree(setup: Setup, timestep: float) -> ET.Element:
    """Return the MJCF document of a set-up that MuJoCo can say."""
    rope = setup.rope
    root = ET.Element("mujoco", model=rope.name or "rope")
    _add(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    # A dense Jacobian: the sparse Newton factor of MuJoCo 4.0.0 is wrong. It was mended in 4.0.1.
    gravity = (rope.gravity[0], 0.0, rope.gravity[1])
    _add(root, "option", timestep=timestep, gravity=gravity, integrator="implicitfast", jacobian="dense")
    world = ET.SubElement(root, "worldbody")
    _add_obstacles(world, setup)
    actuator = ET.SubElement(root, "actuator")
    _add_chain(*_add_arm(world, actuator, setup), rope)
    _add_start(root, setup)
    _add(ET.SubElement(root, "custom"), "text", name=TEXT, data=setup.dumps())
    return root


def _add_arm(world: ET.Element, actuator: ET.Element, setup: Setup) -> tuple[ET.Element, tuple[float, float]]:
    """Add the arm, if there is one; return what the rope hangs from, and where in it, m."""
    arm, at = setup.arm, _pivot(setup)
    if arm is None:
        return world, at
    body = _add(world, "body", name="arm", pos=(at[0], 0.0, at[1]))
    if setup.torque_driven:
        _add_hinge(body, "arm", arm.friction, arm.dry_friction)
        _add_inertial(body, arm.com, arm.mass, arm.inertia)
        limit = {} if math.isinf(arm.torque_limit) else {"ctrlrange": (-arm.torque_limit, arm.torque_limit)}
        _add(actuator, "motor", name="arm_torque", joint="arm", **limit)
    else:
        _add(body, "joint", name="arm", type="hinge", axis=(0.0, -1.0, 0.0), armature=ROTOR)
        _add_inertial(body, 0.0, 1e-6, 1e-9)  # nothing beside the rotor
        _add(actuator, "motor", name="arm_acceleration", joint="arm", gear=(ROTOR,))
    return body, (0.0, -arm.length)


def _pivot(setup: Setup) -> tuple[float, float]:
    """Return where the arm turns, or the rope hangs, m."""
    place = np.zeros(2) if setup.arm is None else np.array(setup.arm.pivot)
    if setup.motion is not None:
        place = place + setup.motion.coef[0, [X, Y], 0]
    return float(place[0]), float(place[1])


def _add_chain(parent: ET.Element, at: tuple[float, float], rope: Rope) -> None:
    """Add the links, nested, and the tip."""
    for k in range(rope.n_links):
        parent = _add(parent, "body", name=f"link{k}", pos=(at[0], 0.0, at[1]))
        rest, bend = rope.rest_angle[k], rope.max_bend[k]
        limit = {} if math.isinf(bend) else {"range": (rest - bend, rest + bend)}
        spring = {"stiffness": rope.stiffness[k], "springref": rest}
        _add_hinge(parent, f"joint{k}", rope.friction[k], rope.dry_friction[k], **spring, **limit)
        _add_inertial(parent, rope.com[k], rope.mass[k], rope.inertia[k])
        at = (0.0, -float(rope.length[k]))
        if rope.radius:
            line = {"size": (rope.radius,), "fromto": (0.0, 0.0, 0.0, 0.0, 0.0, at[1])}
            _add(parent, "geom", type="capsule", contype="1", conaffinity="2", **line)
    _add(parent, "site", name="tip", pos=(0.0, 0.0, at[1]))
    if rope.tip_mass:
        _add_inertial(_add(parent, "body", name="tip", pos=(0.0, 0.0, at[1])), 0.0, rope.tip_mass, 0.0)


def _add_obstacles(world: ET.Element, setup: Setup) -> None:
    """Add pegs and grounds, which touch the rope alone; their friction holds, not the rope's."""
    rub = {"contype": "2", "conaffinity": "1", "condim": "3", "priority": "1"}
    for k, each in enumerate(setup.pegs):
        slide = {"friction": (each.mu, 0.0, 0.0)}
        if isinstance(each, Peg):
            ends = (each.x, -HALF_WIDTH, each.y, each.x, HALF_WIDTH, each.y)
            _add(world, "geom", name=f"peg{k}", type="capsule", size=(each.radius,), fromto=ends, **slide, **rub)
        elif isinstance(each, Ground):
            flat = {"pos": (each.x, 0.0, each.y), "zaxis": (each.nx, 0.0, each.ny), "size": (0.0, 0.0, HALF_WIDTH)}
            _add(world, "geom", name=f"ground{k}", type="plane", **flat, **slide, **rub)


def _add_start(root: ET.Element, setup: Setup) -> None:
    """Add the state at t = 0 as the key ``start``."""
    q, qd = setup.start()
    if setup.torque_driven:
        control = {} if setup.torque is None else {"ctrl": setup.torque.torque([0.0])}
    elif setup.arm is not None:
        motion = setup.motion or hold_arm(0.0)
        q, qd = np.append(motion.angle([0.0]), q), np.append(motion.rate([0.0]), qd)
        control = {"ctrl": motion.acceleration([0.0])}
    else:
        control = {}
    start = {"qpos": np.diff(q, prepend=0.0), "qvel": np.diff(qd, prepend=0.0)}
    _add(ET.SubElement(root, "keyframe"), "key", name="start", **start, **control)


def _add_hinge(body: ET.Element, name: str, friction: float, dry: float, **others: object) -> None:
    axis = (0.0, -1.0, 0.0)
    _add(body, "joint", name=name, type="hinge", axis=axis, damping=friction, frictionloss=dry, **others)


def _add_inertial(body: ET.Element, com: float, mass: float, inertia: float) -> None:
    """Add a body's mass; the inertias out of the plane do not matter: three equal ones pass MuJoCo's checks."""
    _add(body, "inertial", pos=(0.0, 0.0, -com), mass=mass, diaginertia=(inertia, inertia, inertia))


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    """Add an element; numbers are written so that they are read back bit for bit."""
    return ET.SubElement(parent, tag, {name: _worded(value) for name, value in attributes.items()})


def _worded(value: object) -> str:
    if isinstance(value, str):
        return value
    each: Iterable[float] = value if isinstance(value, tuple | np.ndarray) else (value,)
    return " ".join(repr(float(x) + 0.0) for x in each)


def _rope(root: ET.Element, held: Rope) -> Rope:
    """Return the rope as the bodies have it; `held` is the rope that was written."""
    links = [_part(root, f"worldbody//body[@name='link{k}']") for k in range(held.n_links)]
    hinges, inertials = ([_part(link, tag) for link in links] for tag in ("joint", "inertial"))
    ends = [*links[1:], _part(links[-1], "site")]
    weight = root.find("worldbody//body[@name='tip']/inertial")
    gravity = _numbers(_part(root, "option"), "gravity", 3)
    thick = links[0].find("geom")
    return held.replace(
        length=[-_numbers(each, "pos", 3)[2] for each in ends],
        mass=[_numbers(each, "mass", 1)[0] for each in inertials],
        com=[0.0 - _numbers(each, "pos", 3)[2] for each in inertials],
        inertia=[_numbers(each, "diaginertia", 3)[1] for each in inertials],
        friction=[_numbers(each, "damping", 1)[0] for each in hinges],
        dry_friction=[_numbers(each, "frictionloss", 1)[0] for each in hinges],
        stiffness=[_numbers(each, "stiffness", 1)[0] for each in hinges],
        rest_angle=[_numbers(each, "springref", 1)[0] for each in hinges],
        tip_mass=0.0 if weight is None else _numbers(weight, "mass", 1)[0],
        gravity=[gravity[0], gravity[2]],
        radius=0.0 if thick is None else _numbers(thick, "size", 1)[0],
        name=held.name,
    )


def _part(parent: ET.Element, path: str) -> ET.Element:
    found = parent.find(path)
    if found is None:
        raise InvalidInput(f"it lacks the element {path}", fix="Write it again from the set-up")
    return found


def _numbers(element: ET.Element, name: str, count: int) -> list[float]:
    """Return the numbers of an attribute."""
    text = element.get(name, "")
    try:
        found = [] if "_" in text else [float(word) for word in text.split()]  # Python's 1_000 is not MuJoCo's
    except ValueError:
        found = []
    if len(found) != count:
        allowed = "a number" if count == 1 else f"{count} numbers"
        raise InvalidInput(f"{_named(element)} has no usable {name}", got=text, allowed=allowed)
    return found


def _named(element: ET.Element) -> str:
    return f"{element.tag} {element.get('name', '')}".strip()


def _compare(got: ET.Element, expected: ET.Element) -> None:
    """Refuse the first element that is not as it would be written."""
    changed = {name for name in {*got.keys(), *expected.keys()} if got.get(name) != expected.get(name)}
    for name in sorted(changed - {"data"}):
        if _same(got.get(name), expected.get(name)):
            continue
        fix = "Of an edited file the rope's numbers are read, no others: change the set-up instead"
        allowed = f"{expected.get(name)!r}"
        raise InvalidInput(f"{_named(got)} has another {name}", got=got.get(name), allowed=allowed, fix=fix)
    if [each.tag for each in got] != [each.tag for each in expected]:
        allowed = ", ".join(each.tag for each in expected) or "nothing"
        raise InvalidInput(f"{_named(got)} holds other parts", got=[each.tag for each in got], allowed=allowed)
    for one, other in zip(got, expected, strict=True):
        _compare(one, other)


def _same(got: str | None, expected: str | None) -> bool:
    """Whether two texts hold the same numbers."""
    try:
        return [float(word) for word in (got or "").split()] == [float(word) for word in (expected or "").split()]
    except ValueError:
        return False
