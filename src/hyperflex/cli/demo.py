"""``hyperflex demo``: from a recording to an identified rope to a cast, with a report."""

from pathlib import Path
from typing import Annotated

from hyperflex.cli import output
from hyperflex.cli.output import Rows
from hyperflex.cli.warm import compiling_ahead

AHEAD = ("dry", "batch", "contact", "wound", "plan")  # kernels of the fit and the plan, compiled during the tracking
_WRITTEN = {
    "page": "all results on one page, with the cast to play",
    "motion": "the motion for the motor, which winds the rope round a target",
    "tracked": "the markers that were tracked in the video",
    "rope": "the identified rope, with its figures",
}


def demo(
    out: Annotated[Path, "Folder to write to."] = Path("demo-output"),
) -> None:
    """Track a filmed rope, identify it, and plan a cast of it.

    The video comes with the package and is simulated, with a finer chain than the one identified.
    """
    from hyperflex.cli.identify import blocks
    from hyperflex.demo import write_demo

    with compiling_ahead(*AHEAD), output.spinner() as progress:
        found = write_demo(out, progress)
    force = None if found.held is None else found.held.force
    result = {
        "source": "simulated",
        "files": found.files,
        "success": found.identification.success,
        "status": found.identification.status,
        "message": found.identification.message,
        "identification": found.identification.summary(),
        "plan": found.plan.summary(),
        "hold_force_N": force,
        "recorded_rope_winds": None if found.proof is None else found.proof.success,
    }
    output.show(
        result,
        "Everything here is simulated. The rope, as identified from the video:",
        *blocks(found.identification, str(found.files["page"])),
        *(sentence for _, sentence in found.verdicts),
        *([] if force is None else [f"Holding force by a tug: {force:.2f} N."]),
        Rows("Written", [(text, found.files[kind]) for kind, text in _WRITTEN.items() if kind in found.files]),
    )
