"""The fit: multiple shooting from several starts, each over windows from short to long.

A start is a guess x of the parameters. Windows that fit badly may have begun in another state than was guessed:
outliers and gaps spoil guesses, a sticking joint has no gradient, and with few markers a shape looks like its mirror
image. So the states of windows that fit badly are searched from several starts, where shapes look alike in turn with
fits of the parameters to the windows that fit.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hyperflex import memory
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, Interrupted, InvalidInput
from hyperflex.identification.declarations.held import FEW_LINKS
from hyperflex.identification.fit import (
    HARDLY,
    POOR,
    Fit,
    Linear,
    Loss,
    Report,
    Window,
    fit,
    fit_state,
    linearise,
    part_left,
    with_entries,
)
from hyperflex.identification.measurements import FEWEST_SAMPLES, Measurements
from hyperflex.identification.model import Plant
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.model import Rope

# windows so many times shorter come first; how many windows, spread over the recording
FIRST = 8
FIRST_WINDOWS = 40
# times what a value of the middle window costs, or of known noise: worth another state, or start
WORSE = 2.0
# times at most that parameters and states take turns; a rope that is seen at its tip needed four
TURNS = 6
# times what a value of the better windows, or of noise, costs: a shape taken for its mirror costs 100s
AMISS = 10.0
# quantile of the windows' costs that stands for those that fit
BETTER_PART = 0.25
# rounds of fitting parameters after which states are searched
SHORT = 15
# ratio of costs within which two starts, or states of a window, have come to the same
SAME_COST = 1.05
# part of the motion that predictions of windows twice as long may err by for these to be fitted
PREDICTED = 0.3
# by which derivatives with respect to the state may grow from one half of a window to the next: 2 if errors grow with
# time, as those of a phase, some more for several links that beat, and far more where errors grow exponentially
GROWTH = 4.0
# a little more than the time from the first sample to the last, for which that is inside
WHOLE = 1.001
# of the derivatives of all values that are in memory at once
COPIES = 4


def joined_lengths(length: float, duration: float, rope: Rope) -> list[float]:
    """Return lengths of windows, s, from `length`: each about twice the one before at least, the last the `duration`.

    A rope of many links stands for a smooth one, which it is not for long: its windows are not joined.
    """
    lengths = [min(length, WHOLE * duration)]
    while rope.n_links <= FEW_LINKS and lengths[-1] < duration:
        lengths.append(WHOLE * duration / max(1, round(duration / lengths[-1]) // 2))
    return lengths


def diverges(window: Window, linear: Linear) -> bool:
    """Whether errors of a window's state grow exponentially: far more acts in its second half than in its first.

    It compares the largest derivative of all values by all states: in the first half it is not small, as at the
    beginning the derivatives dq/dq0 are 1.
    """
    size = np.abs(linear.state[: window.y.size].reshape(window.t.size, -1)).max(axis=1)
    half = window.t.size // 2
    return bool(size[half:].max(initial=0.0) > GROWTH * size[:half].max(initial=0.0))


@dataclass(frozen=True)
class MultiStart:
    """What all starts have in common.

    length: of the windows, s. usual: that which is usual for this recording (see :func:`usual_length`), and which sets
    the decimation. ambiguous: whether states have several guesses, of shapes that look alike.
    """

    plant: Plant
    measured: Measurements
    length: float
    usual: float
    loss: Loss = field(default_factory=Loss)
    budget: Budget = field(default_factory=Budget)
    report: Report = lambda entry: None

    @cached_property
    def step(self) -> int:
        """Which samples are used: the step from one to the next."""
        return self.measured.step(min(self.length, self.usual))

    @cached_property
    def ambiguous(self) -> bool:
        """Whether states have several guesses."""
        return bool(self.measured.sides) and any(window.others for window in self.windows(self.length)[0])

    def windows(self, length: float) -> tuple[list[Window], int]:
        """Return windows of `length`, s, and the number left out."""
        return self.measured.windows(length, min(self.step, self.measured.step(length)))

    def fit(self, windows: Sequence[Window], x: Array, states: list[Array], report: Report, **how: Any) -> Fit:
        """Fit all windows from one start; what Ctrl-C leaves of it has the status INTERRUPTED."""
        try:
            return fit(self.plant, windows, x, states, loss=self.loss, budget=self.budget, report=report, **how)
        except Interrupted as stop:
            found: Fit = stop.partial
            return found

    def is_bad(self, windows: Sequence[Window], found: Fit) -> bool:
        """Whether values cost twice what known noise does, or a fit leaves a large part of the motion."""
        if self.measured.channels.noise is not None:
            return found.cost - found.prior_cost > WORSE * sum(window.values for window in windows)
        return not found.converged or part_left(windows, found.residuals, found.loss) > POOR

    def fits(self) -> Iterator[Basis]:
        """Yield ever better fits: of shorter windows, of those of the length, and, if that is bad, from other starts.

        Short windows come first, but where states have several guesses, which too few samples do not tell apart. Then
        the `usual` length is doubled until the required one is reached. Only a fit of windows of `length` counts as
        converged; one that was ended early has a status, and nothing may be asked for after it.

        Raises InvalidInput, before the work, for more derivatives than there is memory for; IdentificationError, where
        no window can be simulated.
        """
        channels, x, length = self.measured.channels, self.plant.parameters.start, self.length
        links, count = self.plant.parameters.guess.n_links, x.size
        memory.check(
            8.0 * COPIES * (values := channels.data.size // self.step) * (2 * links + count),
            f"a fit of {count} parameters of {links} links to {values} values",
            "Free fewer parameters, or give a part of the recording",
        )
        lengths = [length]
        while lengths[0] > 2.0 * self.usual:
            lengths.insert(0, 0.5 * lengths[0])
        if not self.ambiguous and lengths[0] / FIRST >= FEWEST_SAMPLES * float(np.median(np.diff(channels.t))):
            lengths.insert(0, lengths[0] / FIRST)
        known: dict[float, Array] = {}
        starts, history = list[Array](), tuple[dict[str, float], ...]()
        for number, part in enumerate(lengths):
            windows, dropped = self.windows(part)
            if part < length:
                windows = windows[:: -(-len(windows) // FIRST_WINDOWS)]
                if not self._enough(windows):
                    continue
            stage = {"window": part, "stage": number, "stages": len(lengths)}
            heard = with_entries(self.report, stage)
            usable, states = self._first_states(windows, x, known, refine=number > 0 or self.ambiguous)
            settings = self.settings(part, usable, dropped + len(windows) - len(usable))
            starts.append(x)
            if part == length:
                tries = self.settled(usable, x, states, heard)
            else:
                tries = iter([self.fit(usable, x, states, heard, enough=HARDLY)])
            for found in tries:
                now = history + tuple(entry | stage for entry in found.history)
                some = replace(found, converged=found.converged and part == length, history=now)
                best = Basis.begun(self.plant, usable, some, self.usual, settings)
                yield best
            x, history = best.fit.x, now
            known = {window.t[0]: state for window, state in zip(usable, best.fit.states, strict=True)}
        yield from self.other_starts(best, starts)

    def settings(self, length: float, windows: Sequence[Window], left_out: int) -> dict[str, Any]:
        """Return what tells how windows of `length`, s, were used."""
        step = min(self.step, self.measured.step(length))
        return {"window": length, "windows": len(windows), "left_out": left_out, "decimation": step}

    def joined(self, found: Basis) -> Basis | None:
        """Fit windows of twice the length, or more, from a fit; None where they end before, or are not predicted.

        All windows are of one length, so that none remains at the end. A window is predicted if, from the state that
        the shorter one has, it leaves less than PREDICTED of the motion: farther ahead errors have grown so much that
        a fit would not find back, or the model is not right for so long.
        """
        duration, x, plant = self.measured.channels.duration, found.fit.x, found.plant
        _, *longer = joined_lengths(found.settings["window"], duration, plant.parameters.guess)
        if not longer:
            return None
        windows, dropped = self.windows(longer[0])
        states, residuals = list[Array](), list[Array]()
        for window in windows:
            earlier = [k for k, each in enumerate(found.windows) if each.t[0] <= window.t[0]][-1:]
            came = [s for k in earlier for s in arrived(plant, x, found.windows[k], found.fit.states[k], window)]
            states += came or [window.guess]
            residual = window.residual(plant, x, states[-1])
            if residual is None:
                return None
            residuals.append(residual)
        if not windows or part_left(windows, residuals, found.fit.loss) > PREDICTED:
            return None
        for window, state, residual in zip(windows, states, residuals, strict=True):
            if diverges(window, linearise(plant, window, x, state, residual, Loss())):
                return None
        settings = found.settings | self.settings(longer[0], windows, dropped)
        return self.continued(replace(found, settings=settings), windows, x, states)

    def continued(self, found: Basis, windows: list[Window], x: Array, states: list[Array]) -> Basis:
        """Return a fit of these windows from x and states, which continues the history of another.

        Raises Interrupted or OutOfTime if it was ended early: what it continues is worth more.
        """
        stage = {"window": found.settings["window"], "stage": 0, "stages": 1}
        heard = with_entries(self.report, stage)
        now = fit(found.plant, windows, x, states, loss=self.loss, budget=self.budget, report=heard)
        self.budget.check()
        now = replace(now, history=found.fit.history + tuple(entry | stage for entry in now.history))
        return Basis.begun(found.plant, windows, now, self.usual, found.settings)

    def other_starts(self, best: Basis, starts: Sequence[Array]) -> Iterator[Basis]:
        """Yield the best fit so far from each of other `starts`, as long as it is bad.

        With the states of the best fit, which have followed the data.
        """
        costs, length = [best.fit.cost], best.settings["window"]
        for number, x in enumerate(starts):
            if not self.is_bad(best.windows, best.fit):
                break
            entry: dict[str, Any] = {"phase": "start", "start": number, "window": length, "stage": 0, "stages": 1}
            before = best.fit
            with suppress(InvalidInput):
                for tried in self.settled(best.windows, x, list(before.states), with_entries(self.report, entry)):
                    found = replace(before, status=tried.status)
                    if tried.cost < before.cost:
                        found = replace(tried, history=before.history + tuple(each | entry for each in tried.history))
                    agree = sum(cost <= SAME_COST * found.cost for cost in (*costs, tried.cost))
                    about = {"starts": len(costs) + 1, "starts_agree": agree}
                    best = replace(best, fit=found, settings=best.settings | about)
                    yield best
                costs.append(tried.cost)

    def settled(self, windows: Sequence[Window], x: Array, states: list[Array], report: Report) -> Iterator[Fit]:
        """Yield fits of all windows, again from other states of those that fit badly, as long as that gains.

        Where shapes look alike, a window whose shape was taken for its mirror image would spoil x in a fit of all
        windows, and with a wrong x the mirror image may fit better: so x is fitted to the windows that fit first.
        """
        begun = x, states
        for _ in range(TURNS * self.ambiguous):
            values, least = self._costs(windows, x, states)
            if np.isfinite(values).all():  # what there is, of all windows
                yield self.fit(windows, x, states, report, rounds=0)
            fitting = np.flatnonzero((values <= least) & np.isfinite(values)).tolist()
            if not self._enough([windows[k] for k in fitting]):
                break
            seen, known = [windows[k] for k in fitting], [states[k] for k in fitting]
            some = self.fit(seen, x, known, report, enough=HARDLY, rounds=SHORT)
            x, states = some.x, list(states)
            for k, state in zip(fitting, some.states, strict=True):
                states[k] = state
            if some.status is not None:
                yield replace(self.fit(windows, x, states, report, rounds=0), status=some.status)
            values, least = self._costs(windows, x, states)
            amiss = _beyond(windows, states, values, min(least, AMISS))
            if not self.search_states(windows, x, states, amiss, self.loss):
                break
        try:
            best = self.fit(windows, x, states, report)
        except InvalidInput:
            best = self.fit(windows, *begun, report)
        yield best
        while True:
            loss, states = best.loss, list(best.states)
            costs = np.array(list(map(loss.cost, best.residuals))) / [window.values for window in windows]
            limit = min(float(np.median(costs)), np.inf if self.measured.channels.noise is None else 1.0)
            before = _beyond(windows, states, costs, WORSE * limit)
            if not self.search_states(windows, best.x, states, before, loss):
                return
            again = self.fit(windows, best.x, states, report)
            if again.cost >= best.cost:
                yield replace(best, status=again.status)
                return
            best = replace(again, history=best.history + again.history)
            yield best

    def _costs(self, windows: Sequence[Window], x: Array, states: list[Array]) -> tuple[Array, float]:
        """Return the mean square of each window's values (W,), inf without a rollout, and the most of one that fits."""
        residuals = [window.residual(self.plant, x, state) for window, state in zip(windows, states, strict=True)]
        values = np.array(
            [np.inf if r is None else float(r @ r) / w.values for w, r in zip(windows, residuals, strict=True)]
        )
        return values, AMISS * float(np.sort(values)[int(BETTER_PART * len(values))])

    def search_states(
        self, windows: Sequence[Window], x: Array, states: list[Array], before: dict[int, float], loss: Loss
    ) -> set[int]:
        """Put states that cost clearly less in place of those of windows, given by number with their costs `before`.

        Return the numbers of those found.
        """
        found: set[int] = set()
        for k, least in before.items():
            self.budget.check()
            starts, window = restart_states(self.plant, windows, x, states, k), windows[k]
            best = fit_state(self.plant, x, window, *starts, loss=loss, enough=HARDLY)
            if best is not None and loss.cost(best[1]) + window.prior_cost(best[0]) < least / SAME_COST:
                states[k] = best[0]
                found.add(k)
        return found

    def _enough(self, windows: Sequence[Window]) -> bool:
        return sum(window.values - window.unknowns for window in windows) > len(self.plant.parameters)

    def _first_states(
        self, windows: Sequence[Window], x: Array, known: dict[float, Array], *, refine: bool
    ) -> tuple[list[Window], list[Array]]:
        """Return the windows that can be simulated, and their states fitted before or guessed from the data.

        With `refine` the states are fitted at the parameters x. Not at the guess, which would bias them if it is wrong,
        but for windows with several guesses, of which the one is kept that fits best.
        """
        if not self._enough(windows):
            values, free = sum(window.values for window in windows), len(self.plant.parameters)
            raise InvalidInput(
                "the recording has too few samples for this fit",
                got=f"{values} values in {len(windows)} usable windows",
                allowed=f"more values than unknowns: a state in each window and {free} free parameters",
                fix="Record longer or faster, free fewer parameters, or choose another window length",
            )
        kept: list[Window] = []
        states: list[Array] = []
        for window in windows:
            self.budget.check()
            # where samples were merged a window begins less than a step later than one of samples
            at = min(known, key=lambda t: abs(t - window.t[0]), default=np.inf)
            near = abs(at - window.t[0]) < window.t[1] - window.t[0]
            starts = [known[at] if near else window.guess, *window.others]
            rounds = 30 if refine or window.others else 0
            found = fit_state(self.plant, x, window, *starts, loss=self.loss, rounds=rounds, enough=HARDLY)
            if found is not None:
                kept.append(window)
                states.append(found[0])
        if not kept:
            raise IdentificationError(
                "Not one window can be simulated with the guess. Check lengths, masses, gravity and units, or give "
                "shorter windows (window=...)."
            )
        return kept, states


def _beyond(windows: Sequence[Window], states: Sequence[Array], values: Array, limit: float) -> dict[int, float]:
    """Return what windows cost of which a value (W,) costs more than `limit`, by number."""
    which = np.flatnonzero(values > limit).tolist()
    return {k: values[k] * windows[k].values + windows[k].prior_cost(states[k]) for k in which}


def restart_states(
    plant: Plant, windows: Sequence[Window], x: Array, states: Sequence[Array], k: int
) -> Iterator[Array]:
    """Yield states to start window k from: the end of the window before, and those of the data."""
    if k > 0:
        yield from arrived(plant, x, windows[k - 1], states[k - 1], windows[k])
    yield from (windows[k].guess, *windows[k].others)


def arrived(plant: Plant, x: Array, before: Window, state: Array, window: Window) -> list[Array]:
    """Return the state (2n,) in which a window begins if the one before began in `state`, or nothing."""
    end, n = plant.propagate(x, float(before.t[0]), state, float(window.t[0])), state.size // 2
    if end is None:
        return []
    end[:n] += (
        2.0 * np.pi * np.round((window.guess - end)[:n] / (2.0 * np.pi))
    )  # whole turns, to come near to the guess
    return [end]


def search_delay(
    plant: Plant, measured: Measurements, length: float, loss: Loss, budget: Budget, *, steps: int = 16, most: int = 4
) -> float:
    """Return the delay, s, that a fit starts from: of least cost on a grid within `length` (s), or 0.0 if hardly less.

    A grid, of `steps` on either side of 0, since the cost has a minimum for each swing: summed over `most` windows,
    whose states take two rounds. It must fall by a fifth. `plant` is without torque, its delay free.
    """
    windows, _ = measured.windows(length)
    windows = windows[:: -(-len(windows) // most)] if windows else []

    def cost(delay: float) -> float:
        budget.check()
        x, total = with_delay(plant, delay).parameters.start, 0.0
        for window in windows:
            found = fit_state(plant, x, window, window.guess, loss=loss, rounds=2)
            if found is None:
                return np.inf
            total += loss.scaled([found[1]]).cost(found[1])
        return total

    delays = length / steps * np.arange(-steps, steps + 1)
    best = min(delays.tolist(), key=cost)
    return best if cost(best) < 0.8 * cost(0.0) else 0.0


def with_delay(plant: Plant, delay: float) -> Plant:
    """Return the model with its delay starting from `delay`, s."""
    return replace(plant, parameters=plant.parameters.starting({"delay": delay}))
