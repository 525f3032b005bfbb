"""Pegs that turn against closed forms and an equation of motion of one angle: capstan, Atwood's machine, bearings."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hyperflex as hf
from hyperflex.core.chain.drive import segment
from hyperflex.core.contact.memory import new_contact_memory
from hyperflex.core.contact.run import new_contact_workspace, try_step
from hyperflex.winding import measure_winding, rope_slip
from tests.core.helpers import rise, scene_of
from tests.reference.wrapping import ARM, laid

RADIUS, WEIGHT, GRAVITY = 0.05, 0.1, 9.81  # m, kg at the tip, m/s^2
AXIS = RADIUS * (1.0 + 1e-6)
TOP = 0.1  # m, of the first joint above the axle
DISC = WEIGHT * RADIUS**2  # kg m^2: a peg as heavy to turn as the weight is to lift


def hung(tail: float = 0.15, mu: float = 0.2, **axle: float) -> tuple[hf.Rope, hf.Peg, np.ndarray]:
    """A light rope half round a peg; down is +y, so it comes from above on the left and its weight hangs on the right.

    It has a thousandth of the weight's mass; links are cut to 0.1 of the radius: corners of 0.1 rad.
    """
    length = TOP + math.pi * AXIS + tail
    rope = hf.Rope.uniform(length, 1e-4, round(length / 0.005), friction=1e-5, tip_mass=WEIGHT, gravity=(0.0, GRAVITY))
    return rope, hf.Peg(0.0, 0.0, RADIUS, mu, **axle), laid(rope.length, (-AXIS, TOP), AXIS, math.pi)


@pytest.mark.parametrize(("sense", "ratio"), [(1.0, math.exp(0.2 * math.pi)), (-1.0, math.exp(-0.2 * math.pi))])
def test_a_rope_brakes_a_spinning_peg_as_the_capstan_law_says(sense, ratio):
    """The weight keeps its pull T, the other end carries T exp(+-mu pi); their difference stops the peg."""
    rope, peg, q0 = hung(inertia=1e-4)
    spun = hf.State(0.0, q0, np.zeros(rope.n_links), peg_rate=[40.0 * sense])
    still = hf.moving_pivot([0.0, 1.0], [-AXIS, -AXIS], [TOP, TOP])
    run = hf.simulate(rope, still, duration=0.2, pegs=[peg], refine=False, state=spun)
    braking = RADIUS * WEIGHT * GRAVITY * (1.0 - ratio) / 1e-4
    # After 30 ms, in which 0.25 mm of slack is taken up. The rope's own weight is a thousandth, its corners are more.
    assert (run.peg_rate[8, 0] - run.peg_rate[3, 0]) / (run.t[8] - run.t[3]) == pytest.approx(braking, rel=3e-3)
    turned = run.peg_angle[-1, 0] - run.peg_angle[3, 0]
    assert turned == pytest.approx(-(run.peg_rate[3, 0] ** 2) / (2.0 * braking), rel=3e-3)
    # The rope sticks then: creep is of the order of nm/s.
    assert abs(run.peg_rate[-1, 0]) < 1e-5
    # All that the peg had is lost, and what the weight fell by, 0.3 % of it.
    assert run.dissipated_energy[-1] == pytest.approx(0.5 * 1e-4 * 40.0**2, rel=4e-3)
    assert rise(run.energy_error) < 1e-5  # the goal of the project for joints with friction


def fall(inertia: float, moved: float, times: np.ndarray) -> np.ndarray:
    """Rate (T,) of the peg of Atwood's machine: an arm of `moved`, kg m^2, without weight on the rope's other end.

    One angle, that of the arm: the rope's straight parts are tangent to the circle, and its length stays.
    """

    def tail(angle: float) -> float:
        x, y = -AXIS - ARM + ARM * math.sin(angle), TOP - ARM * math.cos(angle)
        far = math.hypot(x, y)
        tangent = math.atan2(y, x) + math.acos(AXIS / far)
        return -math.sqrt(far**2 - AXIS**2) - AXIS * (2.0 * math.pi - tangent)

    def slope(angle: float) -> float:
        return (tail(angle + 1e-5) - tail(angle - 1e-5)) / 2e-5

    def mass(angle: float) -> float:
        return moved + (WEIGHT + inertia / AXIS**2) * slope(angle) ** 2

    def motion(_: float, y: np.ndarray) -> list[float]:
        bend = (mass(y[0] + 1e-4) - mass(y[0] - 1e-4)) / 2e-4
        return [y[1], (WEIGHT * GRAVITY * slope(y[0]) - 0.5 * bend * y[1] ** 2) / mass(y[0])]

    path = solve_ivp(motion, (0.0, times[-1]), [0.5 * math.pi, 0.0], t_eval=times, rtol=1e-9, atol=1e-12)
    return np.array([slope(angle) * rate / AXIS for angle, rate in zip(*path.y, strict=True)])


def test_atwoods_machine():
    """The weight falls as an equation of one angle says, in which the peg counts with I / R^2."""
    moved = 0.5 * WEIGHT * ARM**2
    rope, peg, q0 = hung(mu=1.0, inertia=DISC)
    arm = hf.Arm(length=ARM, inertia=moved, pivot=(-AXIS - ARM, TOP))
    none = hf.torque_profile([0.0, 1.0], [0.0, 0.0])
    run = hf.simulate(
        rope, arm=arm, torque=none, arm_angle0=0.5 * math.pi, q0=q0, duration=0.12, pegs=[peg], refine=False
    )
    wanted, heavy = fall(DISC, moved, run.t), fall(0.0, moved, run.t)
    # Corners of 0.1 rad make the lever uneven by 0.05^2 / 2 = 0.1 %; without the peg's inertia it were 69 % faster.
    assert run.peg_rate[-1, 0] == pytest.approx(wanted[-1], rel=5e-3)
    assert heavy[-1] > 1.5 * wanted[-1]
    # Nothing slips: the rope's way is that of the peg's surface once its slack is taken up, after 30 ms.
    gone, turned = run.tip[-1, 1] - run.tip[3, 1], run.peg_angle[-1, 0] - run.peg_angle[3, 0]
    assert AXIS * turned == pytest.approx(gone, rel=5e-3)
    assert np.abs(rope_slip(run, peg, since=0.03)[3:]).max() < 1e-4 < 1e-2 < gone
    assert rise(run.energy_error) < 1e-5


def pulled(peg_axle: dict[str, float], speedup: float = 2.0) -> tuple[hf.Trajectory, hf.Peg]:
    """The weight lifted over a peg of mu = 0.2 by a first joint that moves away with the acceleration `speedup`."""
    rope, peg, q0 = hung(**peg_axle)
    t = np.linspace(0.0, 0.4, 41)  # the motion ends at rest, but after the run
    away = hf.moving_pivot(t, np.full(41, -AXIS), TOP + 0.5 * speedup * t**2)
    return hf.simulate(rope, away, duration=0.16, q0=q0, pegs=[peg], refine=False), peg


def pull_of(run: hf.Trajectory) -> float:
    """Mean pull of the first joint from 40 ms on, N: its work over its way."""
    return float((run.motor_work[-1] - run.motor_work[4]) / (run.base[-1, 1] - run.base[4, 1]))


@pytest.mark.parametrize("inertia", [1e-9, 0.2 * DISC])
def test_tension_on_both_sides_of_a_free_peg(inertia):
    """Without sticking the tensions differ by the moment that accelerates the peg, which is negligible for a light
    one."""
    run, peg = pulled({"inertia": inertia})
    after, pull = WEIGHT * (GRAVITY + 2.0), WEIGHT * (GRAVITY + 2.0) + inertia * 2.0 / RADIUS**2
    # The rope has a thousandth of the mass, and a corner of 0.1 rad bends the lever by as much; capstan: 87 % more.
    assert pull_of(run) == pytest.approx(pull, rel=5e-3)
    state = measure_winding(run, peg)
    # Links come round the peg and tremble by up to 4 %; means over 12 samples.
    assert state.after[4:].mean() == pytest.approx(after, rel=0.02)
    assert state.before[4:].mean() == pytest.approx(pull, rel=0.02)
    assert run.peg_rate[-1, 0] == pytest.approx(-2.0 * 0.16 / RADIUS, rel=0.01)


def test_a_peg_too_heavy_to_turn_is_a_fixed_one():
    fixed, heavy = pulled({})[0], pulled({"inertia": 1e6})[0]
    assert fixed.peg_rate is None
    # The peg turns by 1e-9 rad; the runs take the same steps, and the rope slips equally on both.
    np.testing.assert_allclose(heavy.q, fixed.q, rtol=0, atol=1e-6)
    limit = math.exp(0.2 * math.pi) * WEIGHT * (GRAVITY + 2.0)
    assert pull_of(fixed) == pytest.approx(limit, rel=0.03)  # as the capstan tests have it
    assert pull_of(heavy) == pytest.approx(pull_of(fixed), rel=1e-6)


@pytest.mark.parametrize("where", ["far", "touching"])
def test_a_bearing_slows_a_peg_by_the_exponential(where):
    """Without friction on the rope, in flight and in contact; the loss is the peg's energy."""
    rope, peg, q0 = hung(mu=0.0, inertia=1e-4, bearing=2e-3)
    if where == "far":
        peg = hf.Peg(3.0, 0.0, RADIUS, 0.2, inertia=1e-4, bearing=2e-3)
    still = hf.moving_pivot([0.0, 1.0], [-AXIS, -AXIS], [TOP, TOP])
    spun = hf.State(0.0, q0, np.zeros(rope.n_links), peg_rate=[30.0], peg_angle=[1.0])
    run = hf.simulate(rope, still, duration=0.1, pegs=[peg], refine=False, state=spun)
    assert (run.attrs["contact_steps"] > 0) == (where == "touching")
    part = np.exp(-20.0 * run.t)
    np.testing.assert_allclose(run.peg_rate[:, 0], 30.0 * part, rtol=1e-9)  # exact in each step
    # The angle is exact in flight; a step h in contact takes the mean rate, (b h / I)^2 / 12 = 1e-6 off.
    np.testing.assert_allclose(run.peg_angle[:, 0], 1.0 + 1.5 * (1.0 - part), rtol=1e-5)
    assert np.abs(run.energy_error).max() < 1e-5
    assert run.dissipated_energy[-1] > 0.9 * 0.5 * 1e-4 * 30.0**2 * (1.0 - part[-1] ** 2)


@pytest.mark.parametrize("bearing", [0.0, 2e-5])
def test_energy_never_grows_where_a_cable_falls_on_pulleys(bearing):
    cable = hf.Rope.uniform(length=0.7, mass=0.044, n_links=18, radius=0.0025, friction=1e-3, tip_mass=0.02)
    pegs = [hf.Peg(x, y, 0.03, 0.5, inertia=2e-6, bearing=bearing) for x, y in ((0.0, -0.3), (0.12, -0.45))]
    wall = hf.Wall(-0.5, -2.0, 0.5, -2.0)
    run = hf.simulate(cable, duration=0.5, q0=np.full(18, 1.2), pegs=[wall, *pegs], refine=False)
    assert np.abs(run.peg_rate).max() > 1.0
    # The goals of the project, for joints with friction of 1e-4 N m s/rad and more.
    assert rise(run.energy_error) < 1e-5
    assert rise(-run.contact_loss) < 1e-5
    assert run.attrs["contact_deepest"] < 2e-4
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]


@pytest.mark.parametrize("h", [0.0, 1e-4])
def test_a_peg_takes_the_angular_momentum_that_contacts_give_it(h):
    """In one step, to rounding; and what sticks has the velocity of the peg."""
    rope, peg, q0 = hung(mu=0.3, inertia=1e-4)
    still = hf.moving_pivot([0.0, 1.0], [-AXIS, -AXIS], [TOP, TOP])
    setup = hf.Setup(rope, still, q0=q0, pegs=[peg, hf.Peg(1.0, 1.0, 0.1)])
    scene, n = scene_of(setup), rope.n_links
    workspace, memory = new_contact_workspace(scene, 1e-6, 1e-4, 1e-5), new_contact_memory(n, 2)
    workspace.spin.before[0] = 0.3
    y = np.concatenate([q0, np.full(n, 2.0)])
    try_step(scene, segment(scene.drive, 0.0), 0.0, h, y, memory, workspace, True, 0.0, True)
    impulses, contacts = workspace.impulses, workspace.contacts
    held = impulses.mode[: contacts.total[0]] != 0
    assert held.sum() > 5
    torque = -scene.pegs.reach[0] * impulses.tangent[: contacts.total[0]][held].sum()
    assert 1e-4 * (workspace.spin.after[0] - 0.3) == pytest.approx(torque, rel=1e-9)
    assert abs(torque) > 1e-9  # rounding is 1e-20
    assert workspace.spin.after[1] == 0.0
