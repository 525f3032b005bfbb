"""A fit as a result: values, ratios, sentences and grade."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.identification.diagnosis.grade import FRICTION_LOOSE, LOOSE, MASSES, Findings, grade, hardly
from hyperflex.identification.diagnosis.model_error import law_error
from hyperflex.identification.diagnosis.score_tests import LAWS, ScoreTest
from hyperflex.identification.diagnosis.tolerances import moves_alike
from hyperflex.identification.diagnosis.window_tests import Scatter
from hyperflex.identification.ending import CONVERGED, INTERRUPTED, NOT_CONVERGED, alone
from hyperflex.identification.model.plant import Plant
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import Basis, Interval, of_ratios
from hyperflex.identification.uncertainty.ratios import ratio_spread, ratios
from hyperflex.identification.uncertainty.whiteness import CHANCE
from hyperflex.identification.verdict import (
    consistent,
    held_words,
    noise_not_modelled,
    not_converged,
    not_noise,
    poor_fit,
    poor_torque,
    too_large,
    too_small,
    unexplained,
    verdict,
)
from hyperflex.model import Rope
from hyperflex.sensors import Angles, Markers


def assemble_result(
    basis: Basis,
    held_out: HeldOut | None,
    settings: dict[str, Any],
    intervals: dict[str, Interval] | None = None,
    tests: tuple[ScoreTest, ...] = (),
    scatter: tuple[Scatter, ...] = (),
    early: str = INTERRUPTED,
) -> Identification:
    """Return the result of a fit, whose message is `early` if it was interrupted.

    Intervals of the ratios join those of the parameters.
    """
    plant, information, found, windows = basis.plant, basis.information, basis.fit, basis.windows
    parameters = plant.parameters
    x = parameters.rounded(found.x)
    rope, slopes, (residuals, torque) = parameters.rope(x), parameters.derivatives(x), _residuals(basis)
    known, ratio_std = ratios(rope, parameters.names), ratio_spread(parameters, information)
    moves = ratio_spread(parameters, information, model=True)
    covariance, by_length = information.covariances(slopes)
    message = early if found.interrupted else CONVERGED if found.converged else NOT_CONVERGED
    unit, declared = "rad" if isinstance(plant.sensor, Angles) else "m", settings["noise"] == "declared"
    warnings = (
        not_converged(message),
        poor_fit(windows, residuals, unit, found.loss, white=information.whiteness >= CHANCE),
        poor_torque(windows, torque, found.loss),
    )
    words = [
        warnings[0],
        *verdict(parameters, information, ratio_std),
        *warnings[1:],
        alone(settings.get("starts", 1), settings.get("starts_agree", 1)),
        not_noise(information.correlation, information.whiteness),
        noise_not_modelled(information.agrees, information.freedom),
        too_large(information.variance, information.freedom) if declared else "",
        *(each.remark for each in (intervals or {}).values()),
    ]
    said = (too_small(windows, residuals, found.loss) or _unexplained(basis, tests)) if declared else ""
    if intervals is not None:
        intervals = intervals | of_ratios(known, ratio_std, information.freedom)
    findings = replace(
        _findings(basis, rope, tests, settings), warnings=warnings, held_out=held_out, scatter=scatter, noise=said
    )
    result = Identification(
        rope=rope,
        values=_by_name(plant, rope, parameters.values(x)),
        std=_by_name(plant, None, information.deviations(slopes)),
        ratios=known,
        ratio_std=ratio_std,
        model_std=_by_name(plant, None, information.model_spread(np.diag(slopes))),
        ratio_model_std=moves,
        intervals=intervals or {},
        grade=grade(findings),
        score_tests=tests,
        verdict=tuple(consistent(words)),
        identifiable=findings.identifiable,
        residual_rms=np.sqrt(np.nanmean(residuals**2, axis=0)),
        residual_t=np.concatenate([w.t for w in windows]),
        residuals=residuals,
        held_out=held_out,
        parameters=parameters.labels,
        covariance=covariance,
        length_covariance=by_length,
        singular_values=information.singular,
        settings=settings,
        message=message,
        unit=unit,
        history=tuple(found.history),
        torque_residuals=torque,
    )
    object.__setattr__(result, "_basis", basis)
    return result.with_remark(held_words(result.held), last=True)


def _unexplained(basis: Basis, tests: Sequence[ScoreTest]) -> str:
    """Return that far more than the declared noise is left, where no test finds a cause; nothing without tests."""
    silent = not tests or any(each.believed for each in tests)
    return "" if silent else unexplained(basis.information.variance)


def _findings(basis: Basis, rope: Rope, tests: Sequence[ScoreTest], settings: dict[str, Any]) -> Findings:
    """Return what is found of a fit by its covariance and its score tests."""
    parameters, information = basis.plant.parameters, basis.information
    known, std = ratios(rope, parameters.names), ratio_spread(parameters, information)
    missing = max(0, settings["left_out"] - 1)  # what is left at the end is no window, as a rule
    parts = np.concatenate([_parts(known[name], std[name]) for name in MASSES])
    return Findings(
        rope,
        identifiable=information.unknown.shape[1] == 0,
        tests=tests,
        held=basis.plant.motor is None,
        laws=law_error(basis, tests),
        hardly=_hardly(basis, known, std),
        unknown=bool(parts.any() and (parts[parts > 0.0] > LOOSE).all()),
        moved=_moved(known, ratio_spread(parameters, basis.as_declared.information, model=True)),
        turned=parameters.single("gravity_angle", basis.fit.x),
        left_out=missing / (missing + settings["windows"]),
        alike=moves_alike(basis.plant),
    )


def _moved(ratios: dict[str, Array], moves: dict[str, Array]) -> float:
    """Return by what part of themselves the model's error may move ratios of moments and inertias, at most."""
    parts = [moves[name] / np.maximum(np.abs(ratios[name]), 1e-300) for name in MASSES if name in moves]
    return float(np.nanmax(np.concatenate(parts), initial=0.0)) if parts else 0.0


def _hardly(basis: Basis, ratios: dict[str, Array], spreads: dict[str, Array]) -> list[str]:
    """Return the labels of values and ratios that are hardly known, with standard deviations; a name stands for all.

    Ratios stand for the values that they are of where no torque tells these. What cannot be known at all is told
    elsewhere.
    """
    parameters, information = basis.plant.parameters, basis.information
    std = information.deviations(parameters.derivatives(information.x))
    values = parameters.values(parameters.rounded(information.x))
    told = {"mass", "com", "inertia", *LAWS} if basis.plant.motor is None else set()
    said = []
    for each, value, spread in zip(parameters.all, values, std, strict=True):
        part = spread / value if value > 0.0 and each.kind.form != "linear" and each.name not in told else 0.0
        if (FRICTION_LOOSE if each.name in LAWS else LOOSE) < part < np.inf:
            said.append(hardly(each.label, part))
    for name, numbers in ratios.items():
        parts = _parts(numbers, spreads[name])
        loose = np.flatnonzero(parts > (LOOSE if name in MASSES else FRICTION_LOOSE))
        if 1 < loose.size == np.count_nonzero(parts):
            said.append(hardly(name, float(parts.max())))
        else:
            said += [hardly(f"{name}[{k}]", float(parts[k])) for k in loose]
    return said


def _parts(values: Array, std: Array) -> Array:
    """Return standard deviations (n,) as parts of values (n,); 0 of what was held or cannot be known at all."""
    known = (std > 0.0) & (std < np.inf)
    return np.where(known, std, 0.0) / np.maximum(np.abs(values), 1e-300)


def _residuals(basis: Basis) -> tuple[Array, Array | None]:
    """Return measured less fitted values (m, C) of all windows, rad or m, and torques (m,), N m; NaN in gaps."""
    weights = np.concatenate([w.weight for w in basis.windows])
    each = zip(basis.fit.residuals, basis.windows, strict=True)
    flat = np.concatenate([residual.reshape(w.y.shape) for residual, w in each])
    with np.errstate(divide="ignore", invalid="ignore"):
        every = np.where(weights > 0.0, -flat / weights, np.nan)
    return (every, None) if basis.plant.motor is None else (every[:, :-1], every[:, -1])


def _by_name(plant: Plant, rope: Rope | None, numbers: Array) -> dict[str, Array]:
    """Return numbers (P,) by property: (n,) with the rope's own (or 0) where a link is not free, or single."""
    parameters = plant.parameters
    n = parameters.guess.n_links
    result: dict[str, Array] = {}
    for parameter, number in zip(parameters.all, numbers, strict=True):
        name, held = parameter.name, np.zeros(n)
        if not parameter.links:
            result[name] = np.array(number)
        elif parameter.law != "own":
            result[parameter.label] = np.array(number)
        else:
            if name == "arc":
                held = plant.sensor.values[2:] * (rope is not None)
            elif rope is not None:
                held = getattr(rope, name).copy()
            result.setdefault(name, held)[list(parameter.links)] = number
    return result


def fit_settings(plant: Plant, free: Sequence[str], loss: str, origin: npt.ArrayLike | None) -> dict[str, Any]:
    """Return what was fitted and how, for the settings of a result."""
    moved = "moved" if plant.arm is None else f"moved by an arm of {plant.arm.length:g} m"
    result: dict[str, Any] = {"free": list(free), "loss": loss, "base": "fixed" if plant.motion is None else moved}
    if isinstance(plant.sensor, Markers):
        result["arc_lengths"] = plant.sensor.arc_lengths.tolist()
    if origin is not None:
        result["origin"] = np.asarray(origin, dtype=np.float64).tolist()
    return result
