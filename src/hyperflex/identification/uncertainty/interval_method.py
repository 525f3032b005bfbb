"""Choice of each interval's method: covariance, or profile likelihood where skewed."""

from dataclasses import replace

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.fit.multiple_shooting import Report, with_entries
from hyperflex.identification.options import How
from hyperflex.identification.uncertainty.coordinate import ParameterCoordinate
from hyperflex.identification.uncertainty.covariance import LEVEL, Basis, End, Interval, from_covariance
from hyperflex.identification.uncertainty.profile import WALK, Profile, profiled
from hyperflex.identification.uncertainty.threshold import near_bounds, quantile
from hyperflex.interruption import stoppable

TIED = 0.1  # correlation with a parameter beside its bound from which the bound is felt
BENT = 0.1  # part by which the root of the rise may depart from a straight line before the covariance is left
MOST = 4  # profiles that "auto" takes on, each as dear as two or three fits


def all_intervals(
    basis: Basis,
    how: How,
    level: float = LEVEL,
    *,
    remarks: list[Finding] | None = None,
    budget: Budget | None = None,
    report: Report | None = None,
) -> dict[str, Interval]:
    """Return intervals of all free parameters, by label.

    ``auto`` profiles up to four parameters whose covariance is skewed: within four standard deviations of a bound,
    correlated with such a one, or with squares that do not rise as a parabola; of more, those nearest to their bounds.
    What a profile shows besides is added to `remarks`. `report` gets each round of each profile, with its ``parameter``
    and ``phase="profile"``. Ctrl-C raises Interrupted; in its ``partial``, and out of time, what was not profiled yet
    has intervals from the covariance.
    """
    result = {label: from_covariance(basis, which, level) for which, label in enumerate(basis.plant.parameters.labels)}
    labels = list(result)
    if how == "covariance":
        return result
    with stoppable() as stop:
        chosen = _skewed_parameters(basis) if how == "auto" else list(range(len(labels)))
        chosen = [k for k in chosen if result[labels[k]].kind != "unknown"]
        length = max(float(w.t[-1] - w.t[0]) for w in basis.windows)
        for number, k in enumerate(chosen):
            at = {"phase": "profile", "parameter": labels[k], "window": length, "stage": number, "stages": len(chosen)}
            along = ParameterCoordinate(basis, k)
            found = profiled(
                basis, along, level, budget=budget, report=None if report is None else with_entries(report, at)
            )
            if found.kind == "profile":
                interval = Interval(found.low, found.high, found.kind, found.ends, level)
                result[labels[k]] = _with_model_error(basis, k, interval)
            if remarks is not None:
                remarks += _remarks(found)
    return stop.deliver(result)


def _with_model_error(basis: Basis, which: int, interval: Interval) -> Interval:
    """Return the interval of a profile, made wider by the model's errors; it stays within the parameter's bound."""
    parameter, information = basis.plant.parameters.all[which], basis.information
    x = float(information.x[which])
    one = np.eye(information.x.size)[which : which + 1] * parameter.derivative(x)
    value = parameter.value(x)
    model = float(information.model_spread(one)[0]) * float(np.sqrt(quantile(interval.level, information.freedom)))
    low = value - float(np.hypot(value - interval.low, model))
    least = -np.inf if parameter.form == "linear" else 0.0
    end: End = "bound" if low <= least else interval.ends[0]
    high = value + float(np.hypot(interval.high - value, model))
    return replace(interval, low=max(low, least), high=high, ends=(end, interval.ends[1]))


def _remarks(found: Profile) -> list[Finding]:
    """Return that a profile has found a better optimum, or took too long."""
    if found.gain > WALK.better:
        return [Finding(Kind.BETTER_OPTIMUM, Severity.LIMIT, {"name": found.name, "gain": found.gain})]
    return [Finding(Kind.PROFILE_GIVEN_UP, Severity.LIMIT, {"name": found.name})] * (found.kind == "covariance")


def skewed(basis: Basis, which: int) -> bool:
    """Tell whether the covariance does not suffice for a parameter.

    Beside a bound, its own or that of one it correlates with; or where, two standard deviations away along the line of
    the covariance, the squares rise otherwise than by four. Two rollouts of all windows.
    """
    information = basis.information
    covariance, std = information.covariance, np.sqrt(np.diag(information.covariance))
    near = np.flatnonzero(near_bounds(covariance, information.x - basis.plant.parameters.lower))
    if std[which] == 0.0:
        return False
    if any(abs(covariance[which, k]) > TIED * std[which] * std[k] for k in near):
        return True
    for step in (-2.0, 2.0):
        move = step * information.plain[:, which] / np.sqrt(information.plain[which, which])
        rise = _rise(basis, move)
        if rise is None or abs(np.sqrt(max(rise, 0.0)) / abs(step) - 1.0) > BENT:
            return True
    return False


def _skewed_parameters(basis: Basis) -> list[int]:
    information = basis.information
    std = np.sqrt(np.diag(information.covariance))
    above = (information.x - basis.plant.parameters.lower) / np.where(std > 0.0, std, 1.0)
    known = np.isfinite(information.deviations(np.ones(std.size)))
    chosen: list[int] = []
    for k in np.argsort(above, kind="stable"):
        if len(chosen) < MOST and known[k] and skewed(basis, int(k)):
            chosen.append(int(k))
    return chosen


def _rise(basis: Basis, move: Array) -> float | None:
    """Return the rise of the cost over the residual variance, x and states moved along a straight line."""
    found, total = basis.fit, 0.0
    for window, state, follow in zip(basis.windows, found.states, basis.information.follow, strict=True):
        moved = state + follow @ move
        residual = basis.plant.residual(found.x + move, window, moved)
        if residual is None:
            return None
        total += found.window_cost(window, moved, residual)
    return (total - found.cost) / basis.information.variance
