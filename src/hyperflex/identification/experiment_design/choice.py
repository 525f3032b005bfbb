"""Choice of the next experiment: candidates ranked by expected standard deviation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.files import PathLike
from hyperflex.identification.ending import CONVERGED, INTERRUPTED, Ended
from hyperflex.identification.experiment_design.alternatives import DesignQuestion, advise_alternatives
from hyperflex.identification.experiment_design.experiments import Experiment, default_experiments, variations
from hyperflex.identification.experiment_design.fisher_information import ExpectedInformation, expected_information
from hyperflex.identification.model.names import parse
from hyperflex.model import Arm, Rope
from hyperflex.simulation.rollouts import progress_bar

SHOWN = 3  # wanted numbers in a line of the table, the rest in the summary


@dataclass(frozen=True, eq=False)
class Plan:
    """An experiment and what it would tell.

    Attributes
    ----------
    experiment : Experiment
    std : dict of str to float
        Predicted standard deviation of each wanted number, SI units; inf where the experiment cannot tell it.
    relative : dict of str to float
        The same over the number's value (over a typical change where it is 0, or an offset).
    reason : str
        Why it could not be simulated, or empty.
    """

    experiment: Experiment
    std: dict[str, float]
    relative: dict[str, float]
    reason: str = ""

    @property
    def score(self) -> float:
        """The largest relative standard deviation; inf where something wanted cannot be told."""
        return max(self.relative.values(), default=float("inf"))


@dataclass(frozen=True, eq=False)
class ExperimentDesign(Ended):
    """Experiments ranked by what they would tell; ``print`` shows the table.

    Attributes
    ----------
    plans : tuple of Plan
        The best first, those that could not be simulated last.
    want : tuple of str
        What was wanted.
    advice : str
        In words: which to make; or what to measure where none can tell.
    message : {"converged", "interrupted"}
        Whether all candidates were simulated before Ctrl-C.
    """

    plans: tuple[Plan, ...]
    want: tuple[str, ...]
    advice: str
    message: str = CONVERGED

    @property
    def success(self) -> bool:
        """Whether all candidates were simulated and one can tell what is wanted."""
        return self.message == CONVERGED and self.best is not None

    @property
    def best(self) -> Plan | None:
        """The plan that tells most about what is wanted; None where none can tell it."""
        first = self.plans[0] if self.plans else None
        return first if first is not None and np.isfinite(first.score) else None

    def summary(self) -> dict[str, Any]:
        """Return ranking and words as plain numbers, lists and strings; None where something cannot be told."""
        table = []
        for plan in self.plans:
            e = plan.experiment
            row: dict[str, Any] = {"name": e.name, "rate": e.rate, "duration": e.duration, "markers": e.markers}
            table.append(row | {"std": plan.std, "relative": plan.relative, "reason": plan.reason})
        return dict(files.plain(self.ending() | {"want": self.want, "advice": self.advice, "plans": table}))

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def __str__(self) -> str:
        wide = max([10, *(len(plan.experiment.name) for plan in self.plans)])
        labels = next((list(plan.std) for plan in self.plans if plan.std), [])[:SHOWN]
        columns = "".join(f"  {'std of ' + label:>18}" for label in labels)
        lines = [f"Experiments for {', '.join(self.want)} ({self.message})"]
        lines.append(f"  {'experiment':<{wide}}  frames/s  time, s  markers  {'relative':>9}{columns}")
        for plan in self.plans:
            e = plan.experiment
            start = f"  {e.name:<{wide}}  {e.rate:8g}  {e.duration:7g}  {e.markers or 'angles':>7}"
            if plan.reason:
                lines.append(f"{start}  failed: {plan.reason}")
                continue
            figures = "".join(f"  {_figure(plan.std[label]):>18}" for label in labels)
            lines.append(f"{start}  {_percent(plan.score):>9}{figures}")
        return "\n".join([*lines, f"  {self.advice}"])


def design_experiment(
    rope: Rope,
    want: str | Sequence[str],
    candidates: Sequence[Experiment] | None = None,
    *,
    arm: Arm | None = None,
    noise: float = 2e-3,
    free: Sequence[str] = ("inertia", "friction"),
    progress: bool = False,
) -> ExperimentDesign:
    """Rank experiments by the standard deviations that a fit would state of some parameters (Fisher information).

    Parameters
    ----------
    rope : Rope
        The rope as far as it is known.
    want : str or sequence of str
        What is to be known well: names or labels of free parameters (``"friction"``, ``"inertia[1]"``), or ratios that
        need no known force (``"J/p1"``, ``"p/p1"``, ``"c/p1"``).
    candidates : sequence of Experiment, optional
        By default free swings from several angles and, with an arm, the paper's swings with several rests, 10 s at
        30 frames/s and at most 11 markers; the best of them then with other rates, durations and fewer markers.
    arm : Arm, optional
        What the motions of the candidates turn.
    noise : float
        Standard deviation of a measured value: of a marker's coordinate, m, or of an angle, rad.
    free : sequence of str
        What will be fitted, as in :func:`hyperflex.identify`.
    progress : bool
        Show a bar on standard error.

    Raises
    ------
    InvalidInput
        For names in `want` that are not free, or an unknown word in `free`.
    KeyboardInterrupt
        When Ctrl-C comes before any candidate was simulated; later those done are ranked.

    Notes
    -----
    Ranked by the largest relative standard deviation among what is wanted. The prediction is first order: it holds for
    small noise, a fit of the whole recording (``train=float("inf")``), white noise and a true model.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rope = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    >>> small = hf.Experiment("small", q0=0.1, duration=4.0)
    >>> large = hf.Experiment("large", q0=0.8, duration=4.0)
    >>> hf.design_experiment(rope, "friction", [small, large]).best.experiment.name
    'large'
    """
    words = (want,) if isinstance(want, str) else tuple(want)
    checks.number("noise", noise, sign="positive", unit="m or rad")
    todo = _todo(rope, candidates, arm)
    asked = DesignQuestion(rope, words, tuple(free), arm, noise)
    parse(rope, free, np.array([0.0, rope.total_length]), moved=True, arm=arm or Arm())  # wrong for one, wrong for all
    plans: list[Plan] = []
    seen: list[ExpectedInformation] = []
    message = CONVERGED
    with progress_bar(0.0, len(todo) + (0.0 if candidates is not None else 6.0), progress, "designing") as report:
        try:
            for experiment in _in_turn(todo, plans, vary=candidates is None):
                plans.append(_plan(asked, experiment, seen))
                if report is not None:
                    report(float(len(plans)))
        except KeyboardInterrupt:
            if not plans:
                raise
            message = INTERRUPTED
    ranked = tuple(sorted(plans, key=lambda plan: (plan.score, bool(plan.reason))))
    return ExperimentDesign(ranked, words, _advice(asked, ranked, seen), message)


def _todo(rope: Rope, candidates: Sequence[Experiment] | None, arm: Arm | None) -> list[Experiment]:
    """Return the candidates to begin with."""
    if not isinstance(rope, Rope):
        raise InvalidInput("design takes a Rope", got=type(rope).__name__)
    if candidates is None:
        return default_experiments(rope, arm)
    if len(candidates) == 0 or not all(isinstance(each, Experiment) for each in candidates):
        raise InvalidInput("candidates are no experiments", got=candidates, allowed="a list of hyperflex.Experiment")
    return list(candidates)


def _in_turn(todo: Sequence[Experiment], plans: Sequence[Plan], *, vary: bool) -> Iterator[Experiment]:
    """Yield what to look at, and then variations of what was best."""
    yield from todo
    if vary and plans:
        best = min(plans, key=lambda plan: plan.score)
        if np.isfinite(best.score):
            yield from variations(best.experiment)


def _plan(asked: DesignQuestion, experiment: Experiment, seen: list[ExpectedInformation]) -> Plan:
    """Return the plan of one candidate; errors of `want` pass through."""
    try:
        expected = expected_information(asked.rope, experiment, asked.free, asked.arm, asked.noise)
    except HyperflexError as failure:
        return Plan(experiment, {}, {}, str(failure))
    seen.append(expected)
    spreads = expected.spreads(asked.want).items()
    return Plan(experiment, {name: std for name, (std, _) in spreads}, {name: part for name, (_, part) in spreads})


def _advice(asked: DesignQuestion, ranked: Sequence[Plan], seen: Sequence[ExpectedInformation]) -> str:
    """Return what to do, in words."""
    if all(plan.reason for plan in ranked):
        return "No candidate could be simulated."
    best = ranked[0]
    if not np.isfinite(best.score):
        return advise_alternatives(asked, [plan.experiment for plan in ranked if not plan.reason], seen[0])
    worst = max(best.relative, key=lambda name: best.relative[name])
    said = f"Make: {best.experiment.name}. It tells {worst} to {_percent(best.score)}"
    said += (
        f" ({_figure(best.std[worst])})" if len(best.std) == 1 else f" and the rest of {', '.join(asked.want)} better"
    )
    others = [plan for plan in ranked[1:] if np.isfinite(plan.score)]
    blind = [plan.experiment.name for plan in ranked[1:] if not plan.reason and not np.isfinite(plan.score)]
    if others:
        last = others[-1]
        said += f"; {last.experiment.name} would leave {last.score / best.score:.2g} times as much"
    said += "."
    if blind:
        said += f" Cannot tell: {', '.join(blind)}."
    return said


def _figure(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "cannot be told"


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %" if np.isfinite(value) else "-"
