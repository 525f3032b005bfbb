"""The demo: a video, an identified rope, and a plan that winds it round a target; with a folder that shows it all."""

import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.demo import twin
from hyperflex.errors import DriveError, MissingPackage
from hyperflex.execution import CastRun, EmulatedRope, RunOptions, emulator_of, open_drive, run_plan
from hyperflex.identification import Identification
from hyperflex.interruption import interruptible
from hyperflex.model import PROPERTIES, Peg
from hyperflex.paper import casting_arm
from hyperflex.planning import CastOutcome, CastPlan, HoldingForce, Problem, plan_cast, verify_cast
from hyperflex.recording import Recording
from hyperflex.report import (
    CastReport,
    Film,
    FittedChannels,
    Picture,
    Progress,
    Section,
    TextTable,
    cast_run_figure,
    check_folder,
    fit_figure,
    png,
    sections_markdown,
    silent,
    whole_folder,
    write_page,
    write_pictures,
)
from hyperflex.vision import VideoReader

TARGET = Peg(x=0.62, y=-1.14, radius=0.05, mu=0.3)  # well within reach
_LEAD = (
    "From a video to an identified rope, and to a cast that winds it round a target. The video was made by simulating "
    f"a rope of {twin.FINE} links and filming it with a synthetic camera. Its markers are tracked, and a chain of "
    f"{twin.COARSE} links is identified from them, with uncertainties. Nothing here was measured on a real rope."
)
_HELD_OUT = (
    "Shaded: held-out part. There the state is fitted on half a second, and the next second is predicted without data."
)
_MODEL = (
    f"The cast is planned for the rope as it was identified, {twin.COARSE} links (cut shorter near the target). The "
    "plan is simulated with the same model, and again with shorter links."
)
_TRACKED = (
    "Ten markers in {frames} frames of an H.264 video, with clutter of their colour on the wall and drifting light; "
    "{seen:.1f} % of them were seen, the others were covered. The first guess of the rope, with three times its "
    "friction, is enough to track it. swing.mp4, camera.toml and guess.toml are the inputs, as for hyperflex track."
)
_MAPPED = (
    f"Without noise: what the same fit finds in the same swing without a camera, the best that {twin.COARSE} links can "
    f"do for a rope of {twin.FINE}. To move like it, coarse links need other inertia and friction than the rope simply "
    "cut into as many pieces (plain cut); this bias is not an error of the camera."
)
_CARRIED_OUT = (
    "The planned motion, streamed to an emulated moteus drive: a process that simulates motor, arm and the rope that "
    "made the recording in real time, behind the drive's own protocol. No real drive was used."
)
_SEEN = "Parts of two tracked frames: crosses are detected markers, circles their expected positions, blue is the rope."
_FILES = {
    "tracked": "tracked.mp4",
    "video": "swing.mp4",
    "camera": "camera.toml",
    "guess": "guess.toml",
    "rope": "rope.toml",
    "markers": "markers.nc",
    "identification": "identification.json",
    "summary": "summary.md",
    "page": "report.html",
}


@dataclass(frozen=True)
class Parameter:
    """One identified number and its reference values, in SI units."""

    name: str
    unit: str
    guess: float
    value: float
    std: float  # of the value
    mapped: float  # what the same fit finds without noise: the truth as far as the coarse chain can represent it
    cut: float  # of the rope simply cut into as many links

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval."""
        return self.value - 1.96 * self.std, self.value + 1.96 * self.std

    @property
    def covered(self) -> bool:
        """Whether the interval contains the value that the fit finds without noise."""
        low, high = self.interval
        return low <= self.mapped <= high


@dataclass(frozen=True, eq=False)
class Demo:
    """The results of the demo."""

    recording: Recording  # markers tracked in the bundled video, simulated
    seen: float  # fraction of all markers in all frames that was seen
    identification: Identification  # of the 10-link chain
    parameters: tuple[Parameter, ...]
    angle_noise: Array  # (n,) standard deviation of the measured link angles, rad
    plan: CastPlan  # how the identified rope is wound round a target
    held: HoldingForce | None  # result of a tug at the wound rope
    proof: CastOutcome | None  # the same cast by the rope that made the recording
    run: CastRun | None = None  # and carried out on an emulated drive; None if that was not possible
    unfair: str = ""  # why that is no fair trial, if it is none
    files: dict[str, Path] = field(default_factory=dict)  # of its report, by what they are: "page", "plan", "rope", ...

    @property
    def held_out_rms(self) -> float:
        """Rms prediction error of all links on the held-out part of the recording, rad; NaN without one."""
        held = self.identification.held_out
        return float("nan") if held is None else float(np.sqrt(np.mean(held.rms**2)))

    @property
    def table(self) -> TextTable:
        """The identified parameters, their intervals, and the fit without noise."""
        rows = []
        for each in self.parameters:
            numbers = (each.guess, each.value, *each.interval, each.mapped, each.cut)
            guess, value, low, high, mapped, cut = map("{:.4g}".format, numbers)
            inside = "yes" if each.covered else "no"
            rows.append((f"{each.name}, {each.unit}", guess, value, f"{low} to {high}", mapped, inside, cut))
        header = ("parameter", "guess", "identified", "95 % interval", "without noise", "inside", "plain cut")
        return TextTable(header, tuple(rows))

    @property
    def verdicts(self) -> tuple[tuple[bool, str], ...]:
        """Whether the planned cast succeeds, and the same cast of the rope that was recorded, in sentences."""
        planned = (self.plan.success, CastReport(self.plan).verdict)
        carried = () if self.run is None else ((self.run.success, self._carried_out(self.run, self.unfair)),)
        if self.proof is None:
            return planned, *carried
        text = f"winds {abs(self.proof.turns):.2f} turns and holds too."
        if not self.proof.success:
            text = f"does not: {self.proof.message}. The identified rope differs a little from that rope."
        rope = f"The rope that made the recording ({twin.FINE} links), cast by the same motion"
        return planned, (self.proof.success, f"{rope}, {text}"), *carried

    @staticmethod
    def _carried_out(run: CastRun, unfair: str) -> str:
        wound = (
            f"winds {abs(run.turns or 0.0):.2f} turns" if run.success else f"does not wind: {run.message.rstrip('.')}"
        )
        error = 1e3 * float(np.nanmax(np.abs(run.log.tracking_error), initial=0.0))
        return (
            f"Carried out on an emulated drive, that rope {wound}; the arm was at most {error:.0f} mrad off its goal."
            f"{f' But {unfair}.' if unfair and not run.success else ''}"
        )


def run_demo(progress: Progress = silent, preview: Path | None = None) -> Demo:
    """Track the bundled video's rope, identify it, and plan how to wind it round a target.

    `preview` is a video file that shows the tracked markers.
    """
    track = twin.track(preview=preview, progress=lambda count: progress(f"tracking the rope, frame {count}"))
    recording = twin.recording(track)

    def report(entry: dict[str, float]) -> None:
        progress(f"identifying, windows of {entry['window']:.2g} s, round {entry['round'] + 1:.0f}")

    found = twin.fit(recording, report)
    noise = recording.angles().noise
    scale = np.full(recording.n_links, np.nan) if noise is None else np.median(noise, axis=0)
    progress("planning how to wind the rope round a target")
    plan = plan_cast(found.rope, casting_arm(), TARGET, time_budget=180.0)  # it usually ends after some seconds
    progress("pulling at the wound rope")
    held, proof, run, unfair = plan.measure_holding_force(), None, None, ""
    if plan.motion is not None:
        progress("casting the rope that made the recording")
        recorded = Problem(twin.fine_rope(), casting_arm(), plan.problem.limits)
        proof = verify_cast(recorded, TARGET, plan.motion)
        run, unfair = _carried_out(plan, recorded, progress)
    return Demo(recording, track.seen, found, _parameters(found), scale, plan, held, proof, run, unfair)


def _carried_out(plan: CastPlan, recorded: Problem, progress: Progress) -> tuple[CastRun | None, str]:
    """Carry the plan out on an emulated drive with the rope of a problem; None if the drive cannot be emulated here.

    Also return why it is no fair trial, if it is none; a failure in such a trial is repeated once.
    """
    rope = replace(plan, problem=recorded).setup().rope
    run, unfair = None, ""
    for _ in range(2):  # once more where this computer was too busy
        with suppress(DriveError, MissingPackage):
            make, emulator = emulator_of(plan, "emulator:moteus", rope=rope)
            with emulator:
                source = EmulatedRope(emulator, plan.problem.rope, rope, plan.problem.arm)
                connect = partial(open_drive, f"{make}:{emulator.port}", plan.problem.limits)
                options = RunOptions(wait=30.0, countdown=0.0)
                run = run_plan(
                    plan, connect, source=source, options=options, say=lambda phase: progress(f"drive: {phase}")
                )
                unfair = emulator.unfair
            if run.success or not unfair:
                break
    return run, unfair


def _parameters(found: Identification) -> tuple[Parameter, ...]:
    guess, mapped, cut = twin.guess(), twin.mapped_truth(), twin.coarse_rope()
    return tuple(
        Parameter(
            name,
            PROPERTIES[name].unit,
            guess=float(getattr(guess, name)[0]),
            value=float(found.values[name][0]),
            std=float(found.std[name][0]),
            mapped=mapped[name],
            cut=float(getattr(cut, name)[0]),
        )
        for name in found.values
    )


@interruptible()
def write_demo(directory: str | Path, progress: Progress = silent) -> Demo:
    """Run the demo and write its folder, see :func:`hyperflex.report.folder.whole_folder`.

    If the folder cannot be written at the end, a fallback folder is used, see :func:`hyperflex.files.rescued`.
    """
    check_folder(directory)
    with tempfile.TemporaryDirectory(prefix="hyperflex-") as work:
        tracked = Path(work) / _FILES["tracked"]
        demo = run_demo(progress, tracked)

        def write(folder: Path) -> Demo:
            with whole_folder(folder) as stage:
                shutil.copy(tracked, stage)
                names = _write(stage, demo, progress)
            return replace(demo, files={kind: folder / name for kind, name in names.items()})

        return files.rescued(write, Path(directory))


def _write(folder: Path, demo: Demo, progress: Progress) -> dict[str, str]:
    """Write all files to `folder`, where the tracked video is; return their names by kind."""
    progress("drawing")
    found, cast, last = demo.identification, CastReport(demo.plan, demo.held), demo.recording.n_links - 1
    view = FittedChannels(demo.recording, found, chosen=((last + 1) // 2, last))
    planned = {kind: path.name for kind, path in cast.write_plan(folder).items()}  # removes pictures of its names
    shown = cast.pictures()
    shown["seen"] = Picture(_frames(folder / _FILES["tracked"]), _SEEN, chart=False)
    shown["prediction"] = Picture(png(fit_figure(view)), "Angles of a middle link and of the last one.")
    if demo.run is not None:
        shown["carried-out"] = Picture(png(cast_run_figure(demo.run)), "Arm, torque and rope on the emulated drive.")
    pictures = write_pictures(folder, shown)
    demo.recording.to_netcdf(folder / _FILES["markers"])
    shutil.copy(twin.BUNDLED, folder / _FILES["video"])
    twin.camera().write(folder / _FILES["camera"])
    twin.guess().to_toml(folder / _FILES["guess"])
    found.to_toml(folder / _FILES["rope"])
    found.to_json(folder / _FILES["identification"])
    sections = _sections(demo, cast, shown)
    files.write_text(folder / _FILES["summary"], sections_markdown("Demo (simulated)", sections))
    write_page(folder / _FILES["page"], "A rope, identified and cast", _LEAD, "simulated", sections)
    return _FILES | planned | pictures


def _sections(demo: Demo, cast: CastReport, shown: dict[str, Picture | Film]) -> list[Section]:
    """Return the sections of the page: the cast, the identification, details of the cast."""
    film, seen, prediction, carried = (
        tuple(shown.pop(kind) for kind in {kind} & shown.keys())
        for kind in ("film", "seen", "prediction", "carried-out")
    )
    tracked = _TRACKED.format(frames=demo.recording.t.size, seen=100.0 * demo.seen)
    recording = f"Recording: {demo.recording.source}; {demo.recording.gaps} coordinates are missing."
    findings = (line.strip() for line in demo.identification.report(full=True).splitlines()[1:])
    notes = (_MAPPED, *findings, recording)
    verdict, *marks = demo.verdicts
    return [
        Section("The cast", verdict, marks=tuple(marks), pictures=film),
        _in_short(demo),
        Section("The video", text=(tracked,), pictures=seen),
        Section("The identified rope", table=demo.table, notes=notes),
        Section("Measured, fitted, predicted", text=(_HELD_OUT,), pictures=prediction),
        Section(
            "The cast, step by step",
            text=(*cast.story, _MODEL),
            tiles=cast.tiles,
            pictures=tuple(shown.values()),
            table=cast.texts.table("checks"),
            notes=(cast.texts.text("search"),),
        ),
        *([Section("Carried out on an emulated drive", text=(_CARRIED_OUT,), pictures=carried)] if carried else []),
    ]


def _in_short(demo: Demo) -> Section:
    covered, rope, recording = sum(each.covered for each in demo.parameters), demo.identification.rope, demo.recording
    tiles = (
        (f"{covered} of {len(demo.parameters)}", "95 % intervals contain the values of the fit without noise"),
        (f"{1e3 * demo.held_out_rms:.1f} mrad", "prediction error 1 s ahead, on data that was not fitted"),
        (f"{1e3 * demo.angle_noise.mean():.1f} mrad", "noise of a measured angle, for comparison"),
    )
    setup = (
        f"Rope: {rope.total_length:g} m, {rope.total_mass:g} kg. Recording: {recording.t.size} frames over "
        f"{recording.duration:.1f} s, {recording.n_links} markers, the first "
        f"{demo.identification.settings['fitted_to']:.1f} s fitted. Cast: arm of "
        f"{1e3 * demo.plan.problem.arm.length:g} mm."
    )
    return Section("In short", tiles=tiles, text=(setup,))


def _frames(video: Path) -> bytes:
    """Return the rope in two frames of a video, side by side, as a PNG."""
    from PIL import Image

    with VideoReader(video) as reader:
        images = [frame.image for frame in reader]
    left = images[0].shape[1] * 2 // 5  # the rope is to the right of it in both
    sheet = np.hstack([images[round(part * (len(images) - 1))][:, left:, ::-1] for part in (0.03, 0.25)])
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(sheet)).save(stream, "png", optimize=True)
    return stream.getvalue()
