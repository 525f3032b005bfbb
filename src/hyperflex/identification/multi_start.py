"""The fit: multiple shooting from several starts, each over windows from short to long.

A start is a guess x of the parameters. Windows that fit badly may have begun in another state than was guessed:
outliers and gaps spoil guesses, a sticking joint has no gradient, and with few markers a shape looks like its mirror
image. So parameters are fitted to the windows that fit, states of the others are searched with these, in turn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import memory
from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import STEPS, Fit, Report, fit, fit_state, with_entries
from hyperflex.identification.fit.windows import CUT, Window, decimation_step, nearest_turn, part_left
from hyperflex.identification.measurements import Measurements
from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.plant import Plant
from hyperflex.interruption import stoppable


@dataclass(frozen=True)
class SearchOptions:
    """How the fit searches."""

    # windows so many times shorter come first; how many, spread over the recording
    first: int = 8
    first_windows: int = 40
    # times at most that parameters and states take turns; a rope that is seen at its tip needed four
    turns: int = 6
    # times what a value of the better windows, or of noise, costs: a shape taken for its mirror costs 100s
    amiss: float = 10.0
    # times what a value of the middle window costs, or of known noise: worth another state, or start
    worse: float = 2.0
    # part of its cost: more is the same state again
    better: float = 0.98
    # quantile of the windows' costs that stands for those that fit
    better_part: float = 0.25
    # of a fit after which states are searched
    rounds: int = 15
    # part of the motion that a fit without known noise leaves, from which it is tried from other starts
    bad: float = 0.05
    # further starts of an ambiguous recording, and by which factor, its logarithm, at most
    scattered: int = 3
    spread: float = 0.7
    # ratio of costs within which two starts have come to the same
    alike: float = 1.05
    # cost of a window whose rollout fails: no infinity, of which no quantile is known
    failed: float = 1e100
    # rad, rad/s: ends of fits to the same minimum differ by less, and other minima by far more
    same_state: float = 0.01
    # rounds of fitting a state to a part of a window
    short: int = 10
    # of the grid on either side of 0; windows; rounds of their states
    delay_steps: int = 16
    delay_windows: int = 4
    delay_rounds: int = 2
    # part of the cost without delay that another must come below
    clearly: float = 0.8
    # of the derivatives of all values that are in memory at once
    copies: int = 4


SEARCH = SearchOptions()
GROWING = (0.125, 0.25, 0.5)  # parts of a window to which a state is fitted first


def check_memory(plant: Plant, measured: Measurements, length: float) -> None:
    """Refuse, before the work, more derivatives of windows of `length`, s, than there is memory for."""
    channels, links, count = measured.channels, plant.parameters.guess.n_links, len(plant.parameters)
    values = channels.data.size // decimation_step(channels, length)
    memory.check(
        8.0 * SEARCH.copies * values * (2 * links + count),
        f"a fit of {count} parameters of {links} links to {values} values",
        "Free fewer parameters, or give a part of the recording",
    )


@dataclass
class Fitted:
    """A fit with its windows and the settings that it used."""

    fit: Fit
    windows: list[Window]
    settings: dict[str, Any]


@dataclass(frozen=True)
class _Search:
    """What all starts have in common."""

    plant: Plant
    measured: Measurements
    loss: Loss
    budget: Budget
    report: Report
    ambiguous: bool  # whether states have several guesses, of shapes that look alike

    @property
    def known_noise(self) -> bool:
        """Whether noise was declared, so that a value should cost about 1; assumed noise may be too small."""
        return self.measured.channels.noise is not None and not self.measured.assumed

    def is_bad(self, windows: Sequence[Window], found: Fit) -> bool:
        """Whether values cost twice what known noise does, or a fit leaves a large part of the motion."""
        if self.measured.channels.noise is not None:
            return found.cost - found.prior_cost > SEARCH.worse * sum(window.values for window in windows)
        return not found.converged or part_left(windows, found.residuals) > SEARCH.bad


def multi_start(
    plant: Plant,
    measured: Measurements,
    length: float,
    usual: float,
    *,
    loss: Loss | None = None,
    budget: Budget | None = None,
    report: Report = lambda entry: None,
) -> Fitted:
    """Fit windows of `length`, s, shorter ones first; if the fit is bad, also from other starts.

    Out of time it returns the best so far, whose `status` says so. Raises Interrupted by Ctrl-C, with the best so far;
    IdentificationError, where nothing has been fitted before the time is over or no window can be simulated.
    """
    loss, budget = loss or Loss(), budget or Budget()
    seen = measured.windows(length, decimation_step(measured.channels, length))[0] if measured.sides else []
    ambiguous = any(window.others for window in seen)
    search = _Search(plant, measured, loss, budget, report, ambiguous)
    done: list[Fitted] = []
    with stoppable() as stop:
        for each in _stages(search, length, usual):
            done.append(each)
            if each.fit.status is not None:
                break
        else:
            _try_other_starts(search, done, length)
    if not done:
        raise stop.error or OutOfTime
    best = done[-1]
    best.fit.status = best.fit.status or stop.status
    best.fit.history[:] = [entry for each in done for entry in each.fit.history]
    return best


def _stages(search: _Search, length: float, usual: float) -> Iterator[Fitted]:
    """Yield fits of shorter windows, then of those of `length`, s; the last one if it was ended early."""
    plant, measured, x = search.plant, search.measured, search.plant.parameters.start
    spacing = float(np.median(np.diff(measured.channels.t)))
    lengths = stage_lengths(length, usual, spacing, short=not search.ambiguous)
    known: dict[float, Array] = {}
    for number, part in enumerate(lengths):
        step = decimation_step(measured.channels, part)
        windows, dropped = measured.windows(part, step)
        if part < length:
            windows = windows[:: max(1, len(windows) // SEARCH.first_windows)]
            if not _enough(plant, windows):
                continue
        stage = {"window": part, "stage": number, "stages": len(lengths)}
        heard = with_entries(search.report, stage)
        usable: list[Window] = []
        found: Fit | None = None
        with stoppable() as stop:
            usable, states = _first_states(search, windows, x, known, refine=number > 0 or search.ambiguous)
            if part == length:
                found = _settled(search, usable, x, states, heard)
            else:
                found = _fit(search, usable, x, states, heard, enough=STEPS.hardly)
        if found is None and usable and isinstance(stop.partial, Fit) and len(stop.partial.states) == len(usable):
            found = stop.partial
        if found is None:
            raise stop.error or OutOfTime
        found.status = found.status or stop.status
        found.history[:] = [entry | stage for entry in found.history]
        x, known = found.x, {window.t[0]: state for window, state in zip(usable, found.states, strict=True)}
        left_out = dropped + len(windows) - len(usable)
        settings = {"window": part, "windows": len(usable), "left_out": left_out, "decimation": step}
        yield Fitted(found, usable, settings)


def _try_other_starts(search: _Search, done: list[Fitted], length: float) -> None:
    """Put better fits from other starts in place of the last one, as long as it is bad.

    Starts are the guess, what shorter windows came to and, where shapes look alike, x scattered about the guess. States
    are fitted to each start first, window after window, so that no start is lost by a bad guess of states.
    """
    best, rng = done[-1], np.random.default_rng(0)
    guess = search.plant.parameters.start
    factors = np.exp(rng.uniform(-SEARCH.spread, SEARCH.spread, (SEARCH.scattered * search.ambiguous, guess.size)))
    scattered = [search.plant.parameters.scaled(guess, each) for each in factors]
    starts = [guess, *(each.fit.x for each in done[:-1]), *scattered]
    costs = [best.fit.cost]
    for number, x in enumerate(starts):
        if not search.is_bad(best.windows, best.fit):
            break
        states = states_at(search, best.windows, x, best.fit.states)
        if states is None:
            continue
        entry = {"phase": "start", "start": number, "window": length, "stage": 0, "stages": 1}
        try:
            tried = _settled(search, best.windows, x, states, with_entries(search.report, entry))
        except InvalidInput:
            continue
        costs.append(tried.cost)
        if tried.cost < best.fit.cost:
            tried.history[:], best.fit = best.fit.history, tried
    if len(costs) > 1:
        agree = sum(cost <= SEARCH.alike * best.fit.cost for cost in costs)
        best.settings |= {"starts": len(costs), "starts_agree": agree}


def _fit(search: _Search, windows: Sequence[Window], x: Array, states: list[Array], report: Report, **how: Any) -> Fit:
    return fit(search.plant, windows, x, states, loss=search.loss, budget=search.budget, report=report, **how)


def _settled(search: _Search, windows: Sequence[Window], x: Array, states: list[Array], report: Report) -> Fit:
    """Fit all windows, again from other states of those that fit badly, as long as that gains.

    Where shapes look alike, a window whose shape was taken for its mirror image would spoil x in a fit of all windows,
    and with a wrong x the mirror image may fit better: so x is fitted to the windows that fit first.
    """
    begun = x, states
    for _ in range(SEARCH.turns * search.ambiguous):
        costs = _costs(search, windows, x, states)
        least = float(np.quantile(costs, SEARCH.better_part))
        good = np.flatnonzero((costs < SEARCH.failed) & (costs <= SEARCH.amiss * least)).tolist()
        if sum(windows[k].values - windows[k].unknowns for k in good) <= x.size:
            break
        some = _fit(
            search,
            [windows[k] for k in good],
            x,
            [states[k] for k in good],
            report,
            enough=STEPS.hardly,
            rounds=SEARCH.rounds,
        )
        x, fitted = some.x, dict(zip(good, some.states, strict=True))
        states = [fitted.get(k, state) for k, state in enumerate(states)]
        costs = _costs(search, windows, x, states)
        least = float(np.quantile(costs, SEARCH.better_part))
        amiss = SEARCH.amiss * min(1.0, least)
        changed = _other_states(
            search,
            windows,
            x,
            states,
            np.flatnonzero(costs > amiss).tolist(),
            good=amiss,
            thorough=least < SEARCH.amiss,
        )
        if not changed:
            break
        states = [changed.get(k, state) for k, state in enumerate(states)]
    try:
        best = _fit(search, windows, x, states, report)
    except InvalidInput:
        best = _fit(search, windows, *begun, report)
    while best.status is None:
        costs = np.array([best.loss.cost(r) / w.values for w, r in zip(windows, best.residuals, strict=True)])
        limit = float(np.median(costs))
        poor = np.flatnonzero(costs > SEARCH.worse * (min(limit, 1.0) if search.known_noise else limit)).tolist()
        changed = _other_states(search, windows, best.x, best.states, poor, loss=best.loss)
        if not changed:
            break
        states = [changed.get(k, state) for k, state in enumerate(best.states)]
        again = _fit(search, windows, best.x, states, report)
        if again.cost >= best.cost:
            break
        again.history[:0] = best.history
        best = again
    return best


def _costs(search: _Search, windows: Sequence[Window], x: Array, states: Sequence[Array]) -> Array:
    """Return what a value of each window costs (W,), in units of the noise's variance; much where a rollout fails."""
    residuals = [search.plant.residual(x, window, state) for window, state in zip(windows, states, strict=True)]
    pairs = zip(residuals, windows, strict=True)
    return np.array([SEARCH.failed if r is None else float(r @ r) / window.values for r, window in pairs])


def _other_states(
    search: _Search,
    windows: Sequence[Window],
    x: Array,
    states: Sequence[Array],
    which: Sequence[int],
    *,
    loss: Loss | None = None,
    good: float = 0.0,
    thorough: bool | None = None,
) -> dict[int, Array]:
    """Return states that cost less than the present ones, by their windows' numbers, of `which` windows."""
    known = list(states)
    changed: dict[int, Array] = {}
    for k in which:
        wide = bool(windows[k].others) if thorough is None else thorough
        state = search_state(search, windows, x, known, k, loss or search.loss, good=good, thorough=wide)
        if state is not None:
            known[k] = changed[k] = state
    return changed


def stage_lengths(length: float, usual: float, spacing: float, *, short: bool = True) -> list[float]:
    """Return window lengths, s: `short` ones, then the usual one, doubled until the required length is reached.

    Without short ones where states have several guesses: too few samples tell these apart.
    """
    lengths = [length]
    while lengths[0] > 2.0 * usual:
        lengths.insert(0, 0.5 * lengths[0])
    if short and lengths[0] / SEARCH.first >= CUT.fewest * spacing:
        lengths.insert(0, lengths[0] / SEARCH.first)
    return lengths


def _enough(plant: Plant, windows: Sequence[Window]) -> bool:
    """Whether the windows hold more values than there are unknowns."""
    return sum(window.values - window.unknowns for window in windows) > len(plant.parameters)


def _first_states(
    search: _Search, windows: list[Window], x: Array, known: dict[float, Array], *, refine: bool
) -> tuple[list[Window], list[Array]]:
    """Return the windows that can be simulated, with states fitted before or guessed from the data.

    With `refine` the states are fitted at the parameters x. Not at the guess, which would bias them if it is wrong,
    but for windows with several guesses: of these the one is kept that fits best, or the end of the window before.
    """
    plant = search.plant
    if not _enough(plant, windows):
        raise InvalidInput(
            "the recording has too few samples for this fit",
            got=f"{sum(window.values for window in windows)} values in {len(windows)} usable windows",
            allowed=f"more values than unknowns: a state in each window and {len(plant.parameters)} free parameters",
            fix="Record longer or faster, free fewer parameters, or choose another window length",
        )
    kept: list[Window] = []
    states: list[Array] = []
    for window in windows:
        search.budget.check()
        starts = [known.get(window.t[0], window.guess), *window.others]
        if window.others and kept and refine:
            starts += arrived(plant, x, kept[-1], states[-1], window)
        rounds = 30 if refine or window.others else 0
        found = fit_state(plant, x, window, *starts, loss=search.loss, rounds=rounds, enough=STEPS.hardly)
        if found is not None:
            kept.append(window)
            states.append(found[0])
    if not kept:
        raise IdentificationError(
            "Not one window can be simulated with the guess. Check lengths, masses, gravity and units, or give shorter "
            "windows (window=...)."
        )
    return kept, states


def search_state(
    search: _Search,
    windows: Sequence[Window],
    x: Array,
    states: Sequence[Array],
    k: int,
    loss: Loss,
    *,
    good: float = 0.0,
    thorough: bool = False,
) -> Array | None:
    """Return a state of window k that costs less than the present one does, or None.

    `thorough`: states are fitted to its last samples as well, beginning with the window after, and to its first
    samples, then to more and more of it. That is worth its time where x is about right. A state of which a value costs
    no more than `good` ends the search.
    """
    plant, window = search.plant, windows[k]
    before = plant.residual(x, window, states[k])
    least = np.inf if before is None else SEARCH.better * (loss.cost(before) + window.prior_cost(states[k]))
    best: Array | None = None
    for starts in _starts(plant, windows, x, states, k, loss, thorough=thorough):
        search.budget.check()
        found = fit_state(plant, x, window, *starts, loss=loss, enough=STEPS.hardly)
        if found is not None and (cost := loss.cost(found[1]) + window.prior_cost(found[0])) < least:
            best, least = found[0], cost
            if cost <= good * window.values:
                break
    return best


def _starts(
    plant: Plant, windows: Sequence[Window], x: Array, states: Sequence[Array], k: int, loss: Loss, *, thorough: bool
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
        seen = _part(window, slice(0, max(CUT.fewest, int(part * window.t.size))))
        grown: list[Array] = []
        for state in states:
            found = fit_state(plant, x, seen, state, loss=loss, rounds=SEARCH.short, enough=STEPS.hardly)
            end = state if found is None else found[0]
            if all(np.abs(end - other).max() > SEARCH.same_state for other in grown):
                grown.append(end)
        states = grown
    return states


def _from_behind(plant: Plant, x: Array, window: Window, after: Window, state: Array, loss: Loss) -> list[Array]:
    """Return the state (2n,) of a window from the beginning of the one after, back in time and fitted on the way."""
    end, n = float(after.t[0]), state.size // 2
    for part in (*(1.0 - each for each in GROWING[1:]), 0.0):
        first = int(part * window.t.size)
        mirrored = plant.propagate(x, 0.0, np.append(state[:n], -state[n:]), end - float(window.t[first]))
        if mirrored is None:  # backwards friction would push; forwards, with all rates reversed, it is about right
            return []
        state = nearest_turn(np.append(mirrored[:n], -mirrored[n:]), window.guess)
        found = fit_state(
            plant, x, _part(window, slice(first, None)), state, loss=loss, rounds=SEARCH.short, enough=STEPS.hardly
        )
        state, end = state if found is None else found[0], float(window.t[first])
    return [state]


def states_at(search: _Search, windows: Sequence[Window], x: Array, states: Sequence[Array]) -> list[Array] | None:
    """Return each window's state of least cost at x, from several starts, or None where a window has none."""
    found = list(states)
    for k, window in enumerate(windows):
        search.budget.check()
        starts = restart_states(search.plant, windows, x, found, k)
        best = fit_state(search.plant, x, window, *starts, loss=search.loss)
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


def search_delay(plant: Plant, measured: Measurements, length: float, loss: Loss) -> float:
    """Return the delay, s, that a fit starts from: of least cost on a grid within `length` (s), or 0.0 if hardly less.

    A grid, since the cost has a minimum for each swing. `plant` is without torque, its delay free.
    """
    windows = measured.windows(length, decimation_step(measured.channels, length))[0]
    windows = windows[:: -(-len(windows) // SEARCH.delay_windows)] if windows else []
    states = [window.guess for window in windows]

    def cost(delay: float) -> float:
        x, total = with_delay(plant, delay).parameters.start, 0.0
        for window, state in zip(windows, states, strict=True):
            found = fit_state(plant, x, window, state, loss=loss, rounds=SEARCH.delay_rounds)
            if found is None:
                return np.inf
            total += float(np.minimum(found[1] ** 2, 9.0 * np.median(found[1] ** 2)).sum())  # outliers count little
        return total

    delays = length / SEARCH.delay_steps * np.arange(-SEARCH.delay_steps, SEARCH.delay_steps + 1)
    best = min(delays.tolist(), key=cost)
    return best if cost(best) < SEARCH.clearly * cost(0.0) else 0.0


def with_delay(plant: Plant, delay: float) -> Plant:
    """Return the model with its delay starting from `delay`, s."""
    every = [replace(each, start=delay) if each.name == "delay" else each for each in plant.parameters.all]
    return plant.with_parameters(Parameters(plant.parameters.guess, every))
