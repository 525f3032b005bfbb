"""What a fit shows of itself: whether it fits and predicts, what it determines, and what its values stand for."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.faults import hangs_upwards, unlike_lengths
from hyperflex.identification.declarations.held import CLOCK, DRIFT, LAWS, LINKS, SCALES, as_free
from hyperflex.identification.declarations.score_tests import TESTING, Scatter, ScoreTest, determined
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.fit import NORMAL, POOR, residuals_of
from hyperflex.identification.model import Plant, common_factor, extended, lumped
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.uncertainty.covariance import (
    LEVEL,
    MASSES,
    TOUCHED,
    Basis,
    quantile,
    ratio_gradients,
    ratio_spread,
    ratios,
    widening,
)
from hyperflex.identification.uncertainty.model_error import law_error
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.model import RESISTANCES, Rope
from hyperflex.sensors import Angles, Markers

# part of the motion that may stay unexplained where residuals are white, so that they are noise, and of a torque, which
# sensors or currents do not tell better; else it is POOR
WHITE_POOR = 0.2
# times the declared noise: residuals so much larger are as good as the recording
NOISY = 1.5
# times: noise is not declared so much larger or smaller than it is by mistake
MISDECLARED = 2.0
# rad, of gravity's angle: 11 degrees, more than any camera that was meant to be level
AXES = 0.2
# lengths of a link, to which its mass may reach with a counterweight; 1 is the most without one (Cauchy-Schwarz)
REACH = 2.0
# part of its length by which a point mass may seem to be beyond the end of its string: rulers and knots err so
BEYOND = 0.02
# Of the prediction: part of the error that no motion would make; part of the values within the 95 % band, with which
# the error is about as stated
PERSISTENCE = 0.5
AS_STATED = 0.9
# std over value, beyond which it is poorly determined, and twice that of frictions and stiffnesses; less, as far as
# Student's distribution widens intervals
LOOSE = 0.15
# part of a friction: by more than another law would change it, it is called a model error
FRICTION_MOVES = 0.1
# robust standard deviations of an outlier: of a million of normal errors none is so large; part of the squares from
# which they decide the fit
OUTLYING, DECIDE = 6.0, 0.5
ALONE = 0.5  # part of the outliers that others follow at most
# part of the windows
LEFT_OUT = 0.2
TELL_LENGTHS = (Kind.MASS_FAR, Kind.COM_OR_CLOCK, Kind.LENGTH_OR_CLOCK, Kind.MARKER_PLACES)


def symptoms(
    basis: Basis,
    tests: Sequence[ScoreTest],
    scatter: Sequence[Scatter],
    held_out: HeldOut | None,
    settings: dict[str, Any],
) -> list[Finding]:
    """Return all that a fit, its tests and its predictions show."""
    rope = basis.plant.parameters.rope(basis.plant.parameters.rounded(basis.fit.x))
    odd = [*_of_fit(basis), *_of_prediction(held_out, tests), *_disagreeing(scatter)]
    known, loose = _determined(basis, rope)
    impossible = hangs_upwards(rope)
    declared = score_findings(
        tests, odd=any(each.severity is Severity.WRONG for each in odd), known=known, wrong=bool(impossible)
    )
    std = ratio_spread(basis.plant.parameters, basis.information)["J/p1"]
    if moved := com_moved(basis):  # which the clock explains as well, and which leaves nothing known
        declared, loose = [each for each in declared if each.kind is not Kind.CLOCK], []
    far = _far(rope, basis.plant.parameters.guess, std)
    found = [*impossible, *declared, *odd, *moved, *_lengths_moved(basis, settings), *far, *_com_held(basis), *loose]
    if any(each.kind in TELL_LENGTHS for each in found):
        found = [each for each in found if each.kind is not Kind.UNTESTED]
    angle = basis.plant.parameters.single("gravity_angle", basis.fit.x)
    if abs(angle) > AXES:
        found.append(Finding(Kind.GRAVITY_ROTATED, values={"angle": float(angle)}))
    wrong = any(each.severity is Severity.WRONG for each in found)
    doubtful = [*unlike_lengths(rope), *_outliers(basis)]
    found += [replace(each, severity=Severity.WRONG if wrong else each.severity) for each in doubtful]
    if settings["noise_declared"]:
        found += _of_noise(basis, tests)
    return [*found, *_limits(basis, tests, scatter, settings), *_identifiable(basis)]


def _of_fit(basis: Basis) -> Iterator[Finding]:
    """Yield that a fit did not converge, or leaves much of the motion or of the torque.

    White residuals are measuring noise, of which more is allowed, and as much as was declared; declared noise excuses
    residuals that are not white as far as that, too. A marker on the first joint does not move by what is fitted: its
    errors count against the motion of all.
    """
    fit, sensor = basis.fit, basis.plant.sensor
    if not fit.converged:
        yield Finding(Kind.NOT_CONVERGED, Severity.WRONG, {"ended": fit.status or ""})
    white, points = basis.information.white, not isinstance(sensor, Angles)
    rms, spread, noise = _of_points(_sizes(basis)) if white and points else _sizes(basis)
    seen = rms.size - (basis.plant.motor is not None)  # a torque is the last channel
    if isinstance(sensor, Markers) and sensor.arc_lengths[0] == 0.0:
        spread[: 2 - white] = np.sqrt(np.mean(spread[:seen] ** 2))
    allowed = excused = np.maximum(WHITE_POOR * spread, NOISY * noise)
    if not white:
        allowed = np.clip(NOISY * noise, POOR * spread, WHITE_POOR * spread)
    left = np.where(white & (rms <= excused), 0.0, rms / np.maximum(spread, 1e-12))
    worst = int(np.argmax(left[:seen]))
    if rms[worst] > allowed[worst]:
        what, unit = (f"Marker {worst // (2 - white)}", "m") if points else (f"Link {worst}", "rad")
        values = {"what": what, "rms": float(rms[worst]), "motion": float(spread[worst]), "unit": unit}
        yield Finding(Kind.POOR_FIT, Severity.WRONG, values)
    if seen < rms.size and rms[-1] > excused[-1]:
        yield Finding(Kind.POOR_TORQUE, Severity.WRONG, {"rms": float(rms[-1]), "motion": float(spread[-1])})


def _of_points(sizes: Array) -> Array:
    """Return sizes (3, C) by channel with x and y of each marker as one: noise is the same in both.

    A swing hardly moves y.
    """
    count = sizes.shape[1] // 2
    both = np.sqrt((sizes[:, : 2 * count].reshape(3, count, 2) ** 2).sum(axis=2))
    return np.concatenate([both, sizes[:, 2 * count :]], axis=1)


def _outliers(basis: Basis) -> Iterator[Finding]:
    """Yield that single residuals, far larger than the others, make most of a sum of plain squares.

    Those that follow one another are of the model.
    """
    if basis.fit.loss.name != "squares":
        return
    residuals = residuals_of(basis.windows, basis.fit)
    size = np.abs(residuals) / np.maximum(NORMAL * np.nanmedian(np.abs(residuals), axis=0), 1e-300)
    out, known = size > OUTLYING, np.isfinite(size)
    squares = float((size[out] ** 2).sum() / (size[known] ** 2).sum())
    if squares > DECIDE and (out[1:] & out[:-1]).sum() < ALONE * out.sum():
        values = {"part": float(out.sum() / known.sum()), "beyond": OUTLYING, "squares": squares}
        yield Finding(Kind.OUTLIERS, values=values)


def _sizes(basis: Basis) -> Array:
    """Return rms of residuals (medians under a robust loss), motion within windows and declared noise (3, C)."""
    residuals, weights = residuals_of(basis.windows, basis.fit), np.concatenate([w.weight for w in basis.windows])
    known, motion = weights > 0.0, np.concatenate([w.motion for w in basis.windows])
    count = np.maximum(known.sum(axis=0), 1)
    noise = np.sqrt(np.divide(1.0, weights**2, out=np.zeros_like(weights), where=known).sum(axis=0) / count)
    noise[(~known | (weights <= 1.0)).all(axis=0)] = 0.0  # not declared: no noise is 1 rad or 1 m
    if basis.fit.loss.name == "squares":
        rms = np.sqrt(np.nanmean(residuals**2, axis=0))
    else:
        rms = NORMAL * np.nanmedian(np.abs(residuals), axis=0)
    return np.stack([rms, np.sqrt((motion**2).sum(axis=0) / count), noise])


def _of_prediction(held_out: HeldOut | None, tests: Sequence[ScoreTest]) -> Iterator[Finding]:
    """Yield how predictions of what was not fitted fail, and what a refit has shown to explain most, if not surely."""
    if held_out is None:
        return
    if held_out.failed.size:
        values = {"failed": held_out.failed.size, "count": held_out.starts.size, "times": held_out.failed.tolist()}
        yield Finding(Kind.PREDICTION_FAILED, Severity.WRONG, values)
        return
    held_out = held_out.foreseeable
    error, still = held_out.error, held_out.persistence
    if error > PERSISTENCE * still > 0.0 and not held_out.inside >= AS_STATED:
        yield Finding(Kind.PREDICTION_POOR, Severity.WRONG, {"part": error / still})
    elif held_out.understated > 1.0:
        free = [each.name for each in tests if each.refitted and each.excess_gain > TESTING.sure][:1]
        values = {"part": held_out.inside, "factor": held_out.understated, "free": "".join(as_free(free))}
        yield Finding(Kind.PREDICTION_OUTSIDE, Severity.DOUBT, values)


def _disagreeing(scatter: Sequence[Scatter]) -> list[Finding]:
    """Return the ratio of moments and inertias of which windows disagree most, and that of a resistance."""
    masses = [each for each in scatter if each.label.startswith(MASSES)]
    laws = [each for each in scatter if each not in masses]
    found = [Finding(Kind.RESISTANCE_CHANGES, Severity.LIMIT, each._asdict()) for each in laws[:1]]
    for each in masses[:1]:
        severity = Severity.WRONG if each.part > TESTING.moves else Severity.DOUBT
        found.append(Finding(Kind.WINDOWS_DISAGREE, severity, each._asdict()))
    return found


def _far(rope: Rope, guess: Rope, std: Array) -> Iterator[Finding]:
    """Yield that a link's mass lies beyond the link; `std` (n,) is of J/p1.

    All mass of a link, and beyond, is between its joints or at the far one, so J <= l p (Cauchy-Schwarz); a real link
    may reach beyond its joint, but a point mass at the end of a string does not: J = l p tells its length, or its
    clock, where gravity is known.
    """
    p, inertia = lumped(rope)
    span = np.where(p > 0.0, p, np.inf) * rope.length
    reach, spread = inertia / span, np.where(p > 0.0, std, 0.0) * p[0] / span
    at_end = guess.com > (1.0 - BEYOND) * guess.length
    point = at_end & (guess.inertia < BEYOND * guess.mass * guess.length**2)
    excess = (reach - 1.0) / np.maximum(BEYOND, REPORTED.certain * spread)
    wrong = (excess > 1.0) & (point | (reach > REACH))  # other links may have counterweights, or ends beyond joints
    k = max(range(rope.n_links), key=lambda k: (wrong[k], excess[k]))
    if excess[k] > 1.0:
        yield _or_clock(Kind.MASS_FAR, float(reach[k]), Severity.WRONG if wrong[k] else Severity.DOUBT, link=k)


def com_moved(basis: Basis) -> list[Finding]:
    """Return that a centre of mass is far more off than lengths and times are by what was declared of these."""
    return [
        _or_clock(Kind.COM_OR_CLOCK, x / each.first, link=each.links[0])
        for each, x in zip(basis.plant.parameters.all, basis.fit.x.tolist(), strict=True)
        if each.name == "com" and abs(x - each.first) > REPORTED.certain * each.prior and x / each.first > 0.0
    ]


def _or_clock(kind: Kind, factor: float, severity: Severity = Severity.WRONG, **about: int) -> Finding:
    """Return that a length is a factor times as declared, or that a clock is off."""
    return Finding(kind, severity, about | {"factor": factor, "clock": factor**-0.5, "moved": abs(1.0 - factor)})


def _lengths_moved(basis: Basis, settings: dict[str, Any]) -> list[Finding]:
    """Return that all free lengths of a free swing are off alike by far more than was declared of them.

    So a wrong clock shows: with times x a and lengths x a^2 a rope swings alike. Times that were declared to be better
    known than lengths tell these.
    """
    declared = settings["length_std"]
    parameters, information = basis.plant.parameters, basis.information
    stds = information.deviations(np.ones(len(parameters)))
    lengths = [p.name == "length" and p.form == "log" for p in parameters.all]
    swings = bool(parameters.guess.gravity.any()) and not basis.plant.driven
    if not (any(lengths) and swings and 0.0 < declared <= 2.0 * settings["clock_std"]):
        return []
    off, least = (basis.fit.x - parameters.start)[lengths], REPORTED.certain * np.hypot(declared, stds[lengths])
    moved = bool((off > least).all() or (-off > least).all())
    return [_or_clock(Kind.LENGTH_OR_CLOCK, float(np.exp(off.mean())))] * moved


def _determined(basis: Basis, rope: Rope) -> tuple[bool, list[Finding]]:
    """Return whether any ratio of moments and inertias is known that is free, and what is poorly determined.

    A name stands for all its links. Ratios stand for the values that they are of where no torque tells these. What was
    held, and what cannot be known at all, is reported elsewhere.
    """
    parameters, information = basis.plant.parameters, basis.information
    every, limit = ratios(rope, parameters.names), LOOSE / widening(information.freedom)
    std = information.deviations(parameters.derivatives(information.x))
    values = parameters.values(parameters.rounded(information.x))
    by_ratios = {"mass", "com", "inertia", *LAWS} if basis.plant.constants is None else set()
    loose = {
        each.label: float(spread / value)
        for each, value, spread in zip(parameters.all, values, std, strict=True)
        if each.kind.form != "linear"
        and each.name not in by_ratios
        and 0.0 < (1 + (each.name in LAWS)) * limit * value < spread < np.inf
    }
    masses = list[float]()
    for name, spreads in ratio_spread(parameters, information).items():
        parts = spreads / np.maximum(np.abs(every[name]), 1e-300)
        known = (parts > 0.0) & (parts < np.inf)
        wide = np.flatnonzero(known & (parts > (2 - (name in MASSES)) * limit)).tolist()
        if name in MASSES:
            masses += parts[parts > 0.0].tolist()
        if 1 < len(wide) == known.sum():
            loose[name] = float(parts[wide].max())
        else:
            loose |= {f"{name}[{k}]": float(parts[k]) for k in wide}
    nothing = information.estimated and min(masses, default=0.0) > limit
    found = [Finding(Kind.NOTHING_KNOWN, Severity.WRONG, {"limit": LOOSE})] * nothing
    own = [k for k, each in enumerate(parameters.all) if each.name in ("mass", "inertia", "tip_mass")]
    if not nothing and own and not by_ratios and (std > limit * values)[own].all():
        found.append(Finding(Kind.ONLY_RATIOS, Severity.LIMIT, {"limit": LOOSE}))
    if loose:
        others = "values" if information.unknown.shape[1] == 0 else "ratios"
        found.append(Finding(Kind.POORLY_DETERMINED, values={"parts": loose, "others": others}))
    return not nothing, found


def _of_noise(basis: Basis, tests: Sequence[ScoreTest]) -> Iterator[Finding]:
    """Yield that declared noise is far larger than residuals, or smaller: a doubt if far, and no test finds a cause."""
    from scipy.special import chdtrc

    information = basis.information
    rms, _, noise = _sizes(basis)[:, : None if basis.plant.motor is None else -1]
    declared, left = (float(np.sqrt(np.mean(each**2))) for each in (noise, rms))
    chance = chdtrc(information.freedom, information.freedom * information.variance)  # of so large a variance
    if MISDECLARED * left <= declared:
        values = {"declared": declared, "left": left, "times": declared / max(left, 1e-300)}
        yield Finding(Kind.NOISE_OVERSTATED, values=values)
    elif chance < CHANCE:
        times = float(np.sqrt(information.variance))
        unexplained = times > MISDECLARED and tests and not any(each.significant for each in tests)
        yield Finding(Kind.NOISE_UNDERSTATED, Severity.DOUBT if unexplained else Severity.LIMIT, {"times": times})


def _com_held(basis: Basis) -> Iterator[Finding]:
    """Yield that masses that a torque determines follow from a held com: a doubt where nobody gave it."""
    parameters = basis.plant.parameters
    rope, guess = parameters.rope(parameters.rounded(basis.fit.x)), parameters.guess
    if basis.plant.constants is not None and "mass" in parameters.names and "com" not in parameters.names:
        # moments stay, which the torque determines: m_i com_i + l_i (all mass beyond)
        beyond = np.triu(np.broadcast_to(rope.length[:, None], (rope.n_links, rope.n_links)), 1)
        moments = (np.diag(rope.com) + beyond) @ rope.mass
        moved = np.linalg.pinv(np.diag(1.01 * rope.com) + beyond) @ moments / rope.mass - 1.0
        default = bool(np.allclose(guess.com, 0.5 * guess.length))
        values = {"com": rope.com.tolist(), "default": default, "moved": float(np.abs(moved).max())}
        yield Finding(Kind.COM_HELD, Severity.DOUBT if default else Severity.NOTE, values)


def _com_sensitivity(basis: Basis, tests: Sequence[ScoreTest]) -> float:
    """Return by what part 1 % of held centres of mass moves a ratio that seems to be known better; 0 for none.

    They move the ratio itself, and what was fitted.
    """
    information, worst = basis.information, 0.0
    plant, x, groups = extended(basis.plant, information.x, ["com"])
    gradients, known = ratio_gradients(plant.parameters, x), ratios(plant.parameters.rope(x))
    stds = ratio_spread(basis.plant.parameters, information)
    for test in [each for each in tests if each.name == "com" and not each.freed_with]:
        steps = [0.01 * each.start / each.derivative(each.first) for each in groups["com"]]
        along = np.vstack([test.rate, np.eye(len(steps))]) * steps
        for name in MASSES:
            moved = np.max(np.abs(gradients[name] @ along), axis=1)
            beyond = (moved > 2.0 * stds[name]) & (stds[name] > 0.0)
            worst = max(worst, float(np.max(moved / np.abs(known[name]), where=beyond, initial=0.0)))
    return worst


def moves_alike(plant: Plant) -> bool:
    """Whether a longer and slower rope moves exactly alike: nothing but gravity and the lengths has a scale.

    With times x a and lengths x a^2 gravity stays. A drive, a torque, and inertias or resistances that are held do not
    go along.
    """
    if plant.driven or not plant.parameters.guess.gravity.any():
        return False
    names = {each.name for each in plant.parameters.all}
    held = [each.name for each in RESISTANCES if each.name not in names]
    return "inertia" in names and not any(getattr(plant.parameters.guess, name).any() for name in held)


def _limits(
    basis: Basis, tests: Sequence[ScoreTest], scatter: Sequence[Scatter], settings: dict[str, Any]
) -> Iterator[Finding]:
    """Yield what no motion tells, such as the scale, and what the model, the windows and the noise leave open."""
    information = basis.information
    if information.unknown.shape[1]:
        yield Finding(Kind.COMMON_FACTOR, Severity.LIMIT)
    elif basis.plant.constants is not None:
        yield Finding(Kind.TORQUE_SCALE, Severity.LIMIT)
    else:
        yield Finding(Kind.HELD_SCALE, Severity.LIMIT, {"moved": _com_sensitivity(basis, tests)})
    if moves_alike(basis.plant) and any(each.name == CLOCK and each.std <= REPORTED.untested for each in tests):
        yield Finding(Kind.UNDETECTABLE, Severity.LIMIT)
    part, name, included = law_error(basis, tests)
    if part > FRICTION_MOVES:
        values = {"part": part, "name": as_free([name])[0], "included": included}
        yield Finding(Kind.FRICTION_MODEL, Severity.LIMIT, values)
    missing = max(0, settings["left_out"] - 1)  # what remains at the end is no window, as a rule
    if missing > LEFT_OUT * (missing + settings["windows"]):
        yield Finding(Kind.WINDOWS_LEFT_OUT, Severity.LIMIT, {"part": missing / (missing + settings["windows"])})
    if settings.get("starts", 1) > 1 and settings["starts_agree"] <= 1:
        yield Finding(Kind.LONE_START, Severity.LIMIT, {"starts": settings["starts"]})
    if not information.white:
        yield Finding(Kind.COLOURED, Severity.LIMIT, {"samples": information.correlation})
    if not information.agrees:
        yield Finding(Kind.NOT_STATIONARY, Severity.LIMIT)
    elif widening(information.freedom) > REPORTED.wider:
        half = float(np.sqrt(quantile(LEVEL, information.freedom)))
        yield Finding(Kind.FEW_VALUES, Severity.LIMIT, {"values": information.freedom, "half": half})


def _identifiable(basis: Basis) -> Iterator[Finding]:
    """Yield what can be known: all, or all but a common factor, parameters without effect, and those that act alike."""
    parameters, information = basis.plant.parameters, basis.information
    unknown, x = information.unknown, information.x
    if not information.estimated:
        yield Finding(Kind.NOT_ESTIMATED, Severity.WRONG)
        return
    if unknown.shape[1] == 0:
        yield Finding(Kind.IDENTIFIABLE, Severity.NOTE)
    else:
        common, grows = common_factor(parameters, x, unknown), information.growing
        others = unknown if common is None else unknown - np.outer(common, common @ unknown)
        idle = (np.linalg.norm(others, axis=1) > 1.0 - TOUCHED) & ~grows
        touched = ((np.linalg.norm(unknown, axis=1) > TOUCHED) | grows) & ~idle
        if (count := unknown.shape[1] - int(idle.sum())) > 0:
            names = dict.fromkeys(p.name for p, there in zip(parameters.all, touched, strict=True) if there)
            lost = [name for name, std in ratio_spread(parameters, information).items() if np.isinf(std).any()]
            values = {"count": count, "names": list(names), "lost": lost, "common": common is not None}
            yield Finding(Kind.COMBINATION, Severity.LIMIT if common is None else Severity.NOTE, values)
        if idle.any():
            yield Finding(Kind.NO_EFFECT, Severity.LIMIT, {"names": np.array(parameters.labels)[idle].tolist()})
    least = (parameters.lower >= 0.0) & (parameters.values(parameters.rounded(x)) == 0.0)
    if least.any():
        yield Finding(Kind.AT_ZERO, Severity.LIMIT, {"names": np.array(parameters.labels)[least].tolist()})


@dataclass(frozen=True)
class FindingLimits:
    """Limits from which tests are reported."""

    # standard deviation of gravity's factor: any ruler measures lengths better
    untested: float = 0.05
    # relative, of lengths: a ruler that is read with care errs by less
    short: float = 0.004
    # standard deviations: more than noise makes of 99.7 % of what is right
    certain: float = 3.0
    # times as wide as from a deviation that is known: an interval by three degrees of freedom
    wider: float = 1.5


REPORTED = FindingLimits()


def first_misdeclared(tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what was declared or held, does not fit and matters, and explains most; None where all fits."""
    return next((each for each in tests if each.significant and each.matters), None)


def explaining(tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what explains most of a fit that is poor, though its ratios are not known well enough to move beyond."""
    reported = [each for each in tests if each.significant and each.quantity.reported]
    causes = [each for each in (*_causes(tests), *reported) if each.gain > TESTING.explains]
    return max(causes, key=lambda each: each.gain, default=None)


def score_findings(tests: Sequence[ScoreTest], *, odd: bool, known: bool, wrong: bool) -> list[Finding]:
    """Return the findings of tests of a fit that is `odd`, or that determines no ratio (not `known`).

    What explains such a fit is wrong; `wrong`: something else is known to be, and causes are doubts.
    """
    found = _of_links(tests, odd=odd)
    seeming = {name for each in tests for name in each.explains} if found else set()
    tests = [each for each in tests if each.name not in seeming]
    first, cause = first_misdeclared(tests), None
    if first is not None:
        cause = next((each for each in _causes(tests) if each.gain > first.gain + TESTING.equal), None)
        found.append(finding(first, Severity.WRONG, tests))
    elif (odd or not known) and not wrong and not any(each.severity is Severity.WRONG for each in found):
        cause = explaining(tests)
    if cause is not None:
        found.append(finding(cause, Severity.WRONG))
    found += [finding(each, Severity.DOUBT) for each in tests if each is not cause and _doubtful(each, first)]
    # this motion cannot show a wrong clock or wrong lengths
    untested = any(each.name == CLOCK and each.std > REPORTED.untested for each in tests)
    return [*found, *_lengths(tests), *([Finding(Kind.UNTESTED)] * untested)]


def finding(test: ScoreTest, severity: Severity, tests: Sequence[ScoreTest] = ()) -> Finding:
    """Return a test as a finding, with which others of `tests` explain as much."""
    alike = [each for each in tests if each.significant and each is not test and each.gain > test.gain - TESTING.equal]
    others = {"freed_with": as_free(test.freed_with), "alike": dict(map(_value, alike))}
    values = test.quantity.values(test.name, test.values) | {"moved": test.moved}
    return Finding(test.quantity.kind, severity, values | others, test.gain)


def _value(test: ScoreTest) -> tuple[str, float]:
    """Return what a test is about, and its value; NaN for several."""
    named = test.quantity.kind in (Kind.HELD, Kind.RESISTANCE, Kind.UNEVEN_RESISTANCE)
    name = f"'{test.name}'" if named else str(test.quantity.kind)
    values = test.quantity.values(test.name, test.values).values()
    return name, next((each for each in values if isinstance(each, float)), np.nan)


def _causes(tests: Sequence[ScoreTest]) -> list[ScoreTest]:
    """Return what is held and surely does not fit, though ratios move by no more than noise may, or not at all."""
    certain = (each for each in tests if each.significant and each.excess_gain > TESTING.sure and not each.matters)
    return [each for each in certain if each.law or (each.covered and each.quantity.of_rope)]


def _doubtful(test: ScoreTest, first: ScoreTest | None) -> bool:
    """Whether something seems off, but moves ratios by little, or something else may explain it."""
    if test.name == DRIFT:
        return test.refitted and not (test.significant and test.matters) and (first is None or first.gain <= test.gain)
    if test.name in (LINKS, SCALES) or (test.significant and test.matters):
        return False
    if test.suspected or test.covered:
        return not test.freed_with
    alike = first is not None and abs(test.gain - first.gain) < TESTING.equal
    explains = test.law and test.gain > TESTING.explains and not alike
    return test.significant and (test.slight or test.uneven or test.quantity.reported or explains)


def _of_links(tests: Sequence[ScoreTest], *, odd: bool) -> list[Finding]:
    """Return that links are too long: the cause of an `odd` fit, or a doubt; nothing where another cause is better."""
    links = next((each for each in tests if each.name == LINKS), None)
    if links is None or links.excess_gain < TESTING.likely or links.gain <= TESTING.equal:
        return []
    others = [other for other in tests if other.name not in links.explains]
    better = {other.name for other in others if other.significant and other.gain > links.gain + TESTING.equal}
    if not better <= set(links.freed_with):
        return []
    along = {"freed_with": as_free(links.freed_with)}
    values = along | {"probability": links.excess_gain, "moved": links.ratio_sensitivity}
    explained = max(links.gain, *(other.gain for other in tests if other.name in links.explains), 0.0)
    cause = odd and explained >= max(TESTING.explains, *(other.gain for other in others))
    found = Finding(Kind.LINKS_TOO_LONG, Severity.WRONG if cause else Severity.DOUBT, values, links.gain)
    return [found] * (cause or links.ratio_sensitivity > 0.0)


def _lengths(tests: Sequence[ScoreTest]) -> list[Finding]:
    """Return that lengths seem off where a drive makes the motion depend on them, and no clock seems off."""
    scales = next((each for each in tests if each.name == SCALES and each.values.size > 2), None)
    if scales is None or any(each.significant and each.name == CLOCK for each in tests):
        return []
    known = scales.information[:2, :2]  # of links' lengths and of gravity, the arm being as long as declared
    if not determined(known):
        return []
    score = scales.information[:2] @ np.log(np.clip(scales.values, 1e-9, 1e9))
    off, std = abs(float(np.linalg.solve(known, score)[0])), float(np.sqrt(np.linalg.inv(known)[0, 0]))
    seen = off >= max(REPORTED.short, REPORTED.certain * std)
    return [Finding(Kind.LENGTHS, Severity.DOUBT, {"off": off})] * seen
