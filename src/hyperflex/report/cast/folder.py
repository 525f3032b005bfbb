"""The folder of a planned cast: a page, pictures, a film, the motion for the motor, the verified run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import fill

import numpy as np

from hyperflex import winding
from hyperflex.planning import MAX_SLIP, RATE, CastPlan, HoldingForce, measure_holding_force
from hyperflex.report.animation import animate
from hyperflex.report.cast import words
from hyperflex.report.cast.figures import course_figure, sense_of, strike_figure, tug_figure, way
from hyperflex.report.cast.place import place_caption, place_figure
from hyperflex.report.folder import Tell, whole_folder, write_figures
from hyperflex.report.page import Picture, Section, write_page
from hyperflex.report.style import png

_FILM_RATE, _FILM_WIDTH = 20, 560  # frames a second, pixels
_LINE = 90  # letters that fit beside each other in a film
_TOLD = 2.0  # s of the end of a film in which the hold force is shown
# All that a cast may leave; an earlier one's motion beside another's page would be taken for its own
FILES = (
    "report.html",
    "motion.csv",
    "cast.toml",
    "nearest.toml",
    "cast.nc",
    "cast.gif",
    "strike.png",
    "course.png",
    "tug.png",
)
_CAPTIONS = {
    "film": "The cast as it is planned, simulated: arm (white), rope (yellow), target (red).",
    "strike": "The rope about the strike, early instants dark, late ones bright; simulated.",
    "course": "Arm angle, turns, tension and torque over time. Dashed red: the strike. Green: the rope is watched.",
    "tug": "The simulated tug that gives the hold force: pull, and slip of the rope on the target.",
}


def write_cast(
    directory: str | Path, plan: CastPlan, *, rate: float = RATE, tell: Tell = lambda _: None
) -> tuple[dict[str, Path], HoldingForce | None]:
    """Write everything that there is to a plan.

    Parameters
    ----------
    directory : str or Path
        Folder to write to, whole or not at all; made if it is not there. Files of an earlier cast are replaced or,
        where this one has none of the kind, removed; others stay.
    plan : CastPlan
        One without a throw leaves no more than a page with the reason and where the target is.
    rate : float
        Rows a second of the motor's file, Hz.
    tell : callable
        Told in words what is being done.

    Returns
    -------
    files : dict of str to Path
        By what they are: "page", "film", "motion", "plan", "run", "nearest" (the plan for the nearest target), ...
    held : HoldingForce or None
        What the wound rope bore; None where it is not on the target, or slips without being pulled.

    Raises
    ------
    FileProblem
        The folder cannot be made or written to.
    """
    with whole_folder(directory, FILES) as stage:
        held = None
        names, pictures = {"page": "report.html"}, {}
        if plan.motion is not None:
            names |= {"motion": "motion.csv", "plan": "cast.toml"}
            plan.to_csv(stage / "motion.csv", rate=rate)
            plan.to_toml(stage / "cast.toml")
        if plan.fallback is not None and plan.fallback.plan is not None:
            names["nearest"] = "nearest.toml"
            plan.fallback.plan.to_toml(stage / "nearest.toml")
        if plan.outcome is not None and plan.run is not None:
            tell("tugging at the rope")
            stays = plan.outcome.wound and plan.outcome.slip < MAX_SLIP
            held = measure_holding_force(plan.run, plan.target) if stays else None
            names["run"] = "cast.nc"
            plan.to_netcdf(stage / "cast.nc")
            pictures = draw(stage, plan, held, tell)
            names |= {kind: path.name for kind, path in pictures.items()}
        _write_page(stage / "report.html", plan, held, {kind: path.read_bytes() for kind, path in pictures.items()})
    return {kind: Path(directory) / name for kind, name in names.items()}, held


def film_note(plan: CastPlan, held: HoldingForce | None) -> Callable[[float], str]:
    """Return what a film of the verified run says at a time: target, arm, turns, and in the end the hold."""
    run, cast = plan.required(plan.run, "run"), plan.outcome
    turns = sense_of(plan) * winding.turns(run, plan.target)
    strike = np.inf if cast is None or not np.isfinite(cast.strike_time) else cast.strike_time

    def note(t: float) -> str:
        lines = [f"target: {words.target_words(plan.target)}", f"arm: {_arm_words(plan, t)}"]
        if t < strike:
            lines.append("rope: in the air")
        else:
            lines.append(f"rope: {np.interp(t, run.t, turns):.2f} turns round the target, {way(plan)}")
        if t > run.t[-1] - _TOLD:
            lines.append(_end_words(plan, held))
        return "\n".join(lines)

    return note


def _arm_words(plan: CastPlan, t: float) -> str:
    if plan.throw is None:
        return ""
    limits, count = plan.cast_setup.limits, plan.throw.count
    begun = int((plan.throw.starts(limits) <= t).sum())
    if begun == 0:
        return f"at rest, {words.swings_words(plan)} to come"
    if begun <= count:
        rests = plan.motion is not None and float(plan.motion.rate(t)) == 0.0
        return f"{'rests after ' if rests else ''}swing {begun} of {count}"
    done = t >= plan.throw.stops(limits)
    return f"stands still, {words.swings_words(plan)} done" if done else f"last move after {words.swings_words(plan)}"


def _end_words(plan: CastPlan, held: HoldingForce | None) -> str:
    if not plan.success:
        return fill(f"FAILS: {words.why(plan)}", _LINE)
    if held is None:
        return "wound and held"
    return f"wound and held; hold force {held.force:.2f} N" + (" (tug)" if held.tug.slipped else " or more (tug)")


def draw(
    folder: Path, plan: CastPlan, held: HoldingForce | None, tell: Tell, film: str = "cast.gif"
) -> dict[str, Path]:
    """Draw pictures and film of a verified run into `folder`; return the files by what they are."""
    tell("drawing")
    figures = {"strike": strike_figure(plan), "course": course_figure(plan)}
    if held is not None:
        figures["tug"] = tug_figure(held)
    written = write_figures(folder, figures)
    written["film"] = folder / film
    animate(
        plan.required(plan.run, "run"),
        written["film"],
        frame_rate=_FILM_RATE,
        width=_FILM_WIDTH,
        title="planned cast, simulated",
        note=film_note(plan, held),
        progress=lambda done, total: tell(f"filming, frame {done} of {total}"),
    )
    return written


def shown_pictures(pictures: dict[str, bytes]) -> dict[str, Picture]:
    """Return what :func:`draw` drew with captions, the film first."""
    return {kind: Picture(pictures[kind], caption) for kind, caption in _CAPTIONS.items() if kind in pictures}


def _write_page(path: Path, plan: CastPlan, held: HoldingForce | None, pictures: dict[str, bytes]) -> None:
    sections = [
        Section(
            "In short",
            verdict=(plan.success, words.verdict(plan)),
            text=words.instead(plan),
            tiles=words.tiles(plan, held),
            notes=(words.search_words(plan),),
        )
    ]
    shown = shown_pictures(pictures)
    if "film" not in shown:
        picture = Picture(png(place_figure(plan)), place_caption(plan))
        sections.append(Section("Where the target is", pictures=(picture,)))
    if plan.throw is not None:
        sections.append(Section("What happens" if shown else "What was planned", text=words.story(plan, held)))
    if "film" in shown:
        sections.append(Section("The cast", pictures=(shown["film"], shown["strike"])))
        sections.append(Section("Course", pictures=(shown["course"],)))
    if "tug" in shown:
        sections.append(Section("Hold", pictures=(shown["tug"],)))
    if plan.motion is not None:
        sections.append(Section("Does it stand with a finer rope?", table=words.checks_table(plan)))
        sections.append(Section("Motor", table=words.motor_table(plan)))
    sections.append(Section("Set-up", text=words.setup_words(plan)))
    write_page(path, words.title(plan), words.lead(plan), "simulated", sections)
