"""A cast as it was carried out: its log, what the plan's simulation predicts of it, and whether the rope is wound."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hyperflex import files
from hyperflex.checks import Array, Flags
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.exchange import write_mcap
from hyperflex.execution.learning import CastLog
from hyperflex.execution.stream import FIELDS, StreamLog
from hyperflex.files import NetCDF, PathLike, Variable
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan, FollowResult
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from hyperflex.status import Status
from hyperflex.trajectory import swept
from hyperflex.winding import measure_winding

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEFT = 0.05  # m from the plan at which the rope counts as having left it: the radius of a usual target
NEAR_PLAN = 0.25  # of the difference between a wound and a hanging rope's torque, within which a torque decides


def observed_turns(rope: Rope, arm: Arm, state: RopeState, arm_angle: float, peg: Peg) -> float:
    """Return the signed turns of a rope's links about a peg, from the arm's tip to its end.

    NaN if a link is longer than half the way round the peg: then turns between two joints do not show.
    """
    if rope.length.max() > math.pi * (peg.radius + rope.radius):
        return math.nan
    joints = rope.joints(state.q, arm.tip(arm_angle))
    return float(swept(joints - peg.point).sum() / math.tau)


@dataclass(frozen=True, eq=False)
class Prediction:
    """The simulated run of a plan: times (T,), s, joints (T, n + 1, 2), m, and the motor's torque (T,), N m.

    `touch` is the time at which the rope first touches the target, s; inf if it never does. `side` is 1 if it winds
    counterclockwise, else -1.
    """

    t: Array
    places: Array
    torque: Array
    touch: float
    side: int

    @classmethod
    def of(cls, plan: CastPlan) -> "Prediction | None":
        """Return that of the plan's motion, with its rope as given; None if it cannot be simulated."""
        problem, criteria, motion = plan.problem, plan.problem.criteria, plan.required(plan.motion, "motion")
        duration = float(motion.breaks[-1]) + criteria.settle + criteria.watch
        pegs = (plan.target, *problem.obstacles)
        try:
            run = simulate(problem.rope, motion, arm=problem.arm, duration=duration, pegs=pegs)
        except SimulationError:
            return None
        finer, whole = (np.append(0.0, each.link_ends) for each in (run.setup.rope, problem.rope))
        shared = np.searchsorted(finer + 1e-9, whole)  # links may be cut near pegs
        touched = np.isfinite(measure_winding(run, plan.target).before)
        touch = float(run.t[touched.argmax()]) if touched.any() else math.inf
        places = run.joints[:, shared]
        wound = float(swept(places[-1] - plan.target.point).sum())
        return cls(run.t, places, run.motor_torque, touch, 1 if wound > 0.0 else -1)

    @property
    def free_torque(self) -> tuple[Array, Array] | None:
        """Times, s, and torques, N m, of the free flight: blows of the contact are not sent to a motor."""
        free = self.t < self.touch
        return (self.t[free], self.torque[free]) if np.count_nonzero(free) > 1 else None

    def joints(self, t: Array) -> Array:
        """Return the joints (K, n + 1, 2) at times t (K,), s, interpolated."""
        from scipy.interpolate import make_interp_spline

        return np.asarray(make_interp_spline(self.t, self.places, 1)(np.clip(t, self.t[0], self.t[-1])))


@dataclass(frozen=True, eq=False)
class CastRun:
    """A cast as it was carried out.

    Attributes
    ----------
    plan : CastPlan
    motion : Motion
        What the drive was commanded in the end: the planned motion, or that of the closed loop.
    log : StreamLog
        What was sent to the drive and read from it, times since the begin of the motion.
    prediction : Prediction or None
        The simulated run of the plan; None if it cannot be simulated.
    recording : Recording or None
        Absolute link angles as the source of the rope's state gave them; None without a source.
    observed : ((T,) float64, (T, 2) float64), or None
        Times, s, and the turns of the rope about the target as it was seen then: the likeliest, and the most that may
        be; NaN where they do not show.
    follow : FollowResult or None
        The decisions, if the plan was followed in closed loop.
    stopped : str
        What stopped the run before its end; empty if it came to its end.
    interrupted : bool
        Whether the user stopped it.
    rope : Rope or None
        The rope as the source knew it when the cast began, with its length as it was seen; None: the plan's.
    late : int
        Corrections that came too late to be carried out.
    lag : float
        Known lag of the drive, s.
    contact : bool
        Whether the source of the rope's state is right while the rope touches the target.
    motor : str
        The drive, in words.
    """

    plan: CastPlan
    motion: Motion
    log: StreamLog
    prediction: "Prediction | None" = None
    recording: Recording | None = None
    observed: tuple[Array, Array] | None = None
    follow: FollowResult | None = None
    stopped: str = ""
    interrupted: bool = False
    late: int = 0
    rope: Rope | None = None
    lag: float = 0.0
    contact: bool = True
    motor: str = ""

    @property
    def message(self) -> str:
        """Why the rope did not wind, or why that is unknown; empty if it wound."""
        if self.interrupted:
            return f"interrupted: {self.stopped or 'the torque was switched off'}"
        if self.stopped:
            return self.stopped
        required = self.plan.problem.criteria.turns
        if self.wound is None and self._turns is not None:
            likely, most = self._turns
            return f"not known whether the rope is wound: it shows {likely:.2f} to {most:.2f} turns of {required:g}"
        if self.wound is None:
            return "nothing shows whether the rope is wound: neither a camera nor a torque that differs enough"
        if self.wound:
            return ""
        seen = "" if self.turns is None else f": {abs(self.turns):.2f} turns of {required:g}"
        return f"the rope is not wound{seen} ({self.judged_by})"

    @property
    def status(self) -> Status:
        """SUCCESS: the rope is wound."""
        if self.interrupted:
            return Status.INTERRUPTED
        return Status.FAILED if self.message else Status.SUCCESS

    @property
    def success(self) -> bool:
        """Whether the rope is wound."""
        return not self.message

    @property
    def wound(self) -> bool | None:
        """Whether the rope is wound at the end: by its observed state, else by the torque; None if neither decides."""
        return self._wound_by_torque if self._wound_by_state is None else self._wound_by_state

    @property
    def judged_by(self) -> str:
        """What shows whether it is wound: "state", "torque", or nothing."""
        if self._wound_by_state is not None:
            return "state"
        return "" if self._wound_by_torque is None else "torque"

    @property
    def turns(self) -> float | None:
        """Turns of the observed rope about the target, the least while it is watched; None where nothing shows them."""
        return None if self._turns is None else self._turns[0]

    @property
    def _wound_by_state(self) -> bool | None:
        if self._turns is None:
            return None
        enough, possible = (abs(each) >= self.plan.problem.criteria.turns for each in self._turns)
        return True if enough else None if possible else False

    @cached_property
    def _turns(self) -> tuple[float, float] | None:
        """Likeliest turns, and the most that may be: medians of the halves of the watch, of which the lesser counts."""
        if self.observed is None:
            return None
        t, turns = self.observed
        halves = [each[np.isfinite(each).all(axis=1)] for each in np.array_split(turns[self._watched(t)], 2)]
        if not all(len(each) for each in halves):
            return None
        medians = np.array([np.median(each, axis=0) for each in halves])
        likely, most = medians[np.abs(medians).argmin(axis=0), [0, 1]].tolist()
        return likely, most

    @cached_property
    def _wound_by_torque(self) -> bool | None:
        """Whether the mean torque at the end is that of the wound rope, or that of a rope which hangs from the arm.

        None unless they differ by more than three standard deviations of the torque, and by more than the torque which
        held arm and rope before the cast differed from their weight.
        """
        sent, all_torques = self.log.column("sent"), self.log.column("torque")
        torque, before = all_torques[self._watched(sent)], all_torques[(sent >= -0.5) & (sent < 0.0)]
        if self.prediction is None or not (np.isfinite(torque).any() and np.isfinite(before).any()):
            return None
        watched = self.prediction.t >= self.prediction.t[-1] - self.plan.problem.criteria.watch
        wound = float(self.prediction.torque[watched].mean())
        problem, ends = self.plan.problem, self.motion.angle(np.array([0.0, self._stop]))
        start, hanging = problem.arm.weight_torque(problem.rope, ends).tolist()
        error = abs(float(np.nanmean(before)) - start)
        if abs(wound - hanging) <= max(3.0 * float(np.nanstd(torque)), error):
            return None
        part = (float(np.nanmean(torque)) - hanging) / (wound - hanging)
        if abs(part - 1.0) <= NEAR_PLAN:
            return True
        return False if abs(part) <= NEAR_PLAN else None

    @cached_property
    def deviation(self) -> tuple[Array, Array] | None:
        """Times (T,), s, and the distance (T, n + 1) of each observed joint from the plan's, m.

        Until the predicted strike, if the source knows no contact: what it says then is not where the rope is.
        """
        if self.recording is None or self.prediction is None:
            return None
        t = self.recording.t
        known = slice(t.size if self.contact else int(np.searchsorted(t, self.prediction.touch + self.lag)))
        return t[known], np.linalg.norm(self._joints - self.prediction.joints(t - self.lag), axis=-1)[known]

    @property
    def left_plan(self) -> tuple[float, int] | None:
        """Time, s, and joint (0: at the arm) at which the rope was first 5 cm from the plan; None if it never was."""
        if self.deviation is None:
            return None
        t, away = self.deviation
        far = away > LEFT
        if not far.any():
            return None
        k = int(far.any(axis=1).argmax())
        return float(t[k]), int(far[k].argmax())

    @cached_property
    def _joints(self) -> Array:
        """Joints (T, n + 1, 2) of the observed rope, m, the tip last; the arm is where the drive says."""
        recording = self.recording
        assert recording is not None  # noqa: S101 callers have asked
        problem, t = self.plan.problem, recording.t
        return (self.rope or problem.rope).joints(recording.data, problem.arm.tip(self.log.angle(t)))

    def _watched(self, t: Array) -> Flags:
        """Whether times (K,), s, are those in which the rope is watched: (K,) bool."""
        criteria = self.plan.problem.criteria
        begin = self._stop + criteria.settle
        return (t >= begin) & (t <= begin + criteria.watch)

    @property
    def _stop(self) -> float:
        return float(self.motion.breaks[-1])

    def cast_log(self) -> CastLog:
        """Return what learning needs of the run; InvalidInput if the rope was not observed."""
        if self.recording is None:
            raise InvalidInput("the rope was not observed", fix="Give a source of its state, such as a camera")
        seen, rope = self.recording, self.rope or self.plan.problem.rope
        places = self._joints[:, 1:].reshape(seen.t.size, -1)
        noise = np.zeros((seen.t.size, rope.n_links)) if seen.noise is None else seen.noise
        spread = np.sqrt(np.cumsum((noise * rope.length) ** 2, axis=1))  # of each joint after the first, m
        markers = Recording(seen.t, places, "markers", np.repeat(np.maximum(spread, 1e-9), 2, axis=1), name=seen.name)
        return CastLog(markers, self.plan.problem.rope.link_ends, self.log.angle(seen.t), self.wound)

    def plot(self) -> "Figure":
        """Draw the drive and its goals, and how far the rope was from the plan: return a Matplotlib figure."""
        from hyperflex.report import cast_run_figure

        return cast_run_figure(self)

    def summary(self) -> dict[str, object]:
        """Return the run in figures, for JSON."""
        error, jitter = np.abs(self.log.tracking_error), self.log.jitter
        moving = self.log.column("sent") <= self._stop
        known = error[moving & np.isfinite(error)]
        return {
            "success": self.success,
            "status": self.status,
            "message": self.message,
            "wound": self.wound,
            "judged_by": self.judged_by,
            "turns": self.turns,
            "tracking_error_rms": float(np.sqrt((known**2).mean())) if known.size else None,
            "tracking_error_max": float(known.max()) if known.size else None,
            "left_plan": self.left_plan,
            "cycles": len(self.log.rows),
            "missed_cycles": self.log.missed,
            "late_corrections": self.late,
            "lost_replies": int((self.log.column("lost") > 0).sum()),
            "jitter_p99": float(np.quantile(jitter, 0.99)) if jitter.size else None,
            "decisions": [] if self.follow is None else [each.action for each in self.follow.decisions],
        }

    def to_netcdf(self, path: PathLike) -> None:
        """Write the drive's log, and the rope's angles if it was observed, to a NetCDF-4 file."""
        units = dict(zip(FIELDS, ("s",) * 3 + ("rad", "rad/s", "N m") * 2 + ("V", "degC", "1", "1"), strict=True))
        drive = {
            name: Variable(
                ("cycle",), self.log.column(name), {"units": units[name], "long_name": name.replace("_", " ")}
            )
            for name in FIELDS
        }
        if self.recording is not None:
            drive["time"] = Variable(("time",), self.recording.t, {"units": "s", "long_name": "of the link angles"})
            drive["link_angle"] = Variable(("time", "link"), self.recording.data, {"units": "rad"})
        notes = {"format": "hyperflex cast run 1", "rate": self.log.rate, "missed_cycles": self.log.missed}
        notes |= {"message": self.message, "interrupted": int(self.interrupted), "judged_by": self.judged_by}
        notes |= {"motor": self.motor, "date": datetime.now(UTC).isoformat(timespec="seconds")}
        notes |= {"plan": "; ".join(f"{name}: {text}" for name, text in self.plan.notes().items())}
        files.write_netcdf(path, NetCDF(drive, notes))

    def to_mcap(self, path: PathLike) -> None:
        """Write the drive's log, and the rope's angles if it was observed, to an MCAP file: :func:`write_mcap`."""
        drive = {"t" if name == "sent" else name: self.log.column(name) for name in FIELDS}
        write_mcap(self.recording, path, drive=drive)
