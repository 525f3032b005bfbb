"""A rope that starts inside an obstacle is refused, and one that touches it is not."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.model import obstacle_gaps
from hyperflex.simulation.contact import SHALLOW, check_outside
from tests.refusals import refuses

RADIUS = 0.0025  # m
ROPE = hf.Rope.uniform(0.6, 0.06, 6, RADIUS, friction=1e-3)


@pytest.mark.parametrize(
    ("obstacle", "words"),
    [
        (hf.Ground(0.0, -0.3), r"link 5 is 302 mm deep in it: got Ground"),
        (hf.Peg(0.01, -0.45, 0.03), r"link 4 is 22.5 mm deep in it: got Peg"),
        (hf.Peg(0.0, 0.02, 0.03), r"link 0 is 12.5 mm deep"),  # round the point that the rope hangs from
        (hf.Wall(-0.1, -0.23, 0.1, -0.23), r"link 2 is 103 mm deep in it: got Wall"),  # its ends lie 100 mm away
        (hf.Wall(0.001, -0.5, 0.2, -0.5), r"mm deep in it: got Wall"),  # its joint on the end of a wall
    ],
)
def test_a_start_inside_is_refused(obstacle, words):
    refuses(words, hf.simulate, ROPE, duration=0.1, pegs=[hf.Peg(5.0, 5.0, 0.03), obstacle], refine=False)


@pytest.mark.parametrize(
    "obstacle",
    [
        hf.Ground(0.0, -0.6 - RADIUS),
        hf.Peg(0.03 + RADIUS - 2e-4, -0.45, 0.03),
        hf.Wall(RADIUS - 2e-4, -0.55, RADIUS - 2e-4, 1.0),
        hf.Wall(0.01, -0.23, 0.1, -0.23),
        hf.Ground(0.0, -0.7),
        hf.Ground(0.0, 0.0, 0.0, -1.0),  # it hangs from a ceiling
    ],
)
def test_a_start_that_touches_is_not(obstacle):
    setup = hf.Setup(ROPE, pegs=[obstacle])
    check_outside(setup)  # raises nothing
    joints = hf.simulate(ROPE, duration=1e-3).joints[0]
    assert RADIUS - obstacle_gaps([obstacle], joints[:-1], joints[1:]).min() < SHALLOW


def test_a_run_continues_from_where_one_has_ended_however_deep(monkeypatch):
    """A coarse run may leave a rope some millimetres deep; the same rope and obstacles go on, others start."""
    given = {"duration": 0.05, "pegs": [hf.Ground(0.0, -0.6 - RADIUS)], "refine": False}
    run = hf.simulate(ROPE, **given)
    monkeypatch.setattr("hyperflex.simulation.contact.SHALLOW", -1.0)
    assert hf.simulate(ROPE, **given, state=run.state).success
    for changed in ({"pegs": [hf.Ground(0.0, -0.59)]}, {"pegs": given["pegs"], "tol": 1e-4}):
        refuses("starts inside", hf.simulate, ROPE, **given | changed, state=run.state)


def test_an_arm_carries_the_rope_clear_of_a_peg():
    """The initial position of the arm counts; a driven arm's link does not, and links count from the rope's first
    one."""
    peg = hf.Peg(0.0, -0.4, 0.03)
    refuses("starts inside", check_outside, hf.Setup(ROPE, pegs=[peg]))
    driven = {"torque": hf.torque_profile([0.0, 1.0], [0.0, 0.0]), "arm_angle0": 0.5 * math.pi}
    check_outside(hf.Setup(ROPE, arm=hf.Arm(length=0.3, inertia=1e-3), pegs=[peg], **driven))
    at = hf.Peg(0.15, 0.0, 0.03)  # on the driven arm, which touches nothing
    check_outside(hf.Setup(ROPE, arm=hf.Arm(length=0.3, inertia=1e-3), pegs=[at], **driven))
    beside = hf.Peg(0.3, -0.05, 0.03)
    with pytest.raises(InvalidInput, match=r"link 0 is 32\.5 mm deep"):
        check_outside(hf.Setup(ROPE, arm=hf.Arm(length=0.3, inertia=1e-3), pegs=[beside], **driven))


def test_a_batch_names_the_member():
    q0 = np.array([1.5, 0.0])[:, None] + np.zeros(6)
    with pytest.raises(InvalidInput, match="the rope of member 1 starts inside an obstacle: link 5"):
        hf.simulate_batch(ROPE, q0=q0, duration=0.1, pegs=[hf.Ground(0.0, -0.5)], refine=False)


def test_gaps_are_those_of_a_fine_sampling():
    rng = np.random.default_rng(3)
    joints = np.cumsum(rng.normal(0.0, 0.1, (20, 2)), axis=0)
    pegs = [hf.Peg(0.1, 0.05, 0.04), hf.Peg(-0.2, 0.1, 0.06)]
    gaps = obstacle_gaps(pegs, joints[:-1], joints[1:])
    part = np.linspace(0.0, 1.0, 20001)[:, None, None]
    points = joints[:-1] + part * np.diff(joints, axis=0)
    for peg, gap in zip(pegs, gaps, strict=True):
        away = np.hypot(points[..., 0] - peg.x, points[..., 1] - peg.y).min(axis=0)
        # Next to the closest point the distance is flat: a sampling of 1e-5 m is 1e-9 m off at 1 cm.
        np.testing.assert_allclose(gap, away - peg.radius, rtol=0, atol=1e-7)
