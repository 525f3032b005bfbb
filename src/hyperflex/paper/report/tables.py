"""Tables of the paper's claims and casts, and the claims' verdicts in words."""

from __future__ import annotations

from collections.abc import Sequence

from hyperflex.paper import OUTCOMES, READINGS, T_REST, Claim, Reading, cast, reach_table
from hyperflex.report.tables import TextTable


def claims_table(claims: Sequence[Claim]) -> TextTable:
    """Return measured values, thresholds and verdicts of the paper's claims."""
    rows = tuple(
        (
            claim.name,
            claim.statement,
            claim.reading.title,
            f"{claim.measured:.3g}" if claim.measured < 0.1 else f"{claim.measured:.4f}",
            f"{claim.relation} {claim.threshold:g}",
            "holds" if claim.holds else "does not hold",
            claim.note,
        )
        for claim in claims
    )
    return TextTable(("claim", "what is measured", "in", "value", "threshold", "verdict", "note"), rows)


def verdicts(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Return a sentence for each claim on where it holds and where not."""
    sentences = []
    for name in dict.fromkeys(claim.name for claim in claims):
        own = [claim for claim in claims if claim.name == name]
        titles = list(dict.fromkeys(claim.reading.title for claim in own))
        broken = [title for title in titles if not all(c.holds for c in own if c.reading.title == title)]
        kept = [title for title in titles if title not in broken]
        what = "readings" if isinstance(own[0].reading, Reading) else "swings"
        if not broken:
            sentences.append(f"{name} holds in all {len(titles)} {what}.")
        elif not kept:
            sentences.append(f"{name} holds in none of the {len(titles)} {what}.")
        else:
            sentences.append(
                f"{name} holds in {len(kept)} of {len(titles)} {what} ({'; '.join(kept)}), "
                f"not in the others ({'; '.join(broken)})."
            )
    return tuple(sentences)


def reaches_table() -> TextTable:
    """Return the greatest ``|x|`` of the tip in each 2 s, for every reading and outcome."""
    rows = []
    for reading in READINGS:
        for outcome in OUTCOMES:
            reaches = reach_table(cast(reading, outcome))
            rest = f"{outcome} (rest {T_REST[outcome]:.2f} s)"
            rows.append((reading.title, rest, *(f"{reach:.2f}" for reach in reaches)))
    windows = tuple(f"{2 * k}-{2 * k + 2} s" for k in range(len(rows[0]) - 2))
    return TextTable(("reading", "cast", *windows), tuple(rows))
