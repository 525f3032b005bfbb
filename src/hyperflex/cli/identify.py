"""``hyperflex identify``: a recording and a first guess in, an identified rope and its report out."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from hyperflex import files, identification, model, motion, report
from hyperflex.checks import ByName
from hyperflex.cli import output
from hyperflex.cli.command import ArcLengths, Given, arcs_of, check_destination, check_no_input, numbers, words
from hyperflex.cli.output import Block, Rows
from hyperflex.errors import InvalidInput
from hyperflex.identification import FitOptions
from hyperflex.recording import FASTEST, Declarations, Recording, read_channels, read_recording

_FILES = {"rope": "rope.toml", "figures": "identification.json", "page": "report.html"}
_WRITTEN = {"rope": "rope", "figures": "numbers", "page": "all results on one page"}


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Options with which a recording is read."""

    kind: Annotated[str | None, "angles or markers."] = None
    time: Annotated[str, "Name of the time column; of messages t or log."] = "t"
    declarations: Annotated[Given, Declarations]
    noise: Annotated[float | None, "Standard deviation of a sample, in its unit."] = None
    columns: Annotated[list[str] | None, "Data columns, or joints, in order, with commas."] = None
    markers: Annotated[list[str] | None, "Markers by the file's names, from the pivot to the tip, with commas."] = None
    topic: Annotated[str | None, "Topic of an MCAP file or a bag that holds several."] = None
    max_rate: Annotated[float, "Rate of an angle, rad/s, above which it is refused as a wrong unit."] = FASTEST
    start: Annotated[float, typer.Option(help="Omit samples before this time, s.", show_default="all")] = -math.inf
    end: Annotated[float, typer.Option(help="Omit samples from this time on, s.", show_default="all")] = math.inf

    def read(self, path: Path) -> Recording:
        """Return a recording."""
        given = vars(self) | {"columns": words(self.columns) or None, "markers": words(self.markers) or None}
        span = given.pop("start"), given.pop("end")
        return read_recording(path, **given.pop("declarations"), **given).window(*span)


@dataclass(frozen=True, kw_only=True)
class Torque:
    """Options for the measured torque of motors, in columns of the recording's file."""

    torque: Annotated[
        list[str] | None,
        "Columns of motor torques, N m (or currents), that drive the joints; with commas.",
    ] = None
    torque_joints: Annotated[
        list[str] | None,
        "Joint of each: 0 that the rope hangs from, 1 the next, ... [default: the first ones]",
    ] = None
    torque_constant: Annotated[
        list[str] | None,
        "Torque over the column: 1 for N m; of a current its torque constant, N m/A. [default: 1]",
    ] = None
    torque_noise: Annotated[
        float | None,
        "Standard deviation of the torque of an arm whose motion is prescribed, in its unit.",
    ] = None

    def read(self, path: Path, reading: Reading) -> ByName:
        """Return what a RecordingSetup takes of it."""
        if (columns := words(self.torque)) is None or not columns:
            given = [name for name, value in vars(self).items() if value]
            if given:
                raise InvalidInput(
                    f"--{given[0].replace('_', '-')} is given without --torque", fix="Name the column: --torque torque"
                )
            return {}
        sense = reading.declarations.get("sense")
        found = read_channels(path, columns, time=reading.time, topic=reading.topic, sense=sense)
        t = replace(reading, start=-math.inf, end=math.inf).read(path).t
        found = found[(t >= reading.start) & (t < reading.end)]
        setup: ByName = {"torque": found[:, 0] if len(columns) == 1 else found}
        if self.torque_joints:
            setup["torque_joints"] = [int(each) for each in numbers("--torque-joints", self.torque_joints, "0,1")]
        if self.torque_constant:
            constants = numbers("--torque-constant", self.torque_constant, "0.05")
            setup["torque_constant"] = constants[0] if len(constants) == 1 else constants
        return setup | ({} if self.torque_noise is None else {"torque_noise": self.torque_noise})


def identify(
    recording: Annotated[Path, typer.Argument(help="CSV, NetCDF, MCAP, .mat file or ROS 2 bag of angles or markers.")],
    rope: Annotated[Path, "TOML file with the rope to begin with: the first guess."],
    out: Annotated[
        Path,
        "Folder for rope.toml, identification.json and report.html, or one .toml.",
    ],
    free: Annotated[
        list[str] | None,
        "What to identify; several times or with commas. [default: what the recording determines]",
    ] = None,
    arc_lengths: ArcLengths = None,
    origin: Annotated[
        tuple[float, float] | None,
        "Position of the first joint (of an arm: its shaft) in the camera's frame, x y, m. [default: fitted]",
    ] = None,
    setup: Annotated[
        Path | None, "TOML file of a set-up (as for simulate) whose motion and arm drive the rope."
    ] = None,
    *,
    reading: Reading,
    torque: Torque,
    fit: Annotated[Given, FitOptions],
    time_budget: Annotated[
        float | None,
        "Time for the fit, s; then the best so far is written. inf: no limit. [default: 1800]",
    ] = None,
) -> None:
    """Identify a rope from a recording.

    The file or the options must declare units, axes and frame rate; they are never guessed. Markers sit at the joints
    unless --arc-lengths, or a file of hyperflex track, says otherwise.

    The first line of the result is its grade: usable, usable for ratios (masses, inertias and frictions share a factor
    that a free swing does not determine), or do not use, with the reason.

    A torque (--torque) drives the joints of a rope that no --setup moves, and fixes the scale of masses and frictions;
    with --free torque_constant and --torque-std the constant of each motor is fitted as well.

    Ctrl-C ends the fit; the best result so far is written, marked as interrupted. The exit code is 3 if the fit did not
    converge or the time was over, and 5 if its result must not be used, for example because a declaration is wrong. The
    rope is written in either case, with the grade.
    """
    folder, inputs = out.suffix == "" or out.is_dir(), [recording, rope, setup]
    if folder:
        report.check_folder(out)
        for name in _FILES.values():
            check_no_input(out / name, inputs)
    else:
        check_destination(out, ".toml", inputs)
    places = arcs_of(arc_lengths)
    driven = {**_drive(setup), **torque.read(recording, reading)}
    measured, guess, chosen = reading.read(recording), model.Rope.from_toml(rope), words(free) or None
    if places is None and measured.kind == "markers" and recording.suffix.lower() == ".nc":
        found = np.atleast_1d(files.read_netcdf(recording).attributes.get("arc_lengths", ()))
        if 2 * found.size == measured.data.shape[1]:  # hyperflex track wrote it: its origin is the first joint
            places, origin = found, origin or (0.0, 0.0)
    placed, options = identification.RecordingSetup(**driven, arc_lengths=places, origin=origin), FitOptions(**fit)
    for fault in measured.check():
        output.note(str(fault))
    how: ByName = {"setup": placed, "options": options, "time_budget": time_budget, "progress": True}
    result, stopped = output.run(lambda: identification.identify(measured, guess, chosen, **how))
    summary = {"output": out, **result.summary()}
    if folder:
        written = files.rescued(lambda path: report.write_found(path, result), out)
        with output.keeping(written, "the page", summary), output.spinner() as progress:
            progress("drawing the report")
            written |= report.identification_page(out / _FILES["page"], measured, result, guess)
    else:
        files.rescued(result.to_toml, out)
        written = {"rope": out}
    unusable = 0 if result.success else output.ExitCode.NOT_USABLE
    output.show(
        summary | {"files": written},
        *_blocks(result, str(written.get("page", "the folder"))),
        Rows("Written", [(_WRITTEN[kind], path) for kind, path in written.items()]),
        interrupted=f"Interrupted; the best so far is in {out}, marked as interrupted." if stopped else "",
        code=unusable if result.converged and result.ended is None else output.ExitCode.NOT_CONVERGED,
    )


def _drive(path: Path | None) -> ByName:
    """Return the motion and the arm of a set-up."""
    if path is None:
        return {}
    setup = model.Setup.from_toml(path)
    if setup.torque_driven:
        fix = 'Measure the arm\'s angle and give it as motion = {kind = "file", path = "arm.csv"}; or make the arm the '
        fix += "first link of the rope, and name the column of its torque (--torque)"
        raise InvalidInput(f"{path} drives its arm by a torque", allowed="a motion", fix=fix)
    return {"motion": setup.motion or motion.hold_arm(0.0), "arm": setup.arm}


def _blocks(found: "identification.Identification", whole: str) -> Iterator[Block]:
    """Yield the grade, the fit, tables of parameters and ratios; `whole` is where the whole tables are."""
    unit = report.readable_unit(found.unit, found.residual_rms)
    rows = [("ended", str(found.status)), ("fit error, rms", f"{found.residual_rms_all / unit.size:.3g} {unit.name}")]
    if (held := found.held_out) is not None:
        rows.append((f"prediction error over {held.ahead:g} s, rms", " ".join(report.predicted(found)).rstrip()))
    yield from found.report().splitlines()
    chosen = [
        identification.text(each)
        for each in found.findings
        if each.kind is identification.Kind.CHOSEN and each.values["added"]
    ]
    yield from (each for each in chosen if each not in found.report())
    if "gravity_angle" in found.values:
        yield "gravity_angle is the camera's turn: the rope's file keeps the gravity of the guess."
    yield Rows("Fit", rows)
    for table in filter(None, (report.parameters_table(found, None), report.ratios_table(found))):
        first = [row[0] for row in table.rows]
        # five rows of one ratio at most, and 24 in all: a screen
        kept = [row for k, row in enumerate(table.rows) if first[:k].count(row[0]) < 5][:24]
        shown = [k for k, name in enumerate(table.header) if name != "what it is"]
        header, *lines = (tuple(row[k] for k in shown) for row in (table.header, *kept))
        yield report.TextTable(header, tuple(lines))
        if len(table.rows) > len(kept):
            yield f"  and {len(table.rows) - len(kept)} more, in {whole}"
