"""The order of each integrator, measured, against the one it declares; and where the explicit one stops."""

import re

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core.chain.drive import segment
from hyperflex.core.chain.lanes import COLUMNS, load, rows
from hyperflex.core.integrate.steps import COURSE, ERRORS, add_substeps, extrapolate, new_substeps, scheme, weigh_terms
from hyperflex.errors import InvalidInput
from tests.reference.arm import cast, links_of, still

Q0 = np.array([0.5, 0.6])


def chain() -> hf.Rope:
    """Two links with mild friction: smooth, and slow compared with the steps."""
    return hf.Rope(length=[1.0, 1.0], mass=[0.2, 0.1], friction=2e-2, tip_mass=0.05)


def exact(duration: float) -> np.ndarray:
    """Angles and rates (4,) at the end, from the dense reference."""
    return cast(links_of(chain()), 0.0, still(duration), Q0, np.zeros(2), tol=1e-13)[0]


def slope(steps: np.ndarray, errors: list[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def test_runge_kutta_has_order_four():
    want = exact(1.0)[:2]
    counts = np.array([100, 200, 400])
    runs = [hf.simulate(chain(), duration=1.0, q0=Q0, step=1.0 / k, t_eval=[1.0]) for k in counts]
    errors = [float(np.abs(run.q[-1] - want).max()) for run in runs]
    # Fitted over a factor of four; the next term bends the slope by some hundredths at these steps.
    assert slope(1.0 / counts, errors) == pytest.approx(4.0, abs=0.15)


def fixed_steps(order: int, count: int, duration: float, part_of_last: float | None = None) -> np.ndarray:
    """State (4,) at the end of extrapolated steps of equal length, or within the last one, without error control.

    Within the last step the substeps give the state.
    """
    setup = hf.Setup(rope=chain(), q0=Q0)
    parameters, drive, table = setup.chain(), setup.drive(), scheme(order)
    n = len(Q0)
    y, out, errors = np.zeros(2 * n + 2), np.zeros(2 * n + 2), np.zeros((ERRORS, 2 * n + 2))
    y[:n] = Q0
    lanes, tip = rows(COLUMNS, n)
    base, work = np.zeros((9, len(COLUMNS))), np.zeros(6 * n)
    load(COLUMNS, parameters, lanes, tip)
    kept, weight = new_substeps(n)
    h = duration / count
    for k in range(count):
        part = segment(drive, k * h)
        extrapolate(parameters, drive, part, table, k * h, h, y, out, errors, kept, lanes, tip, base, work)
        if k == count - 1 and part_of_last is not None:
            weight = weight[: table.column.size]
            weigh_terms(COURSE[order, :order], part_of_last, weight)
            add_substeps(weight, kept, y)
        else:
            y[:] = out
    return y[: 2 * n]


# Steps short enough for the leading term of the error and long enough to stay above rounding, 1e-12 of the angles.
COUNTS = {2: (24, 32, 48), 3: (32, 48, 64), 4: (24, 32, 48), 5: (24, 32, 48), 6: (12, 16, 24), 7: (12, 14, 16)}


@pytest.mark.parametrize("order", COUNTS)
def test_extrapolation_has_the_order_that_it_declares(order):
    duration = 0.5
    want = exact(duration)
    counts = np.array(COUNTS[order])
    errors = [float(np.abs(fixed_steps(order, int(k), duration) - want).max()) for k in counts]
    # The next term has the other sign here, so the measured order comes up from below: by 0.01 to 0.3 at these steps.
    assert order - 0.4 < slope(duration / counts, errors) < order + 0.2


# Long enough for the error of one step to stay above rounding, and short enough for its leading term.
STEPS = {3: (0.02, 0.04), 5: (0.03, 0.06), 7: (0.06, 0.1)}


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("order", STEPS)
def test_the_substeps_tell_the_course_of_a_step_to_its_order(order, part):
    steps = np.array(STEPS[order])
    errors = [float(np.abs(fixed_steps(order, 1, h, part) - exact(part * h)).max()) for h in steps]
    # One step errs in proportion to its length^(order + 1), at these steps from 0.8 below to 0.1 above.
    assert order + 0.15 < slope(steps, errors) < order + 1.3


@pytest.mark.parametrize(
    ("changes", "torque"),
    [({}, 1.5e-4), ({"friction": 5e-3}, 5e-4), ({"n_links": 120}, 2e-3), ({"stiffness": 0.1}, 5e-4)],
    ids=["paper's", "friction", "fine", "stiff"],
)
def test_outputs_within_steps_are_as_good_as_the_steps(changes, torque):
    """Also after the arm's switches, where friction settles: accelerations and torques are most sensitive to errors
    there."""
    t = np.linspace(0.0, 1.5, 1201)
    runs = [
        hf.simulate(cable(**changes), hf.arm_swings(), arm=hf.Arm(length=0.105), duration=1.5, t_eval=t, tol=tol)
        for tol in (1e-5, 1e-6)
    ]
    assert np.abs(runs[0].joints - runs[1].joints).max() < 4e-5  # the steps themselves err by up to 3.4 times tol
    assert np.abs(runs[0].motor_torque - runs[1].motor_torque).max() < torque  # N m


def test_the_error_follows_the_tolerance():
    want = exact(2.0)[:2]
    errors = []
    for tol in (1e-4, 1e-6, 1e-8, 1e-10):
        run = hf.simulate(chain(), duration=2.0, q0=Q0, t_eval=[2.0], tol=tol)
        errors.append(float(np.abs(run.q[-1] - want).max()))
    # A hundred times the tolerance over 2 s on links of half a metre, and never worse for a tighter tolerance.
    assert (np.array(errors) < 100 * np.array([1e-4, 1e-6, 1e-8, 1e-10])).all()
    assert (np.diff(errors) < 0).all()


def cable(**changes: object) -> hf.Rope:
    kept = {"length": 2.0, "mass": 0.125, "n_links": 50, "radius": 0.0025, "friction": 5e-4, **changes}
    return hf.Rope.uniform(**kept)


def cast_with(rope: hf.Rope, **how: object) -> hf.Trajectory:
    return hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.105), duration=2.0, t_eval=[2.0], **how)


@pytest.mark.parametrize("n", [25, 50])
def test_runge_kutta_refuses_a_step_beyond_its_limit_and_names_the_limit(n):
    rope = cable(n_links=n)
    known = 2.785 * rope.mass[0] * rope.length[0] ** 2 / (48 * 5e-4)  # the friction mode of neighbouring links
    with pytest.raises(InvalidInput, match="step is beyond the stability limit") as caught:
        cast_with(rope, step=1.1 * known)
    named = float(re.search(r"at most ([\d.e+-]+) s", str(caught.value)).group(1))
    # The formula is for many links; the ends of a finite chain and gravity move the limit by a few per cent.
    assert named == pytest.approx(known, rel=0.05)
    assert f"{1.1 * known}"[:8] in str(caught.value)
    right = cast_with(rope, tol=1e-9)
    just_inside = cast_with(rope, step=0.95 * named)
    # RK4 near its limit is good to a micrometre here (prototype: 1e-6 mm at 4.6e-4 s and n = 50).
    assert np.abs(just_inside.tip - right.tip).max() < 1e-6


JOINTS = [{"friction_model": "printed", "friction": 2e-3}, {"dry_friction": 1e-4}, {"stiffness": 0.1, "friction": 2e-3}]


@pytest.mark.parametrize("changes", JOINTS, ids=["printed", "dry", "stiff"])
def test_the_limit_includes_every_joint_torque(changes):
    """Just inside the named limit each kind of joint is stable: the tip agrees with the method that has no limit."""
    rope = cable(n_links=20, **changes)
    with pytest.raises(InvalidInput) as caught:
        cast_with(rope, step=1.0)
    named = float(re.search(r"at most ([\d.e+-]+) s", str(caught.value)).group(1))
    run = cast_with(rope, step=0.9 * named)
    # The step is stable, not small: some micrometres. Beyond the limit the tip is off by a hundred millimetres.
    assert np.abs(run.tip - cast_with(rope, tol=1e-9).tip).max() < 1e-5


def test_a_chain_without_any_torque_has_no_limit():
    """In free space nothing but inertia acts: every step is stable, and none is refused."""
    rope = hf.Rope(length=[0.5, 0.5], mass=[0.1, 0.1], gravity=(0.0, 0.0))
    run = hf.simulate(rope, duration=1.0, qd0=[0.1, 0.1], step=0.01, t_eval=[1.0])
    # Both links turn together about a fixed end: no relative motion, so the angle grows at a constant rate.
    np.testing.assert_allclose(run.q[-1], [0.1, 0.1], rtol=0, atol=1e-12)
