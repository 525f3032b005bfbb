"""The last part of the demo: the identified rope wound round a target, and the same throw by the rope itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hyperflex.demo.run import Demo
from hyperflex.planning import HoldingForce, measure_holding_force
from hyperflex.report.cast import words
from hyperflex.report.cast.folder import draw, shown_pictures
from hyperflex.report.page import Section

_FILM = "wound.gif"
_OWN = (
    "The rope is planned with as it was identified, {coarse} links (cut shorter near the target); what it then does is "
    "simulated with the same model, and again with shorter links."
)


@dataclass(frozen=True, eq=False)
class WindingPart:
    """What became of the last part of the demo.

    Attributes
    ----------
    files : dict of str to str
        Names of the files by what they are.
    section : Section
        Of the page.
    verdicts : tuple of (bool, str)
        Whether the plan stands, and whether the rope that made the recording winds by the same throw.
    held : HoldingForce or None
        What the wound rope bore.
    """

    files: dict[str, str]
    section: Section
    verdicts: tuple[tuple[bool, str], ...]
    held: HoldingForce | None


def write_winding(folder: Path, demo: Demo, tell: Callable[[str], None]) -> WindingPart:
    """Write the planned cast into `folder`: motion, set-up, verified run, pictures, film."""
    plan, held, names, contents = demo.plan, None, {}, {}
    if plan.motion is not None:
        names = {"motion": "motion.csv", "plan": "plan.toml"}
        plan.to_csv(folder / names["motion"])
        plan.to_toml(folder / names["plan"])
    if plan.outcome is not None and plan.outcome.run is not None:
        tell("tugging at the rope")
        held = measure_holding_force(plan.required(plan.run, "run"), plan.target) if plan.outcome.wound else None
        names["wound"] = "wound.nc"
        plan.to_netcdf(folder / names["wound"])
        drawn = draw(folder, plan, held, tell, _FILM)
        names |= {("wound_film" if kind == "film" else kind): path.name for kind, path in drawn.items()}
        contents = {kind: path.read_bytes() for kind, path in drawn.items()}
    verdicts = ((plan.success, words.verdict(plan)), *_proof(demo))
    section = Section(
        "The identified rope, wound round a target",
        text=(*words.story(plan, held), _OWN.format(coarse=demo.recording.n_links)),
        tiles=words.tiles(plan, held),
        marks=verdicts,
        pictures=tuple(shown_pictures(contents).values()),
        table=words.checks_table(plan),
        notes=(words.search_words(plan),),
    )
    return WindingPart(names, section, verdicts, held)


def _proof(demo: Demo) -> tuple[tuple[bool, str], ...]:
    """Say what the rope that made the recording does in the same throw."""
    proof = demo.proof
    if proof is None:
        return ()
    who = f"The rope that made the recording ({demo.reference.q.shape[1]} links), thrown by the same motion"
    if proof.success:
        return ((True, f"{who}, winds {abs(proof.turns):.2f} turns and holds too."),)
    return ((False, f"{who}, does not: {words.plain(proof.message)}. The identified rope is not quite that rope."),)
