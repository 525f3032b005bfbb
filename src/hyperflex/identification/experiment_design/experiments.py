"""Candidate experiments: motion of the arm, frame rate, duration and markers."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, arm_swings


@dataclass(frozen=True)
class DefaultExperiments:
    """The experiments that are tried by default."""

    most_frames: int = 1000000
    # rad at the first joint, and as much to the other side at the tip
    bent: float = 0.8
    # frames a second, s, and most markers of the default experiments
    rate: float = 30.0
    duration: float = 10.0
    markers: int = 11


DEFAULTS = DefaultExperiments()

ANGLES = (0.3, 0.8, 1.5)  # rad, from which a straight rope is let go
RESTS = (0.34, 0.53, 0.80)  # s, of the paper's swings: its failure, its success, and a slow one
RATES, DURATIONS, FEW = (7.5, 120.0), (5.0, 20.0), (3, 6)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A recording that could be made.

    Parameters
    ----------
    name : str
        For tables.
    motion : Motion, optional
        Of the arm, or of the first joint; by default it is fixed.
    q0, qd0 : (n,) array_like or float, optional
        Link angles, rad, and rates, rad/s, at the start (a number: of all links); by default it hangs at rest.
    rate, duration : float
        Frames a second; recorded time, s.
    markers : int, optional
        Number of markers, evenly from the first joint to the tip; None: the angle of every link is measured.
    noise : float, optional
        Standard deviation of a marker's coordinate, m, or of an angle, rad; None: that of :func:`design_experiment`.
    torque_noise : float, optional
        Standard deviation of the measured motor torque, N m; None: it is not measured.
    """

    name: str
    motion: Motion | None = None
    q0: npt.ArrayLike | None = None
    qd0: npt.ArrayLike | None = None
    rate: float = DEFAULTS.rate
    duration: float = DEFAULTS.duration
    markers: int | None = None
    noise: float | None = None
    torque_noise: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("rate", "1/s"), ("duration", "s"), ("noise", "m or rad"), ("torque_noise", "N m")):
            if getattr(self, name) is not None or name in ("rate", "duration"):
                checks.number(f"experiment {name}", getattr(self, name), sign="positive", unit=unit)
        if self.motion is not None and not isinstance(self.motion, Motion):
            raise InvalidInput("motion of an experiment is none", got=self.motion, allowed="a Motion, or None")
        if self.markers is not None:
            checks.count("experiment markers", self.markers, least=2)
        checks.text("experiment name", self.name)
        if not 2.0 <= self.rate * self.duration + 1e-9 < DEFAULTS.most_frames:
            raise InvalidInput(
                "experiment rate and duration give too few frames, or too many",
                got=[self.rate, self.duration],
                allowed=f"3 to {DEFAULTS.most_frames:g} frames",
            )

    @property
    def t(self) -> Array:
        """Times of the frames (T,), s."""
        return np.arange(int(np.floor(self.duration * self.rate + 1e-9)) + 1) / self.rate

    def start(self, rope: Rope) -> tuple[Array | None, Array | None]:
        """Return angles and rates (n,) of a `rope` at the start; None where they are not given."""
        n = rope.n_links
        q0 = None if self.q0 is None else checks.array("experiment q0", self.q0, (n,), unit="rad", scalar=True)
        qd0 = None if self.qd0 is None else checks.array("experiment qd0", self.qd0, (n,), unit="rad/s", scalar=True)
        return q0, qd0


def default_experiments(rope: Rope, arm: Arm | None) -> list[Experiment]:
    """Return the motions tried first: free swings, and with an arm the paper's."""
    n, hangs = rope.n_links, rope.hanging_angle
    markers = min(n + 1, DEFAULTS.markers)
    found = [Experiment(f"let go at {angle:g} rad", q0=hangs + angle, markers=markers) for angle in ANGLES]
    if n > 1:
        bent = hangs + np.linspace(DEFAULTS.bent, -DEFAULTS.bent, n)
        found.append(Experiment(f"let go bent, {DEFAULTS.bent:g} to {-DEFAULTS.bent:g} rad", q0=bent, markers=markers))
    if arm is not None:
        found += [Experiment(f"swings, rest {rest:g} s", arm_swings(t_rest=rest), markers=markers) for rest in RESTS]
    return found


def variations(best: Experiment) -> list[Experiment]:
    """Return an experiment at other frame rates, durations, and with fewer markers."""
    named = [replace(best, name=f"{best.name}, {rate:g} frames/s", rate=rate) for rate in RATES]
    named += [replace(best, name=f"{best.name}, {time:g} s", duration=time) for time in DURATIONS]
    most = best.markers or 0
    named += [replace(best, name=f"{best.name}, {few} markers", markers=few) for few in FEW if few < most]
    return named
