"""identify: from a recording and a first guess to an Identification."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, Interrupted
from hyperflex.identification.assembly import assemble_result, fit_settings
from hyperflex.identification.diagnosis.declarations import ShortFit, explained, scaled_angles, suspicious
from hyperflex.identification.diagnosis.free_parameters import Trial, choose_parameters
from hyperflex.identification.diagnosis.link_test import link_test
from hyperflex.identification.diagnosis.misdeclared import DECLARED, explaining, first_misdeclared
from hyperflex.identification.diagnosis.model_error import DeclaredStds, with_model_error
from hyperflex.identification.diagnosis.score_tests import SCALES, ScoreTest, score_tests
from hyperflex.identification.diagnosis.tolerances import with_ratio_sensitivity
from hyperflex.identification.diagnosis.window_tests import Scatter, drift_test, scatter_test, window_scores
from hyperflex.identification.ending import INTERRUPTED, OUT_OF_TIME
from hyperflex.identification.excitation import check_excitation
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import Report, one_thread
from hyperflex.identification.fit.stages import Measurements, check_memory, fit_in_stages, search_delay, with_delay
from hyperflex.identification.fit.windows import part_left, usual_length, with_enough_frames
from hyperflex.identification.measurements import with_torque
from hyperflex.identification.options import FitOptions, How, RecordingSetup
from hyperflex.identification.prediction import HeldOut, predict, prediction_uncertainty
from hyperflex.identification.problem import build_plant, checked_measurements, split
from hyperflex.identification.result import Identification
from hyperflex.identification.rounds import rounds_shown
from hyperflex.identification.uncertainty.covariance import Basis, Interval, fit_information
from hyperflex.identification.uncertainty.interval_method import all_intervals
from hyperflex.identification.verdict import POOR, other_lengths, swapped, uneven_scale
from hyperflex.interruption import catch_interrupt, deferred, interruptible, time_limit
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.recording import Recording

TIME_BUDGET = 1800.0  # s of processor time, where no time budget is given


@interruptible(Identification)
@one_thread()
def identify(
    recording: Recording,
    rope_guess: Rope,
    free: Sequence[str] | None = None,
    *,
    setup: RecordingSetup | None = None,
    options: FitOptions | None = None,
    time_budget: float | None = None,
    progress: bool | Report = False,
) -> Identification:
    """Identify a rope from its recorded motion by multiple shooting with exact derivatives.

    The recording is cut into windows, each with an initial state of its own; the parameters are common to all. States
    and parameters are fitted together, to shorter windows first.

    Parameters
    ----------
    recording : Recording
        Angles, or markers at the joints (their angles are fitted), as many links as the rope; or, with `arc_lengths`,
        markers anywhere along the rope (their places are fitted), also fewer than links.
    rope_guess : Rope
        Fixed values, and first guesses of the free ones.
    free : sequence of str, optional
        By default inertia and friction (of more than four links one value for all), and what the score tests of a fit
        with these ask for; the verdict says which, and why. Names are, for each link, ``inertia``, ``com``, ``mass``,
        ``length``, ``friction``, ``dry_friction``, ``stiffness``,
        ``rest_angle``, ``drag``; for the whole ``tip_mass``, ``gravity_angle`` (rad; for a camera that is not level),
        ``delay`` (s, of `motion` in the recording's time; at most a window's length), ``arc`` (m; each marker's place);
        with a measured torque ``arm_inertia`` and ``arm_friction`` (of the shaft). ``friction[2]`` frees one link,
        ``friction:shared`` one value for all, ``friction:inner`` one for all but the first, ``friction:factor`` one
        factor on all guesses, ``friction:taper`` the logarithm by which it grows along the rope, 0 at its middle. With
        a free length, com and inertia of links that are uniform in the guess follow, unless they are free too.
    setup : RecordingSetup, optional
        What moved the rope, where the markers are, and the measured torque; by default the first joint is fixed, and
        angles or markers are those of the joints.
    options : FitOptions, optional
        Windows, loss, held-out part, method of the intervals, and how well lengths, times and torques were measured.
    time_budget : float, s, optional
        Of processor time, compiling left out; 1800 by default, inf: no end. The best so far is returned then, with
        ``message == "time budget exceeded"``.
    progress : bool or callable
        True shows a bar on standard error, or a line every ten seconds where nobody watches; a callable gets a dict
        with window, stage, stages, round, cost, gain, damping, and of a profile its parameter and ``phase="profile"``.

    Raises
    ------
    InvalidInput
        For unknown names in `free`, recordings with too few samples or without motion, links or lengths that do not
        fit the rope, or more samples, links and parameters than the memory holds.
    IdentificationError
        When no window can be simulated at all, or the time budget was over before anything was fitted.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best so far, with ``message == "interrupted"``, if anything was fitted.

    Notes
    -----
    Without a known force or torque a common factor of masses, inertias and frictions is not identifiable: `std` is inf
    there, and `ratios` hold what is known. Samples denser than 200 a window are decimated (``settings["decimation"]``).
    Samples without given noise have equal weights. With fewer markers than links, a prior keeps neighbouring links
    about in line (0.5 rad over the root of their number).

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
    began = time.monotonic()
    setup = checks.instance("setup", RecordingSetup() if setup is None else setup, RecordingSetup)
    options = checks.instance("options", FitOptions() if options is None else options, FitOptions)
    motion, arm, arc_lengths, origin, torque = setup.motion, setup.arm, setup.arc_lengths, setup.origin, setup.torque
    train, lead, ahead, window = options.train, options.lead, options.ahead, options.window
    if time_budget is not None:
        checks.number("time_budget", time_budget, sign="positive", unit="s", infinite=True)
    declared = DeclaredStds(options.length_std, options.clock_std, options.torque_std)
    measured, places = checked_measurements(recording, rope_guess, arc_lengths, origin, motion, arm)
    fitted, rest = split(measured, train, lead, ahead)
    check_excitation(fitted.channels, fitted.shape, rope_guess, moved=motion is not None)
    seen = fitted if torque is None else split(with_torque(measured, torque, setup.torque_noise), train, lead, ahead)[0]
    with rounds_shown(progress) as report:
        problem = _Problem(
            recording=recording,
            guess=rope_guess,
            fitted=seen,
            untorqued=fitted,
            rest=rest,
            places=places,
            arc_lengths=arc_lengths,
            origin=origin,
            motion=motion,
            arm=arm,
            torque=torque is not None,
            declared=declared,
            window=window,
            loss=Loss(options.loss),
            lead=lead,
            ahead=ahead,
            report=report,
            limit=time_limit(TIME_BUDGET if time_budget is None else time_budget),
        )
        result = problem.solve(free, options.intervals, began)
    if result.message == INTERRUPTED:
        raise Interrupted(result)
    return result


@dataclass(frozen=True)
class _Problem:
    """What identify was asked; the names are its own.

    fitted and rest are the measurements to fit and those held out, untorqued those to fit without torque.
    """

    recording: Recording
    guess: Rope
    fitted: Measurements
    untorqued: Measurements
    rest: Measurements | None
    places: Array | None
    arc_lengths: npt.ArrayLike | None
    origin: npt.ArrayLike | None
    motion: Motion | None
    arm: Arm | None
    torque: bool
    declared: DeclaredStds
    window: float | None
    loss: Loss
    lead: float
    ahead: float
    report: Report
    limit: time_limit

    def solve(self, free: Sequence[str] | None, intervals: How | None, began: float) -> Identification:
        """Return the result, or the best of it within the time limit."""
        with self.limit:
            try:
                trial, remark = choose_parameters(self.fit, self.guess) if free is None else (self.fit(free), "")
            except KeyboardInterrupt:
                if not self.limit.over:
                    raise
                raise IdentificationError(
                    f"The time budget was over before anything was fitted to {self.fitted.channels.t.size} samples. "
                    "Allow more (time_budget=...), give a part of the recording, or look at its unit and its noise."
                ) from None
            return self.complete(self.judged(trial), intervals, remark, began)

    def fit(self, free: Sequence[str]) -> Trial:
        """Return the fit of these parameters, its covariance (of noise alone) and score tests."""
        shape = self.fitted.shape
        plant = build_plant(
            self.recording, self.guess, free, self.places, self.origin, self.motion, self.arm, torque=self.torque
        )
        usual = with_enough_frames(usual_length(shape, self.guess), shape)
        delay = {}
        if "delay" in free:
            delay["delay_from"] = search_delay(plant.without_torque(), self.untorqued, usual, self.loss)
            plant = with_delay(plant, delay["delay_from"])
        length = min(usual if self.window is None else self.window, 1.001 * self.fitted.channels.duration)
        check_memory(plant, self.fitted, length)
        found, windows, settings = fit_in_stages(plant, self.fitted, length, usual, self.report, self.loss)
        tests: tuple[ScoreTest, ...] = ()
        scores = None
        basis = Basis(plant, windows, found, fit_information(plant, windows, found))
        with catch_interrupt() as stop:  # what was fitted is worth more than its tests
            if found.converged and not found.interrupted:
                tests = score_tests(basis, self.declared.gravity, angles=self.recording.kind == "angles")
                scores = window_scores(basis, [each.name for each in tests if each.masks and not each.law])
                tests = tuple(sorted((*tests, *drift_test(basis, scores)), key=lambda each: -each.gain))
        found.interrupted = found.interrupted or stop.received
        return Trial(list(free), basis, tests, settings | delay, scores)

    def judged(self, trial: Trial) -> Trial:
        """Return a trial with the test of its links, and with what the model leaves out in its covariance."""
        basis, tests, found = trial.basis, trial.tests, trial.basis.fit
        scatter: tuple[Scatter, ...] = ()
        if tests:
            basis = self._with_model_error(trial, tests)  # what stands if the next test is interrupted
        with catch_interrupt() as stop:
            if found.converged and not found.interrupted:
                tests = (*tests, *link_test(trial.basis, tests))
                basis = self._with_model_error(trial, tests)
                scatter, covariance = scatter_test(trial.basis, trial.scores)
                if scatter:
                    basis = self._with_model_error(trial, tests, covariance)
            tests = with_ratio_sensitivity(basis, tests)
        found.interrupted = found.interrupted or stop.received
        return trial._replace(basis=basis, tests=tests, scatter=scatter)

    def _with_model_error(self, trial: Trial, tests: Sequence[ScoreTest], scatter: Array | None = None) -> Basis:
        return with_model_error(trial.basis, tests, self.declared, scatter)

    def complete(self, trial: Trial, intervals: How | None, remark: str, began: float) -> Identification:
        """Return a fit as a result, with intervals, predictions of what was held out, and a grade."""
        basis, tests, found, fitted = trial.basis, trial.tests, trial.basis.fit, self.fitted.channels
        ranges: dict[str, Interval] | None = None
        held_out: HeldOut | None = None
        with catch_interrupt() as stop:  # what was fitted is worth more than its intervals and its trial
            ranges = self._intervals(trial, intervals)
            if self.rest is not None and not found.interrupted:  # who stops a fit waits for nothing more
                spread = prediction_uncertainty(basis, self.untorqued.channels.data.shape[1])
                plant = basis.plant.without_torque()  # what is held out is predicted without force or torque
                held_out = predict(plant, found.x, self.rest, self.lead, self.ahead, self.loss, spread)
        if stop.received:
            ranges, found.interrupted = stop.partial if ranges is None else ranges, True
        settings = trial.settings | {"fitted_from": float(fitted.t[0]), "fitted_to": float(fitted.t[-1])}
        settings |= {"autocorrelation": basis.information.correlation, "seconds": time.monotonic() - began}
        settings |= fit_settings(basis.plant, trial.free, self.loss.name, self.origin)
        tested = any(each.name == SCALES for each in tests)  # else nothing counts what was declared
        counted = {f"{name}_std": std * tested for name, std in self.declared._asdict().items()}
        settings |= {name: std for name, std in counted.items() if self.torque or name != "torque_std"}
        settings["noise"] = "not declared" if self.recording.noise is None else "declared"
        with catch_interrupt() as stop:
            with deferred():
                result = assemble_result(basis, held_out, settings, ranges, tests, trial.scatter, self._early)
            if not found.interrupted:
                result = self._doubted(result, trial)
        if stop.received:
            found.interrupted = True
            result = assemble_result(basis, held_out, settings, ranges, tests, trial.scatter, self._early)
        return result.with_remark(remark)

    def _doubted(self, result: Identification, trial: Trial) -> Identification:
        """Return a result with what looks wrong in what was declared of the recording, as far as short fits tell."""
        short = ShortFit(self.guess, trial.free, self.arc_lengths, self.origin, self.motion, self.arm, self.loss)
        first = first_misdeclared(trial.tests)
        result = result.with_reason(said := scaled_angles(self.recording, short))
        wrong = result.grade.doubtful or suspicious(self.fitted.shape)
        wrong = wrong or any(each.suspected and each.name in DECLARED for each in trial.tests)
        to_noise = self.recording.noise is not None and trial.basis.information.variance <= 1.0
        if wrong and not to_noise and not said:  # which no slip explains better
            cause = first or explaining(trial.tests)
            named, gain = ("", 0.0) if cause is None else (cause.name, cause.gain)
            result = result.with_reason(explained(self.recording, self.origin, short, named=named, gain=gain))
        if self.arc_lengths is not None:
            return result
        result = result.with_suspicion(other_lengths(self.recording, self.guess))
        result = result.with_reason(uneven_scale(self.recording))
        return result.with_reason(swapped(self.recording, self.guess))

    @property
    def _early(self) -> str:
        """What has ended a fit that was interrupted."""
        return OUT_OF_TIME if self.limit.over else INTERRUPTED

    def _intervals(self, trial: Trial, how: How | None) -> dict[str, Interval] | None:
        basis = trial.basis
        if how is None or not basis.information.estimated:
            return None
        if not basis.fit.converged or basis.fit.interrupted:
            how = "covariance"
        if how == "auto" and (first_misdeclared(trial.tests) or part_left(basis.windows, basis.fit.residuals) > POOR):
            how = "covariance"  # profiles of a fit that is wrong say nothing, and take long
        return all_intervals(basis, how, report=self.report)
