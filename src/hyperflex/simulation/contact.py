"""Runs with pegs or joint limits: free flight, contact steps, and the hand-over.

A flight is so short that no joint can reach a peg meanwhile, as far as the speeds at its ends tell; where they rose by
more than was allowed for, it is flown again by the stepper for contacts. A flight ends where a joint reaches its limit.
"""

from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.articulated_body import can_stick, energies
from hyperflex.core.chain.drive import TORQUE, Drive
from hyperflex.core.chain.torque_peaks import COLUMNS, PEAK, WHEN, WINDOWS
from hyperflex.core.contact import run as at
from hyperflex.core.contact.arrays import STICK
from hyperflex.core.contact.memory import new_contact_memory
from hyperflex.core.contact.run import Scene
from hyperflex.core.integrate.rollout import INDEX, MARK, Limits, T
from hyperflex.errors import InvalidInput
from hyperflex.interruption import deferred, raise_if_cancelled
from hyperflex.model import DEFAULT_TOL, Setup, obstacle_gaps, round_places, unit_along
from hyperflex.simulation.rollouts import Rollout, base_motion, starting_clock
from hyperflex.trajectory import State

SHALLOW = 5e-4  # m, penetration that may be there at the start: a polygon laid on a circle by its joints has some
PASSED = 1e-3  # rad, by which a joint may be past its limit at the start


def check_outside(
    setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope", drive: Drive | None = None
) -> None:
    """Refuse a start at t, s, whose rope is inside an obstacle by more than SHALLOW.

    q (n,), rad, are the angles of the chain's links there, by default those that the set-up starts from, and `drive`
    what drives it, by default that of the set-up; the message is about `who`, and names the link that is deepest
    inside, the obstacle and the depth.
    """
    if not setup.pegs:
        return
    q, base = setup.start()[0] if q is None else q, base_motion(drive or setup.drive(), t)
    steps = setup.chain().length[:, None] * unit_along(q)
    joints = np.cumsum([base[7:9], *steps], axis=0)[int(setup.torque_driven) :]
    depths = setup.rope.radius - obstacle_gaps(setup.pegs, joints[:-1], joints[1:])
    p, i = np.unravel_index(int(depths.argmax()), depths.shape)
    if depths[p, i] <= SHALLOW:
        return
    raise InvalidInput(
        f"{who} starts inside an obstacle: link {i} is {1e3 * depths[p, i]:.3g} mm deep in it",
        got=setup.pegs[p],
        allowed=f"at most {1e3 * SHALLOW:g} mm",
        fix="Give a q0 that keeps clear of it, or move the obstacle",
    )


def check_start(
    setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope", drive: Drive | None = None
) -> None:
    """Refuse a start inside an obstacle, or with a joint bent past its limit by more than PASSED.

    Arguments are as for :func:`check_outside`.
    """
    check_outside(setup, t, q, who, drive)
    if not setup.rope.limited:
        return
    chain, base = setup.chain(), base_motion(drive or setup.drive(), t)
    bend = np.diff(setup.start()[0] if q is None else q, prepend=base[4]) - chain.rest
    past = np.abs(bend) - chain.max_bend
    i = int(np.argmax(past))
    if past[i] > PASSED:
        raise InvalidInput(
            f"{who} starts past a limit: joint {i - int(setup.torque_driven)} is bent by {bend[i]:+.4g} rad from rest",
            got=float(bend[i]),
            allowed=f"at most max_bend = {chain.max_bend[i]:.4g} rad",
            fix="Give a q0 that bends less there, or max_bend = inf for a joint that turns freely",
        )


SHOWN = ("peg_angle", "peg_rate")  # of a State, and of a Trajectory
STEP = "contact_step"
# in a state's checkpoint, in the order of ``contact.memory.ContactMemory``
KEPT = (
    "contact_normal",
    "contact_tangent",
    "contact_mode",
    "contact_penalty",
    "joint_torque",
    "joint_mode",
)


# The hand-over between free flight and contact steps
SHORTEST_FLIGHT = 0.01  # s; the hand-over takes more time than a shorter flight saves
FLIGHT_STEPS = 25.0  # the same in contact steps: long ones take little time
FASTER, SUDDEN = 2.0, 2.0  # a flight allows for speeds so many times as large, and for so much more, m/s
# Of the run's tolerance: four ropes, with dry friction and without, gained and lost up to 1e-7 of the energy scale for
# each second in flights with this part of the default tolerance, up to 2e-6 with ten times as much
FLIGHT_TOL = 1e-2
# m, above this tolerance a run is coarse: near pegs a rope with dry friction takes contact steps everywhere, as in free
# flight each of its joints sticks at an exact event, and more energy may appear (below). Of 195 runs of nine ropes with
# 1e-3 58 wound, 51 of these with 1e-5 as well, in 0.43 of the time (with coarser friction in contact steps, too);
# before, 48 of 52
COARSE_TOL = 1e-4
SLACK = 0.01  # rad, gap at which a joint has left its limit
CLEAR = 0.03  # m, gap at which a rope that was in contact has left, unless it is so fast that it would be back at once
# Energy that may appear at the default tolerance, in parts of the energy scale for each second: if joint friction is at
# least LOW_FRICTION, N m s/rad, and if it is lower or the run coarse. Then the rope's own motion sets the steps.
GAIN, GAIN_FREE, LOW_FRICTION = 1e-6, 1e-4, 1e-4
BUDGET = 250  # steps between two checks of the budget and of interrupts; some take milliseconds
# Facts of a trajectory, from the clock of the contact steps
FACTS = {
    "contact_steps": at.TAKEN,
    "contact_unsolved": at.UNSOLVED,
    "contact_impacts": at.IMPACTS,
    "contact_deepest": at.DEEPEST,
    "limit_passed": at.BEND,
    "energy_appeared": at.ENERGY_GAIN,
}


class ContactRollout(Rollout):
    """A rollout with pegs, or of a rope whose joints have limits; arguments are as of :class:`Rollout`."""

    def __init__(self, setup: Setup, t: Array, *, drive: Drive | None = None, limits: Limits | None = None) -> None:
        super().__init__(setup, t, drive=drive, limits=limits)
        self.contacts, n = setup.contacts(), self.chain.length.size
        m = self.contacts.x.size
        if setup.pegs:
            self.limits = self.limits._replace(tol=FLIGHT_TOL * setup.tol)
        # what the contact steps see at each output; NaN in free flight, but for the spin of pegs that turn
        self.seen = np.full((t.size, 3 * n + 4 + 2 * m), np.nan)
        memory, torque = new_contact_memory(n, m), np.zeros((len(WINDOWS), COLUMNS))
        self.contact = at.ContactState(self.progress.y, np.zeros(at.CLOCK), np.zeros((2, m)), memory, torque)
        self.turning, self.round = np.flatnonzero(np.isfinite(self.contacts.inertia)), round_places(setup.pegs)
        self.flights, self.flown, self.flying, self.clear = 0, 0.0, False, CLEAR
        self.coarse = setup.tol > COARSE_TOL
        # Free flight knows no force on the tip
        self.flies = not any(setup.tip_force) and not (self.coarse and setup.pegs and can_stick(self.chain))
        self._begin(None)

    def check_start(self) -> None:
        """Refuse to begin where the run is if that is inside an obstacle or past a joint's limit."""
        check_start(self.setup, self.time, self.progress.y[: self.chain.length.size], drive=self.drive)

    def resume(self, state: State) -> bool:
        """Continue from a state, with its forces and modes of contacts, if any; see :meth:`Rollout.resume`."""
        as_saved = super().resume(state)
        self._begin(state)
        return as_saved and STEP in state.checkpoint

    def _begin(self, state: State | None) -> None:
        """Begin anew where the run is; forces and modes of contacts are those of `state`, if any."""
        contact, saved = self.contact, {} if state is None else state.checkpoint
        contact.clock[:] = 0.0
        contact.clock[at.STEP], contact.clock[at.IMPACT_DUE] = self.setup.contact_step, 1.0
        contact.spin[:] = 0.0
        for row, name, unit in zip(contact.spin, SHOWN, ("rad", "rad/s"), strict=True):
            if (given := getattr(state, name, None)) is None:
                continue
            row[self.round] = checks.array(f"state {name}", given, (len(self.round),), unit=unit)
            if np.delete(row, self.turning).any():
                got, fix = row[self.round].tolist(), "Give the peg an inertia"
                raise InvalidInput(f"state {name} turns a fixed peg", got=got, allowed="0 there", fix=fix)
        for name, array in zip(KEPT, contact.memory, strict=True):
            array[:] = saved[name] if np.shape(saved.get(name, ())) == array.shape else 0
        if STEP in saved and np.array_equal(saved["y"], contact.y):
            step = min(float(saved[STEP]), self.setup.contact_step)
            contact.clock[at.STEP], contact.clock[at.IMPACT_DUE] = step, 0.0

    def advance(self) -> int:
        """Fly, or step with contacts, for one budget of steps and return the status code."""
        code = self._fly()
        return self._touch() if code == status.LEFT else code

    def _fly(self) -> int:
        """Fly freely while no peg or limit can be reached: LEFT if one may be, RUNNING or OK after a flight."""
        y, clock, stop = self.progress.y, self.progress.clock, self.limits.stop
        if self.time >= stop:
            return status.OK
        if not self.flies:
            return status.LEFT
        gap, speed, left = at.clearance(self.chain, self.drive, self.contacts, self.time, y, 0.0)
        bound = FASTER * speed + SUDDEN
        self.clear = max(CLEAR, max(SHORTEST_FLIGHT, FLIGHT_STEPS * self.setup.contact_step) * bound)
        if gap < self.clear or left <= SLACK:
            return status.LEFT
        self._lock()
        before, begin, span = (y.copy(), clock.copy(), self.contact.spin.copy()), self.time, gap / bound
        self.limits = self.limits._replace(stop=min(begin + span, stop))
        code, self.flying = status.RUNNING, True
        while code == status.RUNNING:
            code = self._coast()
            raise_if_cancelled()
        self.flying = False
        self.limits = self.limits._replace(stop=stop)
        clock[MARK] = -np.inf  # the run continues from where it is
        if code not in (status.OK, status.LIMIT):
            return code
        gap, speed, _ = at.clearance(self.chain, self.drive, self.contacts, self.time, y, 0.0)
        if np.isfinite(span) and (speed > bound or gap <= 0.0):
            with deferred():
                y[:], clock[:], self.contact.spin[:] = before
                return self._touch(begin + span)
        self.flights, self.flown = self.flights + 1, self.flown + self.time - begin
        for array in self.contact.memory:
            array[:] = 0
        if code == status.LIMIT:
            self.contact.clock[at.IMPACT_DUE] = 1.0
            return status.LEFT
        return status.RUNNING if self.time < stop else status.OK

    def _lock(self) -> None:
        """Set the rates of joints that creep to rest: in free flight they stick."""
        rates = self.progress.y[self.chain.length.size : -2]
        for i in np.flatnonzero(self.contact.memory.bent == STICK):
            rates[i] = rates[i - 1] if i > 0 else base_motion(self.drive, self.time)[3]

    def _coast(self) -> int:
        """Fly on for one budget of steps; pegs that turn coast meanwhile, also where Ctrl-C ends the flight."""
        begin, row = self.time, self.done
        try:
            return super().advance()
        finally:
            if self.turning.size:  # their rates decay exponentially
                rows, pegs, (angle, rate) = slice(row, self.done), self.contacts, self.contact.spin
                spans = np.append(self.t[rows], self.time)[:, None] - begin
                x = spans * pegs.bearing / pegs.inertia
                mean = np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
                spins = np.stack([angle + spans * mean * rate, np.exp(-x) * rate], axis=1)
                taken = self.spin_energy(rate) - self.spin_energy(spins[:, 1])
                self.spins[rows], self.contact.spin[:] = spins[:-1], spins[-1]
                self.y[rows, -1] += taken[:-1]
                self.progress.y[-1] += taken[-1]

    def _touch(self, least: float = -np.inf) -> int:
        """Step with contacts until the rope has left the pegs, and at least until `least`, s."""
        setup, clock, contact = self.setup, self.progress.clock, self.contact
        gain = GAIN_FREE if self.coarse or self.chain.viscous.max() < LOW_FRICTION else GAIN
        rate = setup.tol / DEFAULT_TOL * self._energy() * gain
        contact.clock[at.T], contact.clock[at.INDEX] = clock[T], clock[INDEX]
        forced = self.time < least
        stop = min(self.limits.stop, least) if forced else self.limits.stop
        clear = np.inf if forced or not self.flies else self.clear
        bounds = at.Bounds(stop, setup.contact_step, setup.tol, rate, clear, SLACK, BUDGET)
        with deferred():  # else state and clock would not fit together
            scene = Scene(self.chain, self.drive, self.contacts, np.array(setup.tip_force))
            code = int(at.run(scene, bounds, contact, self.t, self.y, self.seen))
            clock[:MARK] = starting_clock(float(contact.clock[at.T]))
            clock[INDEX], clock[MARK] = contact.clock[at.INDEX], -np.inf
        return status.RUNNING if code == status.OK and self.time < self.limits.stop else code

    def _energy(self) -> float:
        """Energy scale, J: kinetic, potential by a fall of the whole rope, and by the force on the tip or a torque."""
        chain, y, n = self.chain, self.progress.y, self.chain.length.size
        base = base_motion(self.drive, self.time)
        kinetic, _ = energies(chain, y[:n], y[n : 2 * n], base, np.empty(2 * n))
        weight = (chain.mass.sum() + chain.tip_mass) * np.hypot(chain.gx, chain.gy)
        moved = (weight + np.hypot(*self.setup.tip_force)) * chain.length.sum()
        torque = np.abs(self.drive.coef[:, TORQUE]).max()
        return float(kinetic + self.spin_energy(self.contact.spin[1]) + moved + torque)

    def facts(self) -> dict[str, float]:
        """Return counts and extremes of contacts for the trajectory."""
        facts = {name: float(self.contact.clock[row]) for name, row in FACTS.items()}
        facts |= {"free_flights": float(self.flights), "free_time": self.flown}
        for name, window in zip(("torque_peak", "torque_mean"), self.contact.torque, strict=True):
            facts |= {name: float(window[PEAK]), f"{name}_time": float(window[WHEN])}
        return facts

    def kept(self) -> dict[str, Any]:
        """Return what the contacts of a run that continues need, by name; nothing in the middle of a flight."""
        if self.flying:
            return {}
        names = zip(KEPT, self.contact.memory, strict=True)
        return {STEP: float(self.contact.clock[at.STEP]), **{name: array.copy() for name, array in names}}

    @property
    def spins(self) -> Array:
        """Angles, rad, and rates, rad/s, of all obstacles at the outputs (T, 2, m), a view of what was seen."""
        return self.seen[:, 3 * self.chain.length.size + 4 :].reshape(len(self.seen), 2, self.contacts.x.size)

    def shown(self, row: int | None) -> dict[str, Any]:
        """Return angles and rates of the round pegs by name, at an output or at the time reached; {} if none turns."""
        return self._turned(self.contact.spin if row is None else self.spins[row])

    def _turned(self, spin: Array) -> dict[str, Any]:
        """Return angles and rates (..., P) of the round pegs by name, from all obstacles (..., 2, m)."""
        turning = np.where(np.isfinite(self.contacts.inertia), spin, 0.0)[..., self.round]
        return {name: turning[..., row, :].copy() for row, name in enumerate(SHOWN) if self.turning.size}

    def spin_energy(self, rates: Array) -> Array:
        """Return the kinetic energy (...,), J, of pegs with rates (..., m), rad/s; what is fixed has none."""
        return np.asarray(0.5 * (self.contacts.inertia[self.turning] * rates[..., self.turning] ** 2).sum(axis=-1))

    def outputs(self, rows: slice, qdd: Array, scalars: Array) -> dict[str, Any]:
        """Return the contact outputs of a trajectory at some samples, by name.

        Where the rope touches, its accelerations and loads become those in contact: `qdd` (k, n) and `scalars` (k, 5)
        of :func:`observe`, which follow from (1) in free flight.
        """
        n = self.chain.length.size
        seen = self.seen[rows]
        touched = ~np.isnan(seen[:, 0])
        qdd[touched], scalars[touched, 2:] = seen[touched, :n], seen[touched, 3 * n : 3 * n + 3]
        force = np.stack([seen[:, n : 2 * n], seen[:, 2 * n : 3 * n]], axis=-1)
        force[~touched] = 0.0
        latest = np.maximum.accumulate(np.where(touched, np.arange(touched.size), -1))
        loss = np.where(latest < 0, 0.0, seen[latest, 3 * n + 3])  # contact loses nothing in free flight
        found = {"contact_force": force[:, n - self.setup.rope.n_links :], "contact_loss": loss}
        return found | self._turned(self.spins[rows])
