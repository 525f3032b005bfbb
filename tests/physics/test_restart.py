"""Stop, save, read, go on: the same numbers, to the last bit, as if nothing had happened."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.simulation import Rollout

ARM = hf.Arm(length=0.105)
STOP, END = 1.0, 2.5  # s; at 1.0 s the arm rests in the middle of a stretch, at no switch
LATE = np.linspace(1.1, END, 15)


def cable(**changes: object) -> hf.Rope:
    kept = {"length": 2.0, "mass": 0.125, "n_links": 12, "radius": 0.0025, "friction": 5e-4, **changes}
    return hf.Rope.uniform(**kept)


def same(got: hf.Trajectory, want: hf.Trajectory) -> None:
    """Equal in every bit of everything that a run computes."""
    for name in ("t", "q", "qd", "qdd", "motor_work", "dissipated_energy", "kinetic_energy", "motor_torque"):
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name), err_msg=name)
    np.testing.assert_array_equal(got.state.q, want.state.q)
    np.testing.assert_array_equal(got.state.qd, want.state.qd)
    assert got.state.step == want.state.step


def through_a_file(run: hf.Trajectory, folder: Path) -> hf.State:
    run.to_netcdf(folder / "stopped.nc")
    return hf.read_trajectory(folder / "stopped.nc").state


METHODS: list[dict[str, Any]] = [{"tol": 1e-6}, {"tol": 1e-9}, {"step": 1e-3}]
STOPS = [STOP, 0.73, 0.7301, 2.4999, np.nextafter(0.73, 0.0), np.nextafter(0.73, 1.0)]  # at a switch and next to it


@pytest.mark.parametrize(("how", "dry"), [*((how, 0.0) for how in METHODS), (METHODS[0], 2e-3)])
@pytest.mark.parametrize("stop", STOPS)
def test_continuing_the_same_motion(tmp_path, stop, how, dry):
    late = LATE[1:] if stop < 2.0 else np.array([END])
    rope = cable(dry_friction=dry)  # with 2 mN m some joints stick, and others come loose, all the time
    whole = hf.simulate(rope, hf.arm_swings(), arm=ARM, duration=END, t_eval=late, **how)
    first = hf.simulate(rope, hf.arm_swings(), arm=ARM, duration=stop, **how)
    state = through_a_file(first, tmp_path)
    second = hf.simulate(rope, hf.arm_swings(), arm=ARM, duration=END - stop, t_eval=late, state=state, **how)
    same(second, whole)


def test_stopping_again_and_again():
    whole = hf.simulate(cable(), hf.arm_swings(), arm=ARM, duration=END, t_eval=[END])
    state = None
    for stop in (0.3, 0.31, 1.0, 1.7, END):
        begin = 0.0 if state is None else state.t
        run = hf.simulate(cable(), hf.arm_swings(), arm=ARM, duration=stop - begin, t_eval=[stop], state=state)
        state = run.state
    np.testing.assert_array_equal(run.q, whole.q)
    np.testing.assert_array_equal(run.motor_work, whole.motor_work)


def test_going_on_with_another_motion_is_the_joined_motion(tmp_path):
    """The second motion begins at the end of the first, at a break, so both versions have the same pieces."""
    first = hf.arm_swings()
    angle = float(first.angle(STOP))
    second = hf.move_arm(angle, -1.0, 0.6).shifted(STOP)
    whole = hf.simulate(cable(), first.then(second, at=STOP), arm=ARM, duration=END, t_eval=LATE)
    stopped = hf.simulate(cable(), first, arm=ARM, duration=STOP)
    state = through_a_file(stopped, tmp_path)
    rest = hf.simulate(cable(), second, arm=ARM, duration=END - STOP, t_eval=LATE, state=state)
    same(rest, whole)


def test_a_joined_motion_in_the_middle_of_a_piece_is_the_same_function_of_time():
    """Here the pieces are expanded about another instant, so bits differ, and no more than bits."""
    first, second = hf.hold_arm(-np.pi / 2), hf.arm_swings().shifted(0.4)
    whole = hf.simulate(cable(), first.then(second, at=0.2), arm=ARM, duration=END, t_eval=LATE, tol=1e-8)
    plain = hf.simulate(cable(), second, arm=ARM, duration=END, t_eval=LATE, tol=1e-8)
    # The second motion rests at the same angle until 0.4 s; the runs differ by the step cut at 0.2 s.
    np.testing.assert_allclose(whole.q, plain.q, rtol=0, atol=1e-5)


def test_a_state_made_by_hand_is_where_the_run_starts():
    q, qd = np.linspace(0.1, 0.4, 12), np.linspace(-1.0, 1.0, 12)
    by_state = hf.simulate(cable(), duration=1.0, state=hf.State(t=3.0, q=q, qd=qd), t_eval=[3.0, 4.0])
    by_start = hf.simulate(cable(), duration=1.0, q0=q, qd0=qd, t_eval=[0.0, 1.0])
    # Times are 3 s later, so steps may differ in their last bits; at the default tolerance that is all.
    np.testing.assert_allclose(by_state.q, by_start.q, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(by_state.t, [3.0, 4.0])


@pytest.mark.parametrize("dry", [0.0, 2e-3], ids=["viscous", "dry"])
def test_looking_up_between_steps_leaves_no_trace(dry):
    """A run may return after every step; the mark from which it continues must not depend on it."""
    setup = hf.Setup(cable(dry_friction=dry), hf.arm_swings(), ARM, tol=1e-7)
    for stop in np.linspace(0.05, 1.5, 59):  # some of these ends cut a step that is then refused and tried shorter
        marks = []
        for budget in (1, 10_000):
            rollout = Rollout(setup, np.array([0.0, stop]))
            rollout.limits = rollout.limits._replace(budget=budget)
            rollout.complete()
            marks.append(
                np.concatenate(
                    [rollout.progress.clock[:8], rollout.progress.y, rollout.progress.mark, rollout.progress.mark_slip]
                )
            )
        np.testing.assert_array_equal(marks[0], marks[1], err_msg=f"stop at {stop} s")


@pytest.mark.parametrize("t_move", [0.7, 0.61])
@pytest.mark.parametrize("t_rest", [0.4, 0.0, 0.13])
def test_swings_continue_for_many_cycles(t_move, t_rest):
    """A cycle's end, as a product and as a sum, is not the same number: the run must pass it all the same."""
    rope = hf.Rope(length=[0.5], mass=[0.1], friction=1e-2)
    motion = hf.arm_swings(t_move, t_rest, "minimum-jerk")
    run = hf.simulate(rope, motion, arm=ARM, duration=100.0, t_eval=[50.0, 100.0], tol=1e-5)
    np.testing.assert_allclose(run.arm_angle, motion.angle([50.0, 100.0]), rtol=0, atol=1e-12)


def test_an_interrupted_run_continues_from_where_it_stood():
    """Ctrl-C, then on: the state must be that of the run, not the one that it began with."""

    def control(t, *_state):
        if t >= stop_at[0]:
            raise KeyboardInterrupt
        return 0.03 * np.sin(5 * t)

    arm = hf.Arm(length=0.105, inertia=1e-3)
    how = {"arm": arm, "torque": control, "control_rate": 100.0, "throw": False, "tol": 1e-8}
    stop_at = [np.inf]
    whole = hf.simulate(cable(), duration=1.0, t_eval=[1.0], **how)
    stop_at = [0.5]
    part = hf.simulate(cable(), duration=1.0, **how)
    assert part.status == "interrupted"
    stop_at = [np.inf]
    rest = hf.simulate(cable(), duration=1.0 - part.state.t, t_eval=[1.0], state=part.state, **how)
    # The control instants are equal up to rounding; so is everything else.
    np.testing.assert_allclose(rest.q, whole.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rest.arm_angle, whole.arm_angle, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rest.motor_work, whole.motor_work, rtol=0, atol=1e-10)
