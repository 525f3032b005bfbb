"""Set-ups as MuJoCo's MJCF and back: plain hinges with explicit inertials, numbers to the last bit.

The text is made from a template, ``templates/rope.xml``, and not by MjSpec, which writes six digits; it needs no
MuJoCo.
"""

import math
import warnings
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files
from hyperflex.core.chain.drive import X, Y
from hyperflex.errors import InvalidInput, located
from hyperflex.files import PathLike
from hyperflex.model import Rope, Setup, Wall
from hyperflex.motion import hold_arm
from hyperflex.simulation import runge_kutta_limit

ROTOR = 1e5  # kg m^2, armature of an arm that follows a motion: the rope's pull then disturbs it by some 1e-5 rad/s^2
LEAST = 1e-15  # mjMINVAL: MuJoCo refuses moving bodies of less mass (kg) or inertia (kg m^2)
MOST_BODIES = 490  # MuJoCo reads XML of at most 500 elements within each other
INTEGRATORS = ("RK4", "implicitfast")
MARGIN = 0.8  # part of the longest stable Runge-Kutta step, which belongs to a rope that hangs straight
HALF_WIDTH = 0.1  # m, of pegs and grounds across the plane
DIFFERS = {
    "a first-order integrator": "no Runge-Kutta step of this size is stable for this set-up, so the integrator is "
    "implicitfast, whose error falls only as the step: compare the result with that of half the step",
    "dry friction": "dry friction becomes frictionloss, a soft constraint: a stuck joint creeps",
    "joint limits": "joint limits become soft constraints: joints pass them a little and bounce",
    "pegs": "contact in MuJoCo is soft: it has no restitution, and the rope sinks in a little and creeps",
}


def write_mjcf(setup: Setup, path: PathLike, *, timestep: float = 1e-4) -> None:
    """Write a set-up as an MJCF file, which MuJoCo and its MjSpec load.

    Parameters
    ----------
    setup : Setup
        Bodies and hinges are named arm and link0, joint0, link1, joint1 and so on, the site at the tip is tip, the
        state at t = 0 the key start. An arm that follows a motion is a heavy rotor with an actuator arm_acceleration,
        whose control is the arm's acceleration, rad/s^2; a torque-driven arm has an actuator arm_torque, N m.
        The caller sets the control over time: ``data.ctrl[0] = setup.motion.acceleration(data.time)``.
    path : path-like
        File to write, whole or not at all.
    timestep : float
        MuJoCo's step, s. The integrator is RK4 if it is stable with this step and there are neither obstacles nor joint
        limits; else implicitfast, which is of first order: its tip may have an error of centimetres after two seconds
        of a fast swing.

    Raises
    ------
    InvalidInput
        If MuJoCo cannot represent the set-up; the message names the reason.

    Warns
    -----
    UserWarning
        If MuJoCo's model of dry friction, joint limits or contact differs, or the integrator is of first order.

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
    # Runge-Kutta's where it is stable and nothing is touched
    integrator = INTEGRATORS[setup.touches or step > MARGIN * runge_kutta_limit(setup.chain())]
    present = {
        "a first-order integrator": integrator != INTEGRATORS[0] and not setup.touches,
        "dry friction": setup.rope.dry_friction.any() or (setup.torque_driven and setup.arm and setup.arm.dry_friction),
        "joint limits": setup.rope.limited,
        "pegs": bool(setup.pegs),
    }
    root = _tree(setup, step, integrator)
    ET.indent(root)
    files.write_text(path, ET.tostring(root, encoding="unicode") + "\n")
    for name, words in DIFFERS.items():
        if present[name]:
            warnings.warn(f"{path}: {words}.", UserWarning, stacklevel=2)


def read_mjcf(path: PathLike) -> Setup:
    """Read the set-up of an MJCF file that :func:`write_mjcf` wrote; the rope's numbers may have been edited since.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Setup
        Equal to the written one, bit for bit, if nothing was edited.

    Raises
    ------
    FileProblem
        If the file cannot be read.
    InvalidInput
        If hyperflex did not write it, or something other than the rope was edited; the message names the element.
    """
    source = files.read_text(path, "MJCF file")
    try:
        root = ET.fromstring(source)
    except (ET.ParseError, ValueError) as error:
        raise InvalidInput(f"{path} is no XML: {error}", fix="Write it again") from None
    text = root.find("custom/text[@name='hyperflex']")
    if text is None or "data" not in text.attrib:
        fix = "Other models have no rope to read: build a hyperflex.Setup"
        raise InvalidInput(f"{path} was not written by hyperflex", allowed="files of hyperflex.write_mjcf", fix=fix)
    with located(str(path)):
        held = Setup.loads(text.attrib["data"], f"the set-up in {path}")
        _refuse(held)
        setup = held.replace(rope=_rope(root, held.rope))
        option = _part(root, "option")
        text.set("data", setup.dumps())  # with the edited numbers
        integrator = checks.choice("the integrator", option.get("integrator"), INTEGRATORS)
        _compare(root, _tree(setup, _numbers(option, "timestep", 1)[0], integrator))
    return setup


def _refuse(setup: Setup) -> None:
    """Raise InvalidInput for properties that MuJoCo cannot represent."""
    rope, pivot = setup.rope, None if setup.motion is None else setup.motion.coef[:, [X, Y]]
    depth = rope.n_links + (setup.arm is not None) + (rope.tip_mass > 0.0)
    wrong = (
        (f"a chain of {depth} bodies, each within the one before", depth > MOST_BODIES, f"at most {MOST_BODIES}"),
        ("one-sided joint friction", rope.friction_model != "relative", "friction_model='relative'"),
        ("this air drag, quadratic in a link's normal velocity", rope.drag.any(), "rope.replace(drag=0.0)"),
        (
            "motors in the rope's joints",
            setup.torque is not None and (setup.arm is None or setup.torque.joints > 1),
            "an arm",
        ),
        ("a pivot that moves", pivot is not None and pivot[..., 1:].any() | np.ptp(pivot, axis=0).any(), "an arm"),
        ("a constant tip force", any(setup.tip_force), "tip_force=(0, 0), and data.xfrc_applied in MuJoCo"),
        ("a wall without thickness", any(isinstance(each, Wall) for each in setup.pegs), "pegs and grounds"),
        ("a peg that turns on an axle", any(each.turns for each in setup.round_pegs), "pegs without inertia"),
        ("restitution", any(each.restitution for each in setup.pegs), "restitution=0"),
        ("contact of a rope without a radius", setup.pegs and not rope.radius, "a rope with radius > 0"),
    )
    for what, present, allowed in wrong:
        if present:
            raise InvalidInput(f"MuJoCo cannot represent {what}", allowed=allowed)
    bodies = [(f"link {k}", rope.mass[k], rope.inertia[k]) for k in range(rope.n_links)]
    if setup.torque_driven and setup.arm is not None:
        bodies.append(("the arm", setup.arm.mass, setup.arm.inertia))
    for name, mass, inertia in bodies:
        if not min(mass, inertia) > LEAST:
            got = {"mass": float(mass), "inertia": float(inertia)}
            raise InvalidInput(f"MuJoCo cannot move {name}", got=got, allowed=f"both above {LEAST:g}, in SI units")


def _tree(setup: Setup, timestep: float, integrator: str) -> ET.Element:
    """Return the MJCF document of a set-up that MuJoCo can represent."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["n"] = _exact
    content = {"setup": setup, "rope": setup.rope, "arm": setup.arm, "pivot": _pivot(setup), "timestep": timestep}
    content["integrator"] = integrator
    content |= {"half_width": HALF_WIDTH, "rotor": ROTOR, "inf": math.inf, **_start(setup)}
    root = ET.fromstring(environment.get_template("rope.xml").render(content))
    root.set("model", setup.rope.name or "rope")
    _part(root, "custom/text").set("data", setup.dumps())
    return root


def _exact(numbers: ArrayLike) -> str:
    """Return numbers as text that is read back bit for bit."""
    return " ".join(repr(x + 0.0) for x in np.atleast_1d(np.asarray(numbers, dtype=np.float64)).tolist())


def _pivot(setup: Setup) -> tuple[float, float, float]:
    """Return the position of the arm's shaft, or of the first joint, m."""
    place = np.zeros(2) if setup.arm is None else np.array(setup.arm.pivot)
    if setup.motion is not None:
        place = place + setup.motion.coef[0, [X, Y], 0]
    return float(place[0]), 0.0, float(place[1])


def _start(setup: Setup) -> dict[str, Any]:
    """Return relative angles and rates at t = 0, and the actuator's command; None without an actuator."""
    (q, qd), control = setup.start(), None
    if setup.torque_driven:
        control = None if setup.torque is None else setup.torque.torque([0.0])
    elif setup.arm is not None:
        motion = setup.motion or hold_arm(0.0)
        q, qd = np.append(motion.angle([0.0]), q), np.append(motion.rate([0.0]), qd)
        control = motion.acceleration([0.0])
    ctrl = None if control is None else control.tolist()
    return {"qpos": np.diff(q, prepend=0.0), "qvel": np.diff(qd, prepend=0.0), "ctrl": ctrl}


def _rope(root: ET.Element, held: Rope) -> Rope:
    """Return the rope described by the bodies; `held` is the rope that was written."""
    links = [_part(root, f"worldbody//body[@name='link{k}']") for k in range(held.n_links)]
    hinges, inertials = ([_part(link, tag) for link in links] for tag in ("joint", "inertial"))
    ends = [*links[1:], _part(links[-1], "site")]
    weight = root.find("worldbody//body[@name='tip']/inertial")
    gravity = _numbers(_part(root, "option"), "gravity", 3)
    thick = links[0].find("geom")
    hinge = {"friction": "damping", "dry_friction": "frictionloss", "stiffness": "stiffness", "rest_angle": "springref"}
    return held.replace(
        length=[-_numbers(each, "pos", 3)[2] for each in ends],
        mass=[_numbers(each, "mass", 1)[0] for each in inertials],
        com=[0.0 - _numbers(each, "pos", 3)[2] for each in inertials],
        inertia=[_numbers(each, "diaginertia", 3)[1] for each in inertials],
        **{name: [_numbers(each, attribute, 1)[0] for each in hinges] for name, attribute in hinge.items()},
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
    """Raise InvalidInput for the first element that differs from the written one."""
    for one, other in zip(got.iter(), expected.iter(), strict=False):
        for name in sorted({*one.keys(), *other.keys()} - {"data"}):
            if _values(one.get(name)) != _values(other.get(name)):
                fix = "Only the rope's numbers of an edited file are read: change the set-up instead"
                what, allowed = f"{_named(one)} has another {name}", f"{other.get(name)!r}"
                raise InvalidInput(what, got=one.get(name), allowed=allowed, fix=fix)
        parts, wanted = [each.tag for each in one], [each.tag for each in other]
        if parts != wanted:
            raise InvalidInput(f"{_named(one)} contains other parts", got=parts, allowed=", ".join(wanted) or "nothing")


def _values(text: str | None) -> list[float] | str | None:
    """Return the numbers of an attribute, or else its text."""
    try:
        return [float(word) for word in (text or "a text").split()]
    except ValueError:
        return text
