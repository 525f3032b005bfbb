"""Batch stepper: many runs taken one interval at a time, each with its own command."""

import weakref
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.batch import rollouts as core
from hyperflex.core.batch.rollouts import Members
from hyperflex.core.chain.drive import ANGLE, TORQUE
from hyperflex.core.chain.lanes import MEMBERS
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import DEFAULT_TOL, Arm, Rope, Setup
from hyperflex.simulation.batch.members import INITIAL_CLOCK, MOST_MEMBERS, members_of, setups_of, starts_of, terms_of
from hyperflex.simulation.commands import COMMANDS, arm_polynomials, setup_for
from hyperflex.simulation.outcome import status_of
from hyperflex.simulation.rollouts import Interval
from hyperflex.status import Status

ROWS = ("q", "qd", "arm_angle", "arm_rate", "work", "dissipated", "codes", "memory")  # of a state, a row each member


@dataclass(frozen=True, eq=False)
class BatchState:
    """State of the members of a batch; row m belongs to member m.

    Attributes
    ----------
    t : float
        Time, s.
    q, qd : (M, n) float64
        Absolute link angles, rad, and rates, rad/s; NaN of a member that has failed.
    arm_angle, arm_rate : (M,) float64
        Of the arms, rad and rad/s.
    work, dissipated : (M,) float64
        Motor work and friction loss since the start, J.
    codes : (M,) int64
        Status codes; :attr:`status` has their names.
    memory : (M, 3) float64
        Memory of the integrator.
    """

    t: float
    q: Array
    qd: Array
    arm_angle: Array
    arm_rate: Array
    work: Array
    dissipated: Array
    codes: npt.NDArray[np.int64]
    memory: Array

    def __post_init__(self) -> None:
        for name in ROWS:
            if isinstance(value := getattr(self, name), np.ndarray):
                value.setflags(write=False)

    @property
    def status(self) -> tuple[Status, ...]:
        """Status of each member (M,): SUCCESS, or how it failed."""
        return tuple(map(status_of, self.codes.tolist()))


class BatchStepper:
    """:class:`hyperflex.Stepper` for many members at once, without pegs and joint limits.

    Parameters
    ----------
    ropes : Rope or sequence of Rope
        One for all members, or one each, with the same number of links and friction model.
    members : int, optional
        Number of members, where there is one rope for all.
    arm : Arm
        The arm of each.
    command : {"acceleration", "angle", "torque"}
        As of :class:`hyperflex.Stepper`.
    tol : float
        As in :func:`hyperflex.simulate_batch`, m.
    threads : int, optional
        By default one a processor. Results do not depend on it.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.

    Notes
    -----
    Each of your threads needs its own stepper, because a stepper works in its own arrays.

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=20, radius=0.0025, friction=2e-4)
    >>> stepper = hf.BatchStepper(cable, members=4, arm=hf.Arm())
    >>> state = stepper.step(stepper.start(), [0.0, 1.0, 2.0, 3.0], dt=0.02)
    >>> state.arm_rate.round(3).tolist()
    [0.0, 0.02, 0.04, 0.06]
    """

    def __init__(
        self,
        ropes: Rope | Sequence[Rope],
        *,
        members: int | None = None,
        arm: Arm | None = None,
        command: str = "acceleration",
        tol: float = DEFAULT_TOL,
        threads: int | None = None,
    ) -> None:
        self.command = checks.choice("command", command, COMMANDS)
        if isinstance(ropes, Rope) and members is not None:
            ropes = [ropes] * checks.count("members", members, most=MOST_MEMBERS)
        setups = self._setups(ropes, arm=arm, tol=tol)
        if members not in (None, len(setups)):
            raise InvalidInput("members and ropes do not fit together", got=members, allowed=f"{len(setups)}")
        self.setups = tuple(setups)
        self._own, self._channel = (1, TORQUE) if command == "torque" else (0, ANGLE)
        self._members = _members_of(setups)
        self._terms = terms_of(setups[0], setups[0].chain())
        self._polynomials = (0.0, np.zeros((3, 6)), np.zeros((3, 2)))
        self._stop = np.zeros(1, dtype=np.int64)
        workers = Budget(threads=threads).threads
        size = -(-len(setups) // (workers * len(MEMBERS))) * len(MEMBERS)
        self._blocks = [(low, min(low + size, len(setups))) for low in range(0, len(setups), size)]
        self._pool = ThreadPoolExecutor(len(self._blocks)) if len(self._blocks) > 1 else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.shutdown, wait=False)

    def start(
        self,
        q0: npt.ArrayLike | None = None,
        qd0: npt.ArrayLike | None = None,
        *,
        arm_angle: npt.ArrayLike = 0.0,
        arm_rate: npt.ArrayLike = 0.0,
        t: float = 0.0,
    ) -> BatchState:
        """Return a state to begin with, as :meth:`hyperflex.Stepper.start` does; by default the ropes hang at rest.

        q0 and qd0 are (n,) or (M, n), arm_angle and arm_rate numbers or (M,): for all members, or of each; t in s.
        """
        rows = self._begin([setup.rope for setup in self.setups], q0, qd0, arm_angle, arm_rate)
        return BatchState(checks.number("t", t, unit="s"), **rows)

    def restart(
        self,
        state: BatchState,
        which: npt.ArrayLike,
        ropes: Rope | Sequence[Rope] | None = None,
        q0: npt.ArrayLike | None = None,
        qd0: npt.ArrayLike | None = None,
        *,
        arm_angle: npt.ArrayLike = 0.0,
        arm_rate: npt.ArrayLike = 0.0,
    ) -> BatchState:
        """Return the state with some members begun anew, also those that had failed; time goes on for all.

        Parameters
        ----------
        state : BatchState
        which : (K,) array_like of int, or (M,) of bool
            The members. With none, the state is returned as it is.
        ropes : Rope or sequence of Rope, optional
            New ropes for them, one or one each. The stepper has them from here on, so that states from before, too, go
            on with the new ropes.
        q0, qd0, arm_angle, arm_rate
            Of these members, as in :meth:`start`.

        Raises
        ------
        InvalidInput
            If an argument cannot be used; the stepper is then as before.
        """
        self._check(state)
        chosen = _members(which, len(self.setups))
        if not chosen.size:
            return state
        first = self.setups[0]
        given = [self.setups[m].rope for m in chosen] if ropes is None else ropes
        given = [given] * chosen.size if isinstance(given, Rope) else list(given)
        kind = first.rope.n_links, first.rope.friction_model
        if len(given) != chosen.size or any((rope.n_links, rope.friction_model) != kind for rope in given):
            allowed = f"{chosen.size} ropes of {kind[0]} links and the batch's friction model"
            raise InvalidInput("ropes do not fit the members", got=[rope.n_links for rope in given], allowed=allowed)
        new = self._begin(given, q0, qd0, arm_angle, arm_rate)
        if ropes is not None:
            setups = self._setups(given, arm=first.arm, tol=first.tol)
            rows = _members_of(setups)
            links = self._members.links.copy()
            links[chosen], self._members.whole[chosen] = rows.links, rows.whole
            links.setflags(write=False)
            self._members = self._members._replace(links=links)
            changed = dict(zip(chosen.tolist(), setups, strict=True))
            self.setups = tuple(changed.get(m, setup) for m, setup in enumerate(self.setups))
        values = {name: getattr(state, name).copy() for name in ROWS}
        for name, value in values.items():
            value[chosen] = new[name]
        return replace(state, **values)

    def _setups(self, ropes: Rope | Sequence[Rope], *, arm: Arm | None, tol: float) -> list[Setup]:
        """Return the set-ups of ropes that the stepper can take."""
        setups = [setup_for(self.command, setup) for setup in setups_of(ropes, duration=1.0, arm=arm, tol=tol)]
        if any(setup.touches for setup in setups):
            raise InvalidInput("a batch is stepped in free flight", got="ropes with joint limits", fix="Use hf.Stepper")
        return setups

    def _begin(
        self,
        ropes: Sequence[Rope],
        q0: npt.ArrayLike | None,
        qd0: npt.ArrayLike | None,
        arm_angle: npt.ArrayLike,
        arm_rate: npt.ArrayLike,
    ) -> dict[str, Any]:
        """Return the rows of a state in which members with these ropes begin."""
        count, n = len(ropes), ropes[0].n_links
        begin = starts_of(setups_of(ropes, duration=1.0, q0=q0, qd0=qd0))
        angle = checks.array("arm_angle", arm_angle, (count,), scalar=True, unit="rad")
        rate = checks.array("arm_rate", arm_rate, (count,), scalar=True, unit="rad/s")
        codes, memory = np.full(count, status.OK), np.tile(INITIAL_CLOCK, (count, 1))
        rows = begin[:, :n], begin[:, n : 2 * n], angle, rate, np.zeros(count), np.zeros(count), codes, memory
        return dict(zip(ROWS, rows, strict=True))

    def tips(self, state: BatchState) -> tuple[Array, Array]:
        """Return places (M, 2), m, and velocities (M, 2), m/s, of the tips in a `state`."""
        self._check(state)
        lengths = np.stack([setup.rope.length for setup in self.setups])
        arm = self.setups[0].arm or Arm()  # a batch has one
        place, turn = arm.tip(state.arm_angle), (arm.length * state.arm_rate)[:, None]
        across = np.stack([np.cos(state.q), np.sin(state.q)], axis=1)
        along = np.stack([np.sin(state.q), -np.cos(state.q)], axis=1)
        swing = np.stack([np.cos(state.arm_angle), np.sin(state.arm_angle)], axis=1)
        return (
            place + np.einsum("mci,mi->mc", along, lengths),
            turn * swing + np.einsum("mci,mi->mc", across, lengths * state.qd),
        )

    @interruptible()
    def step(self, state: BatchState, commands: npt.ArrayLike, dt: float) -> BatchState:
        """Return the state an interval later, as :meth:`hyperflex.Stepper.step` does.

        Parameters
        ----------
        state : BatchState
            From :meth:`start`, :meth:`step` or :meth:`restart`, or one with some values replaced
            (``dataclasses.replace``).
        commands : (M,) array_like or float
            One a member, or one for all: rad/s^2, rad or N m.
        dt : float
            Length of the interval, s, > 0.

        Returns
        -------
        BatchState
            A member that cannot be simulated within `tol` has failed, in ``status`` and as NaN, from there on.
        """
        members, own, count = self._members, self._own, len(self.setups)
        n = members.links.shape[2]
        self._check(state)
        given = checks.array("commands", commands, (count,), scalar=True)
        span = checks.number("dt", dt, sign="positive", unit="s")
        if span != self._polynomials[0]:
            self._polynomials = (span, *arm_polynomials(self.command, span))
        known = np.stack([state.arm_angle, state.arm_rate, given], axis=1)
        members.start[:, own:n], members.start[:, n + own : 2 * n] = state.q, state.qd
        if own:
            members.start[:, 0], members.start[:, n] = state.arm_angle, state.arm_rate
        members.start[:, 2 * n], members.start[:, 2 * n + 1] = state.work, state.dissipated
        members.clock[:] = state.memory
        members.breaks[0::2], members.breaks[1::2] = state.t, state.t + 2.0 * span
        members.coef[0::2, self._channel] = known @ self._polynomials[1]
        y, codes = self._run(state.t, state.t + span)
        angle, rate = (y[:, 0].copy(), y[:, n].copy()) if own else (known @ self._polynomials[2]).T
        codes = np.where(state.codes == status.OK, codes, state.codes)
        q, qd, work, lost = y[:, own:n], y[:, n + own : 2 * n], y[:, 2 * n], y[:, 2 * n + 1]
        return BatchState(state.t + span, q, qd, angle, rate, work, lost, codes, members.clock.copy())

    def _check(self, state: object) -> None:
        """Refuse what is no state of this batch, or holds what no member can begin with."""
        count, n = len(self.setups), self.setups[0].rope.n_links
        if not isinstance(state, BatchState):
            raise InvalidInput("state is not a BatchState", got=state, allowed="what start() or step() returned")
        checks.number("state t", state.t, unit="s")
        shapes: dict[str, tuple[int, ...]] = {"q": (count, n), "qd": (count, n), "memory": (count, len(INITIAL_CLOCK))}
        shapes |= dict.fromkeys(("arm_angle", "arm_rate", "work", "dissipated", "codes"), (count,))
        for name, shape in shapes.items():
            value = getattr(state, name)
            if np.shape(value) != shape or np.asarray(value).dtype.kind not in "if":
                raise InvalidInput(f"state {name} is not of this batch", got=value, allowed=f"numbers of shape {shape}")
        moving = state.codes == status.OK
        for name in ("q", "qd", "arm_angle", "arm_rate", "work", "dissipated"):
            if not np.isfinite(getattr(state, name)[moving]).all():
                raise InvalidInput(f"state {name} is not finite", got=getattr(state, name), allowed="finite numbers")
        if not (state.memory[moving, 0] > 0.0).all() or np.isnan(state.memory[moving]).any():
            fix = "Take it from start() or step()"
            raise InvalidInput("state memory is no integrator's", got=state.memory, allowed="a first step > 0", fix=fix)

    def _run(self, begin: float, end: float) -> tuple[Array, npt.NDArray[np.int64]]:
        """Run all members over a span of time, s; returns their states (M, 2 n + 2) and codes (M,)."""
        count, width = self._members.start.shape
        terms, after = self._terms._replace(begin=begin), np.array([end])
        y, codes, reached = np.full((count, 1, width), np.nan), np.full(count, -1), np.zeros(count)

        def block(span: tuple[int, int]) -> None:
            rows = slice(*span)
            core.run_block(self._members, terms, *span, after, y[rows], codes[rows], reached[rows], self._stop)

        if self._pool is None:
            block(self._blocks[0])
            return y[:, 0], codes
        running = [self._pool.submit(block, span) for span in self._blocks]
        try:
            for each in running:
                each.result()
        except KeyboardInterrupt:  # Ctrl-C
            self._stop[0] = 1
            wait(running)
            self._stop[0] = 0
            raise
        return y[:, 0], codes


def _members(which: npt.ArrayLike, count: int) -> npt.NDArray[np.intp]:
    """Return the numbers of members that were chosen by their numbers or by a mask."""
    chosen = np.asarray(which)
    if chosen.dtype == np.bool_ and chosen.shape == (count,):
        return np.flatnonzero(chosen)
    if not chosen.size and chosen.ndim == 1:
        return np.zeros(0, dtype=np.intp)
    numbers = chosen.astype(np.intp) if chosen.dtype.kind in "iu" and chosen.ndim == 1 else np.full(1, -1)
    if (numbers < 0).any() or (numbers >= count).any() or np.unique(numbers).size < numbers.size:
        allowed = f"each a number from 0 to {count - 1}, once, or a mask of {count}"
        raise InvalidInput("these are no members of the batch", got=which, allowed=allowed)
    return numbers


def _members_of(setups: Sequence[Setup]) -> Members:
    """Return the members of set-ups, to be driven by one polynomial at a time."""
    chains = [setup.chain() for setup in setups]
    drives = [Interval(setup.drive()).drive for setup in setups]
    return members_of(chains, drives, np.zeros((len(setups), 2 * chains[0].length.size + 2)))
