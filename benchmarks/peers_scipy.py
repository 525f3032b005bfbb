"""scipy's integrators on hyperflex's compiled accelerations: the effect of the method alone."""

import itertools
from collections.abc import Callable, Iterator

import numba
import numpy as np
from cast import Cast, Contestant
from scipy.integrate import ode, odeint, solve_ivp

from hyperflex.checks import Array
from hyperflex.core.chain import articulated_body as kernels
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.model import Setup

NAME = "scipy"
ARM = "prescribed exactly, inside the compiled right-hand side; a new call at every switch"
DRIVE = "prescribed"
# (relative, absolute tolerance of angles and rates), both in rad or rad/s; LSODA does better with unequal pairs. In
# --quick the first of each is run.
TOLERANCES = {
    "LSODA": ((1e-4, 1e-3), (1e-3, 1e-3), (1e-4, 1e-4), (1e-5, 1e-5), (1e-6, 1e-6)),
    "Radau": ((1e-3, 1e-3), (1e-2, 1e-2), (1e-4, 1e-4)),
    "DOP853": ((1e-2, 1e-2), (1e-3, 1e-3), (1e-4, 1e-4)),
}

MOST = 1_000_000  # steps between two switches

RightHandSide = Callable[[float, Array, float], Array]


def right_hand_side(cast: Cast) -> RightHandSide:
    """Compile the time derivative of (angles, rates) (2 n,); its third argument, a time, selects the interval."""
    chain, drive = cast.rope.chain(), Setup(cast.rope, cast.motion, cast.arm).drive()
    n, grip = cast.rope.n_links, np.ones(cast.rope.n_links)

    @numba.njit(error_model="numpy")
    def derivative(t, y, inside):  # type: ignore[no-untyped-def]
        dy, base, work = np.empty(2 * n), np.empty(9), np.empty(6 * n)
        base_state(drive, segment(drive, inside), t, base)
        dy[:n] = y[n:]
        kernels.accelerations(chain, y[:n], y[n:], grip, base[:7], 0.0, 0.0, dy[n:], work)
        return dy

    rest = np.zeros(2 * n)
    solve_ivp(derivative, (0.0, 1e-3), rest, "Radau", args=(0.0,))  # also imports what scipy loads late
    return derivative


def run(cast: Cast, function: RightHandSide, method: str, rtol: float, atol: float) -> Array:
    """Return the tip (T, 2)."""
    y = np.zeros(2 * cast.rope.n_links)
    tips = []
    for part in cast.stretches():
        inside, span = 0.5 * (part.start + part.end), [part.start, part.end]
        if method == "LSODA":  # odeint: the same code as solve_ivp's, with its loop outside Python
            y = odeint(function, y, span, args=(inside,), tfirst=True, rtol=rtol, atol=atol, mxstep=MOST)[-1]
        elif method == "DOP853":  # likewise: 2.7 times as quick as through solve_ivp
            loop = ode(function).set_integrator("dop853", rtol=rtol, atol=atol, nsteps=MOST)
            y = loop.set_f_params(inside).set_initial_value(y, part.start).integrate(part.end)
        else:
            y = solve_ivp(function, span, y, method, span[1:], args=(inside,), rtol=rtol, atol=atol).y[:, -1]
        if part.output:
            tips.append(cast.tip(part.end, y[: cast.rope.n_links]))
    return np.array(tips)


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """LSODA and Radau, which are stiff; DOP853, explicit and of high order. BDF took longer at every accuracy."""
    function = right_hand_side(cast)
    for method, pairs in TOLERANCES.items():
        for rtol, atol in itertools.islice(pairs, 1 if quick else None):
            setting = f"rtol {rtol:g}, atol {atol:g}"
            yield Contestant(
                NAME,
                method,
                setting,
                lambda m=method, r=rtol, a=atol: run(cast, function, m, r, a),
                adaptive=True,
            )
