"""Initial state by the Nelder-Mead simplex method (paper (7))."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput, SimulationError
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.simulation import angles
from hyperflex.status import Status

Rates = Literal["rest", "measured", "free"]

RATES = get_args(Rates)
PRECISION = 1e-6  # tolerance of a rollout over the rope's length: some 1e-5 rad, far below the noise of a camera
BEYOND = 1e3  # rad or rad/s: no state that a simplex may try
EDGE = 0.05  # rad, of the first simplex in an angle; in a rate, this over PACE
PACE = 0.2  # s, the time in which such a rate makes such an angle
ANGLE_STEP, ERROR_STEP = 1e-4, 1e-6  # rad and rad^2: tolerances of the simplex, far below the noise of a camera
MAX_EVALUATIONS = 400  # rollouts for each unknown, in each of the two descents


@dataclass(frozen=True, eq=False)
class InitialState:
    """What :func:`estimate_initial_state` found.

    Attributes
    ----------
    q, qd : (n,) float64
        Angles, rad, and rates, rad/s, at the first sample.
    error : float
        E of (7): sum of squares over samples and links, rad^2; gaps left out.
    evaluations : int
        Number of rollouts.
    status : Status
        SUCCESS if the simplex converged, FAILED or INTERRUPTED.
    """

    q: Array
    qd: Array
    error: float
    evaluations: int
    status: Status

    @property
    def success(self) -> bool:
        """Whether the simplex has converged."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why it is no success; empty on success."""
        return "" if self.success else f"{self.status}: the simplex did not converge; allow more evaluations"


@interruptible(InitialState)
def estimate_initial_state(
    recording: Recording,
    rope: Rope,
    *,
    rates: Rates = "rest",
    start: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    max_evaluations: int = MAX_EVALUATIONS,
) -> InitialState:
    """Find the initial state from which a rope comes nearest to its recording: (7) by the Nelder-Mead simplex.

    Parameters
    ----------
    recording : Recording
        Of angles, or of markers at the joints, of a rope that swings freely from a fixed point.
    rope : Rope
    rates : {"rest", "measured", "free"}
        Initial rates: zero, taken from the first three samples, or sought along with the angles.
    start : ((n,), (n,)) array_like, optional
        Angles and rates to start from; by default the measured ones. Rates are used if they are sought.
    max_evaluations : int
        Most rollouts for each unknown, in each of two descents: a fresh simplex restarts where the first one ended, for
        a simplex may collapse.

    Raises
    ------
    InvalidInput
        If the recording does not fit the rope.
    IdentificationError
        If the rope cannot be simulated from the start.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best so far.

    Notes
    -----
    Paper III B, step 2 of Fig. 4.
    """
    measured = matching_angles(recording, rope)
    n = rope.n_links
    best = first_state(measured, rates)
    limit = checks.count("max_evaluations", max_evaluations)
    if start is not None:
        given = checks.sequence("start", start, "angles, rad, and rates, rad/s")
        if len(given) != 2:
            raise InvalidInput("start is not a pair", got=start, allowed="angles, rad, and rates, rad/s")
        best[:n] = checks.array("start angles", given[0], (n,), unit="rad")
        if rates == "free":
            best[n:] = checks.array("start rates", given[1], (n,), unit="rad/s")
    edges = np.append(np.full(n, EDGE), np.full(n, EDGE / PACE))[: 2 * n if rates == "free" else n]
    least, evaluations = squared_error(measured, rope, best), 1
    if not np.isfinite(least):
        raise IdentificationError(
            "The rope cannot be simulated from the start. Give another start or other parameters."
        )

    def error(unknown: Array) -> float:
        """Return E of (7), and keep the best state, so that Ctrl-C loses nothing."""
        nonlocal best, least, evaluations
        state = np.append(unknown, best[edges.size :])
        found, evaluations = squared_error(measured, rope, state), evaluations + 1
        if found < least:
            best, least = state, found
        return found

    converged = False
    with stoppable() as stop:
        for _ in range(2):
            converged = _descend(error, best[: edges.size], edges, limit)
    status = stop.status or (Status.SUCCESS if converged else Status.FAILED)
    return stop.deliver(InitialState(best[:n].copy(), best[n:].copy(), least, evaluations, status))


def _descend(error: Callable[[Array], float], start: Array, edges: Array, max_evaluations: int) -> bool:
    """Descend with a new simplex of these edges, and return whether it converged."""
    from scipy.optimize import minimize

    steepest = edges.max() / EDGE
    options = {
        "initial_simplex": np.vstack([start, start + np.diag(edges)]),
        "xatol": ANGLE_STEP * steepest,
        "fatol": ERROR_STEP,
        "maxfev": max_evaluations * edges.size,
        "maxiter": max_evaluations * edges.size,
        "adaptive": steepest > 1.0,
    }
    return bool(minimize(error, start, method="Nelder-Mead", options=options).success)


def squared_error(measured: Recording, rope: Rope, state: Array) -> float:
    """Return E of (7), rad^2; inf where the rope cannot be simulated.

    Parameters
    ----------
    measured, rope : Recording, Rope
        Angles of as many links as the rope's.
    state : (2 n,) float64
        Angles, rad, and rates, rad/s, at the first sample.
    """
    n = rope.n_links
    if not np.isfinite(state).all() or np.abs(state).max() > BEYOND:
        return float("inf")
    try:
        q = angles(rope, measured.t, state[:n], state[n:], tol=PRECISION * rope.total_length)[0]
    except SimulationError:
        return float("inf")
    return float(np.nansum((q - measured.data) ** 2))


def matching_angles(recording: Recording, rope: Rope) -> Recording:
    """Return the recording's angles if they fit the rope and begin with a full sample."""
    checks.instance("recording", recording, Recording)
    checks.instance("rope", rope, Rope)
    measured = recording.angles()
    if measured.n_links != rope.n_links:
        raise InvalidInput(
            "the recording and the rope have different numbers of links",
            got=rope.n_links,
            allowed=f"{measured.n_links}, as recorded",
        )
    if measured.t.size < 3 or np.isnan(measured.data[:3]).any():
        raise InvalidInput(
            "the first three samples must be there, in all links",
            got=f"{int(np.isnan(measured.data[:3]).sum())} gaps",
            fix="Cut the recording: recording.window(start, end)",
        )
    return measured


def first_state(measured: Recording, rates: Rates) -> Array:
    """Return the measured initial angles with rates (2n,): zero, or from the first three samples."""
    checks.choice("rates", rates, RATES)
    initial = np.zeros(measured.n_links)
    if rates != "rest":
        initial = np.gradient(measured.data[:3], measured.t[:3], axis=0, edge_order=2)[0]
    return np.append(measured.data[0], initial)
