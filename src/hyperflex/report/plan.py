"""The report of a plan: a folder with a page, figures, the motor's motion and the verified run."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.planning import RATE, CastPlan, InsertPlan, Problem, WhipPlan
from hyperflex.report.curves import Moves
from hyperflex.report.folder import Progress, silent, whole_folder
from hyperflex.report.page import Film, Picture, Section, TextTable, write_page
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.player import player_html
from hyperflex.report.scene import Overlay
from hyperflex.report.style import save_png
from hyperflex.report.units import length
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plan = CastPlan | WhipPlan | InsertPlan
PlanT = TypeVar("PlanT", CastPlan, WhipPlan, InsertPlan)
NOT_KNOWN = "not known"
GREAT_TORQUE = 30.0  # times the torque of the rope's weight at the arm: usual casts need 2 to 10 times


class PlanReport(ABC, Generic[PlanT]):
    """The report of a plan: its texts, figures and folder. Each task has a subclass."""

    name: str  # of the task: "cast", ...; stem of the file names
    title: str  # of the page
    task: str  # what is planned, in a sentence
    verdict: str  # whether it succeeds, in a sentence
    target: str
    tiles: tuple[tuple[str, str], ...]  # key figures: value and what it is
    story: tuple[str, ...]  # events in order, in paragraphs
    warning: str = ""
    advice: tuple[str, ...] = ()  # what would help a plan that fails
    layout: ClassVar[dict[str, dict[str, str]]]  # by heading: names of the film and the figures, and their captions
    strobe: ClassVar[str]  # name of the figure with many instants in one picture
    move: ClassVar[str] = "stroke"  # what a move of the arm is called
    last_move: ClassVar[bool] = False  # whether the last move is of another kind, and not counted
    film_speed: ClassVar[float] = 0.5  # simulated seconds a second
    columns: ClassVar[dict[str, Callable[[Any], str]]]  # of the table of verified runs: how to get a cell of an outcome
    runs: ClassVar[tuple[str, str]]  # the run as planned, and the finer one
    runs_note: ClassVar[str]

    def __init__(self, plan: PlanT) -> None:
        self.plan: PlanT = plan

    @abstractmethod
    def figures(self) -> "dict[str, Figure]":
        """Draw the figures of the run, by name."""

    @abstractmethod
    def overlay(self) -> Overlay:
        """Return what film and pictures show in addition to the run."""

    def without_run(self) -> tuple[Section, ...]:
        """Return sections of a page without a run."""
        return ()

    def other_plans(self) -> "Mapping[str, CastPlan | None]":
        """Return further plans whose set-ups are written, by the names of their files; None where there is none."""
        return {}

    @property
    def run(self) -> Trajectory:
        """The verified run; InvalidInput if there is none."""
        return self.plan.required(self.plan.run, "run")

    @property
    def outcome(self) -> Any:
        """The outcome of the verified run; InvalidInput if there is none."""
        return self.plan.required(self.plan.outcome, "outcome")

    def film(self) -> dict[str, Any]:
        """Return arguments of :func:`hyperflex.report.player_html`."""
        return {"title": f"planned {self.name}, simulated", "speed": self.film_speed, "overlay": self.overlay()}

    @property
    def checks(self) -> TextTable:
        """Results of the verified runs, with the links as planned and with finer ones."""
        clear = "clear of arm and obstacles" if self.plan.problem.obstacles else "clear of the arm"
        columns: dict[str, Callable[[Any], str]] = self.columns | {clear: lambda seen: f"{1e3 * seen.clearance:.1f} mm"}
        rows = []
        for name, seen in zip(self.runs, (self.plan.outcome, self.plan.finer_outcome), strict=True):
            done = seen is not None and seen.n_links > 0
            cells: list[str] = [cell(seen) for cell in columns.values()] if done else [NOT_KNOWN] * len(columns)
            rows.append((name, *cells))
        return TextTable(("run", *columns), tuple(rows))

    def write(self, directory: str | Path, *, rate: float = RATE, progress: Progress = silent) -> dict[str, Path]:
        """Write motion, set-up and run to a folder, then figures and the page, in which the run can be played.

        Parameters
        ----------
        directory : str or Path
            Folder to write to, see :func:`whole_folder`. Files of an earlier report of the task are replaced or
            removed.
        rate : float
            Rows a second of the motor's file, Hz.
        progress : callable
            Called with a message on what is being done.

        Returns
        -------
        dict of str to Path
            The files: "page", "motion", "plan" (its set-up), "run", and the figures by name; those that exist.
        """
        return self.write_plan(directory, rate=rate) | self.add_page(directory, progress=progress)

    def write_plan(self, directory: str | Path, *, rate: float = RATE) -> dict[str, Path]:
        """Write motion, set-up and run, without figures; remove files of an earlier report. See :meth:`write`."""
        plan = self.plan
        others: Mapping[str, CastPlan | None] = self.other_plans()
        captions = [name for part in self.layout.values() for name in part]
        own: list[str] = [f"{name}.toml" for name in (*others, self.name)] + [f"{name}.png" for name in captions]
        names = {}
        with whole_folder(directory, [*own, "report.html", "motion.csv", f"{self.name}.nc"]) as stage:
            for name, other in others.items():
                if other is not None:
                    names[name] = f"{name}.toml"
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
        """Draw the figures, and write the page with them and the run. See :meth:`write`."""
        page, source = Path(directory) / "report.html", "Planned and verified by simulation"
        if not self.plan.success:
            source = "Searched for by simulation" if self.searched else "Checked for feasibility, without a search"
        with whole_folder(directory) as stage:
            drawn = self.draw(stage, progress)
            lead = f"{self.task} {source}; nothing here was measured."
            write_page(stage / page.name, self.title, lead, "simulated", self._sections(self.pictures(drawn)))
        return {kind: Path(directory) / path.name for kind, path in drawn.items()} | {"page": page}

    def draw(self, folder: Path, progress: Progress = silent) -> dict[str, Path]:
        """Draw figures of the run to files in `folder`; return them by name.

        An interrupted plan has none, to end without delay.
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
        """Return the player of the run, if there is one, and the figures that :meth:`draw` drew, with captions."""
        setup, shown = self.plan.problem, dict[str, Picture | Film]()
        words = " Red as well: pegs that the rope is to run behind." if setup.criteria.behind else ""
        words += " Violet: obstacles, which the rope must not touch." if setup.obstacles else ""
        for name, caption in (item for part in self.layout.values() for item in part.items()):
            if name == "film" and self.plan.run is not None:
                shown[name] = Film(player_html(self.run, **self.film()), caption + words)
            elif name in drawn:
                strobe = name == self.strobe
                shown[name] = Picture(drawn[name].read_bytes(), caption + words * strobe, chart=not strobe)
        return shown

    def _sections(self, shown: Mapping[str, Picture | Film]) -> list[Section]:
        plan, verdict = self.plan, (self.plan.success, self.verdict)
        sections: list[Section] = [
            Section("In short", verdict=verdict, text=self.advice, tiles=self.tiles, notes=(search_summary(plan),))
        ]
        sections += self.without_run() if plan.run is None else ()
        if self.story:
            sections.append(Section("The plan" if plan.run is None else "What happens", text=self.story))
        for title, kinds in self.layout.items():
            if own := tuple(shown[kind] for kind in kinds if kind in shown):
                sections.append(Section(title, pictures=own))
        if plan.motion is not None:
            sections.append(Section("Check with a finer rope", table=self.checks, notes=(self.runs_note,)))
            sections.append(Section("Motor", table=self._motor_table()))
        return [*sections, Section("Set-up", text=(self._setup(),))]

    @property
    def searched(self) -> bool:
        """Whether a search was made, or at least begun."""
        return searched(self.plan)

    def moves(self) -> Moves | None:
        """Return the moves of the arm that begin within the run, numbered; None without any."""
        moves, starts = self.plan.moves, self._starts
        if moves is None:
            return None
        names = [str(k + 1) for k in range(starts.size)]
        if self.last_move:
            names[-1] = "last"
        count = int((starts < self.run.t[-1]).sum())
        return Moves(starts[:count], moves.angles(self.plan.problem.limits)[: count + 1], tuple(names[:count]))

    @property
    def _starts(self) -> Array:
        """Starts of all moves, s."""
        return np.zeros(0) if self.plan.moves is None else self.plan.moves.starts(self.plan.problem.limits)

    def move_count(self) -> str:
        """Return how many moves the arm makes, with their name."""
        return counted(self._starts.size - self.last_move, self.move)

    def arm_note(self, t: float) -> str:
        """Return which move the arm makes at a time, s, or made last."""
        begun = int((self._starts <= t).sum())
        if not begun:
            return f"arm: {self.move_count()} to come"
        last = self.last_move and begun == self._starts.size
        return "arm: last move" if last else f"arm: {self.move} {begun} of {self._starts.size - self.last_move}"

    def strobe_at(self, t: float, before: float, after: float, shown: str) -> "Figure":
        """Draw the rope at many instants `before` and `after` a time `t`, s; `shown` explains the other objects."""
        start, end = max(t - before, float(self.run.t[0])), min(t + after, float(self.run.t[-1]))
        title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); {shown}"
        return strobe_figure(self.run, start=start, end=end, count=52, title=title, overlay=self.overlay())

    def arm_tiles(self) -> list[tuple[str, str]]:
        """Return key figures of clearance and motor; none if no run was verified to its end."""
        plan, setup, tiles = self.plan, self.plan.problem, list[tuple[str, str]]()
        if math.isfinite(plan.clearance):
            obstacles = ", obstacles" if setup.obstacles else ""
            words = f"clearance: least distance of the rope from arm{obstacles} and shaft; "
            required = f"{1e3 * max(setup.clearance, 0.0):g} mm are required"
            tiles.append((f"{1e3 * plan.clearance:.1f} mm", words + required))
        if (seen := plan.outcome) is not None and math.isfinite(seen.torque):
            limit = setup.limits.torque
            allowed = f"{limit:.3g} N m are allowed" if math.isfinite(limit) else "no limit was given"
            tiles.append((f"{seen.torque:.3g} N m", f"greatest torque of the motor over 5 ms; {allowed}"))
        return tiles

    def torque_warning(self) -> str:
        """Return a warning if a plan without a torque limit needs far more torque than the rope's weight, else ""."""
        plan, setup = self.plan, self.plan.problem
        seen, rope = plan.outcome, setup.rope
        weight = rope.total_mass * math.hypot(*rope.gravity) * setup.arm.length
        if seen is None or not plan.success or math.isfinite(setup.limits.torque):
            return ""
        if not seen.torque > GREAT_TORQUE * weight:
            return ""
        return (
            f"Motor and rope are loaded heavily: {seen.torque:.3g} N m over 5 ms, with a peak of "
            f"{seen.torque_peak:.3g} N m. The rope's weight at the arm makes {weight:.2g} N m. Give --torque to plan "
            "for a weaker motor."
        )

    def _motor_table(self) -> TextTable:
        """Return the requirements of the motion on the motor, with its limits."""
        motion, limits, seen = (
            self.plan.required(self.plan.motion, "motion"),
            self.plan.problem.limits,
            self.plan.outcome,
        )
        t = np.linspace(0.0, float(motion.breaks[-1]), 4001)
        torques = (math.nan, math.nan) if seen is None else (seen.torque, seen.torque_peak)
        needed = (
            ("speed", np.abs(motion.rate(t)).max(), limits.speed, "rad/s"),
            ("acceleration", np.abs(motion.acceleration(t)).max(), limits.acceleration, "rad/s²"),
            ("torque, mean over 5 ms", torques[0], limits.torque, "N m"),
            ("torque, peak over 0.5 ms", torques[1], math.inf, "N m"),
        )
        rows = [
            (f"greatest {name}", _quantity(value, unit, NOT_KNOWN), _quantity(limit, unit, "none given"))
            for name, value, limit, unit in needed
        ]
        return TextTable(("motor", "needed", "limit"), tuple(rows))

    def _setup(self) -> str:
        """Return rope, arm, target, pegs to run behind and obstacles, each in a sentence."""
        setup, rope = self.plan.problem, self.plan.problem.rope
        name = f" ({rope.name})" if rope.name else ""
        tip = f", tip weight {1e3 * rope.tip_mass:.3g} g" if rope.tip_mass else ""
        return (
            f"Rope{name}: {rope.total_length:.4g} m, {1e3 * rope.total_mass:.4g} g, radius {1e3 * rope.radius:.3g} mm, "
            f"{rope.n_links} links{tip}. Arm: {1e3 * setup.arm.length:.4g} mm. Target: {self.target}."
            f"{_obstacles(setup)}"
        )


def _quantity(value: float, unit: str, otherwise: str) -> str:
    """Return a number with its unit, or `otherwise` if it is not finite."""
    return f"{value:.3g} {unit}" if math.isfinite(value) else otherwise


def _obstacles(setup: Problem) -> str:
    """Return pegs to run behind and obstacles in a sentence each, after a space; "" without any."""
    heads = {
        "The rope must run behind these on its way from the arm to the target": setup.criteria.behind,
        "Obstacles, which the rope must not touch": setup.obstacles,
    }
    return "".join(f" {head}: {'; '.join(map(in_words, some))}." for head, some in heads.items() if some)


def in_words(each: Obstacle) -> str:
    """Return kind, place and size of an obstacle."""
    place = f"({each.x:.4g}, {each.y:.4g})"
    if isinstance(each, Peg):
        return f"a peg at {place} m, radius {length(each.radius)}"
    if isinstance(each, Wall):
        return f"a wall from {place} to ({each.x2:.4g}, {each.y2:.4g}) m"
    return f"a ground through {place} m"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def searched(plan: Plan) -> bool:
    """Return whether a search was made, or at least begun."""
    return bool(plan.runs) or plan.interrupted or plan.motion is not None


def search_summary(plan: Plan) -> str:
    """Return how long the search took, in a sentence."""
    if not searched(plan):
        return "No search was made: the feasibility check refused the target."
    ended = ", interrupted before its end" if plan.interrupted else ""
    return f"The search took {plan.seconds:.0f} s and {counted(plan.runs, 'simulated run')}{ended}."
