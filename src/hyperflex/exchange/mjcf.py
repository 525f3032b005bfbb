"""Set-ups as MuJoCo's MJCF: plain hinges with explicit inertials, numbers to the last bit.

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
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.model import Setup, Wall
from hyperflex.motion import hold_arm
from hyperflex.simulation import runge_kutta_limit

ROTOR = 1e5  # kg m^2, armature of an arm that follows a motion: the rope's pull then disturbs it by some 1e-5 rad/s^2
LEAST = 1e-15  # mjMINVAL: MuJoCo refuses moving bodies of less mass (kg) or inertia (kg m^2)
MOST_BODIES = 490  # MuJoCo reads XML of at most 500 elements within each other
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
        The caller sets the control over time: ``data.ctrl[0] = setup.motion.acceleration(data.time)``. The custom text
        hyperflex has the set-up itself, as :meth:`Setup.dumps` writes it.
    path : path-like
        File to write, whole or not at all.
    timestep : float
        MuJoCo's step, s. If RK4 is stable with it and nothing is touched, it is the integrator; else implicitfast is,
        which is of first order: its tip may be off by centimetres after two seconds of a fast swing.

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
    >>> path.read_text().count("<joint")
    5
    """
    checks.instance("setup", setup, Setup)
    step = checks.number("timestep", timestep, sign="positive", unit="s")
    _refuse(setup)
    integrator = _integrator(setup, step)
    present = {
        "a first-order integrator": integrator != "RK4" and not setup.touches,
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


def _integrator(setup: Setup, step: float) -> str:
    """Return MuJoCo's integrator for a step, s: Runge-Kutta's where it is stable and nothing is touched."""
    stable = not setup.touches and step <= MARGIN * runge_kutta_limit(setup.chain())
    return "RK4" if stable else "implicitfast"


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
        ("a peg that turns on an axle", setup.pegs_turn, "pegs without inertia"),
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
    ET.SubElement(ET.SubElement(root, "custom"), "text", name="hyperflex", data=setup.dumps())
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
