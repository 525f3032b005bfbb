"""Choice of the next experiment: candidates ranked by expected standard deviation, and advice."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.errors import HyperflexError, Interrupted, InvalidInput
from hyperflex.files import PathLike
from hyperflex.identification.experiment_design.experiments import Experiment, default_experiments, variations
from hyperflex.identification.experiment_design.fisher_information import ExpectedInformation, expected_information
from hyperflex.identification.model.names import parse
from hyperflex.identification.model.scale import common_factor
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Arm, Rope
from hyperflex.progress import progress_bar
from hyperflex.status import Status

WEIGHED = ("mass", "com", "tip_mass")  # measurable with scales
TORQUE_NOISE = 0.01  # part of the torque that holds arm and rope out level, all mass at the tip
SHOWN = 3  # numbers asked for in a line of the table, the rest in the summary


@dataclass(frozen=True)
class DesignQuestion:
    """Arguments of :func:`design_experiment`."""

    rope: Rope
    want: tuple[str, ...]
    free: tuple[str, ...]
    arm: Arm | None
    noise: float


@dataclass(frozen=True, eq=False)
class Plan:
    """An experiment and the standard deviations that it would give.

    Attributes
    ----------
    experiment : Experiment
    std, relative : dict of str to float
        Predicted standard deviation of each wanted number, SI units, and relative to its value (to a typical change for
        a value of 0, or an offset); inf if the experiment does not determine it.
    reason : str
        Why the experiment could not be simulated; empty if it could.
    """

    experiment: Experiment
    std: dict[str, float]
    relative: dict[str, float]
    reason: str = ""

    @property
    def score(self) -> float:
        """The largest relative standard deviation; inf if a wanted number is not determined."""
        return max(self.relative.values(), default=float("inf"))


@dataclass(frozen=True, eq=False)
class ExperimentDesign:
    """Experiments ranked by expected standard deviations; ``print`` shows the table.

    Attributes
    ----------
    plans : tuple of Plan
        The best first, those that could not be simulated last.
    want : tuple of str
        Names of the wanted numbers.
    advice : str
        Text: the recommended experiment, or what to measure if no experiment determines the wanted numbers.
    interrupted : bool
        Whether Ctrl-C came before all candidates were simulated.
    """

    plans: tuple[Plan, ...]
    want: tuple[str, ...]
    advice: str
    interrupted: bool = False

    @property
    def status(self) -> Status:
        """SUCCESS if all candidates were simulated and one determines what is wanted."""
        if self.interrupted:
            return Status.INTERRUPTED
        return Status.FAILED if self.best is None else Status.SUCCESS

    @property
    def success(self) -> bool:
        """Whether all candidates were simulated and one determines what is wanted."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why the design failed; empty on success."""
        return "" if self.success else f"{self.status}: {self.advice}"

    @property
    def best(self) -> Plan | None:
        """The plan with the smallest standard deviations; None if none determines the wanted numbers."""
        first = self.plans[0] if self.plans else None
        return first if first is not None and np.isfinite(first.score) else None

    def summary(self) -> dict[str, Any]:
        """Return ranking and texts as plain numbers, lists and strings; None for a number that is not determined."""
        head = {"success": self.success, "status": self.status, "message": self.message}
        table = []
        for plan in self.plans:
            e = plan.experiment
            row: dict[str, Any] = {"name": e.name, "rate": e.rate, "duration": e.duration, "markers": e.markers}
            table.append(row | {"std": plan.std, "relative": plan.relative, "reason": plan.reason})
        return dict(files.plain(head | {"want": self.want, "advice": self.advice, "plans": table}))

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def __str__(self) -> str:
        wide = max([10, *(len(plan.experiment.name) for plan in self.plans)])
        labels = next((list(plan.std) for plan in self.plans if plan.std), [])[:SHOWN]
        columns = "".join(f"  {'std of ' + label:>18}" for label in labels)
        lines = [f"Experiments for {', '.join(self.want)} ({self.status})"]
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


@interruptible(ExperimentDesign)
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
    Interrupted
        By Ctrl-C. Its ``partial`` ranks the candidates simulated until then; None before any was.

    Notes
    -----
    Ranked by the largest relative standard deviation among what is asked for. The prediction is first order: it holds
    for small noise, a fit of the whole recording (``train=float("inf")``), white noise, a true model, and lengths and
    times that are exact (``length_std=0, clock_std=0``): their errors come on top in any experiment, and longer
    recordings or less noise do not lessen them.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rope = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    >>> small = hf.Experiment("small", q0=0.1, duration=4.0)
    >>> large = hf.Experiment("large", q0=0.8, duration=4.0)
    >>> hf.design_experiment(rope, "friction", [small, large]).best.experiment.name
    'large'
    """
    names = [want] if isinstance(want, str) else checks.sequence("want", want, "names of parameters")
    words = tuple(checks.text("a name in want", word) for word in names)
    free, progress = checks.sequence("free", free, "names of parameters"), checks.flag("progress", progress)
    checks.number("noise", noise, sign="positive", unit="m or rad")
    todo = _todo(rope, candidates, arm)
    asked = DesignQuestion(rope, words, tuple(free), arm, noise)
    parse(rope, free, np.array([0.0, rope.total_length]), moved=True, arm=arm or Arm())  # wrong for one, wrong for all
    plans: list[Plan] = []
    seen: list[ExpectedInformation] = []
    last = len(todo) + (0.0 if candidates is not None else 6.0)
    with stoppable() as stop, progress_bar(0.0, last, progress, "designing", "experiments") as report:
        for experiment in _in_turn(todo, plans, vary=candidates is None):
            plans.append(_plan(asked, experiment, seen))
            if report is not None:
                report(float(len(plans)))
    if stop.received and not plans:
        raise Interrupted
    ranked = tuple(sorted(plans, key=lambda plan: (plan.score, bool(plan.reason))))
    return stop.deliver(ExperimentDesign(ranked, words, _advice(asked, ranked, seen), stop.received))


def _todo(rope: Rope, candidates: Sequence[Experiment] | None, arm: Arm | None) -> list[Experiment]:
    checks.instance("rope", rope, Rope)
    if arm is not None:
        checks.instance("arm", arm, Arm)
    if candidates is None:
        return default_experiments(rope, arm)
    candidates = checks.sequence("candidates", candidates, "hyperflex.Experiment")
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
    if all(plan.reason for plan in ranked):
        return "No candidate could be simulated."
    best = ranked[0]
    if not np.isfinite(best.score):
        return _alternatives(asked, [plan.experiment for plan in ranked if not plan.reason], seen[0])
    worst = max(best.relative, key=lambda name: best.relative[name])
    said = f"Make: {best.experiment.name}. It determines {worst} to {_percent(best.score)}"
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
        said += f" Not sufficient: {', '.join(blind)}."
    return said


def _alternatives(asked: DesignQuestion, experiments: Sequence[Experiment], seen: ExpectedInformation) -> str:
    """Return why none of the simulated `experiments` determines the wanted numbers, and what would."""
    lost = [name for name, (std, _) in seen.spreads(asked.want).items() if not np.isfinite(std)]
    names = ", ".join(lost) or ", ".join(asked.want)
    if common_factor(seen.parameters, seen.information.x, seen.information.unknown) is None:
        why = "it has no effect in these motions, or the same effect as other free parameters"
        weighed = _weigh(asked, experiments) or "Free fewer parameters, or try motions in which their effects differ."
        return f"No candidate determines {names}: {why}. {weighed}"
    why = "no known force or torque acts, so masses, inertias and frictions share an unknown factor"
    known = [name for name in ("J/p1", "p/p1", "c/p1") if _tells(seen, name)]
    ratio = f"Ratios over the first moment are determined nevertheless: want={known!r}." if known else ""
    helps = (_weigh(asked, experiments), _torque(asked, experiments), ratio)
    return " ".join([f"No candidate determines {names}: {why}.", *(text for text in helps if text)])


def _weigh(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    kept = tuple(word for word in asked.free if word.partition(":")[0].partition("[")[0] not in WEIGHED)
    own = [word for word in asked.want if word.partition("[")[0] in WEIGHED]
    if own:
        return f"Measure {', '.join(own)} directly, with scales, and com on a knife edge."
    if not kept or kept == asked.free:
        return ""
    found = _best(replace(asked, free=kept), experiments)
    weighed = " and ".join(word for word in asked.free if word not in kept)
    return "" if not found else f"Weigh the links and leave {weighed} out of free: {found}."


def _torque(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    if asked.arm is None:
        return "Or drive the rope by a motor whose torque is measured (arm=..., torque_noise)."
    moved = [each for each in experiments if each.motion is not None and each.torque_noise is None]
    reach = asked.arm.length + asked.rope.total_length
    noise = float(f"{TORQUE_NOISE * asked.rope.total_mass * float(np.hypot(*asked.rope.gravity)) * reach:.1g}")
    found = _best(asked, [replace(each, torque_noise=noise) for each in moved])
    return "" if not found else f"Or measure the motor's torque, for example to {noise:g} N m: {found}."


def _tells(seen: ExpectedInformation, name: str) -> bool:
    spreads = seen.spreads([name])
    return bool(spreads) and all(np.isfinite(std) for std, _ in spreads.values())


def _best(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return which experiment then determines the wanted numbers, and how well; empty if none does."""
    scores: dict[str, float] = {}
    for experiment in experiments:
        try:
            expected = expected_information(asked.rope, experiment, asked.free, asked.arm, asked.noise)
            scores[experiment.name] = max(part for _, part in expected.spreads(asked.want).values())
        except HyperflexError:
            continue
    name = min(scores, key=lambda each: scores[each], default="")
    if not name or not np.isfinite(scores[name]):
        return ""
    return f"then {name} determines {', '.join(asked.want)} to {100.0 * scores[name]:.3g} %"


def _figure(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "not determined"


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %" if np.isfinite(value) else "-"
