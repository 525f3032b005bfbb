"""identify: from a recording and a first guess to an Identification."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.budget import DEFAULT_TIME, Budget, one_thread
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, Interrupted, InvalidInput, listed
from hyperflex.identification.declarations.channels import channel_faults
from hyperflex.identification.declarations.faults import evidence, faults
from hyperflex.identification.declarations.held import DRIFT, FEW_LINKS, LAWS, SCALES, as_free
from hyperflex.identification.declarations.link_test import link_test
from hyperflex.identification.declarations.mistakes import ShortFit, mistakes, spring_or_angles
from hyperflex.identification.declarations.score_tests import (
    TESTING,
    Scatter,
    Scores,
    ScoreTest,
    by_gain,
    drift_test,
    hidden_tests,
    scatter_test,
    score_tests,
)
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
from hyperflex.identification.multi_start import WHOLE, WORSE, MultiStart, search_delay, with_delay
from hyperflex.identification.options import FitOptions, RecordingSetup
from hyperflex.identification.prediction import HeldOut, predict
from hyperflex.identification.result import Identification
from hyperflex.identification.symptoms import com_moved, explaining, first_misdeclared, symptoms
from hyperflex.identification.uncertainty.covariance import (
    Basis,
    Interval,
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
        measured = checked_measurements(recording, rope_guess, setup)
        fitted, rest = split(measured, options, setup.arc_lengths)
        check_excitation(fitted.channels, fitted.shape, rope_guess, moved=driven)
    seen = fitted
    if setup.torque is not None and not setup.drives:
        seen = split(with_torque(measured, setup), options, setup.arc_lengths)[0]
    with rounds_shown(progress) as report:
        case = _Case(recording, rope_guess, setup, options, faulty, seen, fitted, rest, budget, report)
        return case.solve(free)


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


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit with what was free in it, and what is known of it so far.

    plain: the fit, with deviations of noise alone. std (4,): of the scales that were declared. choice: how what is free
    was chosen, if nobody did. first: its fit of the shortest windows. spread: covariance by which windows disagree.
    """

    free: list[str]
    plain: Basis
    std: Array
    choice: dict[str, Any]
    first: Basis | None = None
    tests: tuple[ScoreTest, ...] = ()
    scores: Scores | None = None
    scatter: tuple[Scatter, ...] = ()
    spread: Array | None = None
    held_out: HeldOut | None = None
    ranges: dict[str, Interval] | None = None
    remarks: Sequence[Finding] = ()
    found: Sequence[Finding] = ()

    @cached_property
    def basis(self) -> Basis:
        """The fit with all that its deviations count."""
        basis = with_model_error(self.plain, self.tests, self.std, self.spread) if self.tests else self.plain
        return basis if self.held_out is None else with_prediction_error(basis, self.held_out.understated)

    @property
    def ended(self) -> Status | None:
        """Why it ended early."""
        return self.plain.fit.status

    def stopped(self, status: Status | None) -> "Trial":
        """Return the same, ended early."""
        return replace(self, plain=replace(self.plain, fit=replace(self.plain.fit, status=status)))


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

    seen and rest are the measurements to fit and those held out, untorqued those to fit without torque; faulty what
    the recording shows by itself.
    """

    recording: Recording
    guess: Rope
    setup: RecordingSetup
    options: FitOptions
    faulty: Sequence[Finding]
    seen: Measurements
    untorqued: Measurements
    rest: Measurements | None
    budget: Budget
    report: Report
    began: float = field(default_factory=time.monotonic)

    def solve(self, free: Sequence[str] | None) -> Identification:
        """Return the result, or the best of it within the time: what was fitted is worth more than its tests."""
        trial: Trial | None = None
        with stoppable() as stop:
            for trial in self.trials(free):
                if trial.ended is not None:
                    break
        if trial is None:
            if stop.received:
                raise Interrupted
            raise IdentificationError(
                f"The time budget was over before anything was fitted to {self.seen.channels.t.size} samples. "
                "Allow more (time_budget=...), give a part of the recording, or check its unit and its noise."
            )
        trial = trial.stopped(trial.ended or stop.status)
        if trial.ended is not None and not trial.plain.information.estimated:
            with stoppable():
                trial = replace(trial, plain=trial.plain.estimated())
        with deferred():
            if trial.ended is not None:
                found = self._symptoms(trial)
                if trial.plain.fit.converged:
                    found.insert(0, Finding(Kind.NOT_FINISHED, Severity.LIMIT, {"ended": trial.ended}))
                ranges = trial.ranges or next(self._intervals(trial), (None, ()))[0]
                trial = replace(trial, found=found, ranges=ranges)
            result = self._result(trial)
        if trial.ended is Status.INTERRUPTED:
            raise Interrupted(result)
        return result

    def trials(self, free: Sequence[str] | None) -> Iterator[Trial]:
        """Yield ever better fits, with ever more that is known of them; the last one yielded counts."""
        for trial in self.fits(free, {}) if free is not None else self.chosen():
            yield trial
        if trial.tests:
            self.budget.check()
            tests = hidden_tests(trial.plain, trial.tests, self.budget)
            tests = (*tests, *link_test(trial.plain, tests))
            scatter, spread = scatter_test(trial.plain, trial.scores)
            trial = replace(trial, tests=tests, scatter=scatter, spread=spread if scatter else None)
            yield trial
        if self.rest is not None:
            step = trial.plain.settings["decimation"]
            trial = replace(trial, held_out=predict(trial.basis, self.rest, self.options, self.budget, step))
            yield trial
        for ranges, remarks in self._intervals(trial):
            trial = replace(trial, ranges=ranges, remarks=remarks)
            yield trial
        self.budget.check()
        found = self._symptoms(trial)
        doubts = self._mistakes(trial, found)
        if self.faulty and any(each.severity is Severity.WRONG for each in found):  # which follows from that
            found = [each for each in found if each.severity is Severity.NOTE]
        yield replace(trial, found=[*found, *doubts])

    def _symptoms(self, trial: Trial) -> list[Finding]:
        return symptoms(trial.basis, trial.tests, trial.scatter, trial.held_out, self._settings(trial))

    def chosen(self) -> Iterator[Trial]:
        """Yield fits with parameters chosen one by one.

        What the score tests of a fit require is freed as well, as long as that makes a fit that converges: of what
        explains the same, to EQUAL, the first of ALLOWED.
        """
        usual = first_choice(self.guess, torque=self.setup.torque is not None)
        added, rivals = dict[str, float](), list[str]()
        for trial in self.fits(usual, {"usual": usual, "added": added, "rivals": rivals}):
            yield trial
        for _ in range(MOST):
            mistaken = [each.gain for each in trial.tests if each.significant and each.name in (DRIFT, ANGLES)]
            least = max((gain + TESTING.equal for gain in mistaken), default=0.0)
            required = [each for each in trial.tests if self._required(each, trial.free) and each.gain > least]
            if not required or not trial.plain.fit.converged or com_moved(trial.plain):
                return
            if channel_faults(trial.plain, self.recording, trial.tests, self.budget):
                return  # a fault of the recording explains more
            equals = [each for each in required if each.gain > required[0].gain - TESTING.equal]
            chosen = min(equals, key=lambda each: ALLOWED.index(each.name.partition(":")[0]))
            added = added | {chosen.name: chosen.gain}
            if chosen.name == "com" and _declared_com(self.guess):
                rivals = rivals + [each.name for each in equals if each.law]
            choice, richer = {"usual": usual, "added": added, "rivals": rivals}, trial
            try:
                for richer in self.fits(_with_word(trial.free, chosen.name), choice, trial):
                    if richer.ended is not None:  # what has converged and was tested is worth more
                        yield trial.stopped(richer.ended)
            except (InvalidInput, IdentificationError):
                return
            if not richer.plain.fit.converged:
                return
            trial = richer
            yield trial

    def _required(self, test: ScoreTest, free: Sequence[str]) -> bool:
        name = test.name.partition(":")[0]
        if test.uneven and not (f"{name}:shared" in free and np.all(getattr(self.guess, name) > 0.0)):
            return False  # of a factor on a guess that is not alike, or on nothing
        return test.significant and name in ALLOWED and not test.freed_with and (name != "com" or test.matters)

    def fits(self, free: Sequence[str], choice: dict[str, Any], before: Trial | None = None) -> Iterator[Trial]:
        """Yield fits of these parameters, the last with its covariance (of noise alone) and score tests.

        A good fit `before` that lacks the last of them alone is continued.
        """
        shape, loss, delay = self.seen.shape, Loss(self.options.loss), {}
        plant = build_plant(self.recording, self.guess, free, self.setup, self.options.torque_std)
        usual = usual_length(shape, self.guess)
        if "delay" in free:
            delay["delay_from"] = search_delay(replace(plant, torque=False), self.untorqued, usual, loss, self.budget)
            plant = with_delay(plant, delay["delay_from"])
        wanted = usual if self.options.window is None else self.options.window
        length = min(wanted, WHOLE * self.seen.channels.duration)
        search = MultiStart(plant, self.seen, length, usual, loss, self.budget, self.report)
        continued = self._continued(search, free, before)
        for found in search.fits() if continued is None else [continued]:
            found = replace(found, settings=found.settings | delay)
            trial = Trial(list(free), found, self.options.scale_std, choice)
            yield trial
        found = self._with_com(search, found)
        trial = replace(trial, first=found, plain=found.estimated(self.budget))
        yield trial
        for longer in self._lengthened(search, trial.plain) if self.options.window is None else ():
            trial = replace(trial, plain=longer)
            yield trial
        plain = trial.plain
        if plain.fit.converged and not (self.faulty and search.is_bad(plain.windows, plain.fit)):  # nothing to test
            tests, scores = score_tests(plain, self.options.gravity_std, self.budget)
            yield replace(trial, scores=scores, tests=by_gain([*tests, *drift_test(plain, scores)]))

    def _continued(self, search: MultiStart, free: Sequence[str], before: Trial | None) -> Basis | None:
        """Return the continued fit, or None where a fit has to begin anew."""
        if before is None or before.first is None or before.free != free[:-1] or free[-1] == "delay":
            return None
        first, labels, parameters = before.first, before.plain.plant.parameters.labels, search.plant.parameters
        known = dict(zip(labels, first.fit.x.tolist(), strict=False))  # others may have been added later
        x = [known.get(each.label, each.first) for each in parameters.all]
        found = search.continued(replace(first, plant=search.plant), first.windows, np.array(x), first.fit.states)
        return None if search.is_bad(found.windows, found.fit) or not found.fit.converged else found

    def _lengthened(self, search: MultiStart, found: Basis) -> Iterator[Basis]:
        """Yield fits of ever longer windows, as long as these can be followed.

        A state that is common to a longer time leaves more of the motion to the parameters: a phase, above all. Where
        errors grow fast, longer windows tell less; where the model is not right for so long, residuals grow. Those of a
        swing that has nearly ended are a large part of it, but white.
        """
        most = WORSE * found.information.variance

        def is_bad(fitted: Basis) -> bool:
            return not fitted.information.white and search.is_bad(fitted.windows, fitted.fit)

        while found.fit.converged and not is_bad(found) and (longer := search.joined(found)) is not None:
            longer = self._with_com(search, longer)
            if not longer.fit.converged:
                return
            found = longer.estimated(self.budget)
            if is_bad(found) or found.information.variance > most:
                return
            yield found

    def _with_com(self, search: MultiStart, found: Basis) -> Basis:
        """Return a fit with centres of mass free as well where no ratio of masses can follow the data.

        A moment of inertia that would be negative stays at 0, as that of a point mass on a string. Then lengths or
        times that are off by less than was declared of them would look like another fault: that is the prior.
        """
        plant, std = found.plant, self.options.gravity_std
        if std == 0.0 or not _at_bounds(plant, found.fit.x):
            return found
        freed, x, groups = extended(plant, found.fit.x, ["com"])
        loose = search.continued(replace(found, plant=freed), found.windows, x, found.fit.states)  # for the noise
        known = [replace(each, prior=std * self.guess.length[each.links[0]] / each.scale) for each in groups["com"]]
        parameters = Parameters(self.guess, [*plant.parameters.all, *known])
        held = replace(loose, plant=replace(plant, parameters=parameters))
        return search.continued(held, found.windows, loose.fit.x, loose.fit.states)

    def _settings(self, trial: Trial) -> dict[str, Any]:
        """Return what was fitted and how."""
        setup, basis, fitted = self.setup, trial.basis, self.seen.channels
        tested = any(each.name == SCALES for each in trial.tests)  # else nothing counts what was declared
        stds = ["length_std", "clock_std", *(["torque_std"] if setup.torque is not None else [])]
        moved = "moved" if setup.arm is None else f"moved by an arm of {setup.arm.length:g} m"
        settings = {
            **trial.plain.settings,
            **{name: getattr(self.options, name) * tested for name in stds},
            "fitted_from": float(fitted.t[0]),
            "fitted_to": float(fitted.t[-1]),
            "autocorrelation": basis.information.correlation,
            "seconds": time.monotonic() - self.began,
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

    def _intervals(self, trial: Trial) -> Iterator[tuple[dict[str, Interval], Sequence[Finding]]]:
        basis, how = trial.basis, self.options.intervals
        if how is None or not basis.information.estimated:
            return iter(())
        wrong = first_misdeclared(trial.tests) or part_left(basis.windows, basis.fit.residuals, basis.fit.loss) > POOR
        if trial.ended is not None or not basis.fit.converged or (how == "auto" and wrong):
            how = "covariance"  # profiles of a fit that is wrong say nothing, and take long
        return all_intervals(basis, how, self.budget, self.report)

    def _result(self, trial: Trial) -> Identification:
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
        intervals = trial.ranges or {}
        if trial.ranges is not None:
            declared = ratio_spread(parameters, information.declared, model=True)
            intervals = trial.ranges | of_ratios(known, ratio_std, declared, information.freedom)
        result = Identification(
            rope=rope,
            values=_by_name(plant, rope, parameters.values(x)),
            std=_by_name(plant, None, information.deviations(slopes)),
            ratios=known,
            ratio_std=ratio_std,
            model_std=_by_name(plant, None, information.model_spread(np.diag(slopes))),
            ratio_model_std=ratio_spread(parameters, information, model=True),
            intervals=intervals,
            findings=(),
            score_tests=trial.tests,
            residual_rms=np.sqrt(np.nanmean(residuals**2, axis=0)),
            residual_t=np.concatenate([w.t for w in basis.windows]),
            residuals=residuals,
            fitted=np.concatenate([w.y for w in basis.windows])[:, : residuals.shape[1]] - residuals,
            held_out=trial.held_out,
            starts=np.array([each.start for each in parameters.all]),
            parameters=parameters.labels,
            covariance=covariance,
            length_covariance=by_length,
            singular_values=information.singular,
            settings=self._settings(trial),
            converged=found.converged,
            ended=trial.ended,
            unit="rad" if isinstance(plant.sensor, Angles) else "m",
            history=found.history,
            torque_residuals=torque,
            _basis=basis,
        )
        held = [Finding(Kind.HELD_VALUES, Severity.NOTE, {"names": list(result.held)})] if result.held else []
        choice = trial.choice | {"rivals": listed(as_free(trial.choice.get("rivals", ())))}
        severity = Severity.DOUBT if choice["rivals"] else Severity.NOTE
        chosen = [Finding(Kind.CHOSEN, severity, choice)] if trial.choice else []
        return replace(result, findings=ordered([*chosen, *trial.found, *trial.remarks, *held]))


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
