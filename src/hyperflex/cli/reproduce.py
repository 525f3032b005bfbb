"""``hyperflex reproduce``: the paper's figures and claims."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex.cli import output
from hyperflex.cli.output import Rows


def reproduce(
    figures: Annotated[list[str], typer.Argument(help="table1, table2, fig3, fig5, fig6, fig8 to fig13, or all.")],
    out: Annotated[Path, "Folder to write to; made if it does not exist."] = Path("paper"),
) -> None:
    """Reproduce the paper's figures and check its claims.

    Tables I and II and Figs. 3, 5 and 6 are on identification (claims C6, C7), Fig. 8 on online estimation (C8), Figs.
    9 to 12 on casting (C1 to C4), Fig. 13 on timing control (C5). The command writes PNG and CSV for each figure, CSV
    for each table, a Markdown table of the claims and a page with all results. Ctrl-C keeps complete figures and
    tables.
    """
    from hyperflex.paper import claims_table, verdicts
    from hyperflex.paper import reproduce as run
    from hyperflex.report import check_folder

    check_folder(out)
    written: dict[str, Path] = {}
    missing = "the figures not named here, the claims and the page"
    with output.keeping(written, missing, {}), output.spinner() as progress:
        result = run(figures, out, progress=progress, written=lambda path: written.update({path.name: path}))
    claims: list[dict[str, Any]] = []
    for claim in result.claims:
        own = {"claim": claim.name, "in": claim.case.title, "holds": claim.holds}
        reading = {name: value for name, value in vars(claim.case).items() if name in ("path", "friction")}
        values = asdict(claim)
        claims.append(own | reading | {each: values[each] for each in values if each not in ("name", "case")})
    output.show(
        {"files": list(result.files), "claims": claims},
        claims_table(result.claims, short=True),
        Rows("Written", [(path.name, path) for path in result.files]),
        "\n".join(verdicts(result.claims)),
    )
