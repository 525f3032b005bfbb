"""MJCF files: MuJoCo's model and motion agree with the set-up, which is read back bit for bit."""

import re
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from tests.exchange import mujoco_ropes
from tests.refusals import refuses

LINKS = [1, 2, 3, 100, *np.random.default_rng(0).integers(4, 100, 16).tolist()]
ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=4, radius=0.003, friction=1e-4)
MOVED = hf.Setup(ROPE, hf.move_arm(0.0, 1.0, 0.5), hf.Arm())


def written(setup: hf.Setup, folder: Path) -> Path:
    hf.write_mjcf(setup, folder / "rope.xml")
    return folder / "rope.xml"


@pytest.mark.parametrize(("index", "links"), list(enumerate(LINKS)))
def test_compiled_masses_inertias_and_accelerations(index, links, tmp_path):
    """Numbers to the last bits; accelerations at the start to 1e-8, the part that the rope moves a heavy rotor."""
    setup = mujoco_ropes.draw(index, links)
    path, rope = written(setup, tmp_path), setup.rope
    model, data = mujoco_ropes.load(path)
    bodies = [model.body(f"link{k}").id for k in range(links)]
    np.testing.assert_allclose(model.body_mass[bodies], rope.mass, rtol=1e-12)
    np.testing.assert_allclose(model.body_inertia[bodies, 1], rope.inertia, rtol=1e-12)
    assert model.body_mass.sum() == pytest.approx(rope.total_mass + arm_mass(setup), rel=1e-12)
    mujoco.mj_forward(model, data)
    got = np.cumsum(data.qacc)[-links:]
    wanted = hf.simulate(setup, duration=1e-3).qdd[0]
    np.testing.assert_allclose(got, wanted, atol=1e-6 * np.abs(wanted).max())
    assert hf.read_mjcf(path).dumps() == setup.dumps()
    assert hf.read_mjcf(path).rope == rope


def arm_mass(setup: hf.Setup) -> float:
    if setup.arm is None:
        return 0.0
    return setup.arm.mass if setup.torque_driven else 1e-6


@pytest.mark.parametrize(("index", "links"), [*enumerate(LINKS[:3]), (6, 53), (9, 7), (12, 20), (15, 91)])
def test_tip_is_where_mujoco_has_it_after_two_seconds(index, links, tmp_path):
    """To half a millimetre with 100 links, whose rotor and light links lie far apart; a wrong sign is off by cm."""
    setup = mujoco_ropes.draw(index, links)
    tip = mujoco_ropes.tip(setup, written(setup, tmp_path))
    np.testing.assert_allclose(tip, hf.simulate(setup).tip[-1], atol=5e-4 if links > 60 else 1e-6)


@pytest.mark.parametrize(("friction", "wanted"), [(5e-4, "RK4"), (0.05, "implicitfast")])
def test_the_file_as_written_is_right_or_warns_of_its_first_order(friction, wanted, tmp_path):
    """The paper's cable for a second: RK4 to a micrometre; with stiff friction the other integrator, which is said."""
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=friction)
    setup = hf.Setup(cable, hf.arm_swings(), hf.Arm(), duration=1.0, tol=1e-8)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        path = written(setup, tmp_path)
    assert ["half the step" in str(each.message) for each in caught] == [True] * (wanted != "RK4")
    assert ET.parse(path).find("option").get("integrator") == wanted
    assert hf.read_mjcf(path).dumps() == setup.dumps()
    if wanted == "RK4":
        model, data = mujoco_ropes.load(path)
        for _ in range(10_000):
            data.ctrl[0] = setup.motion.acceleration(data.time + 0.5e-4)
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.site("tip").xpos[[0, 2]], hf.simulate(setup).tip[-1], atol=1e-6)


def test_a_chain_at_the_nesting_limit_is_loaded_and_a_longer_one_is_refused(tmp_path):
    """490 bodies are within MuJoCo's 500 nested elements; 1,000 links once ended in a RecursionError."""
    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=489, tip_mass=0.01, friction=0.0)
    model, _ = mujoco_ropes.load(written(hf.Setup(rope), tmp_path))
    assert model.nv == 489
    assert hf.read_mjcf(tmp_path / "rope.xml").rope == rope
    with pytest.raises(InvalidInput, match=r"chain of 1000 bodies.*at most 490"):
        hf.write_mjcf(hf.Setup(hf.Rope.uniform(1.0, 0.1, 1000, friction=0.0)), tmp_path / "long.xml")


def test_edited_rope_is_read(tmp_path):
    path = written(MOVED, tmp_path)
    root = ET.parse(path).getroot()
    for each in root.iter("joint"):
        if each.get("name") == "joint2":
            each.set("damping", "0.25")
    ET.ElementTree(root).write(path)
    assert hf.read_mjcf(path).rope == ROPE.replace(friction=[1e-4, 1e-4, 0.25, 1e-4])


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('name="arm" pos="0.0', 'name="arm" pos="0.5', "body arm has another pos"),
        ('qpos="0.0', 'qpos="0.3', "key start has another qpos"),
        ('axis="0.0 -1.0', 'axis="0.0 1.0', "another axis"),
        ('name="joint1"', 'name="elbow"', "another name"),
        ("<actuator>", '<actuator><motor joint="joint1" />', "actuator contains other parts"),
        ('mass="0.025"', 'mass="heavy"', "inertial has no usable mass.*Allowed: a number"),
        ('mass="0.025"', 'mass="1_000"', "inertial has no usable mass: got '1_000'"),
        ('name="hyperflex"', 'name="other"', "not written by hyperflex"),
        ("</mujoco>", "", "no XML"),
    ],
)
def test_what_is_not_read_back_is_refused_by_name(old, new, named, tmp_path):
    path = written(MOVED, tmp_path)
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")
    refuses(named, hf.read_mjcf, path)


def test_a_file_that_mujoco_has_saved_is_refused(tmp_path):
    """It has six digits, and other parts."""
    path = tmp_path / "saved.xml"
    path.write_text(mujoco.MjSpec.from_file(str(written(MOVED, tmp_path))).to_xml(), "utf-8")
    with pytest.raises(InvalidInput):
        hf.read_mjcf(path)


@pytest.mark.parametrize(
    ("rope", "others", "named"),
    [
        ({"drag": 1e-3}, {}, "air drag"),
        ({"friction_model": "printed"}, {}, "one-sided"),
        ({"mass": [0.1, 0.0, 0.1, 0.1], "inertia": 1e-6}, {}, "cannot move link 1"),
        ({"inertia": 0.0}, {}, "cannot move link 0"),
        ({}, {"motion": hf.moving_pivot([0.0, 1.0, 2.0], [0.0, 0.1, 0.2], [0.0, 0.0, 0.0])}, "pivot that moves"),
        ({}, {"pegs": [hf.Wall(1.0, -1.0, 1.0, 0.0)]}, "wall"),
        ({}, {"pegs": [hf.Peg(1.0, -1.0, 0.1, inertia=1e-3)]}, "turns on an axle"),
        ({}, {"pegs": [hf.Peg(1.0, -1.0, 0.1, restitution=0.5)]}, "restitution"),
        ({"radius": 0.0}, {"pegs": [hf.Peg(1.0, -1.0, 0.1)]}, "without a radius"),
        ({}, {"pegs": [hf.Peg(1.0, -1.0, 0.1)], "tip_force": (1.0, 0.0)}, "tip force"),
        ({}, {"arm": hf.Arm(), "torque": hf.torque_profile([0.0, 1.0], [0.0, 0.0])}, "cannot move the arm"),
    ],
)
def test_what_mujoco_cannot_say_is_refused_by_name(rope, others, named, tmp_path):
    refuses(named, hf.write_mjcf, hf.Setup(ROPE.replace(**rope), **others), tmp_path / "rope.xml")
    assert not (tmp_path / "rope.xml").exists()


def test_softer_laws_of_mujoco_are_reported(tmp_path):
    pegs = [hf.Peg(0.02, -0.5, 0.05, mu=0.4), hf.Ground(0.0, -0.9, mu=0.2)]
    setup = hf.Setup(ROPE.replace(dry_friction=1e-4, max_bend=[np.inf, 0.5, 0.6, 0.7], rest_angle=0.1), pegs=pegs)
    with pytest.warns(UserWarning, match="soft") as told:
        path = written(setup, tmp_path)
    assert [re.search("dry friction|joint limits|contact", str(each.message))[0] for each in told] == [
        "dry friction",
        "joint limits",
        "contact",
    ]
    assert hf.read_mjcf(path).dumps() == setup.dumps()
    model, data = mujoco_ropes.load(path)
    np.testing.assert_allclose(model.jnt_range[1:], 0.1 + np.array([[-0.5, 0.5], [-0.6, 0.6], [-0.7, 0.7]]))
    assert model.jnt_limited.tolist() == [0, 1, 1, 1]
    assert model.dof_frictionloss.tolist() == [1e-4] * 4
    mujoco.mj_forward(model, data)  # the rope hangs through the peg and into the ground
    touched = {(model.geom(int(each.geom[0])).name, float(each.friction[0])) for each in data.contact}
    assert touched == {("peg0", 0.4), ("ground1", 0.2)}
