"""``hyperflex demo``: from a recording to an identified rope to a cast, with a report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from hyperflex.cli import output
from hyperflex.cli.output import Rows
from hyperflex.cli.warm import compiling_ahead

if TYPE_CHECKING:
    from hyperflex.demo import Parameter

AHEAD = ("dry", "batch", "contact", "wound", "plan")  # kernels of the fit and the plan, compiled during the tracking
_SHOWN = ("parameter", "identified", "95 % interval", "without noise", "inside")


def demo(
    out: Annotated[Path, "Folder to write to."] = Path("demo-output"),
) -> None:
    """Track a filmed rope, identify it, and plan a cast of it.

    The video comes with the package and is simulated, with a finer chain than the one identified.
    """
    from hyperflex.demo import write_demo
    from hyperflex.report import TextTable

    with compiling_ahead(*AHEAD), output.spinner() as progress:
        found = write_demo(out, progress)
    table, held = found.table, found.held
    error, noise = found.held_out_rms, found.angle_noise.mean()
    result = {
        "source": "simulated",
        "files": found.files,
        "success": found.identification.success,
        "status": found.identification.status,
        "message": found.identification.message,
        "parameters": {each.name: _parameter(each) for each in found.parameters},
        "held_out_rms_rad": error,
        "angle_noise_rad": noise,
        "plan": found.plan.summary(),
        "hold_force_N": None if held is None else held.force,
        "recorded_rope_winds": None if found.proof is None else found.proof.success,
    }
    shown = [table.header.index(name) for name in _SHOWN]
    files = {
        "page": "all results on one page, with the cast to play",
        "motion": "the motion for the motor, which winds the rope round a target",
        "tracked": "the markers that were tracked in the video",
        "rope": "the identified rope, with its figures",
    }
    rows = [
        ("prediction error 1 s ahead, held out", f"{1e3 * error:.1f} mrad (camera noise {1e3 * noise:.1f})"),
        *([] if held is None else [("holding force by a tug", f"{held.force:.2f} N")]),
    ]
    output.show(
        result,
        TextTable(_SHOWN, tuple(tuple(row[k] for k in shown) for row in table.rows)),
        Rows("Everything here is simulated", rows),
        *(sentence for _, sentence in found.verdicts),
        Rows("Written", [(text, found.files[kind]) for kind, text in files.items() if kind in found.files]),
    )


def _parameter(each: "Parameter") -> dict[str, Any]:
    """Return an identified parameter for JSON."""
    return {
        "unit": each.unit,
        "guess": each.guess,
        "value": each.value,
        "std": each.std,
        "interval_95": each.interval,
        "without_noise": each.mapped,
        "covered": each.covered,
        "plain_cut": each.cut,
    }
