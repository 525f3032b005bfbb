"""``hyperflex reproduce``: the paper's figures and claims."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperflex.cli import output


def reproduce(
    figures: Annotated[list[str], typer.Argument(help="fig9, fig10, fig11, fig12 or all.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to; made if need be.")] = Path("paper"),
    json: output.Json = False,
) -> None:
    """Reproduce the paper's figures and check its claims.

    Writes PNG and CSV for each figure, a Markdown table of the claims and a page that shows it all.
    """
    from hyperflex.report.reproduce import reproduce as run
    from hyperflex.report.tables import verdicts

    with output.spinner(json) as tell:
        result = run(figures, out, progress=tell)
    claims = [
        {
            "claim": claim.name,
            "statement": claim.statement,
            "path": claim.reading.path,
            "friction": claim.reading.friction,
            "measured": claim.measured,
            "relation": claim.relation,
            "threshold": claim.threshold,
            "holds": claim.holds,
            "note": claim.note,
        }
        for claim in result.claims
    ]
    if json:
        output.print_json({"files": list(result.files), "claims": claims})
        return
    header = ("claim", "path", "friction", "measured", "needed", "verdict")
    rows = [
        (
            claim.name,
            claim.reading.path,
            claim.reading.friction,
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
