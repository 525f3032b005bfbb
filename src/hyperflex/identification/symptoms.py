"""What a fit shows of itself: whether it fits and predicts, what it determines, and what its values stand for."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.evidence import hangs_upwards, unlike_lengths
from hyperflex.identification.declarations.held import CLOCK, LAWS, as_free
from hyperflex.identification.declarations.score_findings import REPORTED, score_findings
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest
from hyperflex.identification.declarations.window_tests import Scatter
from hyperflex.identification.findings import Finding, Kind, Severity, percent
from hyperflex.identification.fit import NORMAL
from hyperflex.identification.model import Plant, common_factor, in_common_factor, lumped
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.uncertainty.covariance import TOUCHED, Basis
from hyperflex.identification.uncertainty.model_error import law_error
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.identification.uncertainty.ratios import ratio_gradients, ratio_spread, ratios
from hyperflex.model import RESISTANCES, Rope
from hyperflex.sensors import Angles

MASSES = ("J/p1", "p/p1")  # ratios without friction and stiffness


# Of the fit: part of the motion that may stay unexplained (right fits of real pendulums leave 0.1 to 1 %); the
# same where what stays is white, so that it is noise, and of a torque, which sensors or currents do not tell
# better
POOR = 0.05
WHITE_POOR = 0.2
# times the declared noise: residuals below show less noise, or are as good as the recording
QUIET = 0.5
NOISY = 1.5
# times the declared noise's variance: twice as much is no mistake of whoever declared it
UNEXPLAINED = 4.0
# rad, of gravity's angle: 11 degrees, more than any camera that was meant to be level
AXES = 0.2
# lengths of a link, to which its mass may reach; 1 is the most without counterweights (Cauchy-Schwarz)
REACH = 2.0
# Of the prediction: part of the error that no motion would make; parts of the values within the 95 % band: fewer
# than half are there where deviations are 2.9 times too small, and with 0.9 the error is about as stated
PERSISTENCE = 0.5
INSIDE = 0.5
AS_STATED = 0.9
# std over value, beyond which it is poorly determined; of frictions, stiffnesses
LOOSE = 0.15
FRICTION_LOOSE = 0.3
# part of a friction: by more than another law would change it, it is called a model error
FRICTION_MOVES = 0.1
# part of the windows
LEFT_OUT = 0.2
# samples
CORRELATED = 10.0
# independent values; a variance from fewer has no std
LEAST_FREEDOM = 2.0
# of centres of mass: the change that people think in
PER_CENT = 0.01


def symptoms(
    basis: Basis,
    tests: Sequence[ScoreTest],
    scatter: Sequence[Scatter],
    held_out: HeldOut | None,
    settings: dict[str, Any],
) -> list[Finding]:
    """Return all that a fit, its tests and its predictions show."""
    rope = basis.plant.parameters.rope(basis.plant.parameters.rounded(basis.fit.x))
    odd = [*_of_fit(basis), *_of_prediction(held_out), *_disagreeing(scatter)]
    known, loose = _determined(basis, rope)
    impossible = hangs_upwards(rope)
    declared = score_findings(
        tests, odd=any(each.severity is Severity.WRONG for each in odd), known=known, wrong=bool(impossible)
    )
    found = [*impossible, *declared, *odd, *_far(rope), *loose, *_rotated(basis)]
    wrong = any(each.severity is Severity.WRONG for each in found)
    found += [replace(each, severity=Severity.WRONG if wrong else each.severity) for each in unlike_lengths(rope)]
    if settings["noise"] == "declared":
        found += _of_noise(basis, tests)
    return [*found, *_scale(basis, tests), *_limits(basis, tests, scatter, settings), *_identifiable(basis)]


def _of_fit(basis: Basis) -> Iterator[Finding]:
    """Yield that a fit did not converge, or leaves much of the motion or of the torque.

    White residuals are measuring noise, of which more is allowed, and as much as was declared; declared noise excuses
    residuals that are not white as far as that, too.
    """
    fit, white = basis.fit, basis.information.whiteness >= CHANCE
    if fit.status is not None or not fit.converged:
        yield Finding(Kind.NOT_CONVERGED, Severity.WRONG, {"how": fit.status or "not converged"})
    rms, spread, noise = _sizes(basis)
    least, excused = WHITE_POOR * spread, NOISY * noise
    most = np.maximum(least, excused) if white else np.maximum(POOR * spread, np.minimum(least, excused))
    seen = rms.size - (basis.plant.motor is not None)  # a torque is the last channel
    worst = int(np.argmax(np.where(rms > excused * white, rms / np.maximum(spread, 1e-12), 0.0)[:seen]))
    if rms[worst] > most[worst]:
        what, unit = (
            (f"Link {worst}", "rad") if isinstance(basis.plant.sensor, Angles) else (f"Marker {worst // 2}", "m")
        )
        values = {"what": what, "rms": float(rms[worst]), "motion": float(spread[worst]), "unit": unit}
        yield Finding(Kind.POOR_FIT, Severity.WRONG, values)
    if seen < rms.size and rms[-1] > max(least[-1], excused[-1]):
        yield Finding(Kind.POOR_TORQUE, Severity.WRONG, {"rms": float(rms[-1]), "motion": float(spread[-1])})


def residuals_of(basis: Basis) -> Array:
    """Return measured less fitted channels (m, C) of all windows, rad or m, a torque last, N m; NaN in gaps."""
    weights = np.concatenate([w.weight for w in basis.windows])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weights > 0.0, -np.concatenate(basis.fit.residuals).reshape(weights.shape) / weights, np.nan)


def _sizes(basis: Basis) -> Array:
    """Return rms of residuals (medians under a robust loss), motion within windows and declared noise (3, C)."""
    residuals, weights = residuals_of(basis), np.concatenate([w.weight for w in basis.windows])
    with np.errstate(divide="ignore"):
        noise = np.sqrt(np.nanmean(np.where(weights > 0.0, 1.0 / weights**2, np.nan), axis=0))
    noise[((weights == 0.0) | (weights == 1.0)).all(axis=0)] = 0.0  # not declared
    moved = [np.nanvar(np.where(w.weight > 0.0, w.y, np.nan), axis=0) for w in basis.windows]
    if basis.fit.loss.name == "squares":
        rms = np.sqrt(np.nanmean(residuals**2, axis=0))
    else:
        rms = NORMAL * np.nanmedian(np.abs(residuals), axis=0)
    return np.stack([rms, np.sqrt(np.mean(moved, axis=0)), noise])


def _of_prediction(held_out: HeldOut | None) -> Iterator[Finding]:
    """Yield how predictions of what was not fitted fail."""
    if held_out is None:
        return
    if held_out.failed.size:
        values = {"failed": held_out.failed.size, "count": held_out.starts.size, "times": held_out.failed.tolist()}
        yield Finding(Kind.PREDICTION_FAILED, Severity.WRONG, values)
        return
    held_out = held_out.foreseeable
    error, still = float(np.sqrt(np.mean(held_out.rms**2))), held_out.persistence
    if error > PERSISTENCE * still > 0.0 and not held_out.inside >= AS_STATED:
        yield Finding(Kind.PREDICTION_POOR, Severity.WRONG, {"part": error / still})
    elif held_out.inside < INSIDE:
        yield Finding(Kind.PREDICTION_OUTSIDE, Severity.WRONG, {"part": held_out.inside})


def _disagreeing(scatter: Sequence[Scatter]) -> list[Finding]:
    """Return the ratio of moments and inertias of which windows disagree most, and that of a resistance."""
    masses = [each for each in scatter if each.label.startswith(MASSES)]
    laws = [each for each in scatter if each not in masses]
    found = [Finding(Kind.RESISTANCE_CHANGES, Severity.LIMIT, each._asdict()) for each in laws[:1]]
    for each in masses[:1]:
        severity = Severity.WRONG if each.part > TESTING.moves else Severity.DOUBT
        found.append(Finding(Kind.WINDOWS_DISAGREE, severity, each._asdict()))
    return found


def _far(rope: Rope) -> Iterator[Finding]:
    """Yield that a link's mass lies far beyond the link.

    All mass of a link, and beyond, is between its joints or at the far one, so J <= l p (Cauchy-Schwarz); a real link
    may reach beyond its joint.
    """
    p, inertia = lumped(rope)
    reach = inertia / np.where(p > 0.0, p, np.inf) / rope.length
    k = int(np.argmax(reach))
    if reach[k] > REACH:
        yield Finding(Kind.MASS_FAR, Severity.WRONG, {"link": k, "reach": float(reach[k])})


def _determined(basis: Basis, rope: Rope) -> tuple[bool, list[Finding]]:
    """Return whether any ratio of moments and inertias is known that is free, and what is poorly determined.

    A name stands for all its links. Ratios stand for the values that they are of where no torque tells these. What was
    held, and what cannot be known at all, is reported elsewhere.
    """
    parameters, information = basis.plant.parameters, basis.information
    every, spreads = ratios(rope, parameters.names), ratio_spread(parameters, information)
    known = {name: (std > 0.0) & (std < np.inf) for name, std in spreads.items()}
    parts = {
        name: np.where(known[name], std, 0.0) / np.maximum(np.abs(every[name]), 1e-300) for name, std in spreads.items()
    }
    masses = np.concatenate([parts[name][known[name]] for name in MASSES])
    nothing = masses.size > 0 and bool((masses > LOOSE).all())
    std = information.deviations(parameters.derivatives(information.x))
    values = parameters.values(parameters.rounded(information.x))
    by_ratios = {"mass", "com", "inertia", *LAWS} if basis.plant.motor is None else set()
    loose: dict[str, float] = {}
    for each, value, spread in zip(parameters.all, values, std, strict=True):
        least = (FRICTION_LOOSE if each.name in LAWS else LOOSE) * value
        if each.kind.form != "linear" and each.name not in by_ratios and 0.0 < least < spread < np.inf:
            loose[each.label] = float(spread / value)
    for name, own in parts.items():
        wide = np.flatnonzero(own > (LOOSE if name in MASSES else FRICTION_LOOSE))
        if 1 < wide.size == np.count_nonzero(own):
            loose[name] = float(own.max())
        else:
            loose |= {f"{name}[{k}]": float(own[k]) for k in wide}
    found = [Finding(Kind.NOTHING_KNOWN, Severity.WRONG, {"limit": LOOSE})] * nothing
    if loose:
        labels = [f"{label} (± {percent(part)})" for label, part in loose.items()]
        others = "values" if information.unknown.shape[1] == 0 else "ratios"
        found.append(Finding(Kind.POORLY_DETERMINED, values={"labels": labels, "names": list(loose), "others": others}))
    return not nothing, found


def _rotated(basis: Basis) -> Iterator[Finding]:
    """Yield that gravity was found far from where it was taken to be."""
    angle = basis.plant.parameters.single("gravity_angle", basis.fit.x)
    if abs(angle) > AXES:
        yield Finding(Kind.GRAVITY_ROTATED, values={"angle": float(angle)})


def _of_noise(basis: Basis, tests: Sequence[ScoreTest]) -> Iterator[Finding]:
    """Yield that declared noise is far larger than residuals, or these far larger than noise without a known cause."""
    rms, _, noise = _sizes(basis)[:, : None if basis.plant.motor is None else -1]
    declared, left = (float(np.sqrt(np.mean(each**2))) for each in (noise, rms))
    if left <= QUIET * declared:
        values = {"declared": declared, "left": left, "times": declared / max(left, 1e-300)}
        yield Finding(Kind.NOISE_OVERSTATED, values=values)
    elif tests and not any(each.significant for each in tests) and basis.information.variance > UNEXPLAINED:
        yield Finding(Kind.UNEXPLAINED, values={"times": float(np.sqrt(basis.information.variance))})


def _scale(basis: Basis, tests: Sequence[ScoreTest]) -> Iterator[Finding]:
    """Yield what the scale of masses, inertias and frictions is."""
    if basis.information.unknown.shape[1]:
        yield Finding(Kind.COMMON_FACTOR, Severity.LIMIT)
    elif basis.plant.motor is not None:
        yield Finding(Kind.TORQUE_SCALE, Severity.LIMIT)
    else:
        moves = next((_com_sensitivity(basis, each) for each in tests if each.name == "com"), 0.0)
        words = f" (1 % of a centre of mass moves ratios by up to {percent(moves)})" if moves > 0.0 else ""
        yield Finding(Kind.HELD_SCALE, Severity.LIMIT, {"sensitivity": words})


def _com_sensitivity(basis: Basis, test: ScoreTest) -> float:
    """Return by what part 1 % of held centres of mass moves a ratio that seems to be known better; 0 for none."""
    if test.freed_with:
        return 0.0
    parameters, information = basis.plant.parameters, basis.information
    gradients, known = ratio_gradients(parameters, information.x), ratios(parameters.rope(information.x))
    stds, worst = ratio_spread(parameters, information), 0.0
    for name in MASSES:
        moved = np.max(np.abs(gradients[name] @ (test.rate * np.abs(test.values))), axis=1) * PER_CENT
        beyond = (moved > 2.0 * stds[name]) & (stds[name] > 0.0)
        worst = max(worst, float(np.max(moved / np.abs(known[name]), where=beyond, initial=0.0)))
    return worst


def moves_alike(plant: Plant) -> bool:
    """Whether a longer and slower rope moves exactly alike: nothing but gravity and the lengths has a scale.

    With times x a and lengths x a^2 gravity stays. A drive, a torque, and inertias or resistances that are held do not
    go along.
    """
    if plant.motion is not None or plant.motor is not None or not plant.parameters.guess.gravity.any():
        return False
    names = {each.name for each in plant.parameters.all}
    held = [each.name for each in RESISTANCES if each.name not in names]
    return "inertia" in names and not any(getattr(plant.parameters.guess, name).any() for name in held)


def _limits(
    basis: Basis, tests: Sequence[ScoreTest], scatter: Sequence[Scatter], settings: dict[str, Any]
) -> Iterator[Finding]:
    """Yield what no motion tells, and what the model, the windows and the noise leave open."""
    from scipy.special import chdtrc

    information = basis.information
    if moves_alike(basis.plant) and any(each.name == CLOCK and each.std <= REPORTED.untested for each in tests):
        yield Finding(Kind.UNDETECTABLE, Severity.LIMIT)
    part, name = law_error(basis, tests)
    if part > FRICTION_MOVES:
        yield Finding(Kind.FRICTION_MODEL, Severity.LIMIT, {"part": part, "name": as_free([name])[0]})
    missing = max(0, settings["left_out"] - 1)  # what remains at the end is no window, as a rule
    if missing > LEFT_OUT * (missing + settings["windows"]):
        yield Finding(Kind.WINDOWS_LEFT_OUT, Severity.LIMIT, {"part": missing / (missing + settings["windows"])})
    if settings.get("starts", 1) > 1 and settings["starts_agree"] <= 1:
        yield Finding(Kind.LONE_START, Severity.LIMIT, {"starts": settings["starts"]})
    if information.correlation > CORRELATED or information.whiteness < CHANCE:
        yield Finding(Kind.COLOURED, Severity.LIMIT, {"samples": information.correlation})
    if not information.agrees:
        yield Finding(Kind.NOT_STATIONARY, Severity.LIMIT)
    elif information.freedom < LEAST_FREEDOM:
        yield Finding(Kind.FEW_VALUES, Severity.LIMIT, {"values": information.freedom})
    chance = chdtrc(information.freedom, information.freedom * information.variance)  # of so large a variance
    if settings["noise"] == "declared" and chance < CHANCE:
        yield Finding(Kind.NOISE_UNDERSTATED, Severity.LIMIT, {"times": float(np.sqrt(information.variance))})


def _identifiable(basis: Basis) -> Iterator[Finding]:
    """Yield what can be known: all, or all but a common factor, parameters without effect, and those that act alike."""
    parameters, information = basis.plant.parameters, basis.information
    unknown, x = information.unknown, information.x
    if not information.estimated:
        yield Finding(Kind.NOT_ESTIMATED, Severity.LIMIT)
        return
    if unknown.shape[1] == 0:
        yield Finding(Kind.IDENTIFIABLE, Severity.NOTE)
    else:
        common, grows = common_factor(parameters, x, unknown), in_common_factor(parameters, x, unknown)
        others = unknown if common is None else unknown - np.outer(common, common @ unknown)
        idle = (np.linalg.norm(others, axis=1) > 1.0 - TOUCHED) & ~grows
        touched = ((np.linalg.norm(unknown, axis=1) > TOUCHED) | grows) & ~idle
        if (count := unknown.shape[1] - int(idle.sum())) > 0:
            names = dict.fromkeys(p.name for p, there in zip(parameters.all, touched, strict=True) if there)
            lost = [name for name, std in ratio_spread(parameters, information).items() if np.isinf(std).any()]
            words = f"Not even known: {', '.join(lost)}." if lost else "The ratios over p1 are known."
            values = {"count": count, "names": list(names), "ratios": words, "common": common is not None}
            yield Finding(Kind.COMBINATION, Severity.LIMIT if common is None else Severity.NOTE, values)
        if idle.any():
            yield Finding(Kind.NO_EFFECT, Severity.LIMIT, {"names": np.array(parameters.labels)[idle].tolist()})
    least = (parameters.lower >= 0.0) & (parameters.values(parameters.rounded(x)) == 0.0)
    if least.any():
        yield Finding(Kind.AT_ZERO, Severity.LIMIT, {"names": np.array(parameters.labels)[least].tolist()})
