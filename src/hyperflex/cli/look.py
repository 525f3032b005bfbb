"""``hyperflex look``: what a file of a recording holds, drawn, and the line that reads it."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex import recording, report
from hyperflex.cli import output
from hyperflex.cli.command import check_destination
from hyperflex.cli.output import Rows
from hyperflex.errors import listed


def look(
    file: Annotated[Path, typer.Argument(help="Recording of any format: of a motion tracker, a logger or a program.")],
    out: Annotated[Path | None, "Picture of the recording to write, .png. [default: none]"] = None,
) -> None:
    """Show what a recording contains, and how to read it.

    The format is recognised by the content. For declarations that the file lacks, the proposed command has likely
    values. The command lists them: check them, because they are never assumed when a file is read.
    """
    check_destination(out, ".png", [file])
    found = recording.propose(file)
    content, read = found.content, found.recording
    python, command = recording.python_line(file, found), _command(file, found.arguments)
    chosen = found.arguments.get("markers") or found.arguments.get("columns")
    names = list(chosen or content.points or content.angles or content.names)
    holds = "markers" if content.points else "angles" if content.angles or chosen else "columns"
    widths = {name: content.widths.get(name, 1) for name in names}
    result: dict[str, Any] = {
        "file": file,
        "format": found.format,
        "holds": holds,
        "names": names,
        "unused": list(found.unused),
        "samples": content.t.size,
        "declared": {**content.usual, **content.declared},
        "assumed": list(found.assumed),
        "arguments": dict(found.arguments),
        "python": python if read is not None else None,
        "command": command if read is not None else None,
        "problem": found.problem or None,
    }
    rows = [("format", found.format), (holds, f"{sum(widths.values())}: {_named(content, names)}")]
    if found.unused:
        hint = "" if content.points else " (a motor's torque: --torque NAME)"
        rows.append(("not used", _named(content, found.unused) + hint))
    if read is not None:
        step = read.duration / (read.t.size - 1)
        gaps = read.gaps / read.data.size
        result |= {"start_s": read.t[0], "end_s": read.t[-1], "rate_hz": 1.0 / step, "gaps": gaps}
        result |= {
            "epoch_s": read.epoch,
            "out_of_plane_m": read.out_of_plane,
            "tilt_rad": read.tilt,
            "read": read.convention,
        }
        rows.append(("samples", f"{read.t.size}, {read.t[0]:g} to {read.t[-1]:g} s, {1.0 / step:.4g} a second"))
        rows += [("missing", f"{100.0 * gaps:.2g} %")] if read.gaps else []
        rows += [("epoch", f"{read.epoch:.3f} s since 1970")] if read.epoch is not None else []
        rows.append(("read as", read.convention.partition("; read ")[2] or read.convention))
    rows += [("declared by the file", _text(result["declared"]))] if result["declared"] else []
    rows += (
        [("assumed, to be checked", _text({key: found.arguments[key] for key in found.assumed}))]
        if found.assumed
        else []
    )
    rows += [("but", found.problem)] if found.problem else []
    if out is not None and read is not None:
        labels = [f"{name} {k}" if name in content.widths else name for name in names for k in range(widths[name])]
        report.save_png(report.recording_figure(read, tuple(labels)), out)
        result |= {"output": out, "bytes": out.stat().st_size}
        rows.append(("picture", str(out)))
    lines = [Rows("To read it", [("Python", python), ("shell", command)])] if read is not None else []
    output.show(result, Rows(str(file), rows), *lines)


def _command(file: Path, arguments: Mapping[str, Any]) -> str:
    """Return the command that identifies a rope with the file."""
    words = ["hyperflex", "identify", str(file), "--rope", "rope.toml"]
    for key, value in arguments.items():
        option = f"--{key.replace('_', '-')}"
        words += [option] if value is True else [option, ",".join(value) if isinstance(value, list) else str(value)]
    return shlex.join([*words, "-o", "identified"])


def _named(content: "recording.Content", names: Sequence[str]) -> str:
    """Return names of channels, with the number of their columns where they have several."""
    widths = content.widths
    return listed([f"{name} ({widths[name]} columns)" if name in widths else name for name in names])


def _text(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {listed(value) if isinstance(value, list) else value}" for key, value in values.items())
