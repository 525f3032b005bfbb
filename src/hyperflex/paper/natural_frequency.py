"""Baselines of the paper: inertia by natural frequency (8) and of a cylinder."""

import math
from itertools import pairwise

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.dynamics import mass_matrix
from hyperflex.errors import InvalidInput
from hyperflex.identification import lumped
from hyperflex.model import Rope
from hyperflex.recording import Recording

SIDE = 0.1  # part of the greatest angle beyond which a rope is clearly on one side


def cylinder_inertia(rope: Rope) -> Array:
    """Return the inertia of each link as a cylinder of its mass, length and radius (n,), kg m^2: CM of Table II.

    Parameters
    ----------
    rope : Rope
    """
    return rope.mass * (3.0 * rope.radius**2 + rope.length**2) / 12.0


def natural_frequency_inertia(rope: Rope, period: float) -> float:
    """Return the inertia of a link, kg m^2, from the period of the swinging rope: NF of Table II, (8).

    Parameters
    ----------
    rope : Rope
        All but its `inertia` is used.
    period : float
        T_nat, s (:func:`swing_period` of a recording, or :func:`natural_period` of a model).

    Raises
    ------
    InvalidInput
        Without gravity or mass, or where the period is too short for a positive inertia.

    Notes
    -----
    (8) is solved for J with the whole rope as one rigid rod about its centre of mass, and each link gets the n-th part:
    so the paper's figures come out within 8 % (110e-6 for the printed 102e-6 kg m^2; 83e-6 with one link's mass).
    """
    mass = rope.total_mass
    gravity = float(np.hypot(*rope.gravity))
    moment = float(lumped(rope)[0].sum())
    if gravity * moment <= 0.0:
        raise InvalidInput("a rope without weight has no natural period", got=gravity, allowed="gravity and mass")
    seconds = checks.positive("period", period, "s")
    inertia = gravity * moment * (seconds / (2.0 * np.pi)) ** 2 - moment**2 / mass
    if inertia <= 0.0:
        least = 2.0 * np.pi * float(np.sqrt(moment / mass / gravity))
        raise InvalidInput("the period is too short for (8)", got=seconds, allowed=f"more than {least:.4g} s")
    return inertia / rope.n_links


def natural_period(rope: Rope) -> float:
    """Return the longest period of small swings of a rope that hangs from a fixed point, s; friction is neglected.

    Parameters
    ----------
    rope : Rope
        Without stiffness it needs gravity.
    """
    from scipy.linalg import eigvalsh

    p, _ = lumped(rope)
    both = np.eye(rope.n_links) - np.eye(rope.n_links, k=1)
    stiffness = np.diag(p * np.hypot(*rope.gravity)) + both @ np.diag(rope.stiffness) @ both.T
    square = float(eigvalsh(stiffness, mass_matrix(rope, np.zeros(rope.n_links)))[0])
    if square <= 0.0:
        raise InvalidInput("the rope does not swing", got=square, allowed="gravity or stiffness")
    return 2.0 * np.pi / math.sqrt(square)


def swing_period(recording: Recording, link: int = -1) -> float:
    """Return the period of a measured swing, s: twice the mean time between zero crossings of one link.

    Parameters
    ----------
    recording : Recording
        Of angles, or of markers at the joints. Angles count from hanging.
    link : int
        Which link; by default the last one, as in the paper's Fig. 5.

    Raises
    ------
    InvalidInput
        If it passes through zero less than three times.

    Notes
    -----
    Noise about zero adds no crossing: only samples beyond a tenth of the greatest angle count as a side. A crossing is
    the mean of the zeros of straight lines between the samples from side to side.
    """
    measured = recording.angles()
    known = ~np.isnan(measured.data[:, link])
    t, angle = measured.t[known], measured.data[known, link]
    large = np.flatnonzero(np.abs(angle) > SIDE * np.abs(angle).max())
    crossings = []
    for first, last in pairwise(large):
        if angle[first] * angle[last] < 0.0:
            k = first + np.flatnonzero((angle[first:last] > 0.0) != (angle[first + 1 : last + 1] > 0.0))
            crossings.append((t[k] - angle[k] * (t[k + 1] - t[k]) / (angle[k + 1] - angle[k])).mean())
    if len(crossings) < 3:
        raise InvalidInput("too few swings for a period", got=f"{len(crossings)} zero crossings", allowed="at least 3")
    return float(2.0 * np.diff(crossings).mean())
