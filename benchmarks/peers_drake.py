"""Drake: a MultibodyPlant of revolute joints in continuous time, integrated by its Simulator."""

from collections.abc import Iterator

import numpy as np
from cast import Cast, Contestant
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, RigidBody, RotationalInertia, SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.simulation.rollouts import runge_kutta_limit

NAME = "Drake"
ARMATURE = 1e5  # kg m^2, as for MuJoCo
ARM = (
    f"a revolute joint whose motor has a reflected inertia of {ARMATURE:g} kg m^2 and gives the torque for the arm's "
    "acceleration; the simulator stops at every switch"
)
DRIVE = "torque on a heavy rotor"
AXIS = np.array([0.0, 0.0, 1.0])
# (scheme, largest step, accuracy; None: a fixed step). Fixed steps of radau3 reach 1 mm in less than half the time of
# its error control.
SETTINGS = (
    ("radau3", 0.02, None),
    ("radau3", 0.0125, None),
    ("radau3", 0.005, None),
    ("radau3", 0.1, 1e-2),
    ("radau3", 0.1, 2e-3),
    ("radau3", 0.1, 1e-3),
    ("implicit_euler", 0.1, 1e-2),
    ("runge_kutta3", 0.1, 1e-2),
    ("bogacki_shampine3", 0.1, 1e-3),
)


class Rig:
    """A plant in relative angles: the arm first, then the links."""

    def __init__(self, rope: hf.Rope, arm: hf.Arm | None) -> None:
        self.plant = MultibodyPlant(time_step=0.0)
        self.moving = arm is not None
        parent, drop = self.plant.world_body(), 0.0
        if arm is not None:
            parent, drop = self._arm(), arm.length
        for i in range(rope.n_links):
            place = RigidTransform(np.array([0.0, -drop, 0.0]))
            frame = self.plant.AddFrame(FixedOffsetFrame(f"frame{i}", parent.body_frame(), place))
            body = self._body(f"link{i}", float(rope.mass[i]), float(rope.com[i]), float(rope.inertia[i]))
            friction = float(rope.friction[i])
            self.plant.AddJoint(RevoluteJoint(f"joint{i}", frame, body.body_frame(), AXIS, friction))
            parent, drop = body, float(rope.length[i])
        self.plant.mutable_gravity_field().set_gravity_vector(np.array([*rope.gravity, 0.0]))
        self.plant.Finalize()
        self.last, self.end = parent, np.array([0.0, -drop, 0.0])

    def _body(self, name: str, mass: float, com: float, inertia: float) -> RigidBody:
        about = RotationalInertia(inertia, inertia, inertia)
        place = np.array([0.0, -com, 0.0])
        return self.plant.AddRigidBody(name, SpatialInertia.MakeFromCentralInertia(mass, place, about))

    def _arm(self) -> RigidBody:
        body = self._body("arm", 1e-6, 0.0, 1e-9)
        joint = RevoluteJoint("arm", self.plant.world_frame(), body.body_frame(), AXIS, 0.0)
        motor = self.plant.AddJointActuator("motor", self.plant.AddJoint(joint))
        motor.set_default_rotor_inertia(ARMATURE)
        motor.set_default_gear_ratio(1.0)
        return body

    def run(self, cast: Cast, config: SimulatorConfig) -> Array:
        """Return the tip (T, 2)."""
        simulator = Simulator(self.plant)
        ApplySimulatorConfig(config, simulator)
        context = simulator.get_mutable_context()
        start = float(cast.motion.angle(0.0))
        self.plant.SetPositions(context, np.array([start, -start] + [0.0] * (cast.rope.n_links - 1)))
        torque = self.plant.get_actuation_input_port()
        torque.FixValue(context, [0.0])
        simulator.Initialize()
        tips = []
        for part in cast.stretches():
            torque.FixValue(context, [ARMATURE * part.acceleration])
            simulator.AdvanceTo(part.end)
            if part.output:
                tips.append(self.last.body_frame().CalcPoseInWorld(context).multiply(self.end)[:2])
        return np.array(tips)


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """The fastest integrators; radau1, velocity_implicit_euler, runge_kutta5 and cenic were much slower."""
    rig = Rig(cast.rope, cast.arm)
    settings = list(SETTINGS[1:2] if quick else SETTINGS)
    if not quick:
        settings.append(("runge_kutta3", 0.9 * runge_kutta_limit(cast.rope.chain()), None))  # its limit: 2.51 / 2.785
    for scheme, step, accuracy in settings:
        config = SimulatorConfig(
            integration_scheme=scheme,
            max_step_size=step,
            accuracy=accuracy or 1e-3,
            use_error_control=accuracy is not None,
        )
        method = f"{scheme}, {'fixed step' if accuracy is None else 'error control'}"
        setting = f"step {step:.3g} s" if accuracy is None else f"accuracy {accuracy:g}"
        yield Contestant(NAME, method, setting, lambda c=config: rig.run(cast, c), adaptive=accuracy is not None)
