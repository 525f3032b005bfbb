"""The demo: a video, an identified rope, and a plan that winds it round a target; with a folder that shows it all."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.demo import twin
from hyperflex.identification import Identification
from hyperflex.interruption import interruptible
from hyperflex.model import PROPERTIES, Peg
from hyperflex.paper import casting_arm
from hyperflex.planning import CastOutcome, CastPlan, HoldingForce, Problem, plan_cast, verify_cast
from hyperflex.recording import Recording
from hyperflex.report import (
    BLUE,
    GREEN,
    GREY,
    RED,
    CastReport,
    FittedChannels,
    Picture,
    Progress,
    Section,
    TextTable,
    check_folder,
    fit_figure,
    legend,
    new_figure,
    png,
    sections_markdown,
    silent,
    whole_folder,
    write_page,
)
from hyperflex.vision import VideoReader

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TARGET = Peg(x=0.62, y=-1.14, radius=0.05, mu=0.3)  # well within reach
_LEAD = (
    "From a video to an identified rope to a cast that winds it round a target. The video was made by simulating a "
    f"rope of {twin.FINE} links and filming it with a synthetic camera. Its markers are tracked, and a chain of "
    f"{twin.COARSE} links is identified from them, with uncertainties. Nothing here was measured on a real rope."
)
_HELD_OUT = (
    "Shaded: held out. There the state is fitted on half a second, and the next second is predicted without data."
)
_MODEL = (
    f"The cast is planned for the rope as it was identified, {twin.COARSE} links (cut shorter near the target). The "
    "plan is simulated with the same model, and again with shorter links."
)
_TRACKED = (
    "Ten markers in {frames} frames of an H.264 video, with clutter of their colour on the wall and light that drifts; "
    "{seen:.1f} % of them were seen, the others were covered. The first guess of the rope, with three times its "
    "friction, is enough to track it. swing.mp4, camera.toml and guess.toml are the inputs, as for hyperflex track."
)
_MAPPED = (
    f"Without noise: what the same fit finds in the same swing without a camera, the best that {twin.COARSE} links can "
    f"do for a rope of {twin.FINE}. To move like it, coarse links need other inertia and friction than the rope simply "
    "cut into as many pieces (plain cut); that bias is no error of the camera."
)
_CAPTIONS = {
    "seen": "Two frames as tracked, in part: crosses are markers seen, circles where each was expected, blue the rope.",
    "parameters": "Identified parameters over those of the fit without noise.",
    "prediction": "Angles of a link in the middle and of the last one.",
}
_FILES = {"tracked": "tracked.mp4", "video": "swing.mp4", "camera": "camera.toml", "guess": "guess.toml"}
_FILES |= {"rope": "rope.toml", "markers": "markers.nc", "identification": "identification.json"}
_FILES |= {"summary": "summary.md", "page": "report.html"} | {kind: f"{kind}.png" for kind in _CAPTIONS}


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
    proof: CastOutcome | None  # the same throw by the rope that made the recording

    @property
    def held_out_rms(self) -> float:
        """Rms prediction error of all links on the held-out part of the recording, rad; NaN without one."""
        held = self.identification.held_out
        return float("nan") if held is None else float(np.sqrt(np.mean(held.rms**2)))


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
    held, proof = plan.measure_holding_force(), None
    if plan.motion is not None:
        progress("throwing the rope that made the recording")
        proof = verify_cast(Problem(twin.fine_rope(), casting_arm(), plan.problem.limits), TARGET, plan.motion)
    return Demo(recording, track.seen, found, _parameters(found), scale, plan, held, proof)


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


@dataclass(frozen=True)
class DemoReport:
    """The demo's results, and the files of its report."""

    files: dict[str, Path]  # by what they are: "page", "plan", "rope", ...
    demo: Demo
    parameters: TextTable  # identified values, intervals, and the fit without noise
    verdicts: tuple[tuple[bool, str], ...]  # on the planned cast, and on the same throw of the rope that was recorded


@interruptible()
def write_demo(directory: str | Path, progress: Progress = silent) -> DemoReport:
    """Run the demo and write its folder, see :func:`hyperflex.report.folder.whole_folder`.

    If the folder cannot be written at the end, a fallback folder is used, see :func:`hyperflex.files.rescued`.
    """
    check_folder(directory)
    with tempfile.TemporaryDirectory(prefix="hyperflex-") as work:
        tracked = Path(work) / "tracked.mp4"
        demo = run_demo(progress, tracked)
        video = tracked.read_bytes()
    return files.rescued(lambda folder: _write_folder(folder, demo, video, progress), Path(directory))


def _write_folder(directory: Path, demo: Demo, video: bytes, progress: Progress) -> DemoReport:
    cast = CastReport(demo.plan, demo.held)
    verdicts = ((demo.plan.success, cast.verdict), *_proof(demo))
    report = DemoReport({}, demo, _parameters_table(demo), verdicts)
    with whole_folder(directory) as stage:
        files.write_bytes(stage / _FILES["tracked"], video)
        names = _write(stage, report, cast, progress)
    return replace(report, files={kind: directory / name for kind, name in names.items()})


def _write(folder: Path, report: DemoReport, cast: CastReport, progress: Progress) -> dict[str, str]:
    """Write all files to `folder`; return their names by kind."""
    demo, found = report.demo, report.demo.identification
    progress("drawing")
    last = demo.recording.n_links - 1
    view = FittedChannels(demo.recording, found, chosen=((last + 1) // 2, last))
    pictures = {
        "seen": _frames(folder / _FILES["tracked"]),
        "prediction": png(fit_figure(view)),
        "parameters": png(_parameters_figure(demo)),
    }
    for kind, content in pictures.items():
        files.write_bytes(folder / _FILES[kind], content)
    demo.recording.to_netcdf(folder / _FILES["markers"])
    files.write_bytes(folder / _FILES["video"], twin.BUNDLED.read_bytes())
    twin.camera().write(folder / _FILES["camera"])
    twin.guess().to_toml(folder / _FILES["guess"])
    found.to_toml(folder / _FILES["rope"])
    found.to_json(folder / _FILES["identification"])
    planned, drawn = cast.write_plan(folder), cast.drawn()
    for kind, content in drawn.items():
        files.write_bytes(folder / f"{kind}.png", content)
    sections = _sections(report, cast, pictures, drawn)
    files.write_text(folder / _FILES["summary"], sections_markdown("Demo (simulated)", sections))
    write_page(folder / _FILES["page"], "A rope, identified and cast", _LEAD, "simulated", sections)
    return _FILES | {kind: path.name for kind, path in planned.items()} | {kind: f"{kind}.png" for kind in drawn}


def _sections(
    report: DemoReport, cast: CastReport, pictures: Mapping[str, bytes], drawn: Mapping[str, bytes]
) -> list[Section]:
    """Return the sections of the page: the cast, the identification, details of the cast."""
    demo, shown = report.demo, cast.pictures(drawn)
    seen, parameters, prediction = (
        (Picture(pictures[kind], caption, chart=kind != "seen"),) for kind, caption in _CAPTIONS.items()
    )
    tracked = _TRACKED.format(frames=demo.recording.t.size, seen=100.0 * demo.seen)
    recording = f"Recording: {demo.recording.source}; {demo.recording.gaps} coordinates are missing."
    notes = (_MAPPED, " ".join(demo.identification.report(full=True).splitlines()[1:]), recording)
    film = (shown.pop("film"),) if "film" in shown else ()
    return [
        Section("The cast", report.verdicts[0], marks=report.verdicts[1:], pictures=film),
        _in_short(demo),
        Section("The video", text=(tracked,), pictures=seen),
        Section("The identified rope", pictures=parameters, table=report.parameters, notes=notes),
        Section("Measured, fitted, predicted", text=(_HELD_OUT,), pictures=prediction),
        Section(
            "The cast, step by step",
            text=(*cast.story, _MODEL),
            tiles=cast.tiles,
            pictures=tuple(shown.values()),
            table=cast.texts.table("checks"),
            notes=(cast.search_summary,),
        ),
    ]


def _in_short(demo: Demo) -> Section:
    covered, rope, recording = sum(each.covered for each in demo.parameters), demo.identification.rope, demo.recording
    tiles = (
        (f"{covered} of {len(demo.parameters)}", "95 % intervals contain what the fit finds without noise"),
        (f"{1e3 * demo.held_out_rms:.1f} mrad", "prediction error 1 s ahead, on data that the fit has not seen"),
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


def _parameters_figure(demo: Demo) -> "Figure":
    """Draw each parameter relative to the fit without noise: guess, divided rope, identified value, interval."""
    marks = {
        "value": ("o", BLUE, "identified, 95 % interval"),
        "mapped": ("|", GREEN, "fit without noise"),
        "cut": ("D", GREY, "the rope simply cut into as many links"),
        "guess": ("x", RED, "first guess"),
    }
    with new_figure(10.0, 1.3 + 0.75 * len(demo.parameters)) as figure:
        axis: Any = figure.subplots()
        for row, each in enumerate(demo.parameters):
            axis.plot(np.divide(each.interval, each.mapped), [row, row], color=BLUE, lw=5.0, alpha=0.45)
            for name, (marker, colour, label) in marks.items():
                size, place = 22.0 if marker == "|" else 7.0, getattr(each, name) / each.mapped
                style = {"color": colour, "mew": 1.8, "ls": "none", "label": None if row else label}
                axis.plot([place], [row], marker, ms=size, **style)
        axis.set_yticks(range(len(demo.parameters)), [each.name for each in demo.parameters])
        limits = (len(demo.parameters) - 0.5, -0.5)
        axis.set(ylim=limits, xlabel="value over that of the fit without noise", xscale="log")
        ticks = [0.5, 0.7, 1.0, 1.5, 2.0, 3.0]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        legend(figure, axis, place="upper center")
    return figure


def _proof(demo: Demo) -> tuple[tuple[bool, str], ...]:
    """Return a section on the same throw with the rope that made the recording."""
    proof, rope = demo.proof, f"The rope that made the recording ({twin.FINE} links), thrown by the same motion"
    if proof is None:
        return ()
    if proof.success:
        return ((True, f"{rope}, winds {abs(proof.turns):.2f} turns and holds too."),)
    return ((False, f"{rope}, does not: {proof.message}. The identified rope differs a little from that rope."),)


def _parameters_table(demo: Demo) -> TextTable:
    header = ("parameter", "guess", "identified", "95 % interval", "without noise", "inside", "plain cut")
    rows = []
    for each in demo.parameters:
        numbers = (each.guess, each.value, *each.interval, each.mapped, each.cut)
        guess, value, low, high, mapped, cut = (f"{number:.4g}" for number in numbers)
        inside = "yes" if each.covered else "no"
        rows.append((f"{each.name}, {each.unit}", guess, value, f"{low} to {high}", mapped, inside, cut))
    return TextTable(header, tuple(rows))
