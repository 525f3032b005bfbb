"""scipy's stiff integrators on hyperflex's own compiled accelerations: what the method alone is worth."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numba
import numpy as np
from cast import Cast, Contestant
from scipy.integrate import odeint, solve_ivp

from hyperflex.checks import Array
from hyperflex.core import chain as kernels
from hyperflex.core.drive import base_state, segment
from hyperflex.model import Setup

NAME = "scipy"
ARM = "prescribed exactly, inside the compiled right-hand side; a new call at every switch"
# (relative, absolute tolerance of angles and rates), both in rad or rad/s; unequal pairs did better than equal ones
LSODA = ((1e-3, 1e-3), (1e-4, 1e-3), (1e-4, 1e-4), (1e-5, 1e-5), (1e-6, 1e-6))
RADAU = ((1e-2, 1e-2), (1e-3, 1e-3), (1e-4, 1e-4))

RightHandSide = Callable[[float, Array, float], Array]


def right_hand_side(cast: Cast) -> RightHandSide:
    """Compile the time derivative of (angles, rates) (2 n,); its third argument picks the stretch by a time inside."""
    chain, drive = cast.rope.chain(), Setup(cast.rope, cast.motion, cast.arm).drive()
    n = cast.rope.n_links

    @numba.njit(error_model="numpy")
    def derivative(t, y, inside):  # type: ignore[no-untyped-def]
        dy, base, work = np.empty(2 * n), np.empty(9), np.empty(6 * n)
        base_state(drive, segment(drive, inside), t, base)
        dy[:n] = y[n:]
        kernels.accelerations(chain, y[:n], y[n:], base[:7], 0.0, 0.0, dy[n:], work)
        return dy

    rest = np.zeros(2 * n)
    solve_ivp(derivative, (0.0, 1e-3), rest, "Radau", args=(0.0,))  # also imports what scipy loads late
    return derivative


def run(cast: Cast, function: RightHandSide, method: str, rtol: float, atol: float) -> Array:
    """Return the tip (T, 2)."""
    y = np.zeros(2 * cast.rope.n_links)
    tips = []
    for part in cast.stretches():
        args = (0.5 * (part.start + part.end),)
        if method == "LSODA":  # odeint: the same code as solve_ivp's, with its loop outside Python
            span = [part.start, part.end]
            y = odeint(function, y, span, args=args, tfirst=True, rtol=rtol, atol=atol, mxstep=100_000)[-1]
        else:
            span, ends = (part.start, part.end), [part.end]
            y = solve_ivp(function, span, y, method, ends, args=args, rtol=rtol, atol=atol).y[:, -1]
        if part.output:
            tips.append(cast.tip(part.end, y[: cast.rope.n_links]))
    return np.array(tips)


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """LSODA through odeint, which was quicker than solve_ivp's; Radau. BDF and DOP853 took longer at every accuracy."""
    function = right_hand_side(cast)
    plans = (("LSODA", LSODA[1:2] if quick else LSODA), ("Radau", RADAU[1:2] if quick else RADAU))
    for method, tolerances in plans:
        for rtol, atol in tolerances:
            setting = f"rtol {rtol:g}, atol {atol:g}"
            yield Contestant(
                NAME,
                method,
                setting,
                lambda m=method, r=rtol, a=atol: run(cast, function, m, r, a),
                adaptive=True,
            )
