"""Candidate experiments: motion of the arm, frame rate, duration and markers."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, Interrupted, InvalidInput
from hyperflex.identification.findings import NAMES
from hyperflex.identification.fit import Linear, Loss, Window, linearise
from hyperflex.identification.measurements import build_plant, measure, usual_length, with_torque
from hyperflex.identification.model import PRECISION, Parameter, Parameters, parse, pivot_places
from hyperflex.identification.multi_start import diverges, joined_lengths
from hyperflex.identification.options import RecordingSetup
from hyperflex.identification.ranking import Ranking
from hyperflex.identification.uncertainty.covariance import Information, fisher_information, ratio_spread, ratios
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Arm, Rope, parse_label
from hyperflex.motion import Motion, arm_swings
from hyperflex.recording import Recording
from hyperflex.sensors import Markers
from hyperflex.simulation import simulate
from hyperflex.status import Status

MOST_FRAMES = 1_000_000  # of an experiment: some minutes of work
MARKERS = 11  # at most, of the default experiments
ANGLES = (0.3, 0.8, 1.5)  # rad, from which a straight rope is let go
RATES, DURATIONS, FEW = (7.5, 120.0), (5.0, 20.0), (3, 6)
FAINT = 1e-3  # a ratio below this part of the largest of its kind is compared with that
WEIGHED = ("mass", "com", "tip_mass")  # measurable with scales
FORCELESS = ("J/p1", "p/p1", "c/p1")  # ratios that need no known force


@dataclass(frozen=True, eq=False)
class Experiment:
    """A recording that could be made.

    Parameters
    ----------
    name : str
        For tables.
    motion : Motion, optional
        Motion of the arm or of the first joint; by default it is fixed.
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
    q0: ArrayLike | None = None
    qd0: ArrayLike | None = None
    rate: float = 30.0
    duration: float = 10.0
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
        if not 2.0 <= self.rate * self.duration + 1e-9 < MOST_FRAMES:
            raise InvalidInput(
                "experiment rate and duration give too few frames, or too many",
                got=[self.rate, self.duration],
                allowed=f"3 to {MOST_FRAMES:g} frames",
            )

    @property
    def t(self) -> Array:
        """Times of the frames (T,), s."""
        return np.arange(int(np.floor(self.duration * self.rate + 1e-9)) + 1) / self.rate


def default_experiments(rope: Rope, arm: Arm | None) -> list[Experiment]:
    """Return the motions tried first: free swings, and with an arm the paper's."""
    n, hangs = rope.n_links, rope.hanging_angle
    found = [Experiment(f"let go at {angle:g} rad", q0=hangs + angle) for angle in ANGLES]
    if n > 1:
        bent = ANGLES[1]
        found.append(Experiment(f"let go bent, {bent:g} to {-bent:g} rad", q0=hangs + np.linspace(bent, -bent, n)))
    if arm is not None:
        rests = (0.34, 0.53, 0.80)  # s, of the paper's swings: its failure, its success, and a slow one
        found += [Experiment(f"swings, rest {rest:g} s", arm_swings(t_rest=rest)) for rest in rests]
    return [replace(each, markers=min(n + 1, MARKERS)) for each in found]


def variations(best: Experiment) -> list[Experiment]:
    """Return an experiment at other frame rates, durations, and with fewer markers."""
    named = [replace(best, name=f"{best.name}, {rate:g} frames/s", rate=rate) for rate in RATES]
    named += [replace(best, name=f"{best.name}, {time:g} s", duration=time) for time in DURATIONS]
    most = best.markers or 0
    return named + [replace(best, name=f"{best.name}, {few} markers", markers=few) for few in FEW if few < most]


def size(parameter: Parameter, x: float) -> float:
    """Return what a standard deviation is compared with: the value, or a typical change of what is 0 or an offset."""
    value = abs(parameter.value(x))
    return value if value > 0.0 and parameter.form != "linear" else parameter.width * parameter.scale


def expected_information(
    rope: Rope, experiment: Experiment, free: Sequence[str], arm: Arm | None, noise: float
) -> tuple[Parameters, Information]:
    """Return the parameters and their Fisher information in a simulated recording, windows and states as in a fit.

    InvalidInput or SimulationError if the experiment does not fit the rope or cannot be simulated.
    """
    t, motion, n = experiment.t, experiment.motion, rope.n_links
    base = arm if motion is not None else None
    q0, qd0 = (
        None if given is None else checks.array(f"experiment {name}", given, (n,), unit=unit, scalar=True)
        for name, given, unit in (("q0", experiment.q0, "rad"), ("qd0", experiment.qd0, "rad/s"))
    )
    tol = PRECISION * rope.total_length
    run = simulate(rope, motion, arm=base, duration=float(t[-1]), t_eval=t, tol=tol, q0=q0, qd0=qd0)
    spread = experiment.noise or noise
    if experiment.markers is None:
        arc_lengths, recording = None, Recording(t, run.q, noise=np.full(n, spread))
    else:
        arc_lengths = np.linspace(0.0, rope.total_length, experiment.markers)
        places = Markers(arc_lengths).predict(rope, run.q, pivot_places(motion, base, t))
        recording = Recording(t, places, "markers", np.full(places.shape[1], spread))
    measured, setup = measure(recording, rope, arc_lengths), RecordingSetup(motion, base, arc_lengths)
    if experiment.torque_noise is not None:
        if base is None:
            raise InvalidInput("the torque of no motor can be measured", fix="Give a motion, and arm=... to design")
        setup = replace(setup, torque=run.motor_torque, torque_noise=experiment.torque_noise)
        measured = with_torque(measured, setup)
    plant = build_plant(recording, rope, free, setup)
    length = usual_length(measured.shape, rope, fewest=0)  # alike for all frame rates
    x = plant.parameters.start

    def at(window: Window) -> Linear:  # which the model fits, the noise as given
        k = np.searchsorted(t, window.t[0])
        return linearise(plant, window, x, np.append(run.q[k], run.qd[k]), np.zeros(window.y.size), Loss())

    models: list[Linear] = []
    for longer in joined_lengths(length, recording.duration, rope):
        windows = measured.windows(longer, measured.step(min(longer, length)))[0]
        now = [at(window) for window in windows]
        if models and any(map(diverges, windows, now)):
            break
        models = now
    return plant.parameters, fisher_information(plant.parameters, x, [each.reduced()[0] for each in models])


def spreads(parameters: Parameters, information: Information, want: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return standard deviation, and the same over the size of the value, of each single number in `want`.

    InvalidInput for a word that is neither free nor a ratio.
    """
    x, known = information.x, ratios(parameters.rope(information.x), parameters.names)
    std = information.deviations(parameters.derivatives(x))
    result: dict[str, tuple[float, float]] = {}
    for word in want:
        if word in known:
            spread, value = ratio_spread(parameters, information)[word], np.abs(known[word])
            part = spread / np.maximum(value, FAINT * value.max() or 1.0)
            links = range(int(word == "p/p1"), value.size)  # that of link 0 is 1 by definition
            result |= {f"{word}[{k}]": (float(spread[k]), float(part[k])) for k in links}
            continue
        which = [k for k, each in enumerate(parameters.all) if word in (each.label, each.name)]
        if not which:
            words = [*(each.name for each in parameters.all), *parameters.labels, *known]
            raise InvalidInput("want has names that are not free", got=word, allowed=", ".join(dict.fromkeys(words)))
        for k in which:
            one = parameters.all[k]
            result[one.label] = float(std[k]), float(std[k] / size(one, x[k]))
    return result


@dataclass(frozen=True, eq=False)
class ExperimentPlan:
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
    _scaled: bool = field(default=False, repr=False)  # whether an unknown factor is common to masses and frictions

    @property
    def score(self) -> float:
        """The largest relative standard deviation; inf if a wanted number is not determined."""
        return max(self.relative.values(), default=float("inf"))


@dataclass(frozen=True, eq=False)
class ExperimentDesign(Ranking):
    """Experiments ranked by expected standard deviations; ``print`` shows the table.

    Attributes
    ----------
    plans : tuple of ExperimentPlan
        The best first, those that could not be simulated last.
    want : tuple of str
        Names of the wanted numbers.
    recommendation : str
        Text: the recommended experiment, or what to measure if no experiment determines the wanted numbers.
    ended : Status or None
        INTERRUPTED or OUT_OF_TIME if not all candidates were simulated.
    """

    plans: tuple[ExperimentPlan, ...]
    want: tuple[str, ...]
    recommendation: str
    ended: Status | None = None

    @property
    def best(self) -> ExperimentPlan | None:
        """The plan with the smallest standard deviations; None if none determines the wanted numbers."""
        return next((plan for plan in self.plans[:1] if np.isfinite(plan.score)), None)

    def summary(self) -> dict[str, Any]:
        """Return ranking and texts as plain numbers, lists and strings; None for a number that is not determined."""
        table = []
        for plan in self.plans:
            row = {name: getattr(plan.experiment, name) for name in ("name", "rate", "duration", "markers")}
            table.append(row | {"std": plan.std, "relative": plan.relative, "reason": plan.reason})
        return dict(files.plain(super().summary() | {"want": self.want, "plans": table}))

    def __str__(self) -> str:
        labels = next((list(plan.std) for plan in self.plans if plan.std), [])[:NAMES]
        head = ["experiment", "frames/s", "time, s", "markers", "relative", *(f"std of {label}" for label in labels)]
        rows: list[tuple[list[str], str]] = [(head, "")]
        for plan in self.plans:
            e = plan.experiment
            cells = [e.name, f"{e.rate:g}", f"{e.duration:g}", str(e.markers or "angles")]
            if not plan.reason:
                cells += [
                    _percent(plan.score),
                    *(f"{plan.std[label]:.3g}".replace("inf", "not determined") for label in labels),
                ]
            rows.append((cells, f"failed: {plan.reason}" if plan.reason else ""))
        return self._text(f"Experiments for {', '.join(self.want)}", rows)


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
        The rope, as well as it is known.
    want : str or sequence of str
        Wanted numbers: names or labels of free parameters (``"friction"``, ``"inertia[1]"``), or ratios that need no
        known force (``"J/p1"``, ``"p/p1"``, ``"c/p1"``).
    candidates : sequence of Experiment, optional
        By default free swings from several angles and, with an arm, the paper's swings with several rests, 10 s at
        30 frames/s and at most 11 markers; the best of them then with other rates, durations and fewer markers.
    arm : Arm, optional
        Arm that the motions of the candidates turn.
    noise : float
        Standard deviation of a measured value: of a marker's coordinate, m, or of an angle, rad.
    free : sequence of str
        Parameters that will be fitted, as in :func:`hyperflex.identify`.
    time_budget : float or Budget, optional
        Wall-clock time, s, without compiling; no limit by default. If it runs out, the candidates simulated until then
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
    Experiments are ranked by the largest relative standard deviation of the wanted numbers. The prediction is of first
    order: it is valid for small, white noise, a fit of the whole recording (``train=float("inf")``), a true model, and
    exact lengths and times (``length_std=0, clock_std=0``). Errors of lengths and times add to it in any experiment;
    longer recordings or less noise do not reduce them.

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
    checks.instance("rope", rope, Rope)
    if arm is not None:
        checks.instance("arm", arm, Arm)
    if candidates is not None:
        candidates = checks.sequence("candidates", candidates, "hyperflex.Experiment")
        if not candidates or not all(isinstance(each, Experiment) for each in candidates):
            allowed = "a list of hyperflex.Experiment"
            raise InvalidInput("candidates are no experiments", got=candidates, allowed=allowed)
    parse(rope, free, np.array([0.0, rope.total_length]), moved=True, arm=arm or Arm())  # wrong for one, wrong for all
    todo = default_experiments(rope, arm) if candidates is None else list(candidates)
    plans: list[ExperimentPlan] = []
    budget, varied = Budget.of(time_budget), candidates is not None
    with (
        stoppable() as stop,
        budget.progress(progress, "designing", len(todo) + (0.0 if varied else 6.0), "experiments"),
    ):
        while todo:
            budget.check()
            plans.append(_plan(rope, todo.pop(0), words, free, arm, noise))
            budget.report(float(len(plans)))
            best = min(plans, key=lambda plan: plan.score)
            if not (todo or varied) and np.isfinite(best.score):
                todo, varied = variations(best.experiment), True
    if stop.received and not plans:
        raise Interrupted
    ranked = tuple(sorted(plans, key=lambda plan: (plan.score, bool(plan.reason))))
    return stop.deliver(ExperimentDesign(ranked, words, _recommendation(ranked, words, free), stop.status))


def _plan(
    rope: Rope, experiment: Experiment, want: Sequence[str], free: Sequence[str], arm: Arm | None, noise: float
) -> ExperimentPlan:
    """Return the plan of one candidate; errors of `want` pass through."""
    try:
        parameters, information = expected_information(rope, experiment, free, arm, noise)
    except HyperflexError as failure:
        return ExperimentPlan(experiment, {}, {}, str(failure))
    found = spreads(parameters, information, want).items()
    stds, parts = ({name: each[k] for name, each in found} for k in (0, 1))
    return ExperimentPlan(experiment, stds, parts, _scaled=bool(np.any(information.growing)))


def _recommendation(ranked: Sequence[ExperimentPlan], want: Sequence[str], free: Sequence[str]) -> str:
    """Return which experiment to make or, where none determines the wanted numbers, why not and what would."""
    best, *others = ranked
    if best.reason:
        return "No candidate could be simulated."
    if np.isfinite(best.score):
        worst = max(best.relative, key=lambda name: best.relative[name])
        said = f"Make: {best.experiment.name}. It determines {worst} to {_percent(best.score)}"
        said += f" and the rest of {', '.join(want)} better." if len(best.std) > 1 else "."
        blind = [plan.experiment.name for plan in others if not plan.reason and not np.isfinite(plan.score)]
        return f"{said} Not sufficient: {', '.join(blind)}." if blind else said
    lost = ", ".join(name for name, std in best.std.items() if not np.isfinite(std))
    weighed = " and ".join(word for word in free if (label := parse_label(word)) and label.name in WEIGHED)
    scales = f" Weigh the links and leave {weighed} out of free." if weighed else ""
    if not best._scaled:
        why = "it has no effect in these motions, or the same effect as other free parameters"
        return f"No candidate determines {lost}: {why}.{scales} Or free fewer parameters, or try other motions."
    why = "no known force or torque acts, so masses, inertias and frictions share an unknown factor"
    return (
        f"No candidate determines {lost}: {why}.{scales} Or measure the torque of the motor that drives the rope "
        f"(arm=..., torque_noise=...). Ratios over the first moment need neither: want={FORCELESS}."
    )


def _percent(value: float) -> str:
    return f"{100.0 * value:.3g} %" if np.isfinite(value) else "-"
