"""Restarts: other states of windows that fit badly, and other starts of a fit that ends badly."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.multiple_shooting import Fit, Report, fit, with_entries
from hyperflex.identification.fit.state_search import search_state, states_at
from hyperflex.identification.fit.windows import Window, part_left
from hyperflex.identification.model.plant import Plant

WORSE = 2.0  # times what a value of the middle window costs, or of noise that is known: worth another start
BETTER = 0.98  # of its cost: less is another state, not the same one again
AGAIN = 3  # times at most that all is fitted together after windows have found better states
BAD = 0.05  # part of the motion that a fit without known noise leaves, from which it is tried from other starts
ALIKE = 1.05  # ratio of costs within which two starts have come to the same


def refit_poor_windows(
    plant: Plant, windows: Sequence[Window], found: Fit, *, known_noise: bool, report: Report
) -> Fit:
    """Fit again from other states of the windows that fit badly; return the better fit.

    Outliers and gaps spoil first guesses of states, and a sticking joint has no gradient. With `known_noise` the
    weights are of declared noise: a value should cost about 1.
    """
    for _ in range(AGAIN):
        states, gained = list(found.states), False
        for k in poor_windows(windows, found, known_noise=known_noise):
            wide = bool(windows[k].others)
            better = search_state(plant, windows, found.x, states, k, found.loss, enough=BETTER, thorough=wide)
            if better is not None:
                states[k], gained = better, True
        if not gained:
            return found
        again = fit(plant, windows, found.x, states, loss=found.loss, report=report)
        again.history[:0] = found.history
        if again.cost >= found.cost:
            return found
        found = again
    return found


def poor_windows(windows: Sequence[Window], found: Fit, *, known_noise: bool) -> list[int]:
    """Return the windows whose cost a value is far above the median, or above that of known noise."""
    costs = np.array([found.loss.cost(r) / w.values for w, r in zip(windows, found.residuals, strict=True)])
    limit = float(np.median(costs))
    return [int(k) for k in np.flatnonzero(costs > WORSE * (min(limit, 1.0) if known_noise else limit))]


def fit_from_starts(
    plant: Plant,
    windows: Sequence[Window],
    found: Fit,
    starts: Sequence[Array],
    *,
    known_noise: bool,
    report: Report,
) -> tuple[Fit, int, int]:
    """Return the best of a fit and, if it is bad, of fits from other x [(P,), ..]; how many were tried, and agree.

    States are fitted to each start first, window after window, so that no start is lost by a bad guess of states. It is
    bad if values cost twice what known noise does, or it leaves a large part of the motion.
    """
    if not _is_bad(windows, found, known_noise):
        return found, 1, 1
    costs, best = [found.cost], found
    for number, x in enumerate(starts):
        states = states_at(plant, windows, x, found.states, found.loss)
        if states is None:
            continue
        try:
            heard = with_entries(report, {"phase": "start", "start": number})
            tried = fit(plant, windows, x, states, loss=found.loss, report=heard)
        except InvalidInput:
            continue
        costs.append(tried.cost)
        if tried.cost < best.cost:
            tried.history[:] = found.history
            best = tried
    return best, len(costs), sum(cost <= ALIKE * best.cost for cost in costs)


def _is_bad(windows: Sequence[Window], found: Fit, known_noise: bool) -> bool:
    if known_noise:
        return found.cost - found.prior_cost > WORSE * sum(window.values for window in windows)
    return not found.converged or part_left(windows, found.residuals) > BAD
