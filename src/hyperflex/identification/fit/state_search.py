"""State search: other states that a window may have begun in, and the one of least cost."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import HARDLY, fit_state
from hyperflex.identification.fit.windows import FEWEST, Window, nearest_turn
from hyperflex.identification.model.plant import Plant

GROWING = (0.125, 0.25, 0.5)  # parts of a window to which a state is fitted first
ALIKE = 1e-2  # rad, rad/s: ends of fits to the same minimum differ by less, and other minima by far more
SHORT = 10  # rounds of fitting a state to a part of a window


def search_state(
    plant: Plant,
    windows: Sequence[Window],
    x: Array,
    states: list[Array],
    k: int,
    loss: Loss,
    *,
    enough: float = 1.0,
    good: float = 0.0,
    thorough: bool = False,
) -> Array | None:
    """Return a state of window k that costs less than the part `enough` of what the present one costs, or None.

    `thorough`: states are fitted to its last samples as well, beginning with the window after, and to its first
    samples, then to more and more of it. That is worth its time where x is about right. A state of which a value costs
    no more than `good` ends the search.
    """
    window = windows[k]
    before = plant.residual(x, window, states[k])
    least = np.inf if before is None else enough * (loss.cost(before) + window.prior_cost(states[k]))
    best: Array | None = None
    for starts in _starts(plant, windows, x, states, k, loss, thorough=thorough):
        found = fit_state(plant, x, window, *starts, loss=loss, enough=HARDLY)
        if found is not None and (cost := loss.cost(found[1]) + window.prior_cost(found[0])) < least:
            best, least = found[0], cost
            if cost <= good * window.values:
                break
    return best


def _starts(
    plant: Plant, windows: Sequence[Window], x: Array, states: list[Array], k: int, loss: Loss, *, thorough: bool
) -> Iterator[list[Array]]:
    """Yield groups of states to start window k from, the cheapest first."""
    starts = list(restart_states(plant, windows, x, states, k))
    if not thorough:
        yield starts
        return
    if k > 0:
        yield arrived(plant, x, windows[k - 1], states[k - 1], windows[k])
    if k + 1 < len(windows) and plant.motion is None:
        yield _from_behind(plant, x, windows[k], windows[k + 1], states[k + 1], loss)
    yield _grown(plant, x, windows[k], starts, loss)


def _part(window: Window, rows: slice) -> Window:
    return replace(window, t=window.t[rows], y=window.y[rows], weight=window.weight[rows])


def _grown(plant: Plant, x: Array, window: Window, states: list[Array], loss: Loss) -> list[Array]:
    """Return states (2n,) fitted to the first samples of a window, then to more and more; those that end alike once."""
    for part in GROWING:
        seen = _part(window, slice(0, max(FEWEST, int(part * window.t.size))))
        grown: list[Array] = []
        for state in states:
            found = fit_state(plant, x, seen, state, loss=loss, rounds=SHORT, enough=HARDLY)
            end = state if found is None else found[0]
            if all(np.abs(end - other).max() > ALIKE for other in grown):
                grown.append(end)
        states = grown
    return states


def _from_behind(plant: Plant, x: Array, window: Window, after: Window, state: Array, loss: Loss) -> list[Array]:
    """Return the state (2n,) of a window from the beginning of the one after, back in time and fitted on the way."""
    end, n = float(after.t[0]), state.size // 2
    for part in (*(1.0 - each for each in GROWING[1:]), 0.0):
        first = int(part * window.t.size)
        mirrored = plant.propagate(x, 0.0, np.append(state[:n], -state[n:]), end - float(window.t[first]))
        if mirrored is None:  # backwards friction would push; forwards, with all rates turned round, it is about right
            return []
        state = nearest_turn(np.append(mirrored[:n], -mirrored[n:]), window.guess)
        found = fit_state(plant, x, _part(window, slice(first, None)), state, loss=loss, rounds=SHORT, enough=HARDLY)
        state, end = state if found is None else found[0], float(window.t[first])
    return [state]


def states_at(
    plant: Plant, windows: Sequence[Window], x: Array, states: Sequence[Array], loss: Loss
) -> list[Array] | None:
    """Return each window's state of least cost at x, from several starts, or None where a window has none."""
    found = list(states)
    for k, window in enumerate(windows):
        best = fit_state(plant, x, window, *restart_states(plant, windows, x, found, k), loss=loss)
        if best is None:
            return None
        found[k] = best[0]
    return found


def restart_states(
    plant: Plant, windows: Sequence[Window], x: Array, states: Sequence[Array], k: int
) -> Iterator[Array]:
    """Yield states to start window k from: the end of the window before, that of the data, and both angles at rest."""
    window, n = windows[k], states[k].size // 2
    if k > 0:
        yield from arrived(plant, x, windows[k - 1], states[k - 1], window)
    yield from (window.guess, *window.others)
    yield np.append(window.guess[:n], np.zeros(n))
    yield np.append(states[k][:n], np.zeros(n))


def arrived(plant: Plant, x: Array, before: Window, state: Array, window: Window) -> list[Array]:
    """Return the state (2n,) in which a window begins if the one before began in `state`, or nothing."""
    end = plant.propagate(x, float(before.t[0]), state, float(window.t[0]))
    return [] if end is None else [nearest_turn(end, window.guess)]
