"""The demo's folder: figures, runs, the identified rope, a planned cast and a page that shows it all."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import files
from hyperflex.demo import twin
from hyperflex.demo.run import INTERVAL, Demo, Parameter, run_demo
from hyperflex.interruption import interruptible
from hyperflex.paper import T_MOVE, T_REST, casting_arm
from hyperflex.report import (
    BLUE,
    GREEN,
    GREY,
    RED,
    CastReport,
    Film,
    Picture,
    Progress,
    Section,
    TextTable,
    check_folder,
    fit_figure,
    fitted_channels,
    legend,
    new_figure,
    player_html,
    png,
    search_summary,
    sections_markdown,
    silent,
    strobe_figure,
    whole_folder,
    write_page,
)
from hyperflex.trajectory import Trajectory
from hyperflex.vision import VideoReader

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WINDOW = 2.0  # s, of the table of reaches
_LEAD = (
    "From a video to an identified rope to a cast that winds it round a target. The video was made by simulating a "
    "rope of {fine} links and filming it with a synthetic camera; its markers are tracked, and a chain of {coarse} "
    "links is identified from them, with uncertainties. Nothing here was measured on a real rope."
)
_HELD_OUT = (
    "Shaded: held out. There the state is fitted on half a second, and the next second is predicted without data."
)
_MODEL = (
    "The cast is planned for the rope as it was identified, {coarse} links (cut shorter near the target); the plan is "
    "simulated with the same model, and again with shorter links."
)
_TRACKED = (
    "Ten markers in {frames} frames of an H.264 video, with things of their colour on the wall and light that drifts; "
    "{seen:.1f} % of them were seen, the others were covered. The first guess of the rope, with three times its "
    "friction, is enough to track it. swing.mp4, camera.toml and guess.toml are what hyperflex track was given."
)
_CAPTIONS = {
    "seen": "Two frames as tracked, in part: crosses are markers seen, circles where each was expected, blue the rope.",
    "film": "The identified rope, cast from rest by the paper's motion; simulated.",
    "strobe": "One stroke of the arm late in the cast, early instants dark, late ones bright.",
    "casts": "Tip to the side: the identified chain beside the rope that made the recording.",
    "parameters": "Identified parameters over those of the fit without noise.",
    "prediction": "Angles of a link in the middle and of the last one.",
}


@dataclass(frozen=True)
class DemoReport:
    """The demo's results, and the files of its report."""

    files: dict[str, Path]  # by what they are: "page", "cast", "rope", ...
    demo: Demo
    parameters: TextTable  # identified values, intervals, and the fit without noise
    reaches: TextTable  # greatest reach of the tip in each 2 s
    verdicts: tuple[tuple[bool, str], ...]  # on the planned cast, and on the same throw of the rope that was recorded


@interruptible()
def write_demo(directory: str | Path, progress: Progress = silent) -> DemoReport:
    """Run the demo and write its folder, as :func:`hyperflex.report.folder.whole_folder` does.

    Where the folder cannot be written in the end, it goes to a fallback folder, see :func:`hyperflex.files.rescued`.
    """
    check_folder(directory)
    done: list[tuple[Demo, bytes]] = []  # worked out once, and the video of what was tracked
    return files.rescued(lambda folder: _write_folder(folder, progress, done), Path(directory))


def _write_folder(directory: Path, progress: Progress, done: list[tuple[Demo, bytes]]) -> DemoReport:
    """Write the folder of the demo; run it, unless that is `done`."""
    with whole_folder(directory) as stage:
        if not done:
            demo = run_demo(progress, stage / "tracked.mp4")
            done.append((demo, (stage / "tracked.mp4").read_bytes()))
        demo, video = done[0]
        files.write_bytes(stage / "tracked.mp4", video)
        winding = CastReport(demo.plan, demo.held, "wound")
        verdicts = ((demo.plan.success, winding.verdict), *_proof(demo))
        report = DemoReport({}, demo, _parameters_table(demo), _reaches_table(demo), verdicts)
        names = _write(stage, report, winding, progress)
    return replace(report, files={kind: directory / name for kind, name in names.items()})


def _write(folder: Path, report: DemoReport, winding: CastReport, progress: Progress) -> dict[str, str]:
    """Write everything to `folder`; return the names of the files by what they are."""
    demo, found = report.demo, report.demo.identification
    progress("drawing")
    shown = {"seen": _frames(folder / "tracked.mp4"), **_figures(demo)}
    names = {kind: f"{kind}.png" for kind in shown}
    names |= {"tracked": "tracked.mp4", "video": "swing.mp4", "camera": "camera.toml", "guess": "guess.toml"}
    names |= {"cast": "cast.nc", "rope": "rope.toml", "markers": "markers.nc"}
    names |= {"identification": "identification.json", "summary": "summary.md", "page": "report.html"}
    for kind, content in shown.items():
        files.write_bytes(folder / names[kind], content)
    progress("writing")
    demo.cast.to_netcdf(folder / names["cast"])
    demo.recording.to_netcdf(folder / names["markers"])
    files.write_bytes(folder / names["video"], twin.BUNDLED.read_bytes())
    twin.camera().write(folder / names["camera"])
    twin.guess().to_toml(folder / names["guess"])
    found.to_toml(folder / names["rope"])
    found.to_json(folder / names["identification"])
    wound = winding.write_plan(folder)
    drawn = winding.draw(folder, progress)
    pictures = winding.pictures(drawn)
    first = Section("The cast", report.verdicts[0], marks=report.verdicts[1:], pictures=(pictures.pop("film"),))
    details = Section(
        "The cast, step by step",
        text=(*winding.story, _MODEL.format(coarse=demo.recording.n_links)),
        tiles=winding.tiles,
        pictures=tuple(pictures.values()),
        table=winding.checks,
        notes=(search_summary(demo.plan),),
    )
    sections = [first, *_sections(report, shown), details, _paper_section(report, shown)]
    files.write_text(folder / names["summary"], sections_markdown("Demo (simulated)", sections))
    lead = _LEAD.format(fine=demo.reference.q.shape[1], coarse=demo.recording.n_links)
    write_page(folder / names["page"], "A rope, identified and cast", lead, "simulated", sections)
    return names | {kind: path.name for kind, path in (wound | drawn).items()}


def _figures(demo: Demo) -> dict[str, bytes]:
    """Return the PNGs by name."""
    view, last = fitted_channels(demo.recording, demo.identification), demo.recording.n_links - 1
    return {
        "prediction": png(fit_figure(replace(view, chosen=((last + 1) // 2, last)))),
        "parameters": png(_parameters_figure(demo.parameters)),
        "strobe": png(
            strobe_figure(demo.cast, start=10.1, end=11.35, count=60, title="identified rope, cast (simulated)")
        ),
        "casts": png(_casts_figure(demo)),
    }


def _frames(video: Path) -> bytes:
    """Return the rope in two frames of a video, side by side, as a PNG."""
    from io import BytesIO

    from PIL import Image

    with VideoReader(video) as reader:
        images = [frame.image for frame in reader]
    left = images[0].shape[1] * 2 // 5  # the rope is to the right of it in both
    shown = [images[round(part * (len(images) - 1))][:, left:] for part in (0.03, 0.25)]
    sheet = np.hstack(shown)[..., ::-1]  # blue, green, red to red, green, blue
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(sheet)).save(stream, "png", optimize=True)
    return stream.getvalue()


def _parameters_figure(parameters: tuple[Parameter, ...]) -> "Figure":
    """Draw each parameter over that of the fit without noise: guess, plain cut, identified value and interval."""
    with new_figure(10.0, 1.3 + 0.75 * len(parameters)) as figure:
        axis: Any = figure.subplots()
        for row, each in enumerate(parameters):
            low, high = each.interval
            axis.plot([low / each.mapped, high / each.mapped], [row, row], color=BLUE, lw=5.0, alpha=0.45)
            for value, marker, colour, label in (
                (each.value, "o", BLUE, "identified, 95 % interval"),
                (each.mapped, "|", GREEN, "fit without noise"),
                (each.cut, "D", GREY, "the rope simply cut into as many links"),
                (each.guess, "x", RED, "first guess"),
            ):
                style = {"color": colour, "ms": 22.0 if marker == "|" else 7.0, "mew": 1.8, "ls": "none"}
                axis.plot([value / each.mapped], [row], marker, label=None if row else label, **style)
        axis.set_yticks(range(len(parameters)), [each.name for each in parameters])
        axis.set(ylim=(len(parameters) - 0.5, -0.5), xlabel="value over that of the fit without noise", xscale="log")
        ticks = [0.5, 0.7, 1.0, 1.5, 2.0, 3.0]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        legend(figure, axis, place="upper center")
    return figure


def _casts_figure(demo: Demo) -> "Figure":
    """Draw the tip's path to the side for the identified rope and for the rope that made the recording."""
    with new_figure(10.0, 2.9, "Cast, simulated") as figure:
        axis: Any = figure.subplots()
        for run, name, style in (
            (demo.reference, "the rope", {"color": GREY, "lw": 3.0, "alpha": 0.6}),
            (demo.cast, "identified", {"color": BLUE, "lw": 1.2}),
        ):
            axis.plot(run.t, run.tip[:, 0], label=f"{name}, {run.q.shape[1]} links", **style)
        axis.set(xlabel="time, s", ylabel="tip x, m", xlim=(0.0, demo.cast.t[-1]))
        legend(figure, axis, columns=2)
    return figure


def _proof(demo: Demo) -> tuple[tuple[bool, str], ...]:
    """Return what the rope that made the recording does in the same throw."""
    proof = demo.proof
    if proof is None:
        return ()
    rope = f"The rope that made the recording ({demo.reference.q.shape[1]} links), thrown by the same motion"
    if proof.success:
        return ((True, f"{rope}, winds {abs(proof.turns):.2f} turns and holds too."),)
    return ((False, f"{rope}, does not: {proof.message}. The identified rope is not quite that rope."),)


def held_out_rms(demo: Demo) -> float:
    """Return the rms prediction error over all links on the held-out part, rad; NaN without one."""
    held = demo.identification.held_out
    return float("nan") if held is None else float(np.sqrt(np.mean(held.rms**2)))


def _parameters_table(demo: Demo) -> TextTable:
    header = ("parameter", "guess", "identified", "95 % interval", "without noise", "inside", "plain cut")
    rows = []
    for each in demo.parameters:
        guess, value, mapped, cut, low, high = (
            f"{number:.4g}" for number in (each.guess, each.value, each.mapped, each.cut, *each.interval)
        )
        inside = "yes" if each.covered else "no"
        rows.append((f"{each.name}, {each.unit}", guess, value, f"{low} to {high}", mapped, inside, cut))
    return TextTable(header, tuple(rows))


def _reaches_table(demo: Demo) -> TextTable:
    starts = np.arange(0.0, demo.cast.t[-1] - 0.5 * _WINDOW, _WINDOW)

    def row(name: str, run: Trajectory) -> tuple[str, ...]:
        x = [np.abs(run.tip[(run.t >= start) & (run.t <= start + _WINDOW), 0]).max() for start in starts]
        return (f"{name}, {run.q.shape[1]} links", *(f"{value:.2f}" for value in x))

    header = ("rope", *(f"{start:.0f}-{start + _WINDOW:.0f} s" for start in starts))
    return TextTable(header, (row("identified", demo.cast), row("the rope itself", demo.reference)))


def _notes(demo: Demo) -> tuple[str, ...]:
    links = demo.recording.n_links
    mapped = (
        f"Without noise: what the same fit finds in the same swing without a camera, the best that {links} links "
        f"can do for a rope of {demo.reference.q.shape[1]}. To move like it, coarse links need other inertia and "
        "friction than the rope simply cut into as many pieces (plain cut); that bias is no error of the camera."
    )
    intervals = f"Intervals: identified value plus and minus {INTERVAL} standard deviations."
    recording = f"Recording: {demo.recording.source}; {demo.recording.gaps} coordinates are missing."
    return mapped, " ".join((intervals, *demo.identification.verdict)), recording


def _in_short(demo: Demo) -> Section:
    covered = sum(each.covered for each in demo.parameters)
    reach, own = float(np.abs(demo.cast.tip[:, 0]).max()), float(np.abs(demo.reference.tip[:, 0]).max())
    rope, recording = demo.identification.rope, demo.recording
    error, noise = 1e3 * held_out_rms(demo), 1e3 * float(demo.angle_noise.mean())
    tiles = (
        (f"{covered} of {len(demo.parameters)}", "95 % intervals hold what the fit finds without noise"),
        (f"{error:.1f} mrad", "prediction error 1 s ahead, on data that the fit has not seen"),
        (f"{noise:.1f} mrad", "noise of a measured angle, for comparison"),
        (f"{1e2 * abs(reach - own):.1f} cm", f"between the greatest reaches of the two casts ({reach:.2f} m)"),
    )
    setup = (
        f"Rope: {rope.total_length:g} m, {rope.total_mass:g} kg. Recording: {recording.t.size} frames over "
        f"{recording.duration:.1f} s, {recording.n_links} markers, the first "
        f"{demo.identification.settings['fitted_to']:.1f} s fitted. Cast: arm of {1e3 * casting_arm().length:g} mm, "
        f"half a turn in {T_MOVE:g} s, rest {T_REST['success']:g} s, through the bottom."
    )
    return Section("In short", tiles=tiles, text=(setup,))


def _sections(report: DemoReport, contents: Mapping[str, bytes]) -> list[Section]:
    """Return how the rope was identified, in sections."""
    demo = report.demo
    tracked = _TRACKED.format(frames=demo.recording.t.size, seen=100.0 * demo.seen)
    parameters, prediction = _shown(contents, "parameters"), _shown(contents, "prediction")
    return [
        _in_short(demo),
        Section("The video", text=(tracked,), pictures=_shown(contents, "seen")),
        Section("The identified rope", pictures=parameters, table=report.parameters, notes=_notes(demo)),
        Section("Measured, fitted, predicted", text=(_HELD_OUT,), pictures=prediction),
    ]


def _paper_section(report: DemoReport, contents: Mapping[str, bytes]) -> Section:
    """Return the section on the identified rope, cast as in the paper."""
    film = Film(player_html(report.demo.cast, title="identified rope, simulated"), _CAPTIONS["film"])
    reaches = ("The table gives the greatest |x| of the tip in each 2 s, m.",)
    pictures: tuple[Picture | Film, ...] = (film, *_shown(contents, "strobe", "casts"))
    return Section("The paper's cast", pictures=pictures, table=report.reaches, notes=reaches)


def _shown(contents: Mapping[str, bytes], *kinds: str) -> tuple[Picture, ...]:
    return tuple(Picture(contents[kind], _CAPTIONS[kind], chart=kind not in ("seen", "strobe")) for kind in kinds)
