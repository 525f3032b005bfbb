"""Candidate experiments: motion of the arm, frame rate, duration and markers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, Interrupted, InvalidInput
from hyperflex.files import PathLike
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import linearise
from hyperflex.identification.fit.windows import Window, decimation_step, usual_length
from hyperflex.identification.measurements import build_plant, measure, with_torque
from hyperflex.identification.model.parameters import Parameter, Parameters, common_factor, in_common_factor, parse
from hyperflex.identification.model.plant import PRECISION, Plant, pivot_places
from hyperflex.identification.options import RecordingSetup
from hyperflex.identification.uncertainty.covariance import Information, known_directions
from hyperflex.identification.uncertainty.ratios import ratio_spread, ratios
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, arm_swings
from hyperflex.recording import Recording
from hyperflex.sensors import Markers
from hyperflex.simulation import simulate
from hyperflex.status import Status


@dataclass(frozen=True)
class DefaultExperiments:
    """The experiments that are tried by default."""

    most_frames: int = 1000000
    # rad at the first joint, and as much to the other side at the tip
    bent: float = 0.8
    # frames a second, s, and most markers of the default experiments
    rate: float = 30.0
    duration: float = 10.0
    markers: int = 11


DEFAULTS = DefaultExperiments()

ANGLES = (0.3, 0.8, 1.5)  # rad, from which a straight rope is let go
RESTS = (0.34, 0.53, 0.80)  # s, of the paper's swings: its failure, its success, and a slow one
RATES, DURATIONS, FEW = (7.5, 120.0), (5.0, 20.0), (3, 6)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A recording that could be made.

    Parameters
    ----------
    name : str
        For tables.
    motion : Motion, optional
        Of the arm, or of the first joint; by default it is fixed.
    q0, qd0 : (n,) array_like or float, optional
        Link angles, rad, and rates, rad/s, at the start (a number: of all links); by default it hangs at rest.
    rate, duration : float
        Frames a second; recorded time, s.
    markers : int, optional
        Number of markers, evenly from the first joint to the tip; None: the angle of every link is measured.
    noise : float, optional
        Standard deviation of a marker's coordinate, m, or of an angle, rad; None: that of :func:`design_experiment`.
    torque_noise : float, optional
        Standard deviation of the measured motor torque, N m; None: it is not measured.
    """

    name: str
    motion: Motion | None = None
    q0: npt.ArrayLike | None = None
    qd0: npt.ArrayLike | None = None
    rate: float = DEFAULTS.rate
    duration: float = DEFAULTS.duration
    markers: int | None = None
    noise: float | None = None
    torque_noise: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("rate", "1/s"), ("duration", "s"), ("noise", "m or rad"), ("torque_noise", "N m")):
            if getattr(self, name) is not None or name in ("rate", "duration"):
                checks.number(f"experiment {name}", getattr(self, name), sign="positive", unit=unit)
        if self.motion is not None and not isinstance(self.motion, Motion):
            raise InvalidInput("motion of an experiment is none", got=self.motion, allowed="a Motion, or None")
        if self.markers is not None:
            checks.count("experiment markers", self.markers, least=2)
        checks.text("experiment name", self.name)
        if not 2.0 <= self.rate * self.duration + 1e-9 < DEFAULTS.most_frames:
            raise InvalidInput(
                "experiment rate and duration give too few frames, or too many",
                got=[self.rate, self.duration],
                allowed=f"3 to {DEFAULTS.most_frames:g} frames",
            )

    @property
    def t(self) -> Array:
        """Times of the frames (T,), s."""
        return np.arange(int(np.floor(self.duration * self.rate + 1e-9)) + 1) / self.rate

    def start(self, rope: Rope) -> tuple[Array | None, Array | None]:
        """Return angles and rates (n,) of a `rope` at the start; None where they are not given."""
        n = rope.n_links
        q0 = None if self.q0 is None else checks.array("experiment q0", self.q0, (n,), unit="rad", scalar=True)
        qd0 = None if self.qd0 is None else checks.array("experiment qd0", self.qd0, (n,), unit="rad/s", scalar=True)
        return q0, qd0


def default_experiments(rope: Rope, arm: Arm | None) -> list[Experiment]:
    """Return the motions tried first: free swings, and with an arm the paper's."""
    n, hangs = rope.n_links, rope.hanging_angle
    markers = min(n + 1, DEFAULTS.markers)
    found = [Experiment(f"let go at {angle:g} rad", q0=hangs + angle, markers=markers) for angle in ANGLES]
    if n > 1:
        bent = hangs + np.linspace(DEFAULTS.bent, -DEFAULTS.bent, n)
        found.append(Experiment(f"let go bent, {DEFAULTS.bent:g} to {-DEFAULTS.bent:g} rad", q0=bent, markers=markers))
    if arm is not None:
        found += [Experiment(f"swings, rest {rest:g} s", arm_swings(t_rest=rest), markers=markers) for rest in RESTS]
    return found


def variations(best: Experiment) -> list[Experiment]:
    """Return an experiment at other frame rates, durations, and with fewer markers."""
    named = [replace(best, name=f"{best.name}, {rate:g} frames/s", rate=rate) for rate in RATES]
    named += [replace(best, name=f"{best.name}, {time:g} s", duration=time) for time in DURATIONS]
    most = best.markers or 0
    named += [replace(best, name=f"{best.name}, {few} markers", markers=few) for few in FEW if few < most]
    return named


FAINT = 1e-3  # a ratio below this part of the largest of its kind is judged by that


@dataclass(frozen=True)
class ExpectedInformation:
    """What an experiment would tell about the free parameters of a rope."""

    parameters: Parameters
    information: Information

    def spreads(self, want: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Return standard deviation, and the same over the size of the value, of each single number in `want`.

        InvalidInput for a word that is neither free nor a ratio.
        """
        x = self.information.x
        rope = self.parameters.rope(x)
        std = self.information.deviations(self.parameters.derivatives(x))
        own = {
            p.label: (p.name, float(s), size(p, float(each)))
            for p, s, each in zip(self.parameters.all, std, x, strict=True)
        }
        known = ratios(rope, self.parameters.names)
        result: dict[str, tuple[float, float]] = {}
        for word in want:
            if word in known:
                spread, value = ratio_spread(self.parameters, self.information)[word], np.abs(known[word])
                against = np.maximum(value, FAINT * value.max() or 1.0)
                for k in range(value.size):
                    if word != "p/p1" or k > 0:  # the first is 1 by definition
                        result[f"{word}[{k}]"] = (float(spread[k]), float(spread[k] / against[k]))
                continue
            found = {label: (s, s / of) for label, (name, s, of) in own.items() if word in (label, name)}
            if not found:
                raise InvalidInput(
                    "want names what is not free",
                    got=word,
                    allowed=", ".join(dict.fromkeys([*(p.name for p in self.parameters.all), *own, *known])),
                )
            result |= found
        return result


def size(parameter: Parameter, x: float) -> float:
    """Return what a standard deviation is compared with: the value, or a typical change of what is 0 or an offset."""
    value = abs(parameter.value(x))
    return value if value > 0.0 and parameter.form != "linear" else parameter.width * parameter.scale


def expected_information(
    rope: Rope, experiment: Experiment, free: Sequence[str], arm: Arm | None, noise: float
) -> ExpectedInformation:
    """Return the Fisher information of the parameters in a simulated recording, windows and states as in ``identify``.

    InvalidInput or SimulationError if the experiment does not fit the rope or cannot be simulated.
    """
    t, motion = experiment.t, experiment.motion
    base = arm if motion is not None else None
    tol = PRECISION * rope.total_length
    q0, qd0 = experiment.start(rope)
    run = simulate(rope, motion, arm=base, duration=float(t[-1]), t_eval=t, tol=tol, q0=q0, qd0=qd0)
    spread = experiment.noise or noise
    if experiment.markers is None:
        arc_lengths, recording = None, Recording(t, run.q, noise=np.full(1, spread).repeat(rope.n_links))
    else:
        arc_lengths = np.linspace(0.0, rope.total_length, experiment.markers)
        places = Markers(arc_lengths).predict(rope, run.q, pivot_places(motion, base, t))
        recording = Recording(t, places, "markers", np.full(places.shape[1], spread))
    torque = experiment.torque_noise
    if torque is not None and base is None:
        raise InvalidInput("the torque of no motor can be measured", fix="Give a motion, and arm=... to design")
    setup = RecordingSetup(motion, base, torque=None if torque is None else run.motor_torque)
    plant = build_plant(recording, rope, free, arc_lengths, setup)
    measured = measure(recording, rope, arc_lengths)
    if torque is not None:
        measured = with_torque(measured, run.motor_torque, torque)
    length = min(usual_length(measured.shape, rope), 1.001 * recording.duration)
    windows, _ = measured.windows(length, decimation_step(recording, length))
    states = np.hstack([run.q, run.qd])[np.searchsorted(t, [window.t[0] for window in windows])]
    return ExpectedInformation(plant.parameters, _information(plant, windows, states))


def _information(plant: Plant, windows: Sequence[Window], states: Array) -> Information:
    """Return the information of windows that the model fits, the noise as given."""
    x, widths = plant.parameters.start, plant.parameters.widths
    rows = [np.zeros((x.size, x.size))]
    for window, state in zip(windows, states, strict=True):
        linear = linearise(plant, window, x, state, np.zeros(window.y.size), Loss())
        rows.append(linear.reduced()[0] * widths)
    singular, known, unknown = known_directions(rows)
    covariance = (known / singular[: known.shape[1]] ** 2) @ known.T * np.outer(widths, widths)
    tied = in_common_factor(plant.parameters, x, unknown)
    return Information(x, widths, singular, known, unknown, covariance, 1.0, growing=tied)


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
    ended : Status or None
        INTERRUPTED or OUT_OF_TIME where not all candidates were simulated.
    """

    plans: tuple[Plan, ...]
    want: tuple[str, ...]
    advice: str
    ended: Status | None = None

    @property
    def status(self) -> Status:
        """SUCCESS if all candidates were simulated and one determines what is wanted."""
        return self.ended or (Status.FAILED if self.best is None else Status.SUCCESS)

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
    time_budget: float | Budget | None = None,
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
    time_budget : float or Budget, optional
        Seconds by the clock, without compiling; no limit by default. Out of time, the candidates simulated until then
        are ranked, with ``status`` OUT_OF_TIME.
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
    budget = Budget.of(time_budget)
    with stoppable() as stop, budget.progress(progress, "designing", last, "experiments"):
        for experiment in _in_turn(todo, plans, vary=candidates is None):
            budget.check()
            plans.append(_plan(asked, experiment, seen))
            budget.report(float(len(plans)))
    if stop.received and not plans:
        raise Interrupted
    ranked = tuple(sorted(plans, key=lambda plan: (plan.score, bool(plan.reason))))
    return stop.deliver(ExperimentDesign(ranked, words, _advice(asked, ranked, seen), stop.status))


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
