"""``hyperflex export``: a set-up as MuJoCo's model and back, a run or a recording as MCAP."""

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex import exchange, files, model
from hyperflex.cli import output
from hyperflex.cli.command import check_destination
from hyperflex.cli.identify import Reading

_WRITTEN = {".toml": ".xml", ".xml": ".toml"}  # the suffix that each becomes; all others become .mcap


def export(
    source: Annotated[
        Path, typer.Argument(help="Set-up (.toml), its MJCF (.xml), run (.nc) or recording (.nc, .mat, .csv, .mcap).")
    ],
    out: Annotated[
        Path,
        "File to write: .xml of a set-up, .toml of MJCF, .mcap of the others.",
    ],
    *,
    reading: Reading,
) -> None:
    """Convert a set-up to MuJoCo, or a run or recording to MCAP.

    An MJCF file that hyperflex wrote becomes a set-up again. Features that MuJoCo cannot express are refused by name.
    The file or the options must declare the units and axes of a recording.
    """
    check_destination(out, _WRITTEN.get(source.suffix.lower(), ".mcap"), [source])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        files.rescued(_writer(source, reading), out)
    notes = [str(each.message) for each in caught if each.category is UserWarning]
    result = {"output": out, "bytes": out.stat().st_size, "warnings": notes}
    output.show(result, output.rows(f"Exported {source}", result))


def _writer(source: Path, reading: Reading) -> Callable[[Path], Any]:
    """Return the function that writes what a file becomes."""
    from hyperflex.trajectory import read_trajectory

    suffix = source.suffix.lower()
    if suffix == ".toml":
        return partial(exchange.write_mjcf, model.Setup.from_toml(source))
    if suffix == ".xml":
        return exchange.read_mjcf(source).to_toml
    if suffix == ".nc" and str(files.read_netcdf(source).attributes.get("format")).startswith("hyperflex trajectory"):
        return partial(exchange.write_mcap, read_trajectory(source))
    return partial(exchange.write_mcap, reading.read(source))
