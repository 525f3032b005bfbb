"""Everything that a fit has found, put together and told in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.ending import CONVERGED, INTERRUPTED, NOT_CONVERGED
from hyperflex.identification.misfit import poor, poor_torque
from hyperflex.identification.model.plant import Plant
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import Basis, ratio_spread, ratios
from hyperflex.identification.uncertainty.intervals import Interval, of_ratios
from hyperflex.identification.verdict import (
    failed_predictions,
    in_harmony,
    noise_unknown,
    not_arrived,
    not_noise,
    too_large,
    verdict,
)
from hyperflex.model import Rope
from hyperflex.sensors import Angles


def conclude(
    basis: Basis,
    held_out: HeldOut | None,
    settings: dict[str, Any],
    remarks: list[str],
    intervals: dict[str, Interval] | None = None,
) -> Identification:
    """Put everything together; `remarks` join the verdict, intervals of the ratios those of the parameters."""
    plant, information, found, windows = basis.plant, basis.information, basis.fit, basis.windows
    parameters = plant.parameters
    x = parameters.rounded(found.x)
    rope, slopes = parameters.rope(x), parameters.slopes(x)
    spreads = information.deviations(slopes)
    weights = np.concatenate([w.weight for w in windows])
    flat = np.concatenate([r.reshape(w.y.shape) for r, w in zip(found.residuals, windows, strict=True)])
    with np.errstate(divide="ignore", invalid="ignore"):
        residuals = np.where(weights > 0.0, -flat / weights, np.nan)
    unit = "rad" if isinstance(plant.sensor, Angles) else "m"
    torque = None
    if plant.motor is not None:
        residuals, torque = residuals[:, :-1], residuals[:, -1]
    rms = np.sqrt(np.nanmean(residuals**2, axis=0))
    ratio_sd = ratio_spread(parameters, information)
    message = INTERRUPTED if found.interrupted else CONVERGED if found.converged else NOT_CONVERGED
    words = not_arrived(message) + verdict(parameters, information, rope, ratio_sd)
    words += poor(windows, residuals, unit, found.loss) + poor_torque(windows, torque, found.loss)
    words += not_noise(information.correlation, information.whiteness)
    words += noise_unknown(information.agrees, information.freedom) + failed_predictions(held_out) + remarks
    if ((weights != 0.0) & (weights != 1.0)).any():  # the recording says what its noise is
        words += too_large(information.variance, information.freedom)
    words += [each.remark for each in (intervals or {}).values() if each.remark]
    if intervals is not None:
        intervals = intervals | of_ratios(ratios(rope), ratio_sd, information.freedom)
    return Identification(
        rope=rope,
        values=_by_name(plant, rope, parameters.values(x)),
        sd=_by_name(plant, None, spreads),
        ratios=ratios(rope),
        ratio_sd=ratio_sd,
        intervals=intervals or {},
        verdict=tuple(in_harmony(words)),
        identifiable=information.unknown.shape[1] == 0,
        residual_rms=rms,
        residual_t=np.concatenate([w.t for w in windows]),
        residuals=residuals,
        held_out=held_out,
        parameters=parameters.labels,
        covariance=information.covariance * np.outer(slopes, slopes),
        singular_values=information.singular,
        settings=settings,
        message=message,
        unit=unit,
        history=tuple(found.history),
        torque_residuals=torque,
    ).resting_on(basis)


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
