"""identify: from a recording and a first guess to an Identification."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.budget import DEFAULT_TIME, Budget, OutOfTime, one_thread
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, Interrupted, InvalidInput, listed
from hyperflex.identification.declarations.channels import channel_faults
from hyperflex.identification.declarations.evidence import evidence
from hyperflex.identification.declarations.faults import faults
from hyperflex.identification.declarations.held import DRIFT, FEW_LINKS, LAWS, SCALES, as_free
from hyperflex.identification.declarations.link_test import link_test
from hyperflex.identification.declarations.mistakes import ShortFit, mistakes, spring_or_angles
from hyperflex.identification.declarations.score_tests import (
    TESTING,
    Scores,
    ScoreTest,
    hidden_tests,
    score_tests,
)
from hyperflex.identification.declarations.window_tests import Scatter, drift_test, scatter_test
from hyperflex.identification.findings import Finding, Kind, Severity, ordered, text
from hyperflex.identification.fit import POOR, Loss, Report, part_left, residuals_of
from hyperflex.identification.measurements import (
    Measurements,
    build_plant,
    check_excitation,
    checked_measurements,
    split,
    usual_length,
    with_torque,
)
from hyperflex.identification.model import ANGLES, CONSTANT, Parameters, Plant, extended
from hyperflex.identification.multi_start import WHOLE, WORSE, Fitted, MultiStart, search_delay, with_delay
from hyperflex.identification.options import FitOptions, RecordingSetup
from hyperflex.identification.prediction import HeldOut, predict
from hyperflex.identification.result import Identification
from hyperflex.identification.symptoms import com_moved, explaining, first_misdeclared, symptoms, without_unexplained
from hyperflex.identification.uncertainty.covariance import (
    Basis,
    Information,
    Interval,
    estimate_covariance,
    fit_information,
    of_ratios,
    ratio_spread,
    ratios,
)
from hyperflex.identification.uncertainty.model_error import with_model_error, with_prediction_error
from hyperflex.identification.uncertainty.profile import all_intervals
from hyperflex.interruption import deferred, interruptible, stoppable
from hyperflex.model import Rope
from hyperflex.progress import progress_bar
from hyperflex.recording import Recording
from hyperflex.sensors import Angles, Markers
from hyperflex.status import Status

SMALL = 0.06  # rad: half a turn that was read as degrees
ODD = 0.02  # part of the motion that right fits do not leave, but for noise
MOST = 3  # parameters that are freed at most beyond the first ones: each costs a fit
# Of what was held, what a user is likely not to know: the likeliest first
MOMENTS = ("length", "mass", "com", "inertia", "tip_mass")  # what ratios of moments and inertias are made of
ALLOWED = ("com", "gravity_angle", "delay", *LAWS)


@interruptible(Identification)
@one_thread()
def identify(
    recording: Recording,
    rope_guess: Rope,
    free: Sequence[str] | None = None,
    *,
    setup: RecordingSetup | None = None,
    options: FitOptions | None = None,
    time_budget: float | Budget | None = None,
    progress: bool | Report = False,
) -> Identification:
    """Identify a rope from its recorded motion by multiple shooting with exact derivatives.

    The recording is divided into windows, each with its own initial state; the parameters are common to all. States and
    parameters are fitted together, to shorter windows first.

    Parameters
    ----------
    recording : Recording
        Angles, or markers at the joints (their angles are fitted), with as many links as the rope; or, with
        `arc_lengths`, markers anywhere along the rope (their positions are fitted), also fewer than links.
    rope_guess : Rope
        Fixed values, and first guesses of the free ones.
    free : sequence of str, optional
        By default inertia and friction (one value for all if there are more than four links), and further parameters
        that the score tests of this fit require; a finding names them. Names are, for each link, ``inertia``, ``com``,
        ``mass``, ``length``, ``friction``, ``dry_friction``, ``stiffness``, ``rest_angle``, ``drag``; for the whole
        ``tip_mass``, ``gravity_angle`` (rad; for a camera that is not level), ``delay`` (s, of `motion` in the
        recording's time; at most a window's length), ``arc`` (m; each marker's place); with a measured torque
        ``arm_inertia`` and ``arm_friction`` (of the shaft). ``friction[2]`` frees one link, ``friction:shared`` one
        value for all, ``friction:inner`` one for all but the first, ``friction:factor`` one factor on all guesses,
        ``friction:taper`` the logarithm by which it grows along the rope, 0 at its middle. With a free length, com and
        inertia of the links follow, unless they are free too.
    setup : RecordingSetup, optional
        Motion of the arm, positions of the markers, and measured torque; by default the first joint is fixed, and
        angles or markers are those of the joints.
    options : FitOptions, optional
        Windows, loss, held-out part, method of the intervals, and how well lengths, times and torques were measured.
    time_budget : float or Budget, optional
        Wall-clock time, s, without compiling; 1800 by default, inf: no limit. If it runs out, the result is the best so
        far, with ``status`` OUT_OF_TIME.
    progress : bool or callable
        True shows a bar on standard error, or a line every ten seconds if that is not a terminal; a callable gets a
        dict with window, stage, stages, round, cost, gain, damping, and of a profile its parameter and
        ``phase="profile"``.

    Raises
    ------
    InvalidInput
        For unknown names in `free`, recordings with too few samples or without motion, links or lengths that do not
        fit the rope, or more samples, links and parameters than the memory holds.
    IdentificationError
        When no window can be simulated, or the time budget ran out before the first fit.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best so far, with ``status`` INTERRUPTED, if anything was fitted.

    Notes
    -----
    Without a known force or torque a common factor of masses, inertias and frictions is not identifiable: `std` is then
    inf, and `ratios` contain what is determined. If there are more than 200 samples in a window of 1.2 periods,
    neighbours are replaced by their mean, with a robust loss by their median (``settings["decimation"]`` is their
    number). Samples without given noise have equal weights. With fewer markers than links, a prior keeps neighbouring
    links nearly aligned (0.5 rad over the root of their number).

    Examples
    --------
    >>> import numpy as np
    >>> import hyperflex as hf
    >>> true = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    >>> t = np.linspace(0.0, 6.0, 301)
    >>> swing = hf.simulate(true, duration=6.0, t_eval=t, q0=[0.8], qd0=[0.0])
    >>> result = hf.identify(hf.Recording(t, swing.q), true.replace(friction=1e-3), ["inertia", "friction"])
    >>> bool(abs(result.rope.friction[0] / 2e-4 - 1.0) < 1e-3)
    True
    """
    budget = Budget.of(DEFAULT_TIME if time_budget is None else time_budget)
    setup = checks.instance("setup", RecordingSetup() if setup is None else setup, RecordingSetup)
    options = checks.instance("options", FitOptions() if options is None else options, FitOptions)
    driven = setup.motion is not None or setup.drives
    faulty = faults(checks.instance("recording", recording, Recording), driven=driven)
    with _refused(faulty):
        measured, places = checked_measurements(recording, rope_guess, setup)
        fitted, rest = split(measured, options, setup.arc_lengths)
        check_excitation(fitted.channels, fitted.shape, rope_guess, moved=driven)
    seen = fitted
    if setup.torque is not None and not setup.drives:
        seen = split(with_torque(measured, setup.torque, setup.torque_noise), options, setup.arc_lengths)[0]
    with rounds_shown(progress) as report:
        case = _Case(recording, rope_guess, setup, options, faulty, seen, fitted, rest, places, budget, report)
        result = case.solve(free)
    if result.status is Status.INTERRUPTED:
        raise Interrupted(result)
    return result


@contextmanager
def _refused(faulty: Sequence[Finding]) -> Iterator[None]:
    """Refuse wrapped angles, which no fit explains; what refuses a recording otherwise names its faults as well."""
    for each in faulty:
        if each.kind is Kind.WRAPPED:
            raise InvalidInput(text(each))
    try:
        yield
    except InvalidInput as error:
        fix = " ".join([error.fix, *map(text, faulty)]).strip()
        raise InvalidInput(error.what, got=error.got, allowed=error.allowed, fix=fix) from None


@contextmanager
def rounds_shown(show: bool | Report) -> Iterator[Report]:
    """Show rounds of a fit on standard error if required; yields the callable that gets them, `show` if it is one."""
    shown = not callable(show) and show
    with progress_bar(0.0, 1.0, shown, "first states (Ctrl-C keeps the best so far)", "fit") as bar:
        if bar is not None:
            bar(0.0)

        def draw(entry: dict[str, Any]) -> None:
            stage = f"stage {entry['stage'] + 1:.0f} of {entry['stages']:.0f}, windows of {entry['window']:.3g} s"
            about = f"profile of {entry['parameter']}, " if "parameter" in entry else ""
            # stages count alike, rounds of a stage less and less
            done = (entry["stage"] + 1.0 - 0.7 ** (entry["round"] + 1.0)) / entry["stages"]
            if bar is not None:
                bar(done, f"{about}{stage}: round {entry['round'] + 1:.0f} gained {100.0 * entry['gain']:.2g} %")

        yield show if callable(show) else draw


@dataclass(frozen=True)
class Trial:
    """A fit with what was free in it: of noise alone (`plain`), and with all that its deviations count.

    Then the settings that it used, its fit of the shortest windows, why fit or tests ended early, its score tests, and
    how its windows agree.
    """

    free: list[str]
    plain: Basis
    basis: Basis
    settings: dict[str, Any]
    first: Fitted
    ended: Status | None = None
    tests: tuple[ScoreTest, ...] = ()
    scores: Scores | None = None
    scatter: tuple[Scatter, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether it converged, and was not ended early."""
        return self.plain.fit.converged and self.ended is None


def _with_drift(trial: Trial) -> tuple[ScoreTest, ...]:
    """Return the tests of a fit and that of a drifting clock, the greatest gain first."""
    tests = (*trial.tests, *drift_test(trial.plain, trial.scores, trial.tests))
    return tuple(sorted(tests, key=lambda each: -each.gain))


def first_choice(guess: Rope, *, torque: bool = False) -> list[str]:
    """Return what is free at first: inertia and friction; of a rope of many links one value each, of stiffness if any.

    With a measured torque masses as well, whose scale it fixes.

    A rope of many links that are not alike in the guess keeps its taper: what is free is a factor on all.
    """
    if guess.n_links <= FEW_LINKS:
        return ["mass"] * torque + ["inertia", "friction"]
    words = ["mass"] * torque + (["friction", "stiffness"] if guess.stiffness.any() else ["inertia", "friction"])
    return [f"{word}:{'shared' if np.ptp(getattr(guess, word)) == 0.0 else 'factor'}" for word in words]


@dataclass(frozen=True)
class _Case:
    """What is to be identified.

    seen and rest are the measurements to fit and those held out, untorqued those to fit without torque; places are the
    markers' arc lengths, faulty what the recording shows by itself.
    """

    recording: Recording
    guess: Rope
    setup: RecordingSetup
    options: FitOptions
    faulty: Sequence[Finding]
    seen: Measurements
    untorqued: Measurements
    rest: Measurements | None
    places: Array | None
    budget: Budget
    report: Report

    def solve(self, free: Sequence[str] | None) -> Identification:
        """Return the result, or the best of it within the time: what was fitted is worth more than its tests."""
        began = time.monotonic()
        try:
            trial, chosen = self.choose() if free is None else (self.fit(free), [])
        except OutOfTime:
            raise IdentificationError(
                f"The time budget was over before anything was fitted to {self.seen.channels.t.size} samples. "
                "Allow more (time_budget=...), give a part of the recording, or check its unit and its noise."
            ) from None
        stds = self.options.scale_std
        ranges: dict[str, Interval] | None = None
        held_out: HeldOut | None = None
        remarks, found, doubts = list[Finding](), list[Finding](), list[Finding]()

        def shown() -> list[Finding]:
            return symptoms(trial.basis, trial.tests, trial.scatter, held_out, self._settings(trial, began))

        if trial.tests:
            trial = replace(trial, basis=with_model_error(trial.plain, trial.tests, stds))
        with stoppable() as stop:
            if trial.ended is None:
                if trial.tests:
                    self.budget.check()
                    tests = self._tests(trial)
                    tests = (*tests, *link_test(trial.plain, tests))
                    scatter, covariance = scatter_test(trial.plain, trial.scores)
                    basis = with_model_error(trial.plain, tests, stds, covariance if scatter else None)
                    trial = replace(trial, basis=basis, tests=tests, scatter=scatter)
                if self.rest is not None:
                    held_out = predict(trial.basis, self.rest, self.options, self.budget, trial.settings["decimation"])
                if held_out is not None and held_out.understated > 1.0:
                    trial = replace(trial, basis=with_prediction_error(trial.basis, held_out.understated))
                ranges = self._intervals(trial, remarks)
                self.budget.check()
                with deferred():
                    found = shown()
                doubts = self._mistakes(trial, found)
                if self.faulty and any(each.severity is Severity.WRONG for each in found):  # which follows from that
                    found = [each for each in found if each.severity is Severity.NOTE]
        trial = replace(trial, ended=trial.ended or stop.status)
        with deferred():
            if trial.ended is not None:
                found = shown()
                if trial.plain.fit.converged:
                    found.insert(0, Finding(Kind.NOT_FINISHED, Severity.LIMIT, {"ended": trial.ended}))
                ranges = stop.partial if isinstance(stop.partial, dict) else ranges or self._intervals(trial, remarks)
            findings = without_unexplained([*chosen, *found, *doubts, *remarks])
            return _result(trial, held_out, self._settings(trial, began), ranges, findings)

    def choose(self) -> tuple[Trial, list[Finding]]:
        """Return the fit with parameters chosen one by one, and the choice as a finding.

        What the score tests of a fit require is freed as well, as long as that makes a fit that converges: of what
        explains the same, to EQUAL, the first of ALLOWED. An interrupted fit is the last.
        """
        trial, added = self.fit(first_choice(self.guess, torque=self.setup.torque is not None)), dict[str, float]()
        usual, rivals = trial.free, list[str]()
        for _ in range(MOST):
            mistaken = [each.gain for each in trial.tests if each.significant and each.name in (DRIFT, ANGLES)]
            least = max((gain + TESTING.equal for gain in mistaken), default=0.0)
            required = [each for each in trial.tests if self._required(each, trial.free) and each.gain > least]
            if not required or not trial.complete or com_moved(trial.plain):
                break
            if channel_faults(trial.plain, self.recording, trial.tests, self.budget):
                break  # a fault of the recording explains more
            equals = [each for each in required if each.gain > required[0].gain - TESTING.equal]
            chosen = min(equals, key=lambda each: ALLOWED.index(each.name.partition(":")[0]))
            richer: Trial | None = None
            with stoppable() as stop, suppress(InvalidInput, IdentificationError):
                richer = self.fit(_with_word(trial.free, chosen.name), trial)
            if richer is None or not richer.complete:  # what has converged and was tested is worth more
                trial = replace(trial, ended=stop.status if richer is None else richer.ended)
                break
            trial = richer
            added[chosen.name] = chosen.gain
            if chosen.name == "com" and _declared_com(self.guess):
                rivals += [each.name for each in equals if each.law]
        values = {"usual": usual, "added": added, "rivals": listed(as_free(rivals))}
        return trial, [Finding(Kind.CHOSEN, Severity.DOUBT if rivals else Severity.NOTE, values)]

    def _required(self, test: ScoreTest, free: Sequence[str]) -> bool:
        name = test.name.partition(":")[0]
        if test.uneven and not (f"{name}:shared" in free and np.all(getattr(self.guess, name) > 0.0)):
            return False  # of a factor on a guess that is not alike, or on nothing
        return test.significant and name in ALLOWED and not test.freed_with and (name != "com" or test.matters)

    def fit(self, free: Sequence[str], before: Trial | None = None) -> Trial:
        """Return the fit of these parameters, its covariance (of noise alone) and score tests.

        A good fit `before` that lacks the last of them alone is continued.
        """
        shape, loss = self.seen.shape, Loss(self.options.loss)
        plant = build_plant(self.recording, self.guess, free, self.places, self.setup, self.options.torque_std)
        usual = usual_length(shape, self.guess)
        delay = {}
        if "delay" in free:
            delay["delay_from"] = search_delay(replace(plant, torque=False), self.untorqued, usual, loss, self.budget)
            plant = with_delay(plant, delay["delay_from"])
        wanted = usual if self.options.window is None else self.options.window
        length = min(wanted, WHOLE * self.seen.channels.duration)
        search = MultiStart(plant, self.seen, length, usual, loss, self.budget, self.report)
        search, found = self._with_com(search, self._continued(search, free, before) or search.best())
        first = found
        information, ended = fit_information(search.plant, found.windows, found.fit)
        if self.options.window is None:
            search, found, information, ended = self._lengthened(search, found, information, ended)
        basis = Basis(search.plant, found.windows, found.fit, information, usual)
        trial = Trial(list(free), basis, basis, found.settings | delay, first, ended)
        with stoppable() as stop:
            if trial.complete and not (self.faulty and search.is_bad(found.windows, found.fit)):  # nothing to test
                angles = self.recording.kind == "angles"
                tests, scores = score_tests(basis, self.options.gravity_std, angles=angles, budget=self.budget)
                trial = replace(trial, tests=tests, scores=scores)
                trial = replace(trial, tests=_with_drift(trial))
        return replace(trial, ended=ended or stop.status)

    def _tests(self, trial: Trial) -> tuple[ScoreTest, ...]:
        """Return all tests of the chosen fit, those included that show only where others are free as well."""
        tests = [each for each in trial.tests if each.name != DRIFT]
        angles = self.recording.kind == "angles"
        return _with_drift(replace(trial, tests=hidden_tests(trial.plain, tests, angles=angles, budget=self.budget)))

    def _continued(self, search: MultiStart, free: Sequence[str], before: Trial | None) -> Fitted | None:
        """Return the continued fit, or None where a fit has to begin anew."""
        if before is None or before.free != free[:-1] or free[-1] == "delay":
            return None
        first, labels, parameters = before.first, before.plain.plant.parameters.labels, search.plant.parameters
        known = dict(zip(labels, first.fit.x.tolist(), strict=False))  # others may have been added later
        x = [known.get(each.label, each.first) for each in parameters.all]
        found = search.continued(first, first.windows, np.array(x), first.fit.states)
        bad = search.is_bad(found.windows, found.fit) or not found.fit.converged
        return None if bad and found.fit.status is None else found

    def _lengthened(
        self, search: MultiStart, found: Fitted, information: Information, ended: Status | None
    ) -> tuple[MultiStart, Fitted, Information, Status | None]:
        """Return the fit of longer windows, as long as these can be followed, and its search.

        A state that is common to a longer time leaves more of the motion to the parameters: a phase, above all. Where
        errors grow fast, longer windows tell less; where the model is not right for so long, residuals grow. Those of a
        swing that has nearly ended are a large part of it, but white.
        """
        most = WORSE * information.variance

        def is_bad(fitted: Fitted, about: Information) -> bool:
            return not about.white and search.is_bad(fitted.windows, fitted.fit)

        with stoppable() as stop:
            while ended is None and found.fit.converged and not is_bad(found, information):
                longer = search.joined(found)
                if longer is None:
                    break
                following, longer = self._with_com(search, longer)
                ended = longer.fit.status  # what was interrupted is not finished
                if not longer.fit.converged:
                    break
                more = estimate_covariance(following.plant, longer.windows, longer.fit, self.budget)
                if is_bad(longer, more) or more.variance > most:
                    break
                search, found, information = following, longer, more
        return search, found, information, ended or stop.status

    def _with_com(self, search: MultiStart, found: Fitted) -> tuple[MultiStart, Fitted]:
        """Return a search and its fit, with centres of mass free as well where no ratio of masses can follow the data.

        A moment of inertia that would be negative stays at 0, as that of a point mass on a string. Then lengths or
        times that are off by less than was declared of them would look like another fault: that is the prior.
        """
        plant, std = search.plant, self.options.gravity_std
        if found.fit.status is not None or std == 0.0 or not _at_bounds(plant, found.fit.x):
            return search, found
        freed, x, groups = extended(plant, found.fit.x, ["com"])
        loose = replace(search, plant=freed).continued(found, found.windows, x, found.fit.states)  # for the noise
        known = [replace(each, prior=std * self.guess.length[each.links[0]] / each.scale) for each in groups["com"]]
        parameters = Parameters(self.guess, [*plant.parameters.all, *known])
        search = replace(search, plant=replace(plant, parameters=parameters))
        return search, search.continued(loose, found.windows, loose.fit.x, loose.fit.states)

    def _settings(self, trial: Trial, began: float) -> dict[str, Any]:
        """Return what was fitted and how."""
        setup, basis, fitted = self.setup, trial.basis, self.seen.channels
        tested = any(each.name == SCALES for each in trial.tests)  # else nothing counts what was declared
        stds = ["length_std", "clock_std", *(["torque_std"] if setup.torque is not None else [])]
        moved = "moved" if setup.arm is None else f"moved by an arm of {setup.arm.length:g} m"
        settings = {
            **trial.settings,
            **{name: getattr(self.options, name) * tested for name in stds},
            "fitted_from": float(fitted.t[0]),
            "fitted_to": float(fitted.t[-1]),
            "autocorrelation": basis.information.correlation,
            "seconds": time.monotonic() - began,
            "free": trial.free,
            "loss": self.options.loss,
            "base": "fixed" if setup.motion is None else moved,
            **({"torque_joints": list(setup.joints)} if setup.drives else {}),
            "noise_declared": self.recording.noise is not None,
        }
        if isinstance(basis.plant.sensor, Markers):
            settings["arc_lengths"] = basis.plant.sensor.arc_lengths.tolist()
        if setup.origin is not None:
            settings["origin"] = np.asarray(setup.origin, dtype=np.float64).tolist()
        return settings

    def _mistakes(self, trial: Trial, found: list[Finding]) -> list[Finding]:
        """Return what seems wrong in the declaration of the recording, as far as it and short fits show."""
        short = ShortFit(self.guess, trial.free, self.setup, Loss(self.options.loss), self.budget)
        said = spring_or_angles(self.recording, short)
        left = part_left(trial.plain.windows, trial.plain.fit.residuals, trial.plain.fit.loss)
        wrong = (
            any(each.severity is Severity.WRONG or each.kind is Kind.GRAVITY_ROTATED for each in found)
            or float(np.nanmax(np.abs(self.seen.shape.data))) < SMALL
            or any(each.suspected and each.quantity.declared for each in trial.tests)
            or (any(each.kind is Kind.COLOURED for each in found) and left > ODD)
        )
        to_noise = self.recording.noise is not None and trial.basis.information.variance <= 1.0
        if wrong and not to_noise and not said and not self.faulty:  # which no mistake explains better
            named = first_misdeclared(trial.tests) or explaining(trial.tests)
            said = mistakes(self.recording, short, named)
        faulty = self.faulty
        if not (said or faulty):
            faulty = channel_faults(trial.plain, self.recording, trial.tests, self.budget)
        severity = Severity.WRONG if any(each.severity is Severity.WRONG for each in found) else Severity.DOUBT
        said += [replace(each, severity=max(severity, each.severity)) for each in faulty]
        fitted = trial.basis.plant.parameters.rope(trial.basis.fit.x)  # whose lengths may be free
        return [*(evidence(self.recording, fitted) if self.setup.arc_lengths is None else []), *said]

    def _intervals(self, trial: Trial, remarks: list[Finding]) -> dict[str, Interval] | None:
        basis, how = trial.basis, self.options.intervals
        if how is None or not basis.information.estimated:
            return None
        wrong = first_misdeclared(trial.tests) or part_left(basis.windows, basis.fit.residuals, basis.fit.loss) > POOR
        if not trial.complete or (how == "auto" and wrong):
            how = "covariance"  # profiles of a fit that is wrong say nothing, and take long
        return all_intervals(basis, how, remarks=remarks, budget=self.budget, report=self.report)


def _at_bounds(plant: Plant, x: Array) -> bool:
    """Whether all that is free of the masses of a free swing of few links is at its bound, and com is declared."""
    guess, every = plant.parameters.guess, zip(plant.parameters.all, x <= plant.parameters.lower, strict=True)
    swings = guess.n_links <= FEW_LINKS and guess.gravity.any() and not plant.driven
    bounded = [at_bound for each, at_bound in every if each.name in MOMENTS]
    return bool(_declared_com(guess) and swings and bounded and all(bounded))


def _declared_com(guess: Rope) -> bool:
    """Whether somebody gave the centres of mass: not in the middle of each link, as by default."""
    return not np.allclose(guess.com, 0.5 * guess.length, rtol=1e-6, atol=0.0)


def _with_word(free: Sequence[str], word: str) -> list[str]:
    """Return `free` with a word more; what was one value of all gives way to what it is made of then."""
    name, _, law = word.partition(":")
    parts = {"taper": [f"{name}:factor", word], "pivot": [f"{name}[0]", f"{name}:inner"]}.get(law)
    if parts is None or f"{name}:shared" not in free:
        return [*free, word]
    return [*[each for each in free if each != f"{name}:shared"], *parts]


def _result(
    trial: Trial,
    held_out: HeldOut | None,
    settings: dict[str, Any],
    intervals: dict[str, Interval] | None,
    findings: list[Finding],
) -> Identification:
    """Return the result of a fit. Intervals of the ratios join those of the parameters."""
    basis = trial.basis
    plant, information, found = basis.plant, basis.information, basis.fit
    parameters = plant.parameters
    x = parameters.rounded(found.x)
    rope, slopes, residuals = parameters.rope(x), parameters.derivatives(x), residuals_of(basis.windows, found)
    # a camera that is not level is none of the rope's properties
    rope = rope.replace(gravity=parameters.guess.gravity * parameters.single("gravity_scale", x, held=1.0))
    torque = None
    if plant.motor is not None:
        residuals, torque = residuals[:, :-1], residuals[:, -1]
    known, ratio_std = ratios(rope, parameters.names), ratio_spread(parameters, information)
    covariance, by_length = information.covariances(slopes)
    if intervals is not None:
        declared = ratio_spread(parameters, information.declared, model=True)
        intervals = intervals | of_ratios(known, ratio_std, declared, information.freedom)
    result = Identification(
        rope=rope,
        values=_by_name(plant, rope, parameters.values(x)),
        std=_by_name(plant, None, information.deviations(slopes)),
        ratios=known,
        ratio_std=ratio_std,
        model_std=_by_name(plant, None, information.model_spread(np.diag(slopes))),
        ratio_model_std=ratio_spread(parameters, information, model=True),
        intervals=intervals or {},
        findings=(),
        score_tests=trial.tests,
        residual_rms=np.sqrt(np.nanmean(residuals**2, axis=0)),
        residual_t=np.concatenate([w.t for w in basis.windows]),
        residuals=residuals,
        fitted=np.concatenate([w.y for w in basis.windows])[:, : residuals.shape[1]] - residuals,
        held_out=held_out,
        starts=np.array([each.start for each in parameters.all]),
        parameters=parameters.labels,
        covariance=covariance,
        length_covariance=by_length,
        singular_values=information.singular,
        settings=settings,
        converged=found.converged,
        ended=trial.ended,
        unit="rad" if isinstance(plant.sensor, Angles) else "m",
        history=found.history,
        torque_residuals=torque,
        _basis=basis,
    )
    held = [Finding(Kind.HELD_VALUES, Severity.NOTE, {"names": list(result.held)})] if result.held else []
    return replace(result, findings=ordered([*findings, *held]))


def _by_name(plant: Plant, rope: Rope | None, numbers: Array) -> dict[str, Array]:
    """Return numbers (P,) by property: (n,) with the rope's own (or 0) where a link is not free, or single."""
    result: dict[str, Array] = {}
    for parameter, number in zip(plant.parameters.all, numbers, strict=True):
        name = parameter.name
        if not parameter.links or parameter.law != "own":
            result[parameter.label] = np.array(number)
            continue
        if name not in result:
            others = {"arc": plant.sensor.values[2:], CONSTANT: plant.constants}
            own = np.array(others[name] if name in others else getattr(rope or plant.parameters.guess, name))
            result[name] = own * float(rope is not None)
        result[name][list(parameter.links)] = number
    return result
