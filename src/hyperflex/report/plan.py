"""The report of a plan: a folder with page, figures, the motor's motion and the verified run."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.motion import Motion
from hyperflex.planning import (
    RATE,
    CastOutcome,
    CastPlan,
    InsertOutcome,
    InsertPlan,
    MotorLimits,
    Problem,
    TipStrike,
    WhipPlan,
)
from hyperflex.report.folder import Progress, silent, whole_folder
from hyperflex.report.page import Film, Picture, Section, TextTable, write_page
from hyperflex.report.player import player_html
from hyperflex.report.style import save_png
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plan = CastPlan | WhipPlan | InsertPlan
Outcome = CastOutcome | TipStrike | InsertOutcome
PlanT = TypeVar("PlanT", CastPlan, WhipPlan, InsertPlan)
NOT_KNOWN = "not known"
STROBES = ("strike", "peak", "entry")  # pictures of many instants in one, by their names
STRONG = 30.0  # times the torque of the rope's weight at the arm, which usual casts ask 2 to 10 times


class PlanReport(ABC, Generic[PlanT]):
    """The report of a plan: what it says and shows, and its folder. Its subclasses fill in the attributes."""

    name: str  # stem of the file names
    title: str  # of the page
    task: str  # what is planned, in a sentence
    verdict: str  # whether it succeeds, in a sentence
    target: str
    tiles: tuple[tuple[str, str], ...]  # key figures: value and what it is
    story: tuple[str, ...]  # what happens, in order, in paragraphs
    checks: TextTable  # results of the verified runs, with the links as planned and with finer ones
    captions: ClassVar[dict[str, str]]  # of the film and of every figure that there may be, by name
    layout: ClassVar[dict[str, tuple[str, ...]]]  # headings of the sections with pictures, and the names of these
    checks_note: ClassVar[tuple[str, ...]] = ()
    advice: tuple[str, ...] = ()  # what would help a plan that fails
    without_run: tuple[Section, ...] = ()  # shown where there is no run
    others: Mapping[str, CastPlan | None] = {}  # further plans whose set-up is written, by name, where they are there

    def __init__(self, plan: PlanT) -> None:
        self.plan: PlanT = plan

    @abstractmethod
    def figures(self) -> "dict[str, Figure]":
        """Draw the figures of the run, by name."""

    @abstractmethod
    def film(self) -> dict[str, Any]:
        """Return arguments of :func:`hyperflex.report.player.player_html`."""

    def write(self, directory: str | Path, *, rate: float = RATE, progress: Progress = silent) -> dict[str, Path]:
        """Write motion, set-up and run to a folder, then figures and the page, in which the run can be played.

        Parameters
        ----------
        directory : str or Path
            Folder to write to, see :func:`whole_folder`. Files of an earlier report of the kind are replaced or
            removed.
        rate : float
            Rows a second of the motor's file, Hz.
        progress : callable
            Called with a message on what is being done.

        Returns
        -------
        dict of str to Path
            The files: "page", "motion", "plan" (its set-up), "run", and the figures by name; those there are.
        """
        return self.write_plan(directory, rate=rate) | self.add_page(directory, progress=progress)

    def write_plan(self, directory: str | Path, *, rate: float = RATE) -> dict[str, Path]:
        """Write motion, set-up and run, which need no drawing; files of an earlier report are removed.

        Arguments and answer as of :meth:`write`.
        """
        plan, others = self.plan, {name: other for name, other in self.others.items() if other is not None}
        names = {name: f"{name}.toml" for name in others}
        own = [f"{name}.toml" for name in (*self.others, self.name)] + [f"{name}.png" for name in self.captions]
        own += ["report.html", "motion.csv", f"{self.name}.nc"]
        with whole_folder(directory, own) as stage:
            for name, other in others.items():
                other.to_toml(stage / names[name])
            if plan.motion is not None:
                names |= {"motion": "motion.csv", "plan": f"{self.name}.toml"}
                plan.to_csv(stage / names["motion"], rate=rate)
                plan.to_toml(stage / names["plan"])
            if plan.run is not None:
                names["run"] = f"{self.name}.nc"
                plan.to_netcdf(stage / names["run"])
        return {kind: Path(directory) / name for kind, name in names.items()}

    def add_page(self, directory: str | Path, *, progress: Progress = silent) -> dict[str, Path]:
        """Draw the figures, and write the page with them and the run. Arguments and answer as of :meth:`write`."""
        page = Path(directory) / "report.html"
        with whole_folder(directory) as stage:
            drawn = self.draw(stage, progress)
            lead = f"{self.task} {_source(self.plan)}; nothing here was measured."
            write_page(stage / page.name, self.title, lead, "simulated", self._sections(self.pictures(drawn)))
        return {kind: Path(directory) / path.name for kind, path in drawn.items()} | {"page": page}

    def draw(self, folder: Path, progress: Progress = silent) -> dict[str, Path]:
        """Draw figures of the run to files in `folder`; return them by name.

        None if there is no run, or if the plan was interrupted: who stops a search waits for nothing more.
        """
        if self.plan.run is None or self.plan.interrupted:
            return {}
        progress("drawing")
        figures = self.figures()
        drawn = {name: folder / f"{name}.png" for name in figures}
        for name, figure in figures.items():
            save_png(figure, drawn[name])
        return drawn

    def pictures(self, drawn: Mapping[str, Path]) -> dict[str, Picture | Film]:
        """Return the player of the run, if there is one, and what :meth:`draw` drew, with captions."""
        run, captions = self.plan.run, self.captions
        violet = " Violet: obstacles, which the rope must not touch." if self.plan.problem.obstacles else ""
        words = " Red as well: pegs that the rope is to run behind." if self.plan.problem.behind else ""
        words += violet
        films = {} if run is None else {"film": Film(player_html(run, **self.film()), captions["film"] + words)}
        shown = {kind: caption for kind, caption in captions.items() if kind in drawn}
        return films | {
            kind: Picture(drawn[kind].read_bytes(), caption + words * (kind in STROBES), chart=kind not in STROBES)
            for kind, caption in shown.items()
        }

    def _sections(self, shown: Mapping[str, Picture | Film]) -> list[Section]:
        plan, verdict, search = self.plan, (self.plan.success, self.verdict), (search_summary(self.plan),)
        sections: list[Section] = [
            Section("In short", verdict=verdict, text=self.advice, tiles=self.tiles, notes=search)
        ]
        sections += self.without_run
        if self.story:
            sections.append(Section("The plan" if self.plan.run is None else "What happens", text=self.story))
        for title, kinds in self.layout.items():
            if own := tuple(shown[kind] for kind in kinds if kind in shown):
                sections.append(Section(title, pictures=own))
        if plan.motion is not None:
            sections.append(Section("Check with a finer rope", table=self.checks, notes=self.checks_note))
            sections.append(Section("Motor", table=_motor_table(plan.problem.limits, plan.motion, self.plan.outcome)))
        setup = f"{_rope_and_arm(plan.problem)} Target: {self.target}.{_obstacles(plan.problem)}"
        return [*sections, Section("Set-up", text=(setup,))]


def _motor_table(limits: MotorLimits, motion: Motion, seen: Outcome | None) -> TextTable:
    """Return what a motion needs of the motor, beside the motor's limits."""
    t = np.linspace(0.0, float(motion.breaks[-1]), 4001)
    mean, peak = (math.nan, math.nan) if seen is None else (seen.torque, seen.torque_peak)
    rows = []
    for name, value, limit, unit in (
        ("speed", np.abs(motion.rate(t)).max(), limits.speed, "rad/s"),
        ("acceleration", np.abs(motion.acceleration(t)).max(), limits.acceleration, "rad/s²"),
        ("torque, mean over 5 ms", mean, limits.torque, "N m"),
        ("peak of the torque, for 0.5 ms", peak, math.inf, "N m"),
    ):
        needed = NOT_KNOWN if math.isnan(value) else f"{value:.3g} {unit}"
        rows.append((f"greatest {name}", needed, f"{limit:.3g} {unit}" if math.isfinite(limit) else "none given"))
    return TextTable(("motor", "needed", "limit"), tuple(rows))


def _rope_and_arm(setup: Problem) -> str:
    """Return rope and arm in words, each with a full stop."""
    rope = setup.rope
    name = f" ({rope.name})" if rope.name else ""
    tip = f", tip weight {1e3 * rope.tip_mass:.3g} g" if rope.tip_mass else ""
    return (
        f"Rope{name}: {rope.total_length:.4g} m, {1e3 * rope.total_mass:.4g} g, radius {1e3 * rope.radius:.3g} mm, "
        f"{rope.n_links} links{tip}. Arm: {1e3 * setup.arm.length:.4g} mm."
    )


def _obstacles(setup: Problem) -> str:
    """Return pegs to run behind and obstacles in a sentence each, after a space; "" without any."""
    told = ""
    for head, some in (
        ("Behind these the rope is to run on its way from the arm to the target", setup.behind),
        ("Obstacles, which the rope must not touch", setup.obstacles),
    ):
        if some:
            told += f" {head}: {'; '.join(map(in_words, some))}."
    return told


def in_words(each: Obstacle) -> str:
    """Return an obstacle in words, by its kind, place and size."""
    place = f"({each.x:.4g}, {each.y:.4g})"
    if isinstance(each, Peg):
        return f"a peg at {place} m, radius {length(each.radius)}"
    if isinstance(each, Wall):
        return f"a wall from {place} to ({each.x2:.4g}, {each.y2:.4g}) m"
    return f"a ground through {place} m"


def clear_of(setup: Problem) -> str:
    """Return what a clearance is of, as the head of a table's column."""
    return "clear of arm and obstacles" if setup.obstacles else "clear of the arm"


def clearance_tiles(plan: Plan) -> list[tuple[str, str]]:
    """Return how near the rope comes to its own arm, as a key figure; none if nothing was verified to its end."""
    if math.isnan(plan.clearance):
        return []
    asked = 1e3 * max(plan.problem.clearance, 0.0)
    beside = ", obstacles" if plan.problem.obstacles else ""
    told = f"clearance: least distance of the rope from arm{beside} and shaft; {asked:g} mm are needed"
    return [(f"{1e3 * plan.clearance:.1f} mm", told)]


def torque_tiles(plan: Plan, seen: Outcome | None) -> list[tuple[str, str]]:
    """Return what a plan asks of the motor, as a key figure; none if nothing was verified to its end."""
    if seen is None or math.isnan(seen.torque):
        return []
    limit = plan.problem.limits.torque
    allowed = f"{limit:.3g} N m are allowed" if math.isfinite(limit) else "no limit was given"
    return [(f"{seen.torque:.3g} N m", f"greatest torque of the motor over 5 ms; {allowed}")]


def torque_warning(plan: Plan, seen: Outcome | None) -> str:
    """Return that a plan without a limit of the torque asks for far more of it than the rope's weight does, else ""."""
    if seen is None or not plan.success or math.isfinite(plan.problem.limits.torque):
        return ""
    rope, arm = plan.problem.rope, plan.problem.arm
    weight = rope.total_mass * math.hypot(*rope.gravity) * arm.length
    if not seen.torque > STRONG * weight:
        return ""
    return (
        f"Motor and rope are loaded heavily: {seen.torque:.3g} N m for 5 ms, {seen.torque_peak:.3g} N m at the "
        f"peak, where the rope's weight at the arm makes {weight:.2g} N m. Give --torque to plan for a weaker motor."
    )


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def searched(plan: Plan) -> bool:
    """Whether a search was made, or at least begun."""
    return bool(plan.runs) or plan.interrupted or plan.motion is not None


def _source(plan: Plan) -> str:
    if plan.success:
        return "Planned and verified by simulation"
    return "Searched for by simulation" if searched(plan) else "Checked for feasibility, without a search"


def search_summary(plan: Plan) -> str:
    """Return in a sentence what the search took."""
    if not searched(plan):
        return "No search was made: the feasibility check refused the target."
    ended = ", interrupted before its end" if plan.interrupted else ""
    return f"The search took {plan.seconds:.0f} s and {counted(plan.runs, 'simulated run')}{ended}."
