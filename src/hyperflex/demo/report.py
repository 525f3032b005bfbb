"""The demo's folder: figures, film, NetCDF, the identified rope, a planned cast and a page that shows it all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyperflex import files
from hyperflex.demo.figures import casts_figure, parameters_figure, prediction_figure
from hyperflex.demo.run import INTERVAL, Demo, run_demo
from hyperflex.demo.winding import WindingPart, write_winding
from hyperflex.paper.casting import T_MOVE, T_REST, casting_arm
from hyperflex.paper.casting_claims import WINDOW
from hyperflex.report.animation import animate
from hyperflex.report.folder import whole_folder
from hyperflex.report.page import Picture, Section, write_page
from hyperflex.report.strobe import strobe
from hyperflex.report.style import png
from hyperflex.report.tables import TextTable, markdown
from hyperflex.trajectory import Trajectory

Tell = Callable[[str], None]

_FILM_RATE = 20  # frames a second
_LEAD = (
    "From a recording to an identified rope to its cast. The recording was made by simulating a rope of {fine} links "
    "and looking at it with a noisy camera; a chain of {coarse} links is identified from it, with uncertainties, and "
    "cast; in the end it is wound round a target. Nothing here was measured on a real rope."
)
_SHADED = "Shaded: held out. There the state is fitted on half a second, and the next second is predicted without data."


@dataclass(frozen=True)
class DemoReport:
    """What :func:`write_demo` wrote.

    Attributes
    ----------
    files : dict of str to Path
        By what they are: "page", "film", "cast", "rope", ...
    demo : Demo
        What was found.
    parameters : TextTable
        Identified values, intervals and mapped truth.
    reaches : TextTable
        Reach of the tip in each 2 s.
    winding : WindingPart
        What became of the planned cast.
    """

    files: dict[str, Path]
    demo: Demo
    parameters: TextTable
    reaches: TextTable
    winding: WindingPart


def write_demo(directory: str | Path, tell: Tell = lambda _: None) -> DemoReport:
    """Run the demo and write its folder.

    Parameters
    ----------
    directory : str or Path
        Folder to write to, whole or not at all; made if it is not there, other files in it stay.
    tell : callable
        Told in words what is being done.

    Returns
    -------
    DemoReport

    Raises
    ------
    FileProblem
        The folder cannot be made or written to.
    """
    with whole_folder(directory) as stage:
        demo = run_demo(tell)
        parameters, reaches = _parameters_table(demo), _reaches_table(demo)
        winding = write_winding(stage, demo, tell)
        written = _write(stage, demo, parameters, reaches, winding, tell)
    found = {kind: Path(directory) / name for kind, name in written.items()}
    return DemoReport(found, demo, parameters, reaches, winding)


def _write(
    folder: Path, demo: Demo, parameters: TextTable, reaches: TextTable, winding: WindingPart, tell: Tell
) -> dict[str, str]:
    """Write everything to `folder`; return the names of the files by what they are."""
    tell("drawing")
    pictures = _pictures(demo)
    names = {kind: f"{kind}.png" for kind in pictures}
    names |= {"film": "cast.gif", "cast": "cast.nc", "rope": "rope.toml"}
    names |= {"identification": "identification.json", "summary": "summary.md", "page": "report.html"}
    written = {kind: folder / name for kind, name in names.items()}
    for kind, content in pictures.items():
        with files.atomic(written[kind], "wb") as file:
            file.write(content)
    animate(
        demo.cast,
        written["film"],
        frame_rate=_FILM_RATE,
        width=560,
        title="identified rope, simulated",
        progress=lambda done, total: tell(f"filming, frame {done} of {total}"),
    )
    tell("writing")
    demo.cast.to_netcdf(written["cast"])
    demo.identification.to_toml(written["rope"])
    demo.identification.to_json(written["identification"])
    files.write_text(written["summary"], _summary(demo, parameters, reaches, winding))
    film = written["film"].read_bytes()
    _write_page(written["page"], demo, pictures, film, parameters, reaches, winding.section)
    return names | winding.files


def _pictures(demo: Demo) -> dict[str, bytes]:
    """Return the PNGs by name."""
    last = demo.recording.n_links - 1
    return {
        "prediction": png(prediction_figure(demo.recording, demo.identification, ((last + 1) // 2, last))),
        "parameters": png(parameters_figure(demo.parameters)),
        "strobe": png(strobe(demo.cast, start=10.1, end=11.35, count=60, title="identified rope, cast (simulated)")),
        "casts": png(casts_figure(demo)),
    }


def held_out_rms(demo: Demo) -> float:
    """Return the rms prediction error over all links on the held-out part, rad; NaN without one."""
    held = demo.identification.held_out
    return float("nan") if held is None else float(np.sqrt(np.mean(held.rms**2)))


def _parameters_table(demo: Demo) -> TextTable:
    rows = []
    for each in demo.parameters:
        low, high = each.interval
        interval = f"{low:.4g} to {high:.4g}"
        inside = "yes" if each.covered else "no"
        cut = f"{each.cut:.4g}"
        rows.append(
            (
                f"{each.name}, {each.unit}",
                f"{each.guess:.4g}",
                f"{each.value:.4g}",
                interval,
                f"{each.mapped:.4g}",
                inside,
                cut,
            )
        )
    header = ("parameter", "guess", "identified", "95 % interval", "mapped truth", "inside", "plain cut")
    return TextTable(header, tuple(rows))


def _reaches_table(demo: Demo) -> TextTable:
    starts = np.arange(0.0, demo.cast.t[-1] - 0.5 * WINDOW, WINDOW)
    header = ("rope", *(f"{start:.0f}-{start + WINDOW:.0f} s" for start in starts))

    def row(name: str, run: Trajectory) -> tuple[str, ...]:
        x = [np.abs(run.tip[(run.t >= start) & (run.t <= start + WINDOW), 0]).max() for start in starts]
        return (name, *(f"{value:.2f}" for value in x))

    links = demo.cast.q.shape[1], demo.reference.q.shape[1]
    rows = row(f"identified, {links[0]} links", demo.cast), row(f"the rope itself, {links[1]} links", demo.reference)
    return TextTable(header, rows)


def _notes(demo: Demo) -> tuple[str, ...]:
    links = demo.recording.n_links
    mapped = (
        f"Mapped truth: what the same fit finds in the same swing without noise and gaps, the best that {links} links "
        f"can do for a rope of {demo.reference.q.shape[1]}. To move like it, coarse links need other inertia and "
        "friction than the rope simply cut into as many pieces (plain cut); that bias is no error of the camera."
    )
    intervals = f"Intervals: identified value plus and minus {INTERVAL} standard deviations."
    recording = f"Recording: {demo.recording.source}; {demo.recording.gaps} coordinates are missing."
    return mapped, " ".join((intervals, *demo.identification.verdict)), recording


def _summary(demo: Demo, parameters: TextTable, reaches: TextTable, winding: WindingPart) -> str:
    errors = (
        f"Prediction error on the held-out part, 1 s ahead: {1e3 * held_out_rms(demo):.1f} mrad, "
        f"of which the camera's noise alone is {1e3 * float(demo.angle_noise.mean()):.1f} mrad."
    )
    parts = [
        "# Demo: recording, identified rope, cast (simulated)",
        markdown(parameters).rstrip(),
        "\n".join(f"- {note}" for note in _notes(demo)),
        errors,
        "## Greatest |x| of the tip in each 2 s of the cast, m",
        markdown(reaches).rstrip(),
        f"## {winding.section.title}",
        *winding.section.text,
        "\n".join(f"- {sentence}" for _, sentence in winding.verdicts) + "\n",
    ]
    return "\n\n".join(parts)


def _in_short(demo: Demo) -> Section:
    covered = sum(each.covered for each in demo.parameters)
    reach, own = float(np.abs(demo.cast.tip[:, 0]).max()), float(np.abs(demo.reference.tip[:, 0]).max())
    tiles = (
        (f"{covered} of {len(demo.parameters)}", "95 % intervals hold the mapped truth"),
        (f"{1e3 * held_out_rms(demo):.1f} mrad", "prediction error 1 s ahead, on data that the fit has not seen"),
        (f"{1e3 * float(demo.angle_noise.mean()):.1f} mrad", "noise of a measured angle, for comparison"),
        (f"{1e2 * abs(reach - own):.1f} cm", f"between the greatest reaches of the two casts ({reach:.2f} m)"),
    )
    rope, recording = demo.identification.rope, demo.recording
    setup = (
        f"Rope: {rope.total_length:g} m, {rope.total_mass:g} kg. Recording: {recording.t.size} frames over "
        f"{recording.duration:g} s, {recording.n_links + 1} markers, the first "
        f"{demo.identification.settings['fitted_to']:.1f} s fitted. Cast: arm of {1e3 * casting_arm().length:g} mm, "
        f"half a turn in {T_MOVE:g} s, rest {T_REST['success']:g} s, through the bottom."
    )
    return Section("In short", tiles=tiles, text=(setup,))


def _write_page(
    path: Path,
    demo: Demo,
    pictures: dict[str, bytes],
    film: bytes,
    parameters: TextTable,
    reaches: TextTable,
    winding: Section,
) -> None:
    shown = (
        Picture(film, "The identified rope, cast from rest by the paper's motion; simulated."),
        Picture(pictures["strobe"], "One stroke of the arm late in the cast, early instants dark, late ones bright."),
        Picture(pictures["casts"], "Tip to the side: the identified chain beside the rope that made the recording."),
    )
    sections = [
        _in_short(demo),
        winding,
        Section(
            "The paper's cast",
            pictures=shown,
            table=reaches,
            notes=("The table gives the greatest |x| of the tip in each 2 s, m.",),
        ),
        Section(
            "The identified rope",
            pictures=(Picture(pictures["parameters"], "Identified parameters over their mapped truth."),),
            table=parameters,
            notes=_notes(demo),
        ),
        Section(
            "Measured, fitted, predicted",
            text=(_SHADED,),
            pictures=(Picture(pictures["prediction"], "Angles of a link in the middle and of the one at the tip."),),
        ),
    ]
    lead = _LEAD.format(fine=demo.reference.q.shape[1], coarse=demo.recording.n_links)
    write_page(path, "A rope, identified and cast", lead, "simulated", sections)
