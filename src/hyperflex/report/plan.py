"""The report of a plan, cast or whip: a folder with page, figures, film, the motor's motion and the verified run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.planning import CastPlan, MotorLimits, Thrower, WhipPlan
from hyperflex.planning.files import RATE
from hyperflex.report.animation import animate
from hyperflex.report.folder import Progress, silent, whole_folder
from hyperflex.report.page import Picture, Section, TextTable, write_page
from hyperflex.report.style import save_png
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plan = CastPlan | WhipPlan
NOT_KNOWN = "not known"
_FILM_RATE, _FILM_WIDTH = 20, 560  # frames a second, pixels


@dataclass(frozen=True, eq=False)
class PlanReport:
    """What the report of a plan says and shows.

    Attributes
    ----------
    plan : CastPlan or WhipPlan
    name : str
        Stem of the file names.
    run : Trajectory or None
        The verified run; None where there is none that was finished.
    title, lead, verdict, setup : str
        Heading, the paragraph under it, whether the plan succeeds, and rope, arm and target as given.
    tiles : tuple of (str, str)
        Key figures: value and what it is.
    advice, story : tuple of str
        Paragraphs: what would help a plan that fails; what happens, in order.
    checks, checks_note : TextTable, tuple of str
        Results of the verified runs, with the links as planned and with finer ones.
    captions : dict of str to str
        Of the film and of every figure that there may be, by name.
    figures : dict of str to callable
        Each draws a figure of the run; some that have a caption may be missing.
    layout : dict of str to tuple of str
        Headings of the page's sections with pictures, and the names of these.
    film : dict of str to object
        Arguments of :func:`hyperflex.report.animation.animate`.
    without_run : tuple of Section
        Shown where there is no run.
    others : dict of str to CastPlan or None
        Further plans whose set-up is written, by name; None for one that is not there.
    """

    plan: Plan
    name: str
    run: Trajectory | None
    title: str
    lead: str
    verdict: str
    setup: str
    tiles: tuple[tuple[str, str], ...]
    advice: tuple[str, ...]
    story: tuple[str, ...]
    checks: TextTable
    captions: Mapping[str, str]
    figures: Mapping[str, Callable[[], Figure]]
    layout: Mapping[str, tuple[str, ...]]
    film: Mapping[str, Any]
    checks_note: tuple[str, ...] = ()
    without_run: tuple[Section, ...] = ()
    others: Mapping[str, CastPlan | None] = field(default_factory=dict)


def write_plan(
    directory: str | Path, report: PlanReport, *, rate: float = RATE, progress: Progress = silent
) -> dict[str, Path]:
    """Write the report of a plan.

    Parameters
    ----------
    directory : str or Path
        Folder to write to, wholly or not at all; made if it is not there. Files of an earlier report of the kind are
        replaced or removed; others stay.
    report : PlanReport
    rate : float
        Rows a second of the motor's file, Hz.
    progress : callable
        Called with a message on what is being done.

    Returns
    -------
    dict of str to Path
        The files: "page", "motion", "plan" (its set-up), "run", "film", and the figures by name; those there are.

    Raises
    ------
    FileProblem
        The folder cannot be made or written to.
    """
    own = [f"{report.name}.{kind}" for kind in ("toml", "nc", "gif")]
    own += [f"{name}.toml" for name in report.others] + [f"{name}.png" for name in report.captions]
    with whole_folder(directory, ["report.html", "motion.csv", *own]) as stage:
        names = write_results(stage, report, rate=rate, progress=progress)
        names["page"] = "report.html"
        sections = _sections(report, pictures(stage, report, names))
        write_page(stage / "report.html", report.title, report.lead, "simulated", sections)
    return {kind: Path(directory) / name for kind, name in names.items()}


def write_results(
    folder: Path, report: PlanReport, *, rate: float = RATE, progress: Progress = silent
) -> dict[str, str]:
    """Write everything but the page to `folder`; return the names of the files by what they are."""
    plan, run = report.plan, report.run
    names = {}
    for name, other in report.others.items():
        if other is not None:
            names[name] = f"{name}.toml"
            other.to_toml(folder / names[name])
    if plan.motion is not None:
        names |= {"motion": "motion.csv", "plan": f"{report.name}.toml"}
        plan.to_csv(folder / names["motion"], rate=rate)
        plan.to_toml(folder / names["plan"])
    if run is not None:
        names |= {"run": f"{report.name}.nc", "film": f"{report.name}.gif"} | {
            kind: f"{kind}.png" for kind in report.figures
        }
        plan.to_netcdf(folder / names["run"])
        progress("drawing")
        for kind, draw in report.figures.items():
            save_png(draw(), folder / names[kind])
        animate(
            run,
            folder / names["film"],
            frame_rate=_FILM_RATE,
            width=_FILM_WIDTH,
            progress=lambda done, total: progress(f"filming, frame {done} of {total}"),
            **report.film,
        )
    return names


def pictures(folder: Path, report: PlanReport, names: Mapping[str, str]) -> dict[str, Picture]:
    """Return what :func:`write_results` drew, with captions."""
    shown = {kind: caption for kind, caption in report.captions.items() if kind in names}
    return {kind: Picture((folder / names[kind]).read_bytes(), caption) for kind, caption in shown.items()}


def _sections(report: PlanReport, shown: Mapping[str, Picture]) -> list[Section]:
    plan, verdict = report.plan, (report.plan.success, report.verdict)
    search = (search_summary(plan),)
    sections = [Section("In short", verdict=verdict, text=report.advice, tiles=report.tiles, notes=search)]
    if report.run is None:
        sections += report.without_run
    if report.story:
        sections.append(Section("The plan" if report.run is None else "What happens", text=report.story))
    for title, kinds in report.layout.items():
        if own := tuple(shown[kind] for kind in kinds if kind in shown):
            sections.append(Section(title, pictures=own))
    if plan.motion is not None:
        sections.append(Section("Check with a finer rope", table=report.checks, notes=report.checks_note))
        sections.append(Section("Motor", table=_motor_table(plan, report.run)))
    return [*sections, Section("Set-up", text=(report.setup,))]


def _motor_table(plan: Plan, run: Trajectory | None) -> TextTable:
    """Return what a plan demands of the motor, beside the motor's limits."""
    limits: MotorLimits = plan.thrower.limits
    motion = plan.motion
    if motion is None:
        return TextTable(("motor", "needed", "limit"), ())
    t = np.linspace(0.0, float(motion.breaks[-1]), 4001)
    rows = []
    for name, values, limit, unit in (
        ("speed", motion.rate(t), limits.speed, "rad/s"),
        ("acceleration", motion.acceleration(t), limits.acceleration, "rad/s²"),
        ("torque for the rope", None if run is None else run.motor_torque, limits.torque, "N m"),
    ):
        needed = NOT_KNOWN if values is None else f"{np.abs(values).max():.3g} {unit}"
        rows.append((f"greatest {name}", needed, f"{limit:.3g} {unit}" if math.isfinite(limit) else "none given"))
    return TextTable(("motor", "needed", "limit"), tuple(rows))


def rope_and_arm(setup: Thrower) -> str:
    """Return rope and arm in words, each with a full stop."""
    rope = setup.rope
    name = f" ({rope.name})" if rope.name else ""
    tip = f", tip weight {1e3 * rope.tip_mass:.3g} g" if rope.tip_mass else ""
    return (
        f"Rope{name}: {rope.total_length:.4g} m, {1e3 * rope.total_mass:.4g} g, radius {1e3 * rope.radius:.3g} mm, "
        f"{rope.n_links} links{tip}. Arm: {1e3 * setup.arm.length:.4g} mm."
    )


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def searched(plan: Plan) -> bool:
    """Whether a search was made, or at least begun."""
    return bool(plan.runs) or plan.interrupted or plan.motion is not None


def source(plan: Plan) -> str:
    """Return in a sentence where a plan comes from."""
    if plan.success:
        how = "Planned and verified by simulation"
    else:
        how = "Searched for by simulation" if searched(plan) else "Checked for feasibility, without a search"
    return f"{how}; nothing here was measured."


def search_summary(plan: Plan) -> str:
    """Return in a sentence what the search took."""
    if not searched(plan):
        return "No search was made: the feasibility check refused the target."
    ended = ", interrupted before its end" if plan.interrupted else ""
    return f"The search took {plan.seconds:.0f} s and {counted(plan.runs, 'simulated run')}{ended}."
