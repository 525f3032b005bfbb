"""The identification experiment (paper section III): its twin, and what Tables I, II and Figs. 3, 5, 6 are made of.

The paper does not describe its identification rope. Length, mass and number of links are inferred from its figures, J
and eta are what it found. Its errors are read so: E of (7) is the sum of squares over samples and links, and a noise of
0.01 rad makes it 0.04 rad^2 for 81 samples of 5 links, as in Fig. 6; Tables I and II, whose unit is lost, then hold
sqrt(E / 81) in 0.01 rad, for 2.23 there is 0.0403 rad^2. With this reading a swing of 0.15 rad gives all errors of both
tables within 15 %, so that is what the paper's swing is taken for; a wide one of 1 rad is there beside it, for J can be
told from zero only there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import (
    InitialState,
    IterativeRevision,
    RevisionProfile,
    cylinder_inertia,
    estimate_initial_state,
    iterative_revision,
    natural_frequency_inertia,
    squared_error,
    swing_period,
)
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import angles, simulate

LENGTH, LINK_MASS, LINKS = 1.0, 1.53e-3, 5  # m, kg; inferred
INERTIA, FRICTION = 0.143e-6, 0.631e-3  # kg m^2 of a link, N m s/rad of a joint: what the paper found
GUESSED_FRICTION = 1.26e-3  # N m s/rad, the paper's first one; the first inertia is the cylinder's
RATE, POINTS, FEW = 7.5, 81, 22  # frames a second; samples; samples of the first 3 s
NOISE = 0.01  # rad, root mean square over all samples of a recording
FINE = 40  # links of the finer chain
SEED = 2007
COUNTS = (12, 17, 22, 27, 32, 41, 51, 61, 81)  # samples used, Fig. 6


@dataclass(frozen=True)
class Swing:
    """One recording of the twin.

    Attributes
    ----------
    angle : float
        The rope is held straight at this angle, rad, and let go at t = 0.
    links : int
        Links of the chain that makes the data: 5, the fitted model itself, or 40.
    """

    angle: float
    links: int = LINKS

    @property
    def title(self) -> str:
        """The recording in words."""
        return f"swing of {self.angle:g} rad, data from {self.links} links"

    @property
    def key(self) -> str:
        """A short name for file columns."""
        return f"{'small' if self.angle < 0.5 else 'wide'}_{self.links}"


SMALL, WIDE = Swing(0.15), Swing(1.0)
SWINGS = (SMALL, WIDE)
FINER = tuple(Swing(swing.angle, FINE) for swing in SWINGS)


def true_rope(links: int = LINKS) -> Rope:
    """Return the rope that makes the data.

    Parameters
    ----------
    links : int
        5: with the paper's J and eta. A multiple of it: the same rope cut finer, as a thin cylinder, with the friction
        in each joint that bends alike (joint friction times link length is the same) and the same first joint.
    """
    rope = Rope.uniform(LENGTH, LINKS * LINK_MASS, links, name=f"identification twin, {links} links")
    if links == LINKS:
        return rope.replace(inertia=np.full(LINKS, INERTIA), friction=np.full(LINKS, FRICTION))
    friction = np.full(links, FRICTION * links / LINKS)
    friction[0] = FRICTION
    return rope.replace(friction=friction)


def guess() -> Rope:
    """Return what the revision starts from: the cylinder's inertia and the paper's first friction."""
    rope = Rope.uniform(LENGTH, LINKS * LINK_MASS, LINKS, friction=GUESSED_FRICTION, name="identification guess")
    return rope.replace(inertia=cylinder_inertia(rope))


@cache
def record(swing: Swing, seed: int = SEED) -> Recording:
    """Simulate a swing and look at it as the paper's camera would: 81 samples at 7.5 frames a second.

    Parameters
    ----------
    swing : Swing
    seed : int
        Of the noise. It is normal, and scaled so that its root mean square in this recording is 0.01 rad exactly: E of
        the true motion is 0.0405 rad^2.

    Returns
    -------
    Recording
        Absolute angles of 5 links; of a finer chain those of the straight lines between every eighth joint.
    """
    t = np.arange(POINTS) / RATE
    run = simulate(true_rope(swing.links), duration=t[-1], t_eval=t, q0=np.full(swing.links, swing.angle), tol=1e-9)
    along = np.diff(run.joints[:, :: swing.links // LINKS], axis=1)
    q = np.unwrap(np.arctan2(along[..., 0], -along[..., 1]), axis=0)
    noise = np.random.default_rng(seed).standard_normal(q.shape)
    noise *= NOISE / np.sqrt((noise**2).mean())
    return Recording(t, q + noise, noise=NOISE, name=f"{swing.title} (simulated)", source="simulated")  # type: ignore[arg-type]


@cache
def revised(
    swing: Swing, points: int = POINTS, profile: RevisionProfile = "response", seed: int = SEED
) -> IterativeRevision:
    """Return the iterative revision on the first `points` samples of a swing; each is made once in a process.

    Parameters
    ----------
    swing : Swing
    points : int
        Samples used.
    profile : str
        See :func:`hyperflex.iterative_revision`.
    seed : int
        Of the noise.
    """
    recording = record(swing, seed)
    part = recording.window(-np.inf, (points - 0.5) / RATE)
    return iterative_revision(part, guess(), profile=profile, rounds=8 if profile == "response" else 5)


def whole_error(swing: Swing, found: IterativeRevision, seed: int = SEED) -> float:
    """Return E over all 81 samples, rad^2, of a revision that may have used fewer."""
    state = np.append(found.best.q, found.best.qd)
    return squared_error(record(swing, seed), found.rope, state)


def per_sample(error: float) -> float:
    """Return sqrt(E / 81) in 0.01 rad, as Tables I and II are read."""
    return 100.0 * float(np.sqrt(error / POINTS))


@dataclass(frozen=True, eq=False)
class Method:
    """A row of Table II.

    Attributes
    ----------
    name : str
        "NF", "CM", "IR" or "IR(theta_0)".
    rope : Rope
        With the inertia of that method, and the friction of the revision.
    error : float
        E, rad^2: "IR" starts from the measured angles, the others from those that suit them best.
    state : (2 n,) float64
        Where it starts, rad and rad/s.
    """

    name: str
    rope: Rope
    error: float
    state: Array


@cache
def methods(swing: Swing) -> tuple[Method, ...]:
    """Return the rows of Table II: inertia by natural frequency, as a cylinder, and by the revision."""
    recording, found = record(swing), revised(swing)
    inertias = {
        "NF": natural_frequency_inertia(found.rope, swing_period(recording)),
        "CM": float(cylinder_inertia(guess())[0]),
    }
    rows = []
    for name, inertia in inertias.items():
        rope = found.rope.replace(inertia=np.full(LINKS, inertia))
        best: InitialState = estimate_initial_state(recording, rope)
        rows.append(Method(name, rope, best.error, np.append(best.q, best.qd)))
    measured = np.append(recording.data[0], np.zeros(LINKS))
    rows.append(Method("IR", found.rope, found.best.measured_start, measured))
    rows.append(Method("IR(theta_0)", found.rope, found.error, np.append(found.best.q, found.best.qd)))
    return tuple(rows)


def motion(rope: Rope, state: Array, t: Array) -> Array:
    """Return angles (T, n), rad, at times t, s, of a run from `state` (2 n,)."""
    return angles(rope, t, state[:LINKS], state[LINKS:])[0]
