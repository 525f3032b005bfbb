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
from hyperflex.demo import twin
from hyperflex.errors import DriveError, MissingPackage
from hyperflex.execution import CastRun, EmulatedRope, RunOptions, emulator_of, open_drive, run_plan
from hyperflex.identification import Identification
from hyperflex.interruption import interruptible
from hyperflex.model import Peg
from hyperflex.paper import casting_arm
from hyperflex.planning import CastOutcome, CastPlan, HoldingForce, Problem, plan_cast, verify_cast
from hyperflex.recording import Recording
from hyperflex.report import (
    CastReport,
    Film,
    Picture,
    Progress,
    Section,
    cast_run_figure,
    check_folder,
    identification_sections,
    png,
    silent,
    whole_folder,
    write_found,
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
_TRACKED = (
    "Ten markers in {frames} frames of an H.264 video, with clutter of their colour on the wall and drifting light; "
    "{seen:.1f} % of them were seen, the others were covered. The first guess of the rope, with three times its "
    "friction, is enough to track it. swing.mp4, camera.toml and guess.toml are the inputs, as for hyperflex track."
)
_CARRIED_OUT = (
    "The planned motion, first simulated with the rope that made the recording, then streamed to an emulated moteus "
    "drive: a process that simulates motor, arm and that rope in real time, behind the drive's own protocol. No real "
    "drive was used."
)
_SEEN = "Parts of two tracked frames: crosses are detected markers, circles their expected positions, blue is the rope."
_FILES = {
    "tracked": "tracked.mp4",
    "video": "swing.mp4",
    "camera": "camera.toml",
    "guess": "guess.toml",
    "markers": "markers.nc",
    "page": "report.html",
}


@dataclass(frozen=True, eq=False)
class Demo:
    """The results of the demo."""

    recording: Recording  # markers tracked in the bundled video, simulated
    seen: float  # fraction of all markers in all frames that was seen
    identification: Identification  # of the 10-link chain
    plan: CastPlan  # how the identified rope is wound round a target
    held: HoldingForce | None  # result of a tug at the wound rope
    proof: CastOutcome | None  # the same cast by the rope that made the recording
    run: CastRun | None = None  # and carried out on an emulated drive; None if that was not possible
    unfair: str = ""  # why that is no fair trial, if it is none
    files: dict[str, Path] = field(default_factory=dict)  # of its report, by what they are: "page", "plan", "rope", ...

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
    progress("planning how to wind the rope round a target")
    plan = plan_cast(found.rope, casting_arm(), TARGET, time_budget=180.0)  # it usually ends after some seconds
    progress("pulling at the wound rope")
    held, proof, run, unfair = plan.measure_holding_force(), None, None, ""
    if plan.motion is not None:
        progress("casting the rope that made the recording")
        recorded = Problem(twin.fine_rope(), casting_arm(), plan.problem.limits)
        proof = verify_cast(recorded, TARGET, plan.motion)
        run, unfair = _carried_out(plan, recorded, progress)
    return Demo(recording, track.seen, found, plan, held, proof, run, unfair)


def _carried_out(plan: CastPlan, recorded: Problem, progress: Progress) -> tuple[CastRun | None, str]:
    """Carry the plan out on an emulated drive with the rope of a problem; None if the drive cannot be emulated here.

    Also return why it is no fair trial, if it is none.
    """
    rope = replace(plan, problem=recorded).setup().rope
    with suppress(DriveError, MissingPackage):
        make, emulator = emulator_of(plan, "emulator:moteus", rope=rope)
        with emulator:
            source = EmulatedRope(emulator, plan.problem.rope, rope, plan.problem.arm)
            connect = partial(open_drive, f"{make}:{emulator.port}", plan.problem.limits)
            options = RunOptions(wait=30.0, countdown=0.0)
            run = run_plan(plan, connect, source=source, options=options, say=lambda phase: progress(f"drive: {phase}"))
            return run, emulator.unfair
    return None, ""


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
    cast = CastReport(demo.plan, demo.held)
    texts = cast.write_plan(folder) | write_found(folder, demo.identification)
    seen, carried = Picture(_frames(folder / _FILES["tracked"]), _SEEN, chart=False), dict[str, Picture | Film]()
    if demo.run is not None:
        carried["carried-out"] = Picture(png(cast_run_figure(demo.run)), "Arm, torque and rope on the emulated drive.")
    shown = cast.pictures()
    demo.recording.to_netcdf(folder / _FILES["markers"])
    shutil.copy(twin.BUNDLED, folder / _FILES["video"])
    twin.camera().write(folder / _FILES["camera"])
    twin.guess().to_toml(folder / _FILES["guess"])
    tracked = _TRACKED.format(frames=demo.recording.t.size, seen=100.0 * demo.seen)
    sections = [
        *cast.sections(shown),
        Section("Carried out", text=(_CARRIED_OUT,), marks=demo.verdicts[1:], pictures=tuple(carried.values())),
        Section("The video", text=(tracked,), pictures=(seen,)),
        *identification_sections(demo.recording, demo.identification, twin.guess()),
    ]
    write_page(folder / _FILES["page"], "A rope, identified and cast", _LEAD, "simulated", sections)
    written = {kind: path.name for kind, path in texts.items()}
    return _FILES | written | write_pictures(folder, shown | carried | {"seen": seen})


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
