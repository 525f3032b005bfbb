"""``hyperflex reproduce``: the paper's figures and claims."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex.cli import output

if TYPE_CHECKING:
    from hyperflex.paper import Claim


def reproduce(
    figures: Annotated[list[str], typer.Argument(help="table1, table2, fig3, fig5, fig6, fig8 to fig13, or all.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; made if need be.")] = Path("paper"),
    json: output.Json = False,
) -> None:
    """Reproduce the paper's figures and check its claims.

    Tables I and II and Figs. 3, 5 and 6 are on identification (claims C6, C7), Fig. 8 on online estimation (C8),
    Figs. 9 to 12 on casting (C1 to C4), Fig. 13 on timing control (C5).
    Writes PNG and CSV for each figure, CSV for each table, a Markdown table of the claims and a page that shows it all.
    Ctrl-C leaves the figures and tables that are done.
    """
    from hyperflex.paper import reproduce as run
    from hyperflex.paper import verdicts
    from hyperflex.report import check_folder

    check_folder(out)
    written: dict[str, Path] = {}
    missing = "the figures not named here, the claims and the page"
    with output.keeping(written, missing, {}, as_json=json), output.spinner() as progress:
        result = run(figures, out, progress=progress, written=lambda path: written.update({path.name: path}))
    claims = [_plain(claim) for claim in result.claims]
    if json:
        output.print_json({"files": list(result.files), "claims": claims})
        return
    header = ("claim", "in", "measured", "needed", "verdict")
    rows = [
        (
            claim.name,
            claim.case.title,
            f"{claim.measured:.4g}",
            f"{claim.relation} {claim.threshold:g}",
            "holds" if claim.holds else "does not hold",
        )
        for claim in result.claims
    ]
    output.print_table(header, rows)
    output.print_pairs("Written", [(path.name, str(path)) for path in result.files])
    for sentence in verdicts(result.claims):
        output.console().print(sentence)


def _plain(claim: "Claim") -> dict[str, Any]:
    """Return a claim as JSON has it."""
    from hyperflex.paper import Reading

    reading = claim.case
    left_open = {"path": reading.path, "friction": reading.friction} if isinstance(reading, Reading) else {}
    return {
        "claim": claim.name,
        "statement": claim.statement,
        "in": reading.title,
        **left_open,
        "measured": claim.measured,
        "relation": claim.relation,
        "threshold": claim.threshold,
        "holds": claim.holds,
        "note": claim.note,
    }
