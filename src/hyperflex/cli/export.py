"""``hyperflex export``: a set-up as MuJoCo's model and back, a run or a recording as MCAP."""

import warnings
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hyperflex.cli import output
from hyperflex.errors import InvalidInput

WAYS = {".toml": ".xml", ".xml": ".toml"}  # of what else is read, an .mcap


def export(
    source: Annotated[
        Path,
        typer.Argument(help="Set-up (.toml), its MJCF (.xml), run (.nc) or recording (.nc, .mat, .csv, .mcap)."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .xml of a set-up, .toml of MJCF, .mcap of a run or recording.",
        ),
    ],
    json: output.Json = False,
) -> None:
    """Write a set-up as a MuJoCo model (MJCF), or a run or a recording as an MCAP file for Foxglove.

    An MJCF file that was written by hyperflex becomes a set-up again. What MuJoCo cannot say is refused by name. The
    file of a recording has to declare its own units and axes.
    """
    from hyperflex import files
    from hyperflex.exchange import read_mjcf, write_mjcf
    from hyperflex.model import Setup

    suffix = source.suffix.lower()
    output.check_destination(out, WAYS.get(suffix, ".mcap"), [source])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        if suffix == ".toml":
            files.rescued(partial(write_mjcf, Setup.from_toml(source)), out)
        elif suffix == ".xml":
            files.rescued(read_mjcf(source).to_toml, out)
        else:
            _messages(source, out)
    notes = [str(each.message) for each in told if each.category is UserWarning]
    result = {"output": out, "bytes": out.stat().st_size, "warnings": notes}
    words = [("written", f"{out} ({out.stat().st_size / 1e3:.0f} kB)"), *(("beware", each) for each in notes)]
    output.show(result, f"Exported {source}", words, as_json=json)


def _messages(source: Path, out: Path) -> None:
    """Write a run or a recording as an MCAP file."""
    from hyperflex import files
    from hyperflex.exchange import write_mcap
    from hyperflex.recording import read_recording
    from hyperflex.trajectory import read_trajectory

    known = str(files.read_netcdf(source).attributes.get("format")) if source.suffix.lower() == ".nc" else ""
    try:
        held = read_trajectory(source) if known.startswith("hyperflex trajectory") else read_recording(source)
    except InvalidInput as error:
        fix = "Export files that declare all of it, or in Python write_mcap(read_recording(.., unit=..), ..)"
        raise InvalidInput(error.what, got=error.got, allowed=error.allowed, fix=fix) from None
    files.rescued(partial(write_mcap, held), out)
