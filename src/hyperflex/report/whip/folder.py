"""The folder of a planned whip: a page, pictures, a film, the motion for the motor, the verified run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hyperflex.planning import RATE, Impact, WhipPlan
from hyperflex.report.animation import animate
from hyperflex.report.cast.words import search_words
from hyperflex.report.cast_setup_words import asked_of_motor
from hyperflex.report.folder import Tell, whole_folder, write_figures
from hyperflex.report.page import Picture, Section, write_page
from hyperflex.report.whip import words
from hyperflex.report.whip.figures import course_figure, passing_figure, peak_figure

_FILM_RATE, _FILM_WIDTH, _SLOW = 20, 560, 0.5  # frames a second, pixels, part of real time
_CAPTIONS = {
    "film": "The whip as it is planned, simulated, at half speed: arm (white), rope (yellow), target (red ring).",
    "peak": "The rope about the peak, early instants dark, late ones bright; simulated.",
    "passing": "How the tip passes the target: its way, coloured by its speed; simulated.",
    "course": "Arm angle, the tip's speed and distance from the target, and torque over time. Dashed red: the peak.",
}


def write_whip(
    directory: str | Path, plan: WhipPlan, *, rate: float = RATE, tell: Tell = lambda _: None
) -> tuple[dict[str, Path], Impact | None]:
    """Write everything that there is to a plan.

    Parameters
    ----------
    directory : str or Path
        Folder to write to, whole or not at all; made if it is not there, other files in it stay.
    plan : WhipPlan
        One without strokes leaves no more than a page with the reason.
    rate : float
        Rows a second of the motor's file, Hz.
    tell : callable
        Told in words what is being done.

    Returns
    -------
    files : dict of str to Path
        By what they are: "page", "film", "motion", "plan", "run", ...
    blow : Impact or None
        On a small peg at the target; None where there is no verified run.

    Raises
    ------
    FileProblem
        The folder cannot be made or written to.
    """
    with whole_folder(directory) as stage:
        blow = None
        names, pictures = {"page": "report.html"}, {}
        if plan.motion is not None:
            names |= {"motion": "motion.csv", "plan": "whip.toml"}
            plan.to_csv(stage / "motion.csv", rate=rate)
            plan.to_toml(stage / "whip.toml")
        if plan.outcome is not None:
            tell("striking a small peg")
            blow = plan.impact()
            names["run"] = "whip.nc"
            plan.to_netcdf(stage / "whip.nc")
            pictures = _draw(stage, plan, tell)
            names |= {kind: path.name for kind, path in pictures.items()}
        _write_page(stage / "report.html", plan, blow, {kind: path.read_bytes() for kind, path in pictures.items()})
    return {kind: Path(directory) / name for kind, name in names.items()}, blow


def film_note(plan: WhipPlan) -> Callable[[float], str]:
    """Return what a film of the verified run says at a time: target, arm, and from the peak on how it was met."""
    seen, limits = plan.required(plan.outcome, "outcome"), plan.cast_setup.limits
    starts = None if plan.strokes is None else plan.strokes.starts(limits)

    def note(t: float) -> str:
        begun = 0 if starts is None else int((starts <= t).sum())
        arm = f"stroke {begun} of {words.strokes_words(plan)}" if begun else f"{words.strokes_words(plan)} to come"
        mark = plan.target
        lines = [f"target: x = {mark.x:.3g} m, y = {mark.y:.3g} m, {mark.speed:.3g} m/s or more", f"arm: {arm}"]
        if t < seen.t:
            lines.append("")
        elif plan.success:
            lines.append(f"met at {seen.t:.2f} s: {seen.speed:.1f} m/s, {1e3 * seen.miss:.2g} mm off")
        else:
            lines.append(f"FAILS: {plan.message}")
        return "\n".join(lines)

    return note


def _draw(folder: Path, plan: WhipPlan, tell: Tell) -> dict[str, Path]:
    """Draw pictures and film of the verified run into `folder`; return the files by what they are."""
    tell("drawing")
    figures = {"peak": peak_figure(plan), "passing": passing_figure(plan), "course": course_figure(plan)}
    written = write_figures(folder, figures)
    written["film"] = folder / "whip.gif"
    animate(
        plan.required(plan.run, "run"),
        written["film"],
        frame_rate=_FILM_RATE,
        speed=_SLOW,
        width=_FILM_WIDTH,
        title="planned whip, simulated, at half speed",
        note=film_note(plan),
        targets=plan.target.point[None],
        progress=lambda done, total: tell(f"filming, frame {done} of {total}"),
    )
    return written


def _write_page(path: Path, plan: WhipPlan, blow: Impact | None, pictures: dict[str, bytes]) -> None:
    verdict, tiles = (plan.success, words.verdict(plan)), words.tiles(plan, blow)
    sections = [
        Section("In short", verdict=verdict, tiles=tiles, notes=(search_words(plan),)),
        Section("What happens" if plan.outcome else "What is asked", text=words.story(plan, blow)),
    ]
    shown = {kind: Picture(pictures[kind], caption) for kind, caption in _CAPTIONS.items() if kind in pictures}
    if shown:
        sections.append(Section("The whip", pictures=(shown["film"], shown["peak"], shown["passing"])))
        sections.append(Section("Course", pictures=(shown["course"],)))
    if plan.motion is not None:
        table = words.checks_table(plan)
        sections.append(Section("Does it stand with a finer rope?", table=table, notes=(words.finer_words(),)))
        sections.append(Section("Motor", table=asked_of_motor(plan.cast_setup.limits, plan.motion, plan.run)))
    sections.append(Section("Set-up", text=words.setup_words(plan)))
    title = "A planned whip" if plan.success else "No whip found that meets its target"
    write_page(path, title, words.lead(plan), "simulated", sections)
