"""``hyperflex run``: a planned cast carried out on a drive."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from hyperflex import checks, estimate, execution, hardware, model, planning, report, vision
from hyperflex.cli import output
from hyperflex.cli.command import ArcLengths, Click, Given, OutFolder, arcs_of
from hyperflex.cli.motor import Address, Yes, ZeroFile, check_real, read_zero, wait_for_enter, warn_if_behind
from hyperflex.cli.output import Rows
from hyperflex.errors import DriveError, Interrupted, InvalidInput, MissingPackage
from hyperflex.execution import RunOptions

EMULATED = "EMULATED: motor and rope are simulated in real time behind the drive's protocol"


@dataclass(frozen=True, kw_only=True)
class Sight:
    """Options on the camera that sees the rope."""

    camera: Annotated[
        str | None,
        "Number of a camera (0 is the first) or a stream (rtsp://...) that sees the rope. With an emulated "
        "motor: emulated, for rendered pictures.",
    ] = None
    calibration: Annotated[Path | None, "TOML file of the calibrated camera, with the swing plane (calibrate)."] = None
    arc_lengths: ArcLengths = None
    click: Click = None

    @property
    def view(self) -> "vision.Camera | None":
        """The calibrated camera; None if it is not given."""
        return None if self.calibration is None else vision.read_camera(self.calibration)

    def check(self, rope: "model.Rope", emulated: bool) -> None:
        """Refuse, before any work, a camera that cannot see this rope, files and markers, and missing options."""
        self.view  # noqa: B018 - refuses a calibration that cannot be read
        arcs, length = arcs_of(self.arc_lengths), rope.total_length
        if arcs is not None and (arcs.min() < 0.0 or arcs.max() > 1.1 * length):  # it may be longer than it is planned
            raise InvalidInput("--arc-lengths are not all on the rope", got=arcs.tolist(), allowed=f"0 to {length:g} m")
        if self.camera is None:
            for name, given in (("--calibration", self.calibration), ("--click", self.click)):
                if given:
                    raise InvalidInput(f"{name} is of a camera, which is not given", fix="Give --camera")
            return
        if emulated != (self.camera == "emulated"):
            whose, fix = ("an emulated", "emulated") if emulated else ("a real", "the number of a camera")
            raise InvalidInput(f"--camera does not see the rope of {whose} motor", got=self.camera, allowed=fix)
        missing = {"--calibration": self.calibration, "--arc-lengths": self.arc_lengths}
        if not emulated and not all(missing.values()):
            no = "no " + ", ".join(name for name, value in missing.items() if not value)
            raise InvalidInput("--camera needs more options", got=no, fix="Give them, as for hyperflex watch")

    def check_needed(self, needed: dict[str, bool]) -> None:
        """Refuse options of a real motor that need a camera, by their names and whether they are given."""
        for name, given in needed.items():
            if given and self.camera is None:
                what = f"nothing shows the rope of a real motor, which {name} must know"
                raise InvalidInput(what, fix="Give --camera, --calibration and --arc-lengths")

    def task(self, plan: "planning.CastPlan") -> "estimate.TrackingTask":
        """Return what a real camera tracks: the plan's rope; the markers' colour is taken from its first frames."""
        from hyperflex.cli.track import marker_colours, newest_images

        view = checks.instance("--calibration", self.view, vision.Camera)
        with estimate.open_frames(self.camera or "") as frames:
            colours = marker_colours(newest_images(frames, 10.0), self.click or ())
        arcs = checks.instance("--arc-lengths", arcs_of(self.arc_lengths), np.ndarray)
        return estimate.TrackingTask(
            plan.problem.rope, arcs, view, colours, plan.problem.arm, execution.measured_length(), waits=True
        )


def run(
    plan: Annotated[Path, typer.Argument(help="Plan of a cast (cast.toml), as hyperflex cast wrote it.")],
    options: Annotated[Given, RunOptions],
    out: OutFolder,
    *,
    motor: Address,
    zero: ZeroFile = None,
    drive: Annotated[
        Path | None, "File of hyperflex motor identify: its limits count, and its lag without --lag."
    ] = None,
    torque: Annotated[float | None, "Limit of torque, which a real motor needs", "N m"] = None,
    max_deviation: Annotated[float, "Angle between arm and goal that stops a run", "rad"] = 0.3,
    follow: Annotated[bool, "Correct the moves while the rope swings."] = False,
    correction: Annotated[Given, planning.FollowOptions, "decision_time"],
    repeat: Annotated[
        int | None,
        typer.Option(help="Casts at most. [default: 10 with --learn, else 1]", min=1, max=100),
    ] = None,
    learn: Annotated[bool, "Learn from each cast; stop when the rope winds three times running."] = False,
    sight: Sight,
    page: Annotated[
        int | None, typer.Option(help="Show the run in a browser at this port; 0 for any.", min=0, max=65535)
    ] = None,
    yes: Yes = False,
    dry_run: Annotated[bool, "Check the plan; connect nothing."] = False,
) -> None:
    """Carry out a planned cast on a drive, and report whether the rope is wound.

    The arm moves slowly to its start, the rope must hang still, and after a countdown a separate process streams the
    motion to the drive. At the end, and on Ctrl-C, an error or a lost link, the torque is switched off: the arm falls.
    Read the how-to page "Run a plan on a drive" before you connect a motor. All of this was tested on emulated drives
    only.

    A real motor needs --zero and --torque. Before each cast the command waits for Enter: the arm will move. With --yes
    a run ends at a warning that zero, rope or arm may be wrong; without it you decide.

    A camera (--camera, --calibration, --arc-lengths) shows whether the rope hangs still and whether it is wound, and
    measures the state for --follow and --learn. If the camera no longer sees the rope, the run stops.

    With emulator:MAKE a process emulates drive, motor and rope in real time. Without --camera emulated, the rope's true
    state is observed. The command writes the log (NetCDF and MCAP) and a figure. The exit code is 4 if the rope is not
    wound, or nothing shows that it is.
    """
    report.check_folder(out)
    planned = _cast_of(plan)
    emulated = motor.startswith("emulator:")
    limits, chosen = _of_drive(planned, drive, torque, options)
    if follow and learn:
        raise InvalidInput("a learned motion is not followed in closed loop", fix="Give --follow or --learn")
    count = _count(repeat, learn)
    sight.check(planned.problem.rope, emulated)
    known = read_zero(motor, zero)
    if not (emulated or dry_run):
        check_real(motor, known, limits)
        sight.check_needed({"--learn": learn, "--follow": follow, "--yes and --repeat": yes and count > 1})
    link = hardware.open_link("moteus:none" if emulated else motor)
    hardware.Drive(link, limits).check_motion(planned.required(planned.motion, "motion"))
    planned = _within(planned, limits) if follow or learn else planned
    if dry_run:
        _show_motion(planned)
        return
    if emulated:
        output.note(EMULATED)
    closed = planning.FollowOptions(**correction) if follow else None
    name = f"{motor} (simulated motor and rope)" if emulated else motor
    with nullcontext() if page is None else execution.RunPage(planned, page, name) as shown:
        if shown is not None:
            output.note(f"the run is shown at {shown.address}")

        def say(phase: str) -> None:
            output.note(phase)
            if shown is not None:
                shown.say(phase)

        given: dict[str, Any] = {"follow": closed, "options": chosen, "say": say, "page": shown, "motor": name}
        task = None if emulated or sight.camera is None else sight.task(planned)

        def real(cast: "planning.CastPlan") -> "execution.CastRun":
            connect = partial(execution.open_drive, motor, limits, known, max_deviation)
            with nullcontext() if task is None else execution.CameraRope(sight.camera or "", task) as source:
                return execution.run_plan(
                    cast, connect, source=source, ready=ready, doubt=_refuse if yes else say, **given
                )

        def ready() -> None:
            wait_for_enter("Unwind the rope and keep clear", yes)

        def emulate(cast: "planning.CastPlan") -> "execution.CastRun":
            with _emulated(planned, motor, sight) as (address, source):  # a new one for each cast: nobody unwinds it
                connect = partial(execution.open_drive, address, limits, None, max_deviation)
                return execution.run_plan(cast, connect, source=source, **given)

        _carry_out(planned, emulate if emulated else real, out, repeat=count, learn=learn, emulated=emulated, say=say)
        if shown is not None:
            shown.end(f"{shown.phase}; the casts are over")


def _show_motion(plan: "planning.CastPlan") -> None:
    """Print the result of a dry run."""
    motion = plan.required(plan.motion, "motion")
    figures = {"peak_speed": float(abs(motion.extrema(1)[1]).max()), "torque": plan.torque}
    figures["duration"] = motion.end
    told = "The motion keeps to the limits. Nothing was connected."
    output.show({"success": True, "dry_run": True, **figures}, output.rows("Motion, SI units", figures), told)


@contextmanager
def _emulated(plan: "planning.CastPlan", motor: str, sight: Sight) -> "Iterator[tuple[str, execution.ClockedSource]]":
    """Yield the address of an emulated motor, and its rope: its true state, or what an emulated camera sees of it."""
    make, emulator = execution.emulator_of(plan, motor)
    rope = plan.setup().rope
    with ExitStack() as stack:
        stack.enter_context(emulator)
        stack.callback(warn_if_behind, emulator)
        address = f"{make}:{emulator.port}"
        if sight.camera is None:
            yield address, execution.EmulatedRope(emulator, plan.problem.rope, rope, plan.problem.arm)
            return
        camera = execution.EmulatedCamera(
            plan, emulator, rope, camera=sight.view, arc_lengths=arcs_of(sight.arc_lengths)
        )
        stack.enter_context(camera)
        yield address, stack.enter_context(execution.CameraRope(camera.frames, camera.task))


def _cast_of(path: Path) -> "planning.CastPlan":
    """Return the plan of a cast."""
    planned = planning.read_plan(path)
    if not isinstance(planned, planning.CastPlan):
        raise InvalidInput(f"{path} is no plan of a cast", got=planned.kind, allowed="a cast")
    if not planned.success:
        output.note(f"{path} does not succeed in simulation: {planned.message}")
    return planned


def _of_drive(
    plan: "planning.CastPlan", drive: Path | None, torque: float | None, options: Given
) -> "tuple[model.MotorLimits, RunOptions]":
    """Return the limits of an identified drive, or else the plan's, and the options, with its lag."""
    limits = plan.problem.limits
    if drive is not None:
        fit = hardware.DriveFit.from_toml(drive)
        if fit.message:
            raise InvalidInput(f"{drive} does not describe its drive", got=fit.message, fix="Identify it again")
        fastest = float(abs(plan.required(plan.motion, "motion").extrema(1)[1]).max())
        if "rate_limit" not in fit.values and fastest > fit.reached[0]:
            text = f"{drive} shows nothing above {fit.reached[0]:.3g} rad/s, and the plan reaches {fastest:.3g} rad/s"
            warnings.warn(f"{text}. Identify with a greater --speed and --stroke", UserWarning, stacklevel=2)
        limits, options = fit.motor_limits(limits), {"lag": fit.lag} | options
    limits = limits if torque is None else replace(limits, torque=torque)
    if plan.torque > limits.torque:
        raise InvalidInput(
            "the plan's torque is beyond the limit",
            got=round(plan.torque, 4),
            allowed=f"up to {limits.torque:.3g} N m",
            fix="Allow more, or plan again with --torque",
        )
    return limits, RunOptions(**options)


def _within(plan: "planning.CastPlan", limits: "model.MotorLimits") -> "planning.CastPlan":
    """Return the plan with limits that new moves keep to; refuse limits with which the planned ones are others."""
    changed = replace(plan, problem=replace(plan.problem, limits=limits))
    if changed.motion != plan.motion:
        raise InvalidInput("the plan's moves are others on this drive", fix="Plan again with --drive")
    return changed


def _count(repeat: int | None, learn: bool) -> int:
    """Return the number of casts at most; refuse one with which learning cannot succeed."""
    count, wins = repeat or (10 if learn else 1), execution.LearningOptions().wins
    if learn and count < wins:
        raise InvalidInput("learning ends when casts wind in a row", got=count, allowed=f"--repeat {wins} or more")
    return count


def _refuse(doubt: str) -> None:
    raise InvalidInput(doubt, fix="Correct it, or decide yourself, without --yes")


def _carry_out(
    plan: "planning.CastPlan",
    once: Any,
    out: Path,
    *,
    repeat: int,
    learn: bool,
    emulated: bool,
    say: Callable[[str], None],
) -> None:
    """Carry out one or more casts, write and report them."""
    runs: list[execution.CastRun] = []
    lines: list[str] = []

    def cast(made: "planning.CastPlan") -> Any:
        done, halted = output.run(lambda: once(made))
        if not halted or len(done.log.rows) > 1:  # else the torque was not on yet
            runs.append(done)
            written.update(_write(done, out, f"run-{len(runs)}" if repeat > 1 else "run"))
        if halted:
            raise Interrupted(done)
        say(f"cast {len(runs)}: {done.message or 'the rope is wound'}")
        if learn and runs[-1].stopped:
            raise DriveError(runs[-1].stopped)
        return runs[-1].cast_log() if learn else None

    def keep(attempt: Any) -> None:
        lines.append(str(attempt))
        output.note(lines[-1])

    written: dict[str, Path] = {}
    learned, hint = None, list[str]()
    if learn:
        learned, stopped = output.run(lambda: execution.learn_cast(plan, cast, attempts=repeat, report=keep))
        good, message = learned.success, learned.message
        if learned.attempts:
            out.mkdir(parents=True, exist_ok=True)
            written["learned plan"] = out / "learned.toml"
            known: Given = {"problem": learned.problem, "moves": learned.moves, "message": learned.message}
            known |= dict.fromkeys(("outcome", "finer_outcome", "success_probability"))  # no run verifies it
            replace(plan, **known).to_toml(written["learned plan"])
            hint = [f"The learned plan is run with --lag {learned.lag:.4g}"]
    else:

        def several() -> None:
            while len(runs) < repeat and not (runs and runs[-1].stopped):
                cast(plan)

        stopped = output.run(several)[1]
        good, message = (
            bool(runs) and all(each.success for each in runs),
            runs[-1].message if runs else "nothing was cast",
        )
    result = {"emulated": emulated, "casts": [each.summary() for each in runs], "learned": lines, "message": message}
    result |= {} if learned is None else {"lag": learned.lag}
    title = "Last cast (emulated)" if emulated else "Last cast"
    told = message or "The rope is wound."
    ended = "; nothing moved" if not runs else f": {told.removeprefix('interrupted: ')}"
    output.show(
        {**result, "success": good, "files": written},
        *([Rows(title, _figures(runs[-1]))] if runs else []),
        *([] if stopped else [told]),
        *lines,
        *hint,
        *([Rows("Written", list(written.items()))] if written else []),
        interrupted=f"Interrupted{ended}" if stopped else "",
        code=0 if good else output.ExitCode.NO_PLAN,
    )


def _figures(run: "execution.CastRun") -> list[tuple[str, str]]:
    """Return the figures of a run for people."""
    found = run.summary()
    left, seen = run.left_plan, "" if run.recording is None else "never by 5 cm"
    if left is not None:
        seen = f"by 5 cm first at {left[0]:.2f} s, joint {left[1]} of {run.plan.problem.rope.n_links}"
    rows = [
        ("wound", {True: "yes", False: "no", None: "nothing shows it"}[run.wound]),
        ("shown by", run.judged_by),
        ("turns", "" if run.turns is None else f"{abs(run.turns):.2f}"),
        (
            "arm off its goal",
            _milli("rms", found["tracking_error_rms"]) + _milli(", at most", found["tracking_error_max"]),
        ),
        ("rope off the plan", seen),
        ("replies lost", f"{found['lost_replies']} of {found['cycles']}"),
        ("cycles missed", str(found["missed_cycles"])),
        ("decisions", ", ".join(each.action for each in run.follow.decisions) if run.follow else ""),
    ]
    return [(name, value) for name, value in rows if value]


def _milli(name: str, value: Any) -> str:
    return "" if value is None else f"{name} {1e3 * value:.1f} mrad"


def _write(run: "execution.CastRun", out: Path, name: str) -> dict[str, Path]:
    """Write the files of a run; return their paths."""
    out.mkdir(parents=True, exist_ok=True)
    paths = {f"{name} log": out / f"{name}.nc", f"{name} figure": out / f"{name}.png"}
    run.to_netcdf(paths[f"{name} log"])
    report.save_png(report.cast_run_figure(run), paths[f"{name} figure"])
    try:
        run.to_mcap(out / f"{name}.mcap")
        paths[f"{name} messages"] = out / f"{name}.mcap"
    except MissingPackage as error:
        output.note(str(error))
    return paths
