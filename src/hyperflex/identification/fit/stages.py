"""Stages of a fit: delay search, and short windows before long ones."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import memory
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, Interrupted, InvalidInput
from hyperflex.identification.fit.alternating import fit_alternating
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import HARDLY, Fit, Report, fit, fit_state, with_entries
from hyperflex.identification.fit.restarts import fit_from_starts, refit_poor_windows
from hyperflex.identification.fit.state_search import arrived
from hyperflex.identification.fit.windows import FEWEST, Window, cut_windows, decimation_step
from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.plant import Plant
from hyperflex.interruption import catch_interrupt
from hyperflex.recording import Recording

FIRST = 8  # windows so many times shorter come first
STAGE_WINDOWS = 40  # of the short ones, spread over the recording
DELAY_STEPS = 16  # of the grid on either side of 0, over a window's length
DELAY_WINDOWS = 4  # that are looked at
DELAY_ROUNDS = 2  # of fitting their states
COPIES = 4  # of the derivatives of all values that stand in the memory at once
CLEARLY = 0.8  # part of the cost without delay that another must come below


@dataclass(frozen=True)
class Measurements:
    """What is fitted: channels, the angles that they show, and the prior of a state (see Window).

    assumed: the channels' noise was not declared, but taken to be of a usual size. sides: other angles that would show
    as the same channels.
    """

    channels: Recording
    shape: Recording
    prior: Array | None = None
    assumed: bool = False
    sides: tuple[Recording, ...] = ()

    def windows(self, length: float, step: int = 1) -> tuple[list[Window], int]:
        """Return windows of so many seconds with every `step`-th sample, and how many were left out."""
        sides = [each.decimate(step).data for each in self.sides]
        return cut_windows(self.channels.decimate(step), length, self.shape.decimate(step), self.prior, sides)

    def between(self, start: float, end: float) -> "Measurements":
        """Return the samples with ``start <= t < end``, s."""
        sides = tuple(each.window(start, end) for each in self.sides)
        return replace(
            self, channels=self.channels.window(start, end), shape=self.shape.window(start, end), sides=sides
        )


Done = tuple[Fit, list[Window], dict[str, Any]]


def check_memory(plant: Plant, measured: Measurements, length: float) -> None:
    """Refuse, before the work, more derivatives of windows of `length`, s, than there is memory for."""
    channels, links, count = measured.channels, plant.parameters.guess.n_links, len(plant.parameters)
    values = channels.data.size // decimation_step(channels, length)
    memory.check(
        8.0 * COPIES * values * (2 * links + count),
        f"a fit of {count} parameters of {links} links to {values} values",
        "Free fewer parameters, or give a part of the recording",
    )


def fit_in_stages(
    plant: Plant, measured: Measurements, length: float, usual: float, report: Report, loss: Loss | None = None
) -> Done:
    """Fit shorter windows first, then those of `length` (s); return the last fit, its windows and settings.

    Ctrl-C returns the best so far, marked ``interrupted``; during the first stage it passes through.
    """
    spacing = float(np.median(np.diff(measured.channels.t)))
    x, history, tried, agree = plant.parameters.start, [], 1, 1
    done: list[Done] = []
    seen = measured.windows(length, decimation_step(measured.channels, length))[0] if measured.sides else []
    ambiguous = any(window.others for window in seen)
    lengths = stage_lengths(length, usual, spacing, short=not ambiguous)
    for number, part in enumerate(lengths):
        step = decimation_step(measured.channels, part)
        windows, dropped = measured.windows(part, step)
        if part < length:
            windows = windows[:: max(1, len(windows) // STAGE_WINDOWS)]
            if not _enough(plant, windows):
                continue
        stage = {"window": part, "stage": number, "stages": len(lengths)}
        usable: list[Window] = []
        found: Fit | None = None
        with catch_interrupt() as stop:
            known = {} if not done else {w.t[0]: s for w, s in zip(done[-1][1], done[-1][0].states, strict=True)}
            usable, states = _starts(plant, windows, x, known, loss, refine=bool(done) or ambiguous)
            heard = with_entries(report, stage)
            if ambiguous:
                begun = fit_alternating(plant, usable, x, states, loss or Loss(), heard)
                x, states = begun.x, begun.states
            enough = None if part == length else HARDLY
            found = fit(plant, usable, x, states, loss=loss, enough=enough, report=heard)
            if part == length:
                known_noise = measured.channels.noise is not None
                declared = known_noise and not measured.assumed  # else all windows may seem poor
                found = refit_poor_windows(plant, usable, found, known_noise=declared, report=heard)
                starts = [plant.parameters.start, *(each.x for each, _, _ in done)]
                found, tried, agree = fit_from_starts(
                    plant, usable, found, starts, known_noise=known_noise, report=heard
                )
        if found is None and usable:
            found = stop.partial
        if found is not None:
            history += [entry | stage for entry in found.history]
            left_out = dropped + len(windows) - len(usable)
            settings = {"window": part, "windows": len(usable), "left_out": left_out, "decimation": step}
            if part == length and tried > 1:
                settings |= {"starts": tried, "starts_agree": agree}
            done.append((found, usable, settings))
            x = found.x
        if stop.received:
            if not done:
                raise Interrupted
            done[-1][0].interrupted = True
            break
    done[-1][0].history[:] = history
    return done[-1]


def stage_lengths(length: float, usual: float, spacing: float, *, short: bool = True) -> list[float]:
    """Return window lengths, s: `short` ones, then the usual one, doubled until the length asked for is reached.

    Without short ones where states have several guesses: too few samples tell these apart.
    """
    lengths = [length]
    while lengths[0] > 2.0 * usual:
        lengths.insert(0, 0.5 * lengths[0])
    if short and lengths[0] / FIRST >= FEWEST * spacing:
        lengths.insert(0, lengths[0] / FIRST)
    return lengths


def _enough(plant: Plant, windows: list[Window]) -> bool:
    """Tell whether the windows hold more values than there are unknowns."""
    return sum(window.values - window.unknowns for window in windows) > len(plant.parameters)


def _starts(
    plant: Plant, windows: list[Window], x: Array, known: dict[float, Array], loss: Loss | None, *, refine: bool
) -> tuple[list[Window], list[Array]]:
    """Return the windows that can be simulated, with states fitted before or guessed from the data.

    With `refine` the states are fitted at the parameters x. Not at the guess, which would bias them if it is wrong,
    but for windows with several guesses: of these the one is kept that fits best, or the end of the window before.
    """
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
        starts = [known.get(window.t[0], window.guess), *window.others]
        if window.others and kept and refine:
            starts += arrived(plant, x, kept[-1], states[-1], window)
        rounds = 30 if refine or window.others else 0
        found = fit_state(plant, x, window, *starts, loss=loss, rounds=rounds, enough=HARDLY)
        if found is not None:
            kept.append(window)
            states.append(found[0])
    if not kept:
        raise IdentificationError(
            "Not one window can be simulated with the guess. Check lengths, masses, gravity and units, or give shorter "
            "windows (window=...)."
        )
    return kept, states


def search_delay(plant: Plant, measured: Measurements, length: float, loss: Loss) -> float:
    """Return the delay, s, that a fit starts from: of least cost on a grid within `length` (s), or 0.0 if hardly less.

    A grid, since the cost has a minimum for each swing. `plant` is without torque, its delay free.
    """
    windows = measured.windows(length, decimation_step(measured.channels, length))[0]
    windows = windows[:: -(-len(windows) // DELAY_WINDOWS)] if windows else []
    x, states = plant.parameters.start, [window.guess for window in windows]
    least = begin = _delay_cost(plant, x, windows, states, loss)
    best = 0.0
    for delay in length / DELAY_STEPS * np.arange(-DELAY_STEPS, DELAY_STEPS + 1):
        cost = _delay_cost(plant, with_delay(plant, delay).parameters.start, windows, states, loss)
        if cost < least:
            least, best = cost, float(delay)
    return best if least < CLEARLY * begin else 0.0


def with_delay(plant: Plant, delay: float) -> Plant:
    """Return the model with its delay starting from `delay`, s."""
    every = [replace(each, start=delay) if each.name == "delay" else each for each in plant.parameters.all]
    parameters = Parameters(plant.parameters.guess, every)
    torque = plant.motor is not None
    return Plant(parameters, plant.sensor, plant.motion, plant.arm, torque=torque)


def _delay_cost(plant: Plant, x: Array, windows: list[Window], states: list[Array], loss: Loss) -> float:
    """Return the cost of windows at x with states fitted to them; inf where one cannot be simulated."""
    total = 0.0
    for window, state in zip(windows, states, strict=True):
        found = fit_state(plant, x, window, state, loss=loss, rounds=DELAY_ROUNDS)
        if found is None:
            return np.inf
        total += float(np.minimum(found[1] ** 2, 9.0 * np.median(found[1] ** 2)).sum())  # outliers count little
    return total
