"""The report of a plan: a folder with a page, figures, the motor's motion and the verified run."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from hyperflex.checks import Array, ByName
from hyperflex.planning import BOUNCE_TIME, RATE, CastPlan, InsertPlan, TipOptions, WhipPlan
from hyperflex.report.folder import Progress, silent, whole_folder
from hyperflex.report.page import Film, Picture, Section, write_page, write_pictures
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.player import player_html
from hyperflex.report.scene import Overlay
from hyperflex.report.style import Axes, Figure, png
from hyperflex.report.texts import Texts
from hyperflex.trajectory import Trajectory

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
    captions: ClassVar[dict[str, str]]  # of the film and the figures, by name
    strobe: ClassVar[str]  # name of the figure with many instants in one picture
    move: ClassVar[str] = "stroke"  # what a move of the arm is called
    last_move: ClassVar[bool] = False  # whether the last move is of another kind, and not counted
    film_speed: ClassVar[float] = 0.5  # simulated seconds a second

    def __init__(self, plan: PlanT) -> None:
        self.plan: PlanT = plan
        setup = plan.problem
        content = {"setup": setup, "rope": setup.rope, "limits": setup.limits, "seen": plan.seen}
        template = f"plan/{self.name}.txt"
        content |= {"known": TipOptions(), "great_torque": GREAT_TORQUE, "bounce_time": BOUNCE_TIME}
        texts = self.texts = Texts(template, report=self, plan=plan, **content)
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
        return self.plan.required(self.plan.seen, "outcome")

    @property
    def event(self) -> float:
        """Time of the strike, of the peak, or when the tip is inside, s; NaN if it does not happen."""
        return float(self.outcome.t)

    @property
    def searched(self) -> bool:
        """Whether a search was made, or at least begun."""
        return bool(self.plan.runs) or self.plan.interrupted or self.plan.motion is not None

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
        names |= {name: f"{name}.toml" for name in others} | {name: f"{name}.png" for name in self.captions}
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

    def add_page(
        self, directory: str | Path, *, progress: Progress = silent, remarks: Sequence[str] = ()
    ) -> dict[str, Path]:
        """Draw the figures; write the page with them, the run and `remarks` on the plan. See :meth:`write`."""
        progress("drawing")
        shown = self.pictures()
        with whole_folder(directory) as stage:
            written = write_pictures(stage, shown) | {"page": "report.html"}
            write_page(
                stage / "report.html", self.title, self.texts.text("lead"), "simulated", self._sections(shown, remarks)
            )
        return {kind: Path(directory) / name for kind, name in written.items()}

    def pictures(self) -> dict[str, Picture | Film]:
        """Return the player of the run, if there is one, and the figures; an interrupted plan has none, to end soon."""
        if self.plan.run is None:
            return {}
        colours = self.texts.text("colours")
        captions = self.captions | {name: f"{self.captions[name]} {colours}".strip() for name in ("film", self.strobe)}
        shown: dict[str, Picture | Film] = {"film": Film(player_html(self.run, **self.film()), captions["film"])}
        if not self.plan.interrupted:
            for name, figure in self.figures().items():
                shown[name] = Picture(png(figure), captions[name], chart=name != self.strobe)
        return shown

    def film(self) -> ByName:
        """Return arguments of :func:`hyperflex.report.player_html`."""
        return {"title": f"planned {self.noun}, simulated", "speed": self.film_speed, "overlay": self.overlay()}

    def _sections(self, shown: Mapping[str, Picture | Film], remarks: Sequence[str]) -> list[Section]:
        plan, texts, verdict = self.plan, self.texts, (self.plan.success, self.verdict)
        notes = texts.paragraphs("search")
        sections: list[Section] = [
            Section("In short", verdict=verdict, text=(*remarks, *self.advice), tiles=self.tiles, notes=notes)
        ]
        if self.story:
            sections.append(Section("The plan" if plan.run is None else "What happens", text=self.story))
        if shown:
            sections.append(Section(f"The {self.noun}", pictures=tuple(shown.values())))
        if plan.motion is not None:
            note = texts.paragraphs("note")
            sections.append(Section("Check with a finer rope", table=texts.table("checks"), notes=note))
            sections.append(Section("Motor", table=texts.table("motor")))
        return [*sections, Section("Set-up", text=texts.paragraphs("setup"))]

    @property
    def _starts(self) -> Array:
        """Starts of all moves, s."""
        return np.zeros(0) if self.plan.moves is None else self.plan.moves.starts(self.plan.problem.limits)

    def move_count(self) -> str:
        """Return how many moves the arm makes, with their name."""
        count = self._starts.size - self.last_move
        return f"{count} {self.move}{'' if count == 1 else 's'}"

    def film_note(self, t: float) -> str:
        """Return the film's note at a time, s: target, move of the arm, and what has happened."""
        begun, count = int((self._starts <= t).sum()), self._starts.size - self.last_move
        doing = f"{self.move} {begun} of {count}" if begun else f"{self.move_count()} to come"
        return "\n".join(
            (self.texts.text("film"), f"arm: {'last move' if begun > count else doing}", self.rope_note(t))
        )

    def rope_note(self, t: float) -> str:
        """Return what has happened to the rope by a time, s."""
        return self.texts.text("end") if t >= self.event else ""

    @abstractmethod
    def strobe_of_event(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the rope at many instants about the event, into given axes or a new figure."""

    def strobe_at(self, t: float, before: float, after: float, shown: str, **options: Any) -> "Figure":
        """Draw the rope at many instants `before` and `after` a time `t`, s; `shown` explains the other objects.

        `options` are further ones of :func:`strobe_figure`.
        """
        start, end = max(t - before, float(self.run.t[0])), min(t + after, float(self.run.t[-1]))
        title = f"simulated; {shown}"
        return strobe_figure(self.run, start=start, end=end, count=52, title=title, overlay=self.overlay(), **options)

    def motor_peaks(self) -> tuple[float, float]:
        """Return the greatest speed, rad/s, and acceleration, rad/s^2, of the motion."""
        motion = self.plan.required(self.plan.motion, "motion")
        speed, rise = (float(np.abs(motion.extrema(k)[1]).max()) for k in (1, 2))
        return speed, rise
