"""Runs with pegs or joint limits: free flight, contact steps, and the hand-over.

A flight is so short that no joint can reach a peg meanwhile, as far as the speeds at its ends tell; where they rose by
more than was allowed for, it is flown again by the stepper for contacts. A flight ends where a joint reaches its limit.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.articulated_body import energies
from hyperflex.core.chain.drive import motion_at
from hyperflex.core.chain.torque_peaks import COLUMNS, PEAK, WHEN, WINDOWS
from hyperflex.core.contact import run as at
from hyperflex.core.contact import run as core
from hyperflex.core.contact.arrays import STICK, new_contact_memory
from hyperflex.core.integrate.rollout import INDEX, MARK, T
from hyperflex.interruption import deferred, raise_if_cancelled
from hyperflex.model import DEFAULT_TOL, Setup
from hyperflex.simulation.contact.start import check_start
from hyperflex.simulation.contact.turning_pegs import coast, spin_energy, starting_spin
from hyperflex.simulation.rollouts import Rollout, starting_clock
from hyperflex.trajectory import State

STEP = "contact_step"
# in a state's checkpoint, in the order of ``contact.arrays.ContactMemory``
KEPT = ("contact_normal", "contact_tangent", "contact_mode", "contact_penalty", "joint_torque", "joint_mode")


@dataclass(frozen=True)
class HandOver:
    """When free flight and contact steps alternate, and how much energy contact steps may add.

    Attributes
    ----------
    shortest_flight : float
        s; the hand-over takes more time than a shorter flight saves.
    faster, sudden : float
        A flight allows for speeds so many times as large, and for so much more, m/s.
    flight_tol : float
        Tolerance of a flight as a part of the run's: with all of it a flight would gain and lose more energy than
        contact may.
    slack : float
        Gap at which a joint has left its limit, rad.
    clear : float
        Gap at which a rope that was in contact has left, m, unless it is so fast that it would be back at once.
    gain, gain_free, low_friction : float
        Energy that may appear at the default tolerance, in parts of the energy scale for each second: if joint friction
        is at least `low_friction`, N m s/rad, and if it is lower. Then the rope's own motion sets the steps.
    budget : int
        Steps between two checks of the budget and of interrupts; some take milliseconds.
    """

    shortest_flight: float = 0.01
    faster: float = 2.0
    sudden: float = 2.0
    flight_tol: float = 1e-3
    slack: float = 0.01
    clear: float = 0.03
    gain: float = 1e-6
    gain_free: float = 1e-4
    low_friction: float = 1e-4
    budget: int = 250


RULE = HandOver()


class ContactRun:
    """A rollout with pegs, or of a rope whose joints have limits.

    The `run` is prepared, and resumed if it goes on from a `state`; its arrays are filled.
    """

    def __init__(self, run: Rollout, setup: Setup, state: State | None) -> None:
        contacts = setup.contacts()
        n, m = run.chain.length.size, contacts.x.size
        self.looser = setup.tol / DEFAULT_TOL
        if setup.pegs:
            run.limits = run.limits._replace(tol=RULE.flight_tol * setup.tol)
        self.run, self.setup = run, setup
        self.contacts = contacts
        self.pull, self.longest = np.array(setup.tip_force), setup.contact_step
        run.spin, run.seen = np.zeros((2, m)), np.full((run.t.size, 3 * n + 4 + 2 * m), np.nan)
        torque = np.zeros((len(WINDOWS), COLUMNS))
        self.contact = at.ContactState(run.progress.y, np.zeros(at.CLOCK), run.spin, new_contact_memory(n, m), torque)
        self.flights, self.flown, self.clear = 0, 0.0, RULE.clear
        self.enter(state)

    def enter(self, state: State | None) -> None:
        """Begin anew at the state that the run stands at; forces and modes of contacts are those of `state`, if any."""
        contact, saved = self.contact, {} if state is None else state.checkpoint
        contact.clock[:] = 0.0
        contact.clock[at.STEP], contact.clock[at.IMPACT_DUE] = self.longest, 1.0
        contact.spin[:] = starting_spin(self.setup, state)
        for name, array in zip(KEPT, contact.memory, strict=True):
            array[:] = saved[name] if np.shape(saved.get(name, ())) == array.shape else 0
        if STEP in saved and np.array_equal(saved["y"], contact.y):
            contact.clock[at.STEP], contact.clock[at.IMPACT_DUE] = min(float(saved[STEP]), self.longest), 0.0

    def finish(self, watch: Callable[[float], None] | None = None) -> int:
        """Run to the end and return the status code; `watch` is called with the time reached, s, now and then."""
        code = status.RUNNING
        while code in (status.RUNNING, status.LEFT):
            code = self._fly()
            if code == status.LEFT:
                code = self._touch()
            raise_if_cancelled()
            if watch is not None and code in (status.RUNNING, status.LEFT):
                watch(self.run.time)
        self.run.progress.clock[MARK] = -np.inf  # where the run stands is where it goes on from
        self.run.facts = self._facts()
        names = zip(KEPT, self.contact.memory, strict=True)
        self.run.kept = {STEP: float(self.contact.clock[at.STEP]), **{name: array.copy() for name, array in names}}
        return code

    def _fly(self) -> int:
        """Fly freely while no peg or limit can be reached: LEFT if one may be, RUNNING or OK after a flight."""
        run, clock = self.run, self.run.progress.clock
        stop = run.limits.stop
        if run.time >= stop:
            return status.OK
        if self.pull.any():
            return status.LEFT
        gap, speed, left = core.clearance(run.chain, run.drive, self.contacts, run.time, run.progress.y, 0.0)
        bound = RULE.faster * speed + RULE.sudden
        self.clear = max(RULE.clear, RULE.shortest_flight * bound)
        if gap < self.clear or left <= RULE.slack:
            return status.LEFT
        self._lock()
        y, before, begin, spin = run.progress.y.copy(), clock.copy(), run.time, self.contact.spin.copy()
        span = gap / bound
        run.limits = run.limits._replace(stop=min(begin + span, stop))
        code = status.RUNNING
        while code == status.RUNNING:
            code = self._advance()
            raise_if_cancelled()
        run.limits = run.limits._replace(stop=stop)
        if code not in (status.OK, status.LIMIT):
            return code
        gap, speed, _ = core.clearance(run.chain, run.drive, self.contacts, run.time, run.progress.y, 0.0)
        if np.isfinite(span) and (speed > bound or gap <= 0.0):
            with deferred():
                run.progress.y[:], clock[:], self.contact.spin[:] = y, before, spin
                return self._touch(begin + span)
        self.flights, self.flown = self.flights + 1, self.flown + run.time - begin
        for array in self.contact.memory:
            array[:] = 0
        if code == status.LIMIT:
            self.contact.clock[at.IMPACT_DUE] = 1.0
            return status.LEFT
        return status.RUNNING if run.time < stop else status.OK

    def _lock(self) -> None:
        """Set the rates of stuck joints to rest, as free flight needs; the proximal method leaves small ones."""
        if not self.contact.memory.bent.any():
            return
        run, base, n = self.run, np.empty(9), self.run.chain.length.size
        motion_at(run.drive, run.time, base)
        for i in np.flatnonzero(self.contact.memory.bent == STICK):
            run.progress.y[n + i] = run.progress.y[n + i - 1] if i > 0 else base[3]

    def _advance(self) -> int:
        """Fly on for one budget of steps; pegs that turn coast meanwhile, also where Ctrl-C ends the flight."""
        run, begin, row = self.run, self.run.time, self.run.done
        try:
            return run.advance()
        finally:
            if self.setup.pegs_turn and run.seen is not None:
                n, m = run.chain.length.size, self.contact.spin.shape[1]
                spins, taken = coast(self.setup, self.contact.spin, np.append(run.t[row : run.done], run.time) - begin)
                run.seen[row : run.done, 3 * n + 4 :] = spins[:-1].reshape(-1, 2 * m)
                run.y[row : run.done, 2 * n + 1] += taken[:-1]
                run.progress.y[2 * n + 1] += taken[-1]
                self.contact.spin[:] = spins[-1]

    def _touch(self, least: float = -np.inf) -> int:
        """Step with contacts until the rope has left the pegs, and at least until `least`, s."""
        run, clock, contact = self.run, self.run.progress.clock, self.contact
        scale = self._energy()
        friction = float(run.chain.viscous.max())
        rate = self.looser * scale * (RULE.gain if friction >= RULE.low_friction else RULE.gain_free)
        contact.clock[at.T], contact.clock[at.INDEX] = clock[T], clock[INDEX]
        always = bool(self.pull.any())  # free flight knows no force on the tip
        forced = run.time < least
        stop = min(run.limits.stop, least) if forced else run.limits.stop
        clear = np.inf if always or forced else self.clear
        bounds = at.Bounds(stop, self.longest, self.setup.tol, rate, clear, RULE.slack, RULE.budget)
        with deferred():  # else state and clock would not fit together
            code = int(
                core.run(run.chain, run.drive, self.contacts, self.pull, bounds, contact, run.t, run.y, run.seen)
            )
            index = contact.clock[at.INDEX]
            clock[:MARK] = starting_clock(float(contact.clock[at.T]))
            clock[INDEX], clock[MARK] = index, -np.inf
        return status.RUNNING if code == status.OK and run.time < run.limits.stop else code

    def _energy(self) -> float:
        """Energy scale, J: kinetic, potential by a fall of the whole rope, and by the force on the tip or a torque."""
        run = self.run
        chain, n, base = run.chain, run.chain.length.size, np.empty(9)
        motion_at(run.drive, run.time, base)
        y = run.progress.y
        kinetic, _ = energies(chain, y[:n], y[n : 2 * n], base, np.empty(2 * n))
        kinetic += float(spin_energy(self.setup, self.contact.spin[1]))
        lever = chain.length.sum()
        mass = chain.mass.sum() + chain.tip_mass
        torque = float(np.abs(run.drive.coef[:, 3]).max()) if n else 0.0
        return float(kinetic + mass * np.hypot(chain.gx, chain.gy) * lever + np.hypot(*self.pull) * lever + torque)

    def _facts(self) -> dict[str, float]:
        clock, (brief, lasting) = self.contact.clock, self.contact.torque
        return {
            "contact_steps": float(clock[at.TAKEN]),
            "contact_unsolved": float(clock[at.UNSOLVED]),
            "contact_impacts": float(clock[at.IMPACTS]),
            "contact_deepest": float(clock[at.DEEPEST]),
            "limit_passed": float(clock[at.BEND]),
            "energy_appeared": float(clock[at.ENERGY_GAIN]),
            "free_flights": float(self.flights),
            "free_time": self.flown,
            "torque_peak": float(brief[PEAK]),
            "torque_peak_time": float(brief[WHEN]),
            "torque_mean": float(lasting[PEAK]),
            "torque_mean_time": float(lasting[WHEN]),
        }


def contact_run(run: Rollout, setup: Setup, state: State | None) -> ContactRun:
    """Make a prepared rollout one beside the pegs of its set-up, and within the limits of its joints.

    A start inside a peg, or past a limit, is refused.
    """
    check_start(setup, run.time, run.progress.y[: run.chain.length.size])
    return ContactRun(run, setup, state)


class ContactSamples(NamedTuple):
    """Contact outputs of a run at its samples."""

    free: npt.NDArray[np.bool_]  # (T,) samples in free flight
    qdd: Array  # (T, n) rad/s^2; NaN there
    force: Array  # (T, n, 2) of the pegs on the links, N; 0 there
    load: Array  # (T, 3) force, N, and torque, N m, at the first joint; NaN there
    loss: Array  # (T,) energy lost to contact since the start of the run, J
    spin: Array  # (T, 2, m) angles, rad, and rates, rad/s, of the obstacles; of those that turn


def split_samples(seen: Array, n: int) -> ContactSamples:
    """Split contact outputs (T, 3 n + 4 + 2 m) of n links and m obstacles into their parts."""
    free = np.isnan(seen[:, 0])
    force = np.stack([seen[:, n : 2 * n], seen[:, 2 * n : 3 * n]], axis=-1)
    latest = np.maximum.accumulate(np.where(free, -1, np.arange(free.size)))  # contact loses nothing in free flight
    loss = np.where(latest < 0, 0.0, seen[np.maximum(latest, 0), 3 * n + 3])
    spin = seen[:, 3 * n + 4 :].reshape(free.size, 2, (seen.shape[1] - 3 * n - 4) // 2)
    return ContactSamples(
        free, seen[:, :n], np.where(free[:, None, None], 0.0, force), seen[:, 3 * n : 3 * n + 3], loss, spin
    )
