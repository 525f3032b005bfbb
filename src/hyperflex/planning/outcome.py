"""Outcomes of simulated runs: of a cast whether it winds and holds, why not, and the force that it withstands."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import winding
from hyperflex.budget import Budget
from hyperflex.checks import Array, Flags
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interruption import interruptible
from hyperflex.model import Peg, named
from hyperflex.motion import Motion
from hyperflex.planning.clearance import way_gaps
from hyperflex.planning.options import MEAN_TIME, WindCriteria
from hyperflex.planning.problem import Problem
from hyperflex.planning.verification import (
    USUAL,
    Accuracy,
    clearances,
    folded_flat,
    greatest_bend,
    motor_torques,
    refusal,
    verified_setup,
)
from hyperflex.simulation import SAMPLE_TIME, lean_warning, sideways, simulate
from hyperflex.status import Status
from hyperflex.trajectory import Trajectory
from hyperflex.winding import TugTest, Winding

BOUNCE_TIME = 0.3  # s off the peg that do not end a stay on it
TOO_LONG = "the verification took longer than the time allowed for it"


@dataclass(frozen=True, eq=False, kw_only=True)
class RunOutcome:
    """Figures of a whole simulated run; NaN if the simulation failed.

    Attributes
    ----------
    max_bend : float
        Greatest angle between neighbouring links, rad: of the rope's contact with itself only joint limits are
        simulated (:func:`hyperflex.planning.verification.limit_bend`). Above pi it folds through itself, and fails.
    folded : bool
        Whether a joint reached its limit: the rope was folded flat, and what it does then is left to chance.
    clearance : float
        Least distance between the rope and its own arm, the motor's shaft or an obstacle, m; below 0 the rope goes
        through, and fails. See :func:`hyperflex.planning.clearance.rope_clearance`.
    spare_clearance : float
        The least of these distances less those required, m: not below 0 if the run succeeds. An arm that the rope may
        go through does not count: inf without anything else.
    torque, torque_peak : float
        Greatest motor torque as a mean over 5 ms, which the motor's limit is for, and its greatest peak, as a mean over
        0.5 ms: when the rope strikes a peg, for example. N m.
    refused : str
        Why the run fails whatever its goal: the rope goes through itself, arm or shaft, or touches an obstacle, or
        comes nearer than allowed; empty if it does not.
    message : str
        Why the run fails; empty if it succeeds.
    n_links : int
        Links of the simulated rope; 0 if the simulation failed.
    run : Trajectory or None
        The run; None if the simulation failed, or if the outcome was read from a file.
    """

    max_bend: float = np.nan
    folded: bool = False
    clearance: float = np.nan
    spare_clearance: float = np.nan
    torque: float = np.nan
    torque_peak: float = np.nan
    refused: str = ""
    message: str = ""
    n_links: int = 0
    run: Trajectory | None = None

    @property
    def completed(self) -> bool:
        """Whether the simulation reached its end."""
        return self.n_links > 0


def run_figures(problem: Problem, run: Trajectory, until: float = np.inf) -> dict[str, Any]:
    """Return the fields of a :class:`RunOutcome` but its message; obstacles count `until` a time, s."""
    near, max_bend, (torque, torque_peak) = clearances(problem, run, until), greatest_bend(run), motor_torques(run)
    return {
        "max_bend": max_bend,
        "folded": folded_flat(run),
        "clearance": min(each.value for each, _, _ in near),
        "spare_clearance": min(each.value - least for each, least, _ in near),
        "torque": torque,
        "torque_peak": torque_peak,
        "refused": refusal(max_bend, near),
        "n_links": run.q.shape[1],
        "run": run,
    }


def excess_torque(problem: Problem, torque: float) -> str:
    """Return that a run needs more `torque`, N m, than the motor gives; empty if it does not."""
    given = problem.limits.torque
    return "" if torque <= given else f"it needs {torque:.3g} N m of a motor that gives {given:.3g}"


@dataclass(frozen=True, eq=False, kw_only=True)
class CastOutcome(RunOutcome):
    """Outcome of a cast in a simulated run.

    Attributes
    ----------
    wound : bool
        Whether the rope makes the required turns, or more, about the peg in all of the criteria's `watch`, from
        `settle` after the motion's end on.
    held : bool
        Whether it slips by less than `max_slip` in the watch, and withstands the required pull.
    turns : float
        Signed turns from the arm's tip to the rope's end at the end of the run, positive counterclockwise.
    slip : float
        Greatest slip of the rope on the peg in the watch, m; NaN or infinite if the rope is not on the peg.
    load_ratio : float
        Greatest pull of the arm's side in the watch over the greatest that the capstan equation allows; NaN if the rope
        is not on the peg. Below 1 there is a margin.
    strike_time : float
        Start of the longest stay on the peg, s, breaks of BOUNCE_TIME included; NaN if the rope never touches it.
    touch_time : float
        First touch of the peg, s: before `strike_time` if the rope grazes the peg and comes off.
    contact_angle : float
        Least angle of the peg that the rope covers in the watch, rad, >= 0: `turns` less what is straight or hangs.
    tip_hangs : bool
        Whether the rope's end is lower than the peg's centre all through the watch. One that lies on top of the peg may
        fall to either side.
    sideways, half_width : float
        Distances from the plane, m, at the last sample before the first touch of anything, for a rope that begins out
        of the plane by the criteria's `tilt`: of the first link to touch, and the greatest from there to the rope's
        end, which half of the peg's width must exceed: no bound, for the rope moves on to the side as it winds. NaN if
        the rope touches nothing, or it is not known.
    aside : float
        `half_width` over the tilt, m/rad.
    lean : float
        Greatest angle of a link out of the plane until then, rad.
    runs_behind : tuple of bool
        Whether the rope runs behind each of the set-up's pegs `behind`: all through the watch it touches the peg
        between the arm and its first touch of the target. Empty if the simulation failed.
    others
        As of :class:`RunOutcome`.
    """

    wound: bool = False
    held: bool = False
    turns: float = 0.0
    slip: float = np.nan
    load_ratio: float = np.nan
    strike_time: float = np.nan
    touch_time: float = np.nan
    contact_angle: float = np.nan
    tip_hangs: bool = True
    sideways: float = np.nan
    half_width: float = np.nan
    aside: float = np.nan
    lean: float = np.nan
    runs_behind: tuple[bool, ...] = ()

    @property
    def success(self) -> bool:
        """Wound and held."""
        return self.wound and self.held and not self.message

    @property
    def lean_warning(self) -> str:
        """That the rope leans too far out of the plane for what is said of it; empty if not."""
        return lean_warning(self.lean)

    def in_short(self) -> str:
        """Return the most important figures for whoever carries the cast out, with units."""
        covered = f"{np.degrees(self.contact_angle):.0f} degrees covered"
        return f"{abs(self.turns):.2f} turns, {covered}, strikes at {self.strike_time:.2f} s, {self.torque:.3g} N m"


@interruptible()
def verify_cast(
    problem: Problem,
    peg: Peg,
    motion: Motion,
    *,
    accuracy: Accuracy = USUAL,
    time_budget: float | Budget | None = None,
) -> CastOutcome:
    """Simulate a motion from rest with a peg, and evaluate the outcome.

    Links are refined near the peg, and joints limited (:mod:`hyperflex.planning.verification`).

    Parameters
    ----------
    motion : Motion
        With an end: the arm's stop, or that of the rest after it.
    accuracy : Accuracy
        Tolerance, step in contact, and length of the links near the peg: by default 1e-5 m, 0.2 ms, 0.3 radii.
    time_budget : float or Budget, optional
        Time of the run by the clock, s; a run that takes more has failed.
    """
    budget, criteria = Budget.of(time_budget), problem.criteria
    end = motion.end
    duration = end + criteria.settle + criteria.watch
    setup = verified_setup(problem, motion, duration, (peg,), accuracy)
    t: Array = np.arange(0.0, duration + 1e-9, SAMPLE_TIME)
    t[-1] = min(t[-1], duration)
    try:
        run = simulate(setup, t_eval=t, time_budget=budget)
    except SimulationError as error:
        late = error.status == Status.OUT_OF_TIME
        return CastOutcome(message=too_long(budget) if late else f"the simulation failed ({error.status})")
    return evaluate_cast(problem, peg, run, end)


def too_long(budget: Budget) -> str:
    """Return that a verification took too long, and whether other programs were the cause.

    They were if this process had less than half of a processor for more than a second.
    """
    if (share := budget.processor_share) > 0.5 or budget.elapsed < 1.0:
        return TOO_LONG
    return f"{TOO_LONG}: this machine is busy, it had {100.0 * share:.0f} % of a processor; give a longer time_budget"


def evaluate_cast(problem: Problem, peg: Peg, run: Trajectory, end: float) -> CastOutcome:
    """Evaluate a run whose motion ended at `end`, s."""
    wound, criteria = winding.measure_winding(run, peg), problem.criteria
    watched = run.t >= end + criteria.settle
    turns = wound.turns[watched]
    turns_kept = float((np.sign(turns[-1]) * turns).min())
    slips = winding.rope_slip(run, peg, since=end + criteria.settle)[watched]
    on = bool(np.isfinite(slips).all())
    slip = float(np.abs(slips).max())
    enough, held = turns_kept >= criteria.turns, on and slip < criteria.max_slip
    touched, covered = np.isfinite(wound.before), float(wound.contact[watched].min())
    figures = run_figures(problem, run)
    above = -(run.tip - peg.point) @ np.array(run.rope.gravity)
    apart = way_gaps(run.rope, peg, criteria.behind, run.q[watched], run.joints[watched])
    led = tuple(bool(each.all()) for each in (apart < winding.TOUCH).T)
    beside, aside, lean, doubt = _aside(run)
    half_width = criteria.tilt * aside
    if not touched.any():
        message = "the rope does not touch the peg"
    elif not enough:
        most, least = float(np.abs(wound.turns).max()), max(0.0, turns_kept)
        message = f"of {most:.2f} turns {least:.2f} remain while it is watched, {criteria.turns:g} required"
    elif not on:
        message = "the rope leaves the peg"
    elif not held:
        message = f"it slips by {1e3 * slip:.1f} mm, {1e3 * criteria.max_slip:g} allowed"
    elif figures["refused"]:
        message = figures["refused"]
    elif not all(led):
        message = f"the rope does not run behind {named(criteria.behind[led.index(False)])}"
    elif covered < criteria.contact:
        degrees = np.degrees([covered, criteria.contact])
        message = f"it covers {degrees[0]:.0f} degrees of the peg, {degrees[1]:.0f} required"
    elif criteria.max_sideways < math.inf and not math.isfinite(half_width):
        message = f"how far to the side it is at its first touch is not known: {doubt}"
    elif half_width > criteria.max_sideways:
        tilted = f"for a start {np.degrees(criteria.tilt):.3g} degrees out of the plane"
        message = f"at its first touch it is up to {1e3 * half_width:.0f} mm to the side {tilted}, "
        message += f"{1e3 * criteria.max_sideways:g} allowed"
    else:
        message = excess_torque(problem, figures["torque"])
    if not (enough and held) and figures["refused"]:
        message += f"; {figures['refused']}"
    return CastOutcome(
        wound=enough,
        held=held,
        turns=float(turns[-1]),
        slip=slip,
        load_ratio=_load_ratio(wound, watched, peg) if on else np.nan,
        strike_time=_longest_stay(run.t, touched),
        touch_time=float(run.t[touched.argmax()]) if touched.any() else np.nan,
        contact_angle=covered,
        message=message,
        tip_hangs=bool((above[watched] < 0.0).all()),
        sideways=criteria.tilt * beside,
        half_width=half_width,
        aside=aside,
        lean=criteria.tilt * lean,
        runs_behind=led,
        **figures,
    )


def _aside(run: Trajectory) -> tuple[float, float, float, str]:
    """Return `sideways`, `half_width` and `lean` of a :class:`CastOutcome` over the tilt, and why they are unknown."""
    touching = np.zeros(1) if run.contact_force is None else run.contact_force.any(axis=2)
    doubt = "it touches nothing"
    if touching.any():
        try:
            found = sideways(run, tilt=1.0)
            beyond = np.abs(found.joints[-1, int(touching.argmax()) % run.q.shape[1] :])
            return float(beyond[:2].mean()), float(beyond.max()), float(np.abs(found.angles).max()), ""
        except (InvalidInput, SimulationError) as error:
            doubt = str(error)
    return math.nan, math.nan, math.nan, doubt


def _longest_stay(t: Array, touched: Flags) -> float:
    """Start of the longest stay on the peg, s; NaN if there is none. Breaks of BOUNCE_TIME do not end it."""
    there = t[touched]
    stays = np.split(there, np.flatnonzero(np.diff(there) > BOUNCE_TIME) + 1)
    return float(max(stays, key=np.ptp)[0]) if there.size else math.nan


def _load_ratio(wound: Winding, watched: Flags, peg: Peg) -> float:
    """Return the greatest ratio of the pull to what the capstan equation allows, both averaged over MEAN_TIME."""
    mean = np.full(round(MEAN_TIME / SAMPLE_TIME), SAMPLE_TIME / MEAN_TIME)
    before, after = (np.convolve(force[watched], mean, mode="valid") for force in (wound.before, wound.after))
    arc = np.abs(wound.arc[watched]).min()
    return float((before / np.maximum(after * np.exp(peg.mu * arc), 1e-12)).max())


@dataclass(frozen=True, eq=False)
class HoldingForce:
    """Force that a wound rope withstands, by a simulated tug from the end of a run and by the capstan equation.

    `tail_weight` is that of the rope that hangs beyond the peg, N, `contact_angle` >= 0 the angle about the peg from
    the first to the last link in contact, rad, `mu` the friction coefficient between rope and peg.
    """

    tug: TugTest
    tail_weight: float
    contact_angle: float
    mu: float

    @property
    def force(self) -> float:
        """Pull before the rope slipped, N; a lower bound if it did not slip."""
        return self.tug.hold

    @property
    def capstan_force(self) -> float:
        """The capstan equation for a rope without weight on the peg: the tail's weight times e^(mu angle), N."""
        return float(self.tail_weight * np.exp(self.mu * self.contact_angle))


@interruptible()
def measure_holding_force(
    run: Trajectory,
    peg: Peg,
    *,
    max_slip: float = WindCriteria.max_slip,
    time_budget: float | Budget | None = None,
) -> HoldingForce | None:
    """Tug at the rope from the end of a run with a peg; None if it is not on the peg or the tug cannot be simulated.

    The rope holds while it slips by less than `max_slip`, m. `time_budget`, s, is as of :func:`hyperflex.simulate`;
    SimulationError if it ends before.
    """
    wound = winding.measure_winding(run, peg)
    if not np.isfinite(wound.tail[-1]):
        return None
    try:
        tug = winding.tug_test(run, peg, allowed=max_slip, time_budget=time_budget)
    except InvalidInput:
        return None
    except SimulationError as error:
        if error.status == Status.OUT_OF_TIME:
            raise
        return None
    return HoldingForce(tug, float(wound.tail[-1]), abs(float(wound.arc[-1])), peg.mu)


def require_holding_force(outcome: CastOutcome, peg: Peg, criteria: WindCriteria, budget: Budget) -> CastOutcome:
    """Return the outcome, as a failure if a simulated tug shows that the rope withstands less than is required.

    A holding force of 0 requires no tug.
    """
    force = criteria.holding_force
    if force <= 0.0 or not outcome.success or outcome.run is None:
        return outcome
    try:
        measured = measure_holding_force(outcome.run, peg, max_slip=criteria.max_slip, time_budget=budget)
    except SimulationError:
        return replace(outcome, held=False, message=too_long(budget), n_links=0)
    if measured is None:
        return replace(outcome, held=False, message="its holding force could not be simulated")
    if measured.tug.holds(force):
        return outcome
    pull = f"{measured.force:.3g} N"
    found = f"its holding force is {pull}" if measured.tug.slipped else f"it was pulled with {pull} at most"
    return replace(outcome, held=False, message=f"{found}, {force:.3g} N required")
