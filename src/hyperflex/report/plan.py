"""The report of a plan: a folder with a page, figures, the motor's motion and the verified run."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.planning import RATE, CastPlan, InsertPlan, TipOptions, WhipPlan
from hyperflex.report.curves import Panel, time_course
from hyperflex.report.folder import Progress, silent, whole_folder
from hyperflex.report.page import Film, Picture, Section, write_page
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.player import player_html
from hyperflex.report.scene import Overlay
from hyperflex.report.style import png
from hyperflex.report.texts import Texts
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plan = CastPlan | WhipPlan | InsertPlan
PlanT = TypeVar("PlanT", CastPlan, WhipPlan, InsertPlan)
GREAT_TORQUE = 30.0  # times the torque of the rope's weight at the arm: usual casts need 2 to 10 times


class PlanReport(ABC, Generic[PlanT]):
    """The report of a plan: its texts, figures and folder. Each task has a subclass.

    Attributes
    ----------
    plan : PlanT
    texts : Texts
        Filled in from ``templates/plan``.
    title, verdict, warning : str
        Heading of the page; whether the plan succeeds, in a sentence; empty without a warning.
    tiles : tuple of (str, str)
        Key figures: value, and what it is.
    story, advice : tuple of str
        Events in order, in paragraphs; what would help a plan that fails.
    """

    name: ClassVar[str]  # of the task: "cast", ...; stem of the file names
    noun: ClassVar[str]  # what is planned
    layout: ClassVar[dict[str, dict[str, str]]]  # by heading: names of the film and the figures, and their captions
    strobe: ClassVar[str]  # name of the figure with many instants in one picture
    move: ClassVar[str] = "stroke"  # what a move of the arm is called
    last_move: ClassVar[bool] = False  # whether the last move is of another kind, and not counted
    film_speed: ClassVar[float] = 0.5  # simulated seconds a second

    def __init__(self, plan: PlanT) -> None:
        self.plan: PlanT = plan
        setup = plan.problem
        content = {"setup": setup, "rope": setup.rope, "limits": setup.limits, "seen": plan.outcome}
        template = f"plan/{self.name}.txt"
        texts = self.texts = Texts(template, report=self, plan=plan, known=TipOptions(), **content)
        self.title, self.verdict, self.warning = (texts.text(name) for name in ("title", "verdict", "warning"))
        self.tiles = tuple((value, meaning) for value, meaning in texts.rows("tiles"))
        self.story, self.advice = texts.paragraphs("story"), texts.paragraphs("advice")

    @abstractmethod
    def figures(self) -> "dict[str, Figure]":
        """Draw the figures of the run, by name."""

    def overlay(self) -> Overlay:
        """Return what film and pictures show in addition to the run: notes, obstacles, and the event."""
        marks = (self.event,) if math.isfinite(self.event) else ()
        return Overlay(self.film_note, obstacles=self.plan.problem.obstacles, marks=marks)

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

    @property
    def event(self) -> float:
        """Time of the strike, of the peak, or when the tip is inside, s; NaN if it does not happen."""
        return float(self.outcome.t)

    @property
    def searched(self) -> bool:
        """Whether a search was made, or at least begun."""
        return bool(self.plan.runs) or self.plan.interrupted or self.plan.motion is not None

    @property
    def search_summary(self) -> str:
        """How long the search took, in a sentence."""
        plan = self.plan
        if not self.searched:
            return "No search was made: the feasibility check refused the target."
        ended = ", interrupted before its end" if plan.interrupted else ""
        return f"The search took {plan.seconds:.0f} s and {counted(plan.runs, 'simulated run')}{ended}."

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
        plan, others = self.plan, self.other_plans()
        names = {"motion": "motion.csv", "plan": f"{self.name}.toml", "run": f"{self.name}.nc", "page": "report.html"}
        names |= {name: f"{name}.toml" for name in others}
        names |= {name: f"{name}.png" for captions in self.layout.values() for name in captions}
        with whole_folder(directory, tuple(names.values())) as stage:
            for name, other in others.items():
                if other is not None:
                    other.to_toml(stage / names[name])
            if plan.motion is not None:
                plan.to_csv(stage / names["motion"], rate=rate)
                plan.to_toml(stage / names["plan"])
            if plan.run is not None:
                plan.to_netcdf(stage / names["run"])
            return {kind: Path(directory) / name for kind, name in names.items() if (stage / name).exists()}

    def add_page(self, directory: str | Path, *, progress: Progress = silent) -> dict[str, Path]:
        """Draw the figures, and write the page with them and the run. See :meth:`write`."""
        source = "Planned and verified by simulation"
        if not self.plan.success:
            source = "Searched for by simulation" if self.searched else "Checked for feasibility, without a search"
        lead = f"{self.texts.text('task')} {source}; nothing here was measured."
        progress("drawing")
        drawn = self.drawn()
        with whole_folder(directory) as stage:
            for name, content in drawn.items():
                files.write_bytes(stage / f"{name}.png", content)
            write_page(stage / "report.html", self.title, lead, "simulated", self._sections(self.pictures(drawn)))
        return {name: Path(directory) / f"{name}.png" for name in drawn} | {"page": Path(directory) / "report.html"}

    def drawn(self) -> dict[str, bytes]:
        """Return the figures of the run as PNG, by name; an interrupted plan has none, to end without delay."""
        if self.plan.run is None or self.plan.interrupted:
            return {}
        return {name: png(figure) for name, figure in self.figures().items()}

    def pictures(self, drawn: Mapping[str, bytes]) -> dict[str, Picture | Film]:
        """Return the player of the run, if there is one, and the figures that :meth:`drawn` returned, with captions."""
        setup, shown = self.plan.problem, dict[str, Picture | Film]()
        words = " Red as well: pegs that the rope is to run behind." if setup.criteria.behind else ""
        words += " Violet: obstacles, which the rope must not touch." if setup.obstacles else ""
        for name, caption in (item for part in self.layout.values() for item in part.items()):
            if name == "film" and self.plan.run is not None:
                shown[name] = Film(player_html(self.run, **self.film()), caption + words)
            elif name in drawn:
                strobe = name == self.strobe
                shown[name] = Picture(drawn[name], caption + words * strobe, chart=not strobe)
        return shown

    def film(self) -> dict[str, Any]:
        """Return arguments of :func:`hyperflex.report.player_html`."""
        return {"title": f"planned {self.noun}, simulated", "speed": self.film_speed, "overlay": self.overlay()}

    def _sections(self, shown: Mapping[str, Picture | Film]) -> list[Section]:
        plan, texts, notes = self.plan, self.texts, (self.search_summary,)
        verdict = (plan.success, self.verdict)
        sections: list[Section] = []
        sections.append(Section("In short", verdict=verdict, text=self.advice, tiles=self.tiles, notes=notes))
        sections += self.without_run() if plan.run is None else ()
        if self.story:
            sections.append(Section("The plan" if plan.run is None else "What happens", text=self.story))
        for title, kinds in self.layout.items():
            if own := tuple(shown[kind] for kind in kinds if kind in shown):
                sections.append(Section(title, pictures=own))
        if plan.motion is not None:
            note = texts.paragraphs("note")
            sections.append(Section("Check with a finer rope", table=texts.table("checks"), notes=note))
            sections.append(Section("Motor", table=texts.table("motor")))
        return [*sections, Section("Set-up", text=texts.paragraphs("setup"))]

    def moves(self) -> list[tuple[float, str]]:
        """Return start, s, and number of the arm's moves that begin within the run."""
        names = [*map(str, range(1, self._starts.size)), "last" if self.last_move else str(self._starts.size)]
        return [(start, name) for start, name in zip(self._starts, names, strict=False) if start < self.run.t[-1]]

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

    def film_note(self, t: float) -> str:
        """Return the film's note at a time, s: target, move of the arm, and what has happened."""
        end = self.texts.text("end") if t >= self.event else ""
        return "\n".join((self.texts.text("film"), self.arm_note(t), end))

    def strobe_at(self, t: float, before: float, after: float, shown: str) -> "Figure":
        """Draw the rope at many instants `before` and `after` a time `t`, s; `shown` explains the other objects."""
        start, end = max(t - before, float(self.run.t[0])), min(t + after, float(self.run.t[-1]))
        title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); {shown}"
        return strobe_figure(self.run, start=start, end=end, count=52, title=title, overlay=self.overlay())

    def course(self, *panels: Panel) -> "Figure":
        """Draw the time course of the run with two panels; it marks the event."""
        return time_course(self.run, f"the {self.noun}", panels, self.moves(), self.event)

    def motor_peaks(self) -> tuple[float, float]:
        """Return the greatest speed, rad/s, and acceleration, rad/s^2, of the motion."""
        motion = self.plan.required(self.plan.motion, "motion")
        t = np.linspace(0.0, float(motion.breaks[-1]), 4001)
        return float(np.abs(motion.rate(t)).max()), float(np.abs(motion.acceleration(t)).max())

    @property
    def weight_torque(self) -> float:
        """Torque of the rope's weight at the arm, N m."""
        rope = self.plan.problem.rope
        return rope.total_mass * math.hypot(*rope.gravity) * self.plan.problem.arm.length

    def needs_much_torque(self) -> bool:
        """Whether a plan that succeeds without a torque limit needs far more torque than the rope's weight."""
        seen, limit = self.plan.outcome, self.plan.problem.limits.torque
        if seen is None or not self.plan.success or math.isfinite(limit):
            return False
        return seen.torque > GREAT_TORQUE * self.weight_torque


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
