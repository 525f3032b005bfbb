"""Alternating fits: parameters by the windows that fit, then states of the others, in turn, before all are fitted."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import Fit, Report, fit
from hyperflex.identification.fit.state_search import search_state, states_at
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.model.plant import Plant
from hyperflex.interruption import catch_interrupt

TURNS = 6  # times at most that parameters and states take turns; four were needed for a rope that is seen at its tip
AMISS = 10.0  # times what a value of the better windows, or of noise, costs: a shape taken for its mirror costs 100s
SCATTERED, SPREAD = 3, 0.7  # other starts, and by which factor, its logarithm, at most
FAILED = 1e100  # cost of a window whose rollout fails: no infinity, of which no quantile is known
BETTER_PART = 0.25  # quantile of the windows' costs that stands for those that fit
HARDLY, ROUNDS = 0.05, 15  # gain of a round, as a part of the cost, and rounds, that end a fit of the parameters


def fit_alternating(
    plant: Plant, windows: Sequence[Window], x: Array, states: list[Array], loss: Loss, report: Report
) -> Fit:
    """Return x (P,) and states of windows, of known noise, from which all can be fitted together.

    If even the better windows do not fit then, it is tried from some other x about the first one, until they do. Raises
    Interrupted by Ctrl-C, with what there is.
    """
    best, rng = _alternated(plant, windows, x, states, loss, report), np.random.default_rng(0)
    with catch_interrupt() as stop:
        for _ in range(SCATTERED):
            if _typical(windows, best) <= AMISS:
                break
            other = plant.parameters.scaled(x, np.exp(rng.uniform(-SPREAD, SPREAD, x.size)))
            begun = states_at(plant, windows, other, states, loss)
            if begun is not None:
                tried = _alternated(plant, windows, other, begun, loss, report)
                best = min(best, tried, key=lambda each: _typical(windows, each))
    return stop.deliver(best)


def _typical(windows: Sequence[Window], found: Fit) -> float:
    """Return what a value of the better windows costs."""
    costs = [float(r @ r) / window.values for r, window in zip(found.residuals, windows, strict=True)]
    return float(np.quantile(costs, BETTER_PART))


def _alternated(
    plant: Plant, windows: Sequence[Window], x: Array, states: list[Array], loss: Loss, report: Report
) -> Fit:
    """Return x (P,) and states of windows, of known noise, from which all can be fitted together.

    A window whose shape was taken for its mirror image would spoil x in a fit of all windows, and with a wrong x the
    mirror image may fit better. So x is fitted to the windows that fit, states of the others are searched with that,
    and so on.
    """
    begun = x, states
    with catch_interrupt() as stop:
        for _ in range(TURNS):
            found = _fit_of_the_better(plant, windows, x, states, loss, report)
            if found is None:
                break
            x, states = found
            changed = _other_states(plant, windows, x, states, loss)
            if not changed:
                break
            states = [changed.get(k, state) for k, state in enumerate(states)]
    try:
        whole = fit(plant, windows, x, states, loss=loss, rounds=0)
    except InvalidInput:
        whole = fit(plant, windows, *begun, loss=loss, rounds=0)
    return stop.deliver(whole)


def _fit_of_the_better(
    plant: Plant, windows: Sequence[Window], x: Array, states: list[Array], loss: Loss, report: Report
) -> tuple[Array, list[Array]] | None:
    """Return x and the states fitted to the windows that fit; None where these are too few."""
    costs = _costs(plant, windows, x, states)
    good = np.flatnonzero((costs < FAILED) & (costs <= AMISS * np.quantile(costs, BETTER_PART))).tolist()
    if sum(windows[k].values - windows[k].unknowns for k in good) <= x.size:
        return None
    chosen, begun = [windows[k] for k in good], [states[k] for k in good]
    found = fit(plant, chosen, x, begun, loss=loss, enough=HARDLY, rounds=ROUNDS, report=report)
    fitted = dict(zip(good, found.states, strict=True))
    return found.x, [fitted.get(k, state) for k, state in enumerate(states)]


def _other_states(
    plant: Plant, windows: Sequence[Window], x: Array, states: list[Array], loss: Loss
) -> dict[int, Array]:
    """Return states that cost less than the present ones, of windows that fit badly, by their numbers."""
    costs = _costs(plant, windows, x, states)
    changed: dict[int, Array] = {}
    least = float(np.quantile(costs, BETTER_PART))
    good = AMISS * min(1.0, least)
    for k in np.flatnonzero(costs > good).tolist():
        known = [changed.get(j, state) for j, state in enumerate(states)]
        state = search_state(plant, windows, x, known, k, loss, good=good, thorough=least < AMISS)
        if state is not None:
            changed[k] = state
    return changed


def _costs(plant: Plant, windows: Sequence[Window], x: Array, states: Sequence[Array]) -> Array:
    """Return what a value of each window costs (W,), in units of the noise's variance; FAILED where a rollout fails."""
    residuals = [plant.residual(x, window, state) for window, state in zip(windows, states, strict=True)]
    pairs = zip(residuals, windows, strict=True)
    return np.array([FAILED if r is None else float(r @ r) / window.values for r, window in pairs])
