"""From short windows to long ones: short ones forgive a poor guess, long ones tell the most."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import Fit, Report, fit, fit_state
from hyperflex.identification.fit.restarts import restarted
from hyperflex.identification.fit.windows import FEWEST, Window, cut, thin
from hyperflex.identification.model.plant import Plant
from hyperflex.recording import Recording

FIRST = 8  # windows so many times shorter come first
HARDLY = 1e-2  # gain of a round, as a part of the cost, that ends a stage before the last
STAGE_WINDOWS = 40  # of the short ones, spread over the recording


@dataclass(frozen=True)
class Measured:
    """What is fitted: channels, the angles that they show, and what is believed of a state (see Window)."""

    channels: Recording
    shape: Recording
    believed: Array | None = None

    def windows(self, length: float, step: int = 1) -> tuple[list[Window], int]:
        """Return windows of so many seconds with every `step`-th sample, and how many were left out."""
        return cut(self.channels.decimate(step), length, self.shape.decimate(step), self.believed)

    def between(self, start: float, end: float) -> Measured:
        """Return the samples with ``start <= t < end``, s."""
        return replace(self, channels=self.channels.window(start, end), shape=self.shape.window(start, end))


Done = tuple[Fit, list[Window], dict[str, Any]]


def fit_in_stages(
    plant: Plant, measured: Measured, length: float, usual: float, report: Report, loss: Loss | None = None
) -> Done:
    """Fit shorter windows first, then those of the wanted length; return the last fit, its windows and settings.

    Ctrl-C returns what stands, marked ``interrupted``; before the first stage has fitted anything it passes through.
    """
    spacing = float(np.median(np.diff(measured.channels.t)))
    x, history = plant.parameters.start, []
    done: list[Done] = []
    lengths = stage_lengths(length, usual, spacing)
    for number, part in enumerate(lengths):
        step = thin(measured.channels, part)
        windows, dropped = measured.windows(part, step)
        if part < length:
            windows = windows[:: max(1, len(windows) // STAGE_WINDOWS)]
            if not _enough(plant, windows):
                continue
        stage = {"window": part, "stage": number, "stages": len(lengths)}
        try:
            known = {} if not done else {w.t[0]: s for w, s in zip(done[-1][1], done[-1][0].states, strict=True)}
            usable, states = _starts(plant, windows, x, known, loss, refine=bool(done))
            enough = None if part == length else HARDLY
            heard = _with_stage(report, stage)
            found = fit(plant, usable, x, states, loss=loss, enough=enough, report=heard)
            if part == length and not found.interrupted:
                found = restarted(plant, usable, found, known_noise=measured.channels.noise is not None, report=heard)
        except KeyboardInterrupt:
            if not done:
                raise
            done[-1][0].interrupted = True
            break
        history += [entry | stage for entry in found.history]
        left_out = dropped + len(windows) - len(usable)
        settings = {"window": part, "windows": len(usable), "left_out": left_out, "decimation": step}
        done.append((found, usable, settings))
        x = found.x
        if found.interrupted:
            break
    done[-1][0].history[:] = history
    return done[-1]


def stage_lengths(length: float, usual: float, spacing: float) -> list[float]:
    """Return window lengths, s: short ones, then the usual one, doubled until the wanted length is reached."""
    lengths = [length]
    while lengths[0] > 2.0 * usual:
        lengths.insert(0, 0.5 * lengths[0])
    if lengths[0] / FIRST >= FEWEST * spacing:
        lengths.insert(0, lengths[0] / FIRST)
    return lengths


def _enough(plant: Plant, windows: list[Window]) -> bool:
    """Tell whether the windows hold more values than there are unknowns."""
    spare: int = sum(window.values + window.believed.shape[0] - window.guess.size for window in windows)
    return spare > len(plant.parameters)


def _with_stage(report: Report, stage: dict[str, float]) -> Report:
    return lambda entry: report(entry | stage)


def _starts(
    plant: Plant, windows: list[Window], x: Array, known: dict[float, Array], loss: Loss | None, *, refine: bool
) -> tuple[list[Window], list[Array]]:
    """Return the windows that can be simulated, with states fitted before or as the data show them.

    With `refine` the states are fitted at the parameters x. Not at the guess: a wrong guess would bend them its way.
    """
    if not _enough(plant, windows):
        raise InvalidInput(
            "the recording has too few samples for this fit",
            got=f"{sum(window.values for window in windows)} values in {len(windows)} usable windows",
            allowed=f"more values than unknowns: a state in each window and {len(plant.parameters)} free parameters",
            fix="Record longer or faster, free fewer parameters, or choose another window length",
        )
    kept, states = [], []
    for window in windows:
        start = known.get(window.t[0], window.guess)
        found = fit_state(plant, x, window, start, loss=loss, rounds=30 if refine else 0)
        if found is not None:
            kept.append(window)
            states.append(found[0])
    if not kept:
        raise IdentificationError(
            "Not one window can be simulated with the guess. Check lengths, masses, gravity and units, or give shorter "
            "windows (window=...)."
        )
    return kept, states
