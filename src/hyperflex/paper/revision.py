"""The paper's method (Fig. 4): initial state by the Nelder-Mead simplex (7), and iterative revision (IR) in turn."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.budget import one_thread
from hyperflex.checks import Array
from hyperflex.dynamics import bias, mass_matrix
from hyperflex.errors import IdentificationError, Interrupted, InvalidInput, SimulationError
from hyperflex.identification import check_motion, check_times
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Rope, Setup
from hyperflex.paper.regression import fit_regression
from hyperflex.recording import Recording
from hyperflex.simulation import AngleJacobian, angles
from hyperflex.status import Status

Rates = Literal["rest", "measured", "free"]
RevisionProfile = Literal["response", "calculated", "measured", "measured rates"]

RATES = get_args(Rates)
PROFILES: tuple[RevisionProfile, ...] = get_args(RevisionProfile)
SETTLED = 0.1  # standard deviations: revisions that move J and eta by less no longer count
FALSE_DIGITS = 1e-6  # and so do relative changes below this, where nothing but rounding is left
PRECISION = 1e-6  # tolerance of a rollout over the rope's length: some 1e-5 rad, far below the noise of a camera
BEYOND = 1e3  # rad or rad/s: no state that a simplex may try
EDGE = 0.05  # rad, of the first simplex in an angle; in a rate, this over PACE
PACE = 0.2  # s, the time in which such a rate makes such an angle
ANGLE_STEP, ERROR_STEP = 1e-4, 1e-6  # rad and rad^2: tolerances of the simplex, far below the noise of a camera
MAX_EVALUATIONS = 400  # rollouts for each unknown, in each of the two descents


@dataclass(frozen=True, eq=False)
class InitialState:
    """The result of :func:`estimate_initial_state`.

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
    start: tuple[ArrayLike, ArrayLike] | None = None,
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
        Maximum rollouts for each unknown, in each of two descents: a new simplex restarts where the first one ended,
        because a simplex may collapse.

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


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the revision: parameters, and the initial state that suits them best.

    Attributes
    ----------
    inertia, friction : float
        J of each link, kg m^2, and eta of each joint, N m s/rad.
    q, qd : (n,) float64
        Initial angles, rad, and rates, rad/s.
    error, measured_start : float
        E of (7) with that state, and with the measured initial angles, rad^2.
    evaluations, seconds : int, float
        Rollouts of the downhill simplex; time since the revision began.
    """

    inertia: float
    friction: float
    q: Array
    qd: Array
    error: float
    measured_start: float
    evaluations: int
    seconds: float


@dataclass(frozen=True, eq=False)
class IterativeRevision:
    """The result of :func:`iterative_revision`.

    Attributes
    ----------
    rope, best : Rope, Round
        The rope with the J and eta of the best round; that round: the last one, or the one of least error without
        convergence.
    std : dict of str to float
        Standard deviations of "inertia" and "friction" from the regression.
    rounds : tuple of Round
        All rounds; the first one has the guess's parameters.
    status : Status
        SUCCESS if the values no longer changed, FAILED or INTERRUPTED.
    samples : int
        Number of measured angles that were fitted, without gaps.
    """

    rope: Rope
    best: Round
    std: dict[str, float]
    rounds: tuple[Round, ...]
    status: Status
    samples: int

    @property
    def success(self) -> bool:
        """Whether the rounds have converged."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why it is no success; empty on success."""
        return "" if self.success else f"{self.status}: the rounds did not converge; try another guess or more rounds"

    @property
    def converged_after(self) -> int | None:
        """Number of revisions after which the values no longer changed; None without convergence."""
        return len(self.rounds) - 2 if self.success else None

    @property
    def error(self) -> float:
        """E of (7), rad^2."""
        return self.best.error

    @property
    def seconds(self) -> float:
        """Time that it took, s."""
        return self.rounds[-1].seconds

    @property
    def evaluations(self) -> int:
        """Rollouts of the downhill simplex, in all rounds."""
        return sum(each.evaluations for each in self.rounds)


@one_thread()
@interruptible(IterativeRevision)
def iterative_revision(
    recording: Recording,
    rope_guess: Rope,
    *,
    rates: Rates = "rest",
    profile: RevisionProfile = "response",
    rounds: int = 8,
    max_evaluations: int = MAX_EVALUATIONS,
    progress: Callable[[Round], None] | None = None,
) -> IterativeRevision:
    """Identify link inertia and joint friction by the paper's method: revise initial state and parameters in turn.

    A round finds the initial angles by the downhill simplex method (7), simulates from them, and identifies J and eta
    by least squares. It ends when a revision moves both by less than a tenth of their standard deviations.

    Parameters
    ----------
    recording : Recording
        Of angles, or of markers at the joints, of a rope that swings freely from a fixed point.
    rope_guess : Rope
        Its inertia and friction, averaged over the links, are the first guess; one value of each is sought for all
        links.
    rates : {"rest", "measured", "free"}
        Initial rates, see :func:`estimate_initial_state`.
    profile : {"response", "calculated", "measured", "measured rates"}
        Quantities of the least squares. ``"calculated"`` is (6) with the calculated angles, rates and accelerations, as
        step 4 is printed; ``"measured"`` takes angles and rates (by three successive samples) from the recording;
        ``"measured rates"`` only the rates. By default the torques of (5), Lambda times the changes of J and eta, are
        propagated through the linearised motion to changes of the angles, which are fitted to the measured ones.
    rounds : int
        Revisions at most.
    max_evaluations : int
        See :func:`estimate_initial_state`.
    progress : callable, optional
        Called with each :class:`Round`.

    Raises
    ------
    InvalidInput
        If the recording does not fit the rope, or shows no motion beyond noise.
    IdentificationError
        If the rope cannot be simulated from the guess.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best round so far; None in the first one.

    Notes
    -----
    Paper III A-B. A calculated profile satisfies (4) with its own J and eta, so ``"calculated"`` never changes them.
    With ``"measured"`` the errors of the angles, multiplied by gravity, are a hundred times as large as J's torque, and
    the rounds diverge; with ``"measured rates"`` they converge slowly, and the noise of the rates biases eta. Only the
    default converges to the least error.
    """
    began = time.perf_counter()
    measured = matching_angles(recording, rope_guess)
    check_times(measured, rope_guess)
    check_motion(measured)
    checks.choice("profile", profile, PROFILES)
    if progress is not None and not callable(progress):
        raise InvalidInput("progress cannot be called", got=progress, allowed="a function of a round, or None")
    rope = rope_guess.replace(inertia=rope_guess.inertia.mean(), friction=rope_guess.friction.mean())
    first = first_state(measured, rates)
    start = (first[: measured.n_links], first[measured.n_links :])
    names = ["inertia", "friction", "q0", *(["qd0"] if rates == "free" else [])]
    jacobian = AngleJacobian(Setup(rope_guess), names) if profile == "response" else None
    done: list[Round] = []
    status, std = Status.FAILED, dict.fromkeys(("inertia", "friction"), float("inf"))
    with stoppable() as stop:
        try:
            for _ in range(checks.count("rounds", rounds) + 1):
                state = estimate_initial_state(
                    measured, rope, rates=rates, start=start, max_evaluations=max_evaluations
                )
                plain = squared_error(measured, rope, first)
                start = (state.q, state.qd)
                values = (float(rope.inertia[0]), float(rope.friction[0]))
                spent = time.perf_counter() - began
                done.append(Round(*values, state.q, state.qd, state.error, plain, state.evaluations, spent))
                if progress is not None:
                    progress(done[-1])
                if len(done) > 1 and _unchanged(done[-2], done[-1], std):
                    status = Status.SUCCESS
                    break
                if jacobian is None:
                    revised, spread = _by_torques(measured, rope, done[-1], profile)
                else:
                    revised, spread = _by_response(measured, rope, done[-1], jacobian)
                std = dict(zip(std, spread.tolist(), strict=True))
                rope = rope.replace(inertia=revised[0], friction=revised[1])
        except (IdentificationError, InvalidInput):  # the parameters have diverged
            if not done:
                raise
    if stop.received:
        if not done:
            raise Interrupted
        status = Status.INTERRUPTED
    best = done[-1] if status is Status.SUCCESS else min(done, key=lambda each: each.error)
    rope = rope_guess.replace(inertia=best.inertia, friction=best.friction)
    samples = int(np.isfinite(measured.data).sum())
    return stop.deliver(IterativeRevision(rope, best, std, tuple(done), status, samples))


def _unchanged(before: Round, now: Round, std: dict[str, float]) -> bool:
    """Whether a revision has moved neither parameter."""
    pairs = {name: (getattr(before, name), getattr(now, name)) for name in std}
    return all(abs(b - a) <= max(SETTLED * std[name], FALSE_DIGITS * b) for name, (a, b) in pairs.items())


def _by_torques(measured: Recording, rope: Rope, at: Round, profile: RevisionProfile) -> tuple[Array, Array]:
    """Solve (6) with a mixture of measured and calculated motion: J and eta, and their standard deviations (2,)."""
    q, qd = angles(rope, measured.t, at.q, at.qd)
    qdd = np.array([np.linalg.solve(mass_matrix(rope, a), -bias(rope, a, b)) for a, b in zip(q, qd, strict=True)])
    if profile != "calculated":
        qd = np.full(q.shape, np.nan)  # three successive samples make a rate: none at the ends
        qd[1:-1] = np.gradient(measured.data, measured.t, axis=0)[1:-1]
        q = measured.data if profile == "measured" else q
    found = fit_regression(rope, q, qd, qdd).solve()
    return np.maximum(found.values, 0.0), found.std


def _by_response(measured: Recording, rope: Rope, at: Round, jacobian: AngleJacobian) -> tuple[Array, Array]:
    """Fit J and eta, both at least 0, and the initial state to the measured angles by the linearised motion.

    Returns J and eta, and their standard deviations (2,).
    """
    from scipy.optimize import lsq_linear

    q, _, dq, _ = jacobian(measured.t, at.q, at.qd, rope)
    known = np.isfinite(measured.data)
    left, matrix = (measured.data - q)[known], dq[known]
    scale = np.sqrt((matrix**2).sum(axis=0))
    matrix = matrix / scale
    residual = left - matrix @ np.linalg.lstsq(matrix, left, rcond=None)[0]
    variance = float(residual @ residual) / max(left.size - scale.size, 1)
    spread = np.sqrt(variance * np.diag(np.linalg.pinv(matrix.T @ matrix))) / scale
    wanted = left + matrix[:, :2] @ (np.array([at.inertia, at.friction]) * scale[:2])
    least = np.append(np.zeros(2), np.full(scale.size - 2, -np.inf))
    return lsq_linear(matrix, wanted, (least, np.inf), method="bvls").x[:2] / scale[:2], spread[:2]
