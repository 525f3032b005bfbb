"""The compiled drive against its motion, and against an independent computation of the arm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hyperflex as hf
from hyperflex.core.chain.drive import base_state, segment
from tests.core.helpers import EXAMPLES
from tests.reference.arm import bang_bang_swings

ROPE = hf.Rope(length=[0.3], mass=[0.1])
ARM = hf.Arm(length=0.2, pivot=(0.5, -0.3))
GRID = np.linspace(0.0, 2.0, 41)
MOTIONS = {
    "hold": hf.hold_arm(0.7),
    "bang-bang": hf.arm_swings(0.7, 0.4),
    "over": hf.arm_swings(0.7, 0.4, path="over"),
    "ramp": hf.arm_swings(0.5, 0.3, "ramp", ramp=0.2),
    "no-rest": hf.arm_swings(0.6, 0.0, "minimum-jerk"),
    "move": hf.move_arm(-1.0, 2.0, 0.8, "minimum-jerk"),
    "late": hf.move_arm(-1.0, 2.0, 0.8).shifted(0.35),
    "sampled": hf.sampled_motion(GRID, np.sin(2 * GRID) ** 2),
    "joined": hf.move_arm(0.0, 1.0, 0.8).then(hf.move_arm(1.0, -0.5, 0.5).shifted(1.1), at=0.9),
    "joined-to-swings": hf.hold_arm(-np.pi / 2).then(hf.arm_swings(0.7, 0.4).shifted(0.4), at=0.2),
}
each = pytest.mark.parametrize("name", MOTIONS)


def compiled(motion: hf.Motion, t: float) -> np.ndarray:
    """The base (9,) that the kernels see at time t, in the segment that begins at or before t."""
    drive = hf.Setup(ROPE, motion, ARM).drive()
    base = np.full(9, np.nan)
    base_state(drive, segment(drive, t), t, base)
    return base


@each
@given(t=st.floats(-1.0, 30.0))
@settings(max_examples=max(EXAMPLES // 4, 10))
def test_kernel_and_motion_agree_at_any_time(name, t):
    motion = MOTIONS[name]
    switches = motion.switches(-2.0, 31.0)
    if switches.size and np.abs(switches - t).min() < 1e-9:
        t += 1e-6  # at a switch the acceleration may be read on either side
    base = compiled(motion, t)
    # A time of 30 s is good to 4e-15 s; rates reach 10 rad/s and accelerations 50 rad/s^2.
    assert base[4] == pytest.approx(float(motion.angle(t)), abs=1e-12)
    assert base[3] == pytest.approx(float(motion.rate(t)), abs=1e-11)
    assert base[2] == pytest.approx(float(motion.acceleration(t)), abs=1e-10)


@each
def test_rates_and_accelerations_are_derivatives(name):
    """Derivatives of the angle and of the joint's position; central differences if nothing jumps within the step."""
    motion, h = MOTIONS[name], 1e-5
    times = np.linspace(0.013, 4.0, 97)
    switches = motion.switches(-1.0, 5.0)
    if switches.size:
        times = times[np.abs(times[:, None] - switches).min(axis=1) > 2 * h]
    for t in times:
        here, back, ahead = compiled(motion, t), compiled(motion, t - h), compiled(motion, t + h)
        # Truncation h^2 / 6 times a third derivative of some 1e3 rad/s^3; rounding 1e-15 / h: both below 1e-7.
        assert (ahead[4] - back[4]) / (2 * h) == pytest.approx(here[3], abs=1e-6)
        assert (ahead[3] - back[3]) / (2 * h) == pytest.approx(here[2], abs=1e-6)
        np.testing.assert_allclose((ahead[7:9] - back[7:9]) / (2 * h), here[5:7], rtol=0, atol=1e-6)
        np.testing.assert_allclose((ahead[5:7] - back[5:7]) / (2 * h), here[:2], rtol=0, atol=1e-5)


@pytest.mark.parametrize("over", [False, True], ids=["under", "over"])
def test_bang_bang_swings_are_those_of_the_reference(over):
    motion = hf.arm_swings(0.73, 0.53, path="over" if over else "under")
    stretches = list(bang_bang_swings(0.73, 0.53, 20.0, over=over))
    for stretch in stretches:
        for part in (0.001, 0.4, 0.999):
            t = stretch.start + part * (stretch.end - stretch.start)
            angle, rate, push = stretch.at(t)
            want = stretch.base(t, ARM.length)
            base = compiled(motion, t)
            # Switches of the tenth cycle are sums of forty times: 1e-14 s, times 25 rad/s^2.
            np.testing.assert_allclose(base[:7], want, rtol=0, atol=1e-11)
            assert (float(motion.angle(t)), float(motion.rate(t))) == pytest.approx((angle, rate), abs=1e-12)
            assert float(motion.acceleration(t)) == pytest.approx(push, abs=1e-12)
    # Each end of a stretch is a switch, and there are no others (but the last, which the span of 20 s cut).
    found = motion.switches(0.0, stretches[-1].start)
    np.testing.assert_allclose(found, [s.start for s in stretches], rtol=0, atol=1e-12)


@each
def test_segments_follow_each_other_without_gap_or_overlap(name):
    drive = hf.Setup(ROPE, MOTIONS[name], ARM).drive()
    t, ends = -1.0, []
    while t < 20.0 and len(ends) < 500:
        part = segment(drive, t)
        assert part.start <= t + 1e-11  # at a switch the later segment, give or take rounding
        assert part.end > t
        ends.append(part.end)
        t = part.end
    inside = [e for e in ends if np.isfinite(e) and e <= 20.0]
    want = MOTIONS[name].switches(-1.0, 20.0)
    assert len(ends) < 500
    # The kernel restarts at every switch; it may restart at a break that is none (the beginning of a cycle).
    for switch in want:
        assert np.abs(np.array(inside) - switch).min() < 1e-9


def test_a_moving_point_moves_the_joint():
    path = hf.moving_pivot(GRID, 0.1 * np.cos(GRID), 0.2 * GRID**2)
    drive = hf.Setup(ROPE, path).drive()
    base = np.zeros(9)
    for t in (0.1, 0.777, 1.9):
        base_state(drive, segment(drive, t), t, base)
        np.testing.assert_allclose(base[7:9], path.point(t), rtol=0, atol=1e-14)
    np.testing.assert_allclose(path.point(GRID), np.stack([0.1 * np.cos(GRID), 0.2 * GRID**2], axis=1), atol=1e-14)
