"""From short windows to long ones: short ones forgive a poor guess, long ones tell the most."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.identification._parameters import Parameters
from hyperflex.identification._shooting import Fit, Plant, Report, fit, fit_state
from hyperflex.identification._windows import FEWEST, Window, cut, first_state, thin
from hyperflex.recording import Recording

STAGES = (8,)  # windows this many times shorter come first
STAGE_WINDOWS = 40  # of the short ones, spread over the recording


Done = tuple[Fit, list[Window], dict[str, Any]]


def fit_in_stages(plant: Plant, parameters: Parameters, recording: Recording, length: float, report: Report) -> Done:
    """Fit shorter windows first, then those of the wanted length; return the last fit, its windows and settings.

    Ctrl-C returns what stands, marked ``interrupted``; before the first stage has fitted anything it passes through.
    """
    spacing = float(np.median(np.diff(recording.t)))
    x, history = parameters.start, []
    done: list[Done] = []
    for shorter in [*(s for s in STAGES if length / s >= FEWEST * spacing), 1]:
        part = length / shorter
        step = thin(recording, part)
        thinned = recording.decimate(step)
        windows, dropped = cut(thinned, part, thinned.noise)
        if shorter > 1:
            windows = windows[:: max(1, len(windows) // STAGE_WINDOWS)]
            if not _enough(parameters, windows):
                continue
        try:
            usable, states = _starts(plant, parameters, windows, x, refine=bool(done))
            found = fit(plant, parameters, usable, x, states, report=_with_window(report, part))
        except KeyboardInterrupt:
            if not done:
                raise
            done[-1][0].interrupted = True
            break
        history += [entry | {"window": part} for entry in found.history]
        left_out = dropped + len(windows) - len(usable)
        settings = {"window": part, "windows": len(usable), "left_out": left_out, "decimation": step}
        done.append((found, usable, settings))
        x = found.x
        if found.interrupted:
            break
    done[-1][0].history[:] = history
    return done[-1]


def _enough(parameters: Parameters, windows: list[Window]) -> bool:
    """Tell whether the windows hold more values than there are unknowns."""
    spare: int = sum(window.values - 2 * window.y.shape[1] for window in windows)
    return spare > len(parameters)


def _with_window(report: Report, part: float) -> Report:
    return lambda entry: report(entry | {"window": part})


def _starts(
    plant: Plant, parameters: Parameters, windows: list[Window], x: Array, *, refine: bool
) -> tuple[list[Window], list[Array]]:
    """Return the windows that can be simulated, with their states as the data show them.

    With `refine` the states are fitted at the parameters x. Not at the guess: a wrong guess would bend them its way.
    """
    if not _enough(parameters, windows):
        raise InvalidInput(
            "the recording has too few samples for this fit",
            got=f"{sum(window.values for window in windows)} values in {len(windows)} usable windows",
            allowed=f"more values than unknowns: a state in each window and {len(parameters)} free parameters",
            fix="Record longer or faster, free fewer parameters, or choose another window length",
        )
    rope = parameters.rope(x)
    kept, states = [], []
    for window in windows:
        found = fit_state(plant, rope, window, first_state(window), rounds=30 if refine else 0)
        if found is not None:
            kept.append(window)
            states.append(found[0])
    if not kept:
        raise IdentificationError(
            "Not one window can be simulated with the guess. Check lengths, masses, gravity and units, or give shorter "
            "windows (window=...)."
        )
    return kept, states
