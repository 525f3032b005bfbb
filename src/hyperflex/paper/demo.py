"""The thin line from end to end: a recording in, an identified rope out, and its cast."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import Identification, identify
from hyperflex.model import Rope
from hyperflex.motion import swings
from hyperflex.paper import twin
from hyperflex.paper.casting import DURATION, T_MOVE, T_REST, casting_arm
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

Tell = Callable[[str], None]

INTERVAL = 1.96  # standard deviations to each side of a 95 % interval
SAMPLES_PER_SECOND = 200
_UNITS = {"friction": "N m s/rad", "inertia": "kg m^2"}


@dataclass(frozen=True)
class Parameter:
    """One identified number beside what is known about it.

    Attributes
    ----------
    name, unit : str
        What it is, and its SI unit.
    guess, value, sd : float
        Before, after, and the standard deviation.
    mapped : float
        What the same fit finds without noise: the truth as far as the coarse chain can hold it.
    cut : float
        That of the rope simply cut into as many links.
    """

    name: str
    unit: str
    guess: float
    value: float
    sd: float
    mapped: float
    cut: float

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval."""
        return self.value - INTERVAL * self.sd, self.value + INTERVAL * self.sd

    @property
    def covered(self) -> bool:
        """Whether the interval holds the mapped truth."""
        low, high = self.interval
        return low <= self.mapped <= high


@dataclass(frozen=True, eq=False)
class Demo:
    """What the demo found.

    Attributes
    ----------
    recording : Recording
        The bundled recording, simulated.
    identification : Identification
        Of the 10-link chain.
    parameters : tuple of Parameter
        The identified numbers with intervals and mapped truth.
    angle_noise : (n,) float64
        Standard deviation of the measured link angles, rad: the least prediction error that can be measured.
    cast : Trajectory
        The identified rope, cast by the paper's motion.
    reference : Trajectory
        The rope that made the recording, cast likewise.
    """

    recording: Recording
    identification: Identification
    parameters: tuple[Parameter, ...]
    angle_noise: Array
    cast: Trajectory
    reference: Trajectory


def run_demo(tell: Tell = lambda _: None) -> Demo:
    """Identify the bundled recording's rope and cast it.

    Parameters
    ----------
    tell : callable
        Told in words what is being done.

    Returns
    -------
    Demo
    """
    tell("reading the recording")
    recording, guess = twin.bundled(), twin.guess()

    def report(entry: dict[str, float]) -> None:
        tell(f"identifying, windows of {entry['window']:.2g} s, round {entry['round'] + 1:.0f}")

    found = identify(recording, guess, twin.FREE, train=twin.TRAIN, window=twin.WINDOW, progress=report)
    if found.status == "interrupted":  # identify hands back the best so far; a demo of half a fit would mislead
        raise KeyboardInterrupt
    mapped, cut = twin.mapped_truth(), twin.coarse_rope()
    parameters = tuple(
        Parameter(
            name,
            _UNITS[name],
            float(getattr(guess, name)[0]),
            float(found.values[name][0]),
            float(found.sd[name][0]),
            mapped[name],
            float(getattr(cut, name)[0]),
        )
        for name in found.values
    )
    tell("casting the identified rope")
    noise = recording.angles().noise
    scale = np.full(recording.n_links, np.nan) if noise is None else np.median(noise, axis=0)
    return Demo(recording, found, parameters, scale, _cast(found.rope), _cast(twin.fine_rope()))


def _cast(rope: Rope) -> Trajectory:
    """Cast a rope by the paper's successful motion through the bottom."""
    motion = swings(T_MOVE, T_REST["success"])
    t = np.linspace(0.0, DURATION, round(DURATION * SAMPLES_PER_SECOND) + 1)
    return simulate(rope, motion, arm=casting_arm(), duration=DURATION, t_eval=t)
