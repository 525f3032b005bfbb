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

RevisionProfile = Literal["response", "calculated", "measured", "measured rates"]

PROFILES: tuple[RevisionProfile, ...] = get_args(RevisionProfile)
SETTLED = 0.1  # standard deviations: revisions that move J and eta by less no longer count
FALSE_DIGITS = 1e-6  # and so do relative changes below this, where nothing but rounding is left
PRECISION = 1e-6  # tolerance of a rollout over the rope's length: some 1e-5 rad, far below the noise of a camera
BEYOND = 1e3  # rad: no angle that a simplex may try
EDGE = 0.05  # rad, of the first simplex
ANGLE_STEP, ERROR_STEP = 1e-4, 1e-6  # rad and rad^2: tolerances of the simplex, far below the noise of a camera
MAX_EVALUATIONS = 400  # rollouts for each unknown, in each of the two descents


@dataclass(frozen=True, eq=False)
class InitialState:
    """The result of :func:`estimate_initial_state`.

    Attributes
    ----------
    q : (n,) float64
        Angles at the first sample, rad.
    error : float
        E of (7): sum of squares over samples and links, rad^2; gaps left out.
    evaluations : int
        Number of rollouts.
    status : Status
        SUCCESS if the simplex converged, FAILED or INTERRUPTED.
    """

    q: Array
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
    start: ArrayLike | None = None,
    max_evaluations: int = MAX_EVALUATIONS,
) -> InitialState:
    """Find the angles from which a rope at rest comes nearest to its recording: (7) by the Nelder-Mead simplex.

    Parameters
    ----------
    recording : Recording
        Of angles, or of markers at the joints, of a rope that swings freely from a fixed point, let go at rest.
    rope : Rope
    start : (n,) array_like, optional
        Angles to start from, rad; by default the measured ones.
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
    limit = checks.count("max_evaluations", max_evaluations)
    first = measured.data[0] if start is None else start
    best = checks.array("start", first, (rope.n_links,), unit="rad")
    least, evaluations = squared_error(measured, rope, best), 1
    if not np.isfinite(least):
        raise IdentificationError(
            "The rope cannot be simulated from the start. Give another start or other parameters."
        )

    def error(q: Array) -> float:
        """Return E of (7), and keep the best angles, so that Ctrl-C loses nothing."""
        nonlocal best, least, evaluations
        found, evaluations = squared_error(measured, rope, q), evaluations + 1
        if found < least:
            best, least = q.copy(), found
        return found

    converged = False
    with stoppable() as stop:
        for _ in range(2):
            converged = _descend(error, best, limit)
    status = stop.status or (Status.SUCCESS if converged else Status.FAILED)
    return stop.deliver(InitialState(best, least, evaluations, status))


def _descend(error: Callable[[Array], float], start: Array, max_evaluations: int) -> bool:
    """Descend with a new simplex, and return whether it converged."""
    from scipy.optimize import minimize

    options = {
        "initial_simplex": np.vstack([start, start + EDGE * np.eye(start.size)]),
        "xatol": ANGLE_STEP,
        "fatol": ERROR_STEP,
        "maxfev": max_evaluations * start.size,
        "maxiter": max_evaluations * start.size,
    }
    return bool(minimize(error, start, method="Nelder-Mead", options=options).success)


def squared_error(measured: Recording, rope: Rope, q: Array) -> float:
    """Return E of (7), rad^2, of a rope let go at rest; inf where it cannot be simulated.

    Parameters
    ----------
    measured, rope : Recording, Rope
        Angles of as many links as the rope's.
    q : (n,) float64
        Angles at the first sample, rad.
    """
    if not np.isfinite(q).all() or np.abs(q).max() > BEYOND:
        return float("inf")
    try:
        made = angles(rope, measured.t, q, np.zeros_like(q), tol=PRECISION * rope.total_length)[0]
    except SimulationError:
        return float("inf")
    return float(np.nansum((made - measured.data) ** 2))


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


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the revision: parameters, and the initial angles that suit them best.

    Attributes
    ----------
    inertia, friction : float
        J of each link, kg m^2, and eta of each joint, N m s/rad.
    q : (n,) float64
        Initial angles, rad.
    error, measured_start : float
        E of (7) from these angles, and from the measured initial angles, rad^2.
    evaluations, seconds : int, float
        Rollouts of the downhill simplex; time since the revision began.
    """

    inertia: float
    friction: float
    q: Array
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
        Of angles, or of markers at the joints, of a rope that swings freely from a fixed point, let go at rest.
    rope_guess : Rope
        Its inertia and friction, averaged over the links, are the first guess; one value of each is sought for all
        links.
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
    start = measured.data[0]
    jacobian = AngleJacobian(Setup(rope_guess), ["inertia", "friction", "q0"]) if profile == "response" else None
    done: list[Round] = []
    status, std = Status.FAILED, dict.fromkeys(("inertia", "friction"), float("inf"))
    with stoppable() as stop:
        try:
            for _ in range(checks.count("rounds", rounds) + 1):
                state = estimate_initial_state(measured, rope, start=start, max_evaluations=max_evaluations)
                plain, start = squared_error(measured, rope, measured.data[0]), state.q
                values = (float(rope.inertia[0]), float(rope.friction[0]))
                spent = time.perf_counter() - began
                done.append(Round(*values, state.q, state.error, plain, state.evaluations, spent))
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
    q, qd = angles(rope, measured.t, at.q, np.zeros_like(at.q))
    qdd = np.array([np.linalg.solve(mass_matrix(rope, a), -bias(rope, a, b)) for a, b in zip(q, qd, strict=True)])
    if profile != "calculated":
        qd = np.full(q.shape, np.nan)  # three successive samples make a rate: none at the ends
        qd[1:-1] = np.gradient(measured.data, measured.t, axis=0)[1:-1]
        q = measured.data if profile == "measured" else q
    found = fit_regression(rope, q, qd, qdd)
    return np.maximum([found.inertia, found.friction], 0.0), np.array(list(found.std.values()))


def _by_response(measured: Recording, rope: Rope, at: Round, jacobian: AngleJacobian) -> tuple[Array, Array]:
    """Fit J and eta, both at least 0, and the initial angles to the measured angles by the linearised motion.

    Returns J and eta, and their standard deviations (2,).
    """
    from scipy.optimize import lsq_linear

    q, _, dq, _ = jacobian(measured.t, at.q, np.zeros_like(at.q), rope)
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
