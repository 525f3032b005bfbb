"""``hyperflex demo``: from a recording to an identified rope to a cast, with a report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex.cli import output

if TYPE_CHECKING:
    from hyperflex.demo import DemoReport

_SHOWN = ("parameter", "identified", "95 % interval", "without noise", "inside")


def demo(
    out: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path("demo-output"),
    json: output.Json = False,
) -> None:
    """Track a filmed rope, identify it, plan a cast that winds it round a target, and show the result.

    The video comes with the package and is simulated, with a finer chain than the one identified.
    """
    from hyperflex.demo import write_demo

    with output.spinner() as progress:
        report = write_demo(out, progress)
    if json:
        output.print_json(_figures(report))
    else:
        _show(report)


def _figures(report: "DemoReport") -> dict[str, Any]:
    """Return what the demo found, for JSON."""
    found = report.demo
    parameters = {
        each.name: {
            "unit": each.unit,
            "guess": each.guess,
            "value": each.value,
            "std": each.std,
            "interval_95": each.interval,
            "without_noise": each.mapped,
            "covered": each.covered,
            "plain_cut": each.cut,
        }
        for each in found.parameters
    }
    return {
        "source": "simulated",
        "files": report.files,
        **found.identification.ending(),
        "parameters": parameters,
        "held_out_rms_rad": found.held_out_rms,
        "angle_noise_rad": found.angle_noise.mean(),
        "plan": found.plan.summary(),
        "hold_force_N": None if report.demo.held is None else report.demo.held.force,
        "recorded_rope_winds": None if found.proof is None else found.proof.success,
    }


def _show(report: "DemoReport") -> None:
    """Print what the demo found, and its main files."""
    table, figures = report.parameters, _figures(report)
    shown = [table.header.index(name) for name in _SHOWN]
    output.print_table(_SHOWN, [[row[k] for k in shown] for row in table.rows])
    error, noise = 1e3 * figures["held_out_rms_rad"], 1e3 * figures["angle_noise_rad"]
    output.print_pairs(
        "Everything here is simulated",
        [("prediction error 1 s ahead, held out", f"{error:.1f} mrad (camera noise {noise:.1f})")],
    )
    if report.demo.held is not None:
        output.console().print(f"Hold force by a tug: {report.demo.held.force:.2f} N.", markup=False)
    for _, sentence in report.verdicts:
        output.console().print(sentence, markup=False)
    wound = {"motion": "the motion for the motor, which winds the rope round a target"}
    output.print_pairs(
        "Look at",
        [
            ("the whole story on one page, with the cast to play", str(report.files["page"])),
            *((words, str(report.files[kind])) for kind, words in wound.items() if kind in report.files),
            ("what was tracked in the video", str(report.files["tracked"])),
            ("the identified rope, with its figures", str(report.files["rope"])),
        ],
    )
