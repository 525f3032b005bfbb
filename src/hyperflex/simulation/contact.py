"""Runs with pegs or joint limits: free flight, contact steps, and the hand-over.

A flight is so short that no joint can reach a peg meanwhile, as far as the speeds at its ends tell; where they rose by
more than was allowed for, it is flown again by the stepper for contacts. A flight ends where a joint reaches its limit.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.core.chain.articulated_body import energies
from hyperflex.core.chain.drive import motion_at
from hyperflex.core.chain.torque_peaks import COLUMNS, PEAK, WHEN, WINDOWS
from hyperflex.core.contact import run as at
from hyperflex.core.contact.arrays import STICK, new_contact_memory
from hyperflex.core.contact.gaps import Pegs
from hyperflex.core.contact.run import Scene
from hyperflex.core.integrate.rollout import INDEX, MARK, T
from hyperflex.errors import InvalidInput
from hyperflex.interruption import deferred, raise_if_cancelled
from hyperflex.model import DEFAULT_TOL, Setup, Wall, round_places
from hyperflex.simulation.rollouts import Rollout, starting_clock
from hyperflex.trajectory import State

SHALLOW = 5e-4  # m, penetration that may be there at the start: a polygon laid on a circle by its joints has some
PASSED = 1e-3  # rad, by which a joint may be past its limit at the start


def check_outside(setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope") -> None:
    """Refuse a start at t, s, whose rope is inside an obstacle by more than SHALLOW.

    q (n,), rad, are the angles of the chain's links there, by default those that the set-up starts from; the message is
    about `who`, and names the link that is deepest inside, the obstacle and the depth.
    """
    if not setup.pegs:
        return
    chain, drive, pegs = setup.chain(), setup.drive(), setup.contacts()
    q = setup.start()[0] if q is None else q
    base = np.empty(9)
    motion_at(drive, t, base)
    steps = chain.length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=1)
    joints = np.concatenate([base[None, 7:9], base[7:9] + np.cumsum(steps, axis=0)])
    found = depths(pegs, joints)
    i, p = np.unravel_index(int(np.argmax(found)), found.shape)
    if found[i, p] <= SHALLOW:
        return
    rows = [each for each in setup.pegs for _ in range(3 if isinstance(each, Wall) else 1)]  # as ``packed`` makes them
    raise InvalidInput(
        f"{who} starts inside an obstacle: link {i - pegs.first} is {1e3 * found[i, p]:.3g} mm deep in it",
        got=rows[p],
        allowed=f"at most {1e3 * SHALLOW:g} mm",
        fix="Give a q0 that keeps clear of it, or move the obstacle",
    )


def check_start(setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope") -> None:
    """Refuse a start inside an obstacle or past a joint's limit; arguments as for :func:`check_outside`."""
    check_outside(setup, t, q, who)
    check_limits(setup, t, q, who)


def check_limits(setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope") -> None:
    """Refuse a start with a joint bent past its limit by more than PASSED; arguments as for :func:`check_outside`."""
    if not setup.rope.limited:
        return
    chain, drive, base = setup.chain(), setup.drive(), np.empty(9)
    motion_at(drive, t, base)
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


def depths(pegs: Pegs, joints: Array) -> Array:
    """Return how deep each link is in each obstacle (n, m), m; negative where it is clear; joints (n + 1, 2), m.

    A link across a wall counts as deep as the nearer of its ends is far from it, and the reach.
    """
    away = joints[:, None] - np.stack([pegs.x, pegs.y], axis=1)  # (n + 1, m, 2)
    begin, link = away[:-1], np.diff(away, axis=0)
    part = np.clip(-(begin * link).sum(axis=2) / (link**2).sum(axis=2), 0.0, 1.0)
    from_centre = np.linalg.norm(begin + part[:, :, None] * link, axis=2)
    s = away[..., 0] * pegs.ux + away[..., 1] * pegs.uy  # along a face, and out of it
    d = away[..., 1] * pegs.ux - away[..., 0] * pegs.uy
    crossing = d[:-1] * d[1:] < 0.0
    at = s[:-1] + np.diff(s, axis=0) * d[:-1] / np.where(crossing, -np.diff(d, axis=0), 1.0)
    across = crossing & (at >= 0.0) & (at <= pegs.span)
    kinds = [pegs.span == 0.0, pegs.span == np.inf, across, (s[1:] >= 0.0) & (s[1:] <= pegs.span)]
    gaps = [from_centre, d[1:], -np.minimum(np.abs(d[:-1]), np.abs(d[1:])), np.abs(d[1:])]
    result = pegs.reach - np.select([np.broadcast_to(kind, crossing.shape) for kind in kinds], gaps, np.inf)
    result[: pegs.first] = -np.inf
    return np.asarray(result)


SHOWN = ("peg_angle", "peg_rate")  # of a State, and of a Trajectory


def starting_spin(setup: Setup, state: State | None) -> Array:
    """Return angles, rad, and rates, rad/s, of all obstacles at the start (2, m): 0 unless a state says otherwise."""
    places, turning = round_places(setup.pegs), turning_inertia(setup)
    spin = np.zeros((2, turning.size))
    for row, name, unit in zip(spin, SHOWN, ("rad", "rad/s"), strict=True):
        if state is None or (given := getattr(state, name)) is None:
            continue
        row[places] = checks.array(f"state {name}", given, (len(places),), unit=unit)
        if row[turning == 0.0].any():
            fix = "Give the peg an inertia"
            raise InvalidInput(f"state {name} turns a fixed peg", got=row[places].tolist(), allowed="0 there", fix=fix)
    return spin


def turning_inertia(setup: Setup) -> Array:
    """Return the moments of inertia (m,), kg m^2, of the obstacles that turn; 0 of others."""
    inertia = setup.contacts().inertia
    return np.where(np.isfinite(inertia), inertia, 0.0)


def coast(setup: Setup, spin: Array, spans: Array) -> tuple[Array, Array]:
    """Return what pegs that nothing touches do: exponential decay of their rates, exactly.

    `spin` (2, m) are angles, rad, and rates, rad/s, before; the answer (k, 2, m) is for the times since then, `spans`
    (k,), s, and comes with the energy (k,) that the axles took meanwhile, J.
    """
    pegs = setup.contacts()
    x = spans[:, None] * pegs.bearing / pegs.inertia
    mean = np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
    spins = np.stack([spin[0] + spans[:, None] * mean * spin[1], np.exp(-x) * spin[1]], axis=1)
    return spins, np.asarray((-0.5 * np.expm1(-2.0 * x) * turning_inertia(setup) * spin[1] ** 2).sum(axis=1))


def spin_energy(setup: Setup, rates: Array) -> Array:
    """Return the kinetic energy (...,), J, of pegs with rates (..., m), rad/s; what is fixed has none."""
    inertia = turning_inertia(setup)
    turns = inertia > 0.0
    return np.asarray(0.5 * (inertia[turns] * rates[..., turns] ** 2).sum(axis=-1))


def shown(setup: Setup, spin: Array | None) -> dict[str, Any]:
    """Return angles and rates (..., P) of the round pegs by name, from all obstacles (..., 2, m); {} if none turns."""
    if spin is None or not setup.pegs_turn:
        return {}
    turning = np.where(turning_inertia(setup) > 0.0, spin, 0.0)[..., round_places(setup.pegs)]
    return {name: turning[..., row, :].copy() for row, name in enumerate(SHOWN)}


STEP = "contact_step"
# in a state's checkpoint, in the order of ``contact.arrays.ContactMemory``
KEPT = ("contact_normal", "contact_tangent", "contact_mode", "contact_penalty", "joint_torque", "joint_mode")


# The hand-over between free flight and contact steps
SHORTEST_FLIGHT = 0.01  # s; the hand-over takes more time than a shorter flight saves
FASTER, SUDDEN = 2.0, 2.0  # a flight allows for speeds so many times as large, and for so much more, m/s
FLIGHT_TOL = 1e-3  # of the run's: with all of it a flight would gain and lose more energy than contact may
SLACK = 0.01  # rad, gap at which a joint has left its limit
CLEAR = 0.03  # m, gap at which a rope that was in contact has left, unless it is so fast that it would be back at once
# Energy that may appear at the default tolerance, in parts of the energy scale for each second: if joint friction is at
# least LOW_FRICTION, N m s/rad, and if it is lower. Then the rope's own motion sets the steps.
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


class ContactRun:
    """A rollout with pegs, or of a rope whose joints have limits.

    The `run` is prepared, and resumed if it goes on from a `state`; its arrays are filled.
    """

    def __init__(self, run: Rollout, setup: Setup, state: State | None) -> None:
        contacts = setup.contacts()
        n, m = run.chain.length.size, contacts.x.size
        self.looser = setup.tol / DEFAULT_TOL
        if setup.pegs:
            run.limits = run.limits._replace(tol=FLIGHT_TOL * setup.tol)
        self.run, self.setup = run, setup
        self.contacts = contacts
        self.pull, self.longest = np.array(setup.tip_force), setup.contact_step
        run.spin, run.seen = np.zeros((2, m)), np.full((run.t.size, 3 * n + 4 + 2 * m), np.nan)
        torque = np.zeros((len(WINDOWS), COLUMNS))
        self.contact = at.ContactState(run.progress.y, np.zeros(at.CLOCK), run.spin, new_contact_memory(n, m), torque)
        self.flights, self.flown, self.clear = 0, 0.0, CLEAR
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
        gap, speed, left = at.clearance(run.chain, run.drive, self.contacts, run.time, run.progress.y, 0.0)
        bound = FASTER * speed + SUDDEN
        self.clear = max(CLEAR, SHORTEST_FLIGHT * bound)
        if gap < self.clear or left <= SLACK:
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
        gap, speed, _ = at.clearance(run.chain, run.drive, self.contacts, run.time, run.progress.y, 0.0)
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
        rate = self.looser * scale * (GAIN if friction >= LOW_FRICTION else GAIN_FREE)
        contact.clock[at.T], contact.clock[at.INDEX] = clock[T], clock[INDEX]
        always = bool(self.pull.any())  # free flight knows no force on the tip
        forced = run.time < least
        stop = min(run.limits.stop, least) if forced else run.limits.stop
        clear = np.inf if always or forced else self.clear
        bounds = at.Bounds(stop, self.longest, self.setup.tol, rate, clear, SLACK, BUDGET)
        with deferred():  # else state and clock would not fit together
            scene = Scene(run.chain, run.drive, self.contacts, self.pull)
            code = int(at.run(scene, bounds, contact, run.t, run.y, run.seen))
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
        facts = {name: float(self.contact.clock[row]) for name, row in FACTS.items()}
        facts |= {"free_flights": float(self.flights), "free_time": self.flown}
        for name, window in zip(("torque_peak", "torque_mean"), self.contact.torque, strict=True):
            facts |= {name: float(window[PEAK]), f"{name}_time": float(window[WHEN])}
        return facts


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
