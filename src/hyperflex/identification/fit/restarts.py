"""Other first states for windows that fit worse than the rest: a state may be caught far from the best one.

Outliers and gaps spoil the first guess of a state, and a joint that sticks in the simulation answers to no small
change. Where the window before arrives, the simulation goes on as the rope did.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.multiple_shooting import Fit, Report, fit, fit_state
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.model.plant import Plant

WORSE = 2.0  # times what a value of the middle window costs, or of noise that is known: worth another start
BETTER = 0.98  # of its cost: less is another state, not the same one again
AGAIN = 3  # times at most that all is fitted together after windows have found better states


def restarted(plant: Plant, windows: Sequence[Window], found: Fit, *, known_noise: bool, report: Report) -> Fit:
    """Return the fit after windows that fit badly have been started elsewhere; the same one where none gains.

    Parameters
    ----------
    plant, windows, found
        What was fitted; `found` has not been interrupted.
    known_noise : bool
        Whether the windows' weights are those of declared noise, so that a value should cost about 1.
    report : callable
        Hears of the rounds of fits of all together.
    """
    for _ in range(AGAIN):
        states, gained = list(found.states), False
        for k in worse(windows, found, known_noise=known_noise):
            better = _elsewhere(plant, windows, found, states, k)
            if better is not None:
                states[k], gained = better, True
        if not gained:
            return found
        again = fit(plant, windows, found.x, states, loss=found.loss, report=report)
        again.history[:0] = found.history
        if again.interrupted or again.cost >= found.cost:
            found.interrupted = again.interrupted
            return found if again.cost >= found.cost else again
        found = again
    return found


def worse(windows: Sequence[Window], found: Fit, *, known_noise: bool) -> list[int]:
    """Return which windows cost much more for each value than the middle one, or than noise that is known explains."""
    costs = np.array([_cost(found, window, *each) / window.values for window, each in _each(windows, found)])
    limit = float(np.median(costs))
    return [int(k) for k in np.flatnonzero(costs > WORSE * (min(limit, 1.0) if known_noise else limit))]


def _each(windows: Sequence[Window], found: Fit) -> Iterator[tuple[Window, tuple[Array, Array]]]:
    for window, state, residual in zip(windows, found.states, found.residuals, strict=True):
        yield window, (state, residual)


def _cost(found: Fit, window: Window, state: Array, residual: Array) -> float:
    """Cost of a window with this state."""
    believed = window.belief(state)
    return found.loss.cost(residual) + float(believed @ believed)


def _elsewhere(plant: Plant, windows: Sequence[Window], found: Fit, states: Sequence[Array], k: int) -> Array | None:
    """Return a state of window k that costs less than the present one, from the best of several starts; else None."""
    window = windows[k]
    least, best = BETTER * _cost(found, window, found.states[k], found.residuals[k]), None
    for start in _starts(plant, windows, found.x, states, k):
        tried = fit_state(plant, found.x, window, start, loss=found.loss)
        if tried is not None and (cost := _cost(found, window, *tried)) < least:
            least, best = BETTER * cost, tried[0]
    return best


def _starts(plant: Plant, windows: Sequence[Window], x: Array, states: Sequence[Array], k: int) -> Iterator[Array]:
    """States to start window k from: where the window before arrives, what the data show, both angles at rest."""
    window, n = windows[k], states[k].size // 2
    if k > 0:
        arrived = plant.carried(x, float(windows[k - 1].t[0]), states[k - 1], float(window.t[0]))
        if arrived is not None:
            turns = 2.0 * np.pi * np.round((window.guess[:n] - arrived[:n]) / (2.0 * np.pi))
            yield np.append(arrived[:n] + turns, arrived[n:])
    yield window.guess
    yield np.append(window.guess[:n], np.zeros(n))
    yield np.append(states[k][:n], np.zeros(n))
