"""Stiction projection: derivatives of the start where joints stick."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain, mass_matrix
from hyperflex.core.chain.drive import Drive, segment
from hyperflex.core.tangent import extrapolation as dr
from hyperflex.core.tangent.extrapolation import Directions


def stiction_projection(
    chain: Chain, drive: Drive, t: float, q: Array, modes: Array, directions: Directions, start: Array
) -> Array:
    """Derivatives of the state just after the start, where stuck joints turn with their parents.

    A joint within its limit that is given a little rate stops after a time in proportion to it. To first order that is
    an impulse on both links, whichever the sense: momenta are kept but for it.

    Parameters
    ----------
    t, q : float, (n,) float64
        Time, s, and angles, rad, at the start.
    modes : (n,) or (0,) float64
        Of the joints in the first step, 0.0 where one sticks; (0,): none may stick.
    start : (2 n, p) float64
        Derivatives of angles and rates as they are given.
    """
    n = q.size
    stuck = np.flatnonzero(modes == 0.0)
    if not stuck.size:
        return start
    turn = np.eye(n) - np.eye(n, k=-1)  # of each joint, by the rates of the links
    slip = turn[stuck] @ start[n:]
    if stuck[0] == 0:
        part, moved = segment(drive, t), np.zeros(dr.CHANGES)
        for x, m in enumerate(directions.driven):
            if m >= 0:
                dr.base_change(drive, part, t, 0.0, directions, m, moved)
                slip[0, x] -= moved[dr.RATE]
    if not slip.any():
        return start
    mass = np.zeros((n, n))
    mass_matrix(chain, q, mass)
    reaction_factor = len(chain.reaction) - 1.0
    impulse = np.linalg.solve(mass, (np.eye(n) - reaction_factor * np.eye(n, k=-1))[stuck].T)
    result = start.copy()
    result[n:] -= impulse @ np.linalg.solve(turn[stuck] @ impulse, slip)
    return result
