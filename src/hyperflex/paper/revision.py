"""Iterative revision (IR) of parameters and initial state, the paper's method (Fig. 4)."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hyperflex import checks
from hyperflex.budget import one_thread
from hyperflex.checks import Array
from hyperflex.dynamics import bias, mass_matrix
from hyperflex.errors import IdentificationError, Interrupted, InvalidInput
from hyperflex.identification import check_motion, check_times
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Rope, Setup
from hyperflex.paper.regression import fit_regression
from hyperflex.paper.simplex import (
    MAX_EVALUATIONS,
    RATES,
    Rates,
    estimate_initial_state,
    first_state,
    matching_angles,
    squared_error,
)
from hyperflex.recording import Recording
from hyperflex.simulation import AngleJacobian, angles
from hyperflex.status import Status

RevisionProfile = Literal["response", "calculated", "measured", "measured rates"]

PROFILES = ("response", "calculated", "measured", "measured rates")
SETTLED = 0.1  # standard deviations: revisions that move J and eta by less no longer count
FALSE_DIGITS = 1e-6  # and so do relative changes below this, where nothing but rounding is left
UNKNOWNS = ("inertia:shared", "friction:shared")


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
    """What :func:`iterative_revision` found.

    Attributes
    ----------
    rope, best : Rope, Round
        The last round, or the one of least error if it did not converge, and the rope with its J and eta.
    std : dict of str to float
        Standard deviations of "inertia" and "friction" from the regression.
    rounds : tuple of Round
        All rounds; the first one has the guess's parameters.
    status : Status
        SUCCESS if nothing moved any more, FAILED or INTERRUPTED.
    samples : int
        Measured angles that were fitted, gaps left out.
    profile, rates : str
        As given.
    """

    rope: Rope
    best: Round
    std: dict[str, float]
    rounds: tuple[Round, ...]
    status: Status
    samples: int
    profile: str
    rates: str

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
        """Number of revisions after which nothing moved any more; None if it did not converge."""
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
    """Identify link inertia and joint friction as the paper does: initial state and parameters revised in turn.

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
        What the least squares compare. ``"calculated"`` is (6) with the calculated angles, rates and accelerations, as
        step 4 is printed; ``"measured"`` takes angles and rates (by three successive samples) from the recording;
        ``"measured rates"`` only the rates. By default the torques of (5), Lambda times the changes of J and eta, are
        carried through the linearised motion to changes of the angles, fitted to the measured ones.
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
    Paper III A-B. A calculated profile fulfils (4) with its own J and eta, so with ``"calculated"`` nothing ever moves.
    With ``"measured"`` the errors of the angles, multiplied by gravity, outweigh J's torque a hundredfold and the
    rounds diverge; with ``"measured rates"`` they creep, and the noise of the rates biases eta. Only the default
    settles at the least error.
    """
    began = time.perf_counter()
    measured = matching_angles(recording, rope_guess)
    check_times(measured, rope_guess)
    check_motion(measured)
    checks.choice("profile", profile, PROFILES)
    checks.choice("rates", rates, RATES)
    if progress is not None and not callable(progress):
        raise InvalidInput("progress cannot be called", got=progress, allowed="a function of a round, or None")
    revision = _Revision(measured, rope_guess, rates, profile, checks.count("max_evaluations", max_evaluations))
    done: list[Round] = []
    status, std = Status.FAILED, {"inertia": float("inf"), "friction": float("inf")}
    values = np.array([rope_guess.inertia.mean(), rope_guess.friction.mean()])
    with stoppable() as stop:
        try:
            for _ in range(checks.count("rounds", rounds) + 1):
                found = revision.state(values, done[-1] if done else None, began)
                done.append(found)
                if progress is not None:
                    progress(found)
                if len(done) > 1 and _unchanged(done[-2], found, std):
                    status = Status.SUCCESS
                    break
                values, spread = revision.parameters(found)
                std = {"inertia": float(spread[0]), "friction": float(spread[1])}
        except IdentificationError:
            if not done:
                raise
    if stop.received:
        if not done:
            raise Interrupted
        status = Status.INTERRUPTED
    best = done[-1] if status is Status.SUCCESS else min(done, key=lambda each: each.error)
    samples = int(np.isfinite(measured.data).sum())
    rope = revision.rope(np.array([best.inertia, best.friction]))
    return stop.deliver(IterativeRevision(rope, best, std, tuple(done), status, samples, profile, rates))


def _unchanged(before: Round, now: Round, std: dict[str, float]) -> bool:
    """Whether a revision has moved neither parameter."""
    pairs = {"inertia": (before.inertia, now.inertia), "friction": (before.friction, now.friction)}
    return all(abs(b - a) <= max(SETTLED * std[name], FALSE_DIGITS * b) for name, (a, b) in pairs.items())


class _Revision:
    """The two halves of a round."""

    def __init__(self, measured: Recording, guess: Rope, rates: Rates, profile: RevisionProfile, limit: int) -> None:
        self.measured, self.guess, self.rates, self.profile, self.limit = measured, guess, rates, profile, limit
        self.jacobian = None
        if profile == "response":
            names = ["inertia", "friction", "q0", *(["qd0"] if rates == "free" else [])]
            self.jacobian = AngleJacobian(Setup(guess), names)

    def rope(self, values: Array) -> Rope:
        """Return the guess with one J and one eta (2,) for all links."""
        return self.guess.replace(inertia=values[0], friction=values[1])

    def state(self, values: Array, before: Round | None, began: float) -> Round:
        """Find the initial state (steps 2 and 3 of Fig. 4)."""
        try:
            rope = self.rope(values)
        except InvalidInput as error:
            what = f"J = {values[0]:.3g} kg m^2, eta = {values[1]:.3g} N m s/rad"
            raise IdentificationError(f"{what}: {error}") from error
        start = None if before is None else (before.q, before.qd)
        found = estimate_initial_state(self.measured, rope, rates=self.rates, start=start, max_evaluations=self.limit)
        plain = squared_error(self.measured, rope, first_state(self.measured, self.rates))
        seconds = time.perf_counter() - began
        inertia, friction = float(values[0]), float(values[1])
        return Round(inertia, friction, found.q, found.qd, found.error, plain, found.evaluations, seconds)

    def parameters(self, at: Round) -> tuple[Array, Array]:
        """Identify J and eta (step 4 of Fig. 4); return them and their standard deviations (2,)."""
        rope = self.rope(np.array([at.inertia, at.friction]))
        return self.by_torques(rope, at) if self.jacobian is None else self.by_response(self.jacobian, rope, at)

    def by_torques(self, rope: Rope, at: Round) -> tuple[Array, Array]:
        """Solve (6) with a mixture of measured and calculated motion."""
        q, qd = angles(rope, self.measured.t, at.q, at.qd)
        qdd = np.array([np.linalg.solve(mass_matrix(rope, a), -bias(rope, a, b)) for a, b in zip(q, qd, strict=True)])
        if self.profile != "calculated":
            seen = np.full(q.shape, np.nan)  # three successive samples make a rate: none at the ends
            seen[1:-1] = np.gradient(self.measured.data, self.measured.t, axis=0)[1:-1]
            q, qd = self.measured.data if self.profile == "measured" else q, seen
        found = fit_regression(rope, q, qd, qdd, UNKNOWNS).solve()
        return np.maximum(found.values, 0.0), found.std

    def by_response(self, jacobian: AngleJacobian, rope: Rope, at: Round) -> tuple[Array, Array]:
        """Fit J and eta, and the initial state, to the measured angles by the linearised motion."""
        q, _, dq, _ = jacobian(self.measured.t, at.q, at.qd, rope)
        known = np.isfinite(self.measured.data)
        left, matrix = (self.measured.data - q)[known], dq[known]
        scale = np.sqrt((matrix**2).sum(axis=0))
        matrix = matrix / scale
        values = np.array([at.inertia, at.friction])
        move = np.linalg.lstsq(matrix, left, rcond=None)[0]
        residual = left - matrix @ move
        variance = float(residual @ residual) / max(left.size - move.size, 1)
        spread = np.sqrt(variance * np.diag(np.linalg.pinv(matrix.T @ matrix))) / scale
        below = values + (move / scale)[:2] <= 0.0
        if below.any():  # what would become negative stops at 0, and the rest adapts to it
            held = np.append(below, np.zeros(scale.size - 2, dtype=bool))
            move = np.where(held, -np.append(values, np.zeros(scale.size - 2)) * scale, 0.0)
            move[~held] = np.linalg.lstsq(matrix[:, ~held], left - matrix @ move, rcond=None)[0]
        return np.where(below, 0.0, np.maximum(values + (move / scale)[:2], 0.0)), spread[:2]
