"""The set-up of a verified run: links refined near pegs, joints bent no further than the rope's thickness lets them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL, FINE, Peg, Rope, Setup, Wall, cuts
from hyperflex.motion import Motion
from hyperflex.planning.clearance import Clearance, obstacle_clearance, rope_clearance
from hyperflex.planning.problem import Problem
from hyperflex.trajectory import Trajectory

FOLD = 1e-3  # rad past half a turn, above which a rope has folded through itself: a limit may be passed by less


class Accuracy(NamedTuple):
    """How finely a run is simulated.

    Attributes
    ----------
    tol, contact_step : float
        As for :func:`hyperflex.simulate`, m and s.
    ratio : float
        As for :func:`hyperflex.refine_rope`: longest link near a peg, in radii of the rope's axis on it.
    """

    tol: float = DEFAULT_TOL
    contact_step: float = DEFAULT_CONTACT_STEP
    ratio: float = FINE


USUAL = Accuracy()
# Of the runs that verify a cast. 29 casts of 13 random ropes ended as with USUAL, in 0.74 of the time. With a greater
# tolerance joints do not stick exactly (simulation.contact.COARSE_TOL), and peaks of the torque need steps below
# 0.5 ms. Casts that were planned with links of 0.5 radii took less time, but three of 25 came off the peg in MuJoCo,
# where casts of the same three targets with links of 0.3 radii held
CAST_ACCURACY = Accuracy(tol=1e-4, contact_step=4e-4)


def limit_bend(rope: Rope) -> Rope:
    """Return the rope with joint limits where it has none, the first joint, a hinge, excepted.

    Its axis bends to a circle of the rope's own radius and no tighter (:meth:`Rope.with_bend_radius`): there the rope
    touches itself. Joints between links of length l bend by 2 atan(l / (2 radius)) at most, and by half a turn where
    the radius is 0. Limits that the rope has stay as they are. A rope with friction as the paper prints it, which knows
    no joint limits, is returned as it is.
    """
    if rope.friction_model != "relative":
        return rope
    most = 2.0 * np.arctan2(rope.length[:-1] + rope.length[1:], 4.0 * rope.radius)
    left = most - np.abs(rope.rest_angle[1:])
    given = np.append(rope.max_bend[0], np.where(left > 0.0, left, np.inf))
    return rope.replace(max_bend=np.where(np.isfinite(rope.max_bend), rope.max_bend, given))


def verified_setup(
    problem: Problem,
    motion: Motion,
    duration: float,
    pegs: tuple[Peg | Wall, ...] = (),
    accuracy: Accuracy = USUAL,
) -> Setup:
    """Return what is simulated to verify a motion of `duration`, s, from rest, with an `accuracy`.

    Links are refined near `pegs`, and near those that the rope is to run behind. The set-up's obstacles, which are not
    to be touched, are there as well.
    """
    checks.instance("accuracy", accuracy, Accuracy)
    pegs = (*pegs, *problem.criteria.behind)
    arm, beside = problem.arm, (*pegs, *problem.obstacles)
    fine = problem.cut(cuts(problem.rope, pegs, arm=arm, ratio=accuracy.ratio))
    given: dict[str, Any] = {"q0": fine.q0, "qd0": fine.qd0} if fine.q0 else {}
    rope = limit_bend(fine.rope)
    tol, contact_step, _ = accuracy
    return Setup(rope, motion, arm, duration=duration, tol=tol, pegs=beside, contact_step=contact_step, **given)


def greatest_bend(run: Trajectory) -> float:
    """Return the greatest angle between neighbouring links of a run, rad."""
    return float(np.abs(np.diff(run.q, axis=1)).max(initial=0.0))


def at_limits(rope: Rope, q: Array, within: float = 0.0) -> Flags:
    """Return at which angles q (..., n), rad, a joint but the first is past its limit, or `within` so little of it."""
    bend: Array = np.abs(np.diff(q, axis=-1) - rope.rest_angle[1:])
    return np.asarray((bend > rope.max_bend[1:] - within).any(axis=-1))


def folded_flat(run: Trajectory) -> bool:
    """Return whether a joint of a run with joint limits reached one."""
    return bool(run.attrs.get("limit_passed", 0.0) > 0.0 or at_limits(run.rope, run.q, FOLD).any())


def motor_torques(run: Trajectory) -> tuple[float, float]:
    """Return the greatest motor torque of a run as a mean over 5 ms, and its greatest peak, a mean over 0.5 ms; N m.

    Samples tell what is smooth, where nothing is touched. Means over steps in contact tell the rest
    (``core.chain.torque_peaks``): a sample there is a mean over part of a step, which may begin with a blow.

    Their windows slide by a tenth of their length. The arm's own torque is added to the rope's where that is greatest,
    which need not be where their sum is.
    """
    arm, motion, touched = run.setup.arm, run.setup.motion, run.contact_force
    sampled, own = np.abs(run.motor_torque), np.zeros(run.t.size)
    if arm is not None and motion is not None:
        own = arm.shaft_torque(run.rope.gravity, run.arm_angle, run.arm_rate, motion.acceleration(run.t))
    mean, peak = (
        abs(run.attrs.get(name, 0.0) + own[np.abs(run.t - run.attrs.get(f"{name}_time", 0.0)).argmin()])
        for name in ("torque_mean", "torque_peak")
    )
    free = sampled if touched is None else sampled[~touched.any(axis=(1, 2))]
    mean = max(float(mean), float(free.max(initial=0.0)))
    return mean, max(float(peak), mean)


def clearances(problem: Problem, run: Trajectory, until: float = np.inf) -> list[tuple[Clearance, float, str]]:
    """Return how near the rope of a run comes to its own arm, and to obstacles, if any, `until` a time, s.

    Each with the distance, m, that is required (-inf: the rope may go through its arm), and what it does at 0.
    """
    found = [(rope_clearance(run), problem.clearance, "goes through")]
    if some := problem.obstacles:
        found.append((obstacle_clearance(run, some, until), max(problem.clearance, 0.0), "touches"))
    return found


def refusal(max_bend: float, near: Sequence[tuple[Clearance, float, str]]) -> str:
    """Return why a run fails whatever its goal; empty if it does not.

    The rope goes through itself, or too near its own arm or an obstacle, by the distances `near` of :func:`clearances`.
    """
    if max_bend > np.pi + FOLD:
        return f"the rope folds through itself, by {np.degrees(max_bend):.0f} degrees at a joint"
    for each, least, verb in near:
        where = f"{each.what} at {each.t:.2f} s"
        if each.value <= min(least, 0.0):
            return f"the rope {verb} {where}"
        if each.value <= least:
            return f"the rope comes within {1e3 * each.value:.1f} mm of {where}, {1e3 * least:g} mm required"
    return ""
