"""Where to look for the delay between camera and motion: a coarse grid, since each swing has a minimum of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import fit_state
from hyperflex.identification.fit.stages import Measured
from hyperflex.identification.fit.windows import Window, thin
from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.plant import Plant

STEPS = 16  # of the grid on either side of 0, over a window's length
WINDOWS = 4  # that are looked at
ROUNDS = 2  # of fitting their states
CLEARLY = 0.8  # part of the cost without delay that another must come below


def first_delay(plant: Plant, measured: Measured, length: float, loss: Loss) -> float:
    """Return the delay, s, from which a fit should start: the guess's cost is least there, or 0.0 if hardly so.

    Parameters
    ----------
    plant : Plant
        Without torque; its delay is free.
    measured : Measured
        What is fitted.
    length : float
        Of the windows that are looked at, and greatest delay that is tried on either side, s.
    loss : Loss
    """
    windows = measured.windows(length, thin(measured.channels, length))[0]
    windows = windows[:: -(-len(windows) // WINDOWS)] if windows else []
    x, states = plant.parameters.start, [window.guess for window in windows]
    least = begin = _cost(plant, x, windows, states, loss)
    best = 0.0
    for delay in length / STEPS * np.arange(-STEPS, STEPS + 1):
        cost = _cost(plant, with_delay(plant, delay).parameters.start, windows, states, loss)
        if cost < least:
            least, best = cost, float(delay)
    return best if least < CLEARLY * begin else 0.0


def with_delay(plant: Plant, delay: float) -> Plant:
    """Return the same, with a delay that starts from `delay`, s."""
    every = [replace(each, start=delay) if each.name == "delay" else each for each in plant.parameters.all]
    parameters = Parameters(plant.parameters.guess, every)
    torque = plant.motor is not None
    return Plant(parameters, plant.sensor, plant.motion, plant.arm, torque=torque)


def _cost(plant: Plant, x: Array, windows: list[Window], states: list[Array], loss: Loss) -> float:
    """Return what windows cost at x with states fitted to them; inf where one cannot be simulated."""
    total = 0.0
    for window, state in zip(windows, states, strict=True):
        found = fit_state(plant, x, window, state, loss=loss, rounds=ROUNDS)
        if found is None:
            return np.inf
        total += float(np.minimum(found[1] ** 2, 9.0 * np.median(found[1] ** 2)).sum())  # outliers count little
    return total
