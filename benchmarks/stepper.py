"""Stepwise runs: cost of a step beyond its share of one long run, and the difference of the results."""

import statistics
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from cast import FRICTION, PAPER_LINKS, cable, distance_mm
from clock import NOTE, alternately

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.simulation import Rollout

DT, SECONDS, SWITCH = 1 / 30, 10.0, 0.5  # s: an interval, a run, and between changes of the command's sense
ARM = hf.Arm(length=0.105, inertia=2e-3, friction=1e-3)
PEG = hf.Peg(0.2, -1.0, 0.03, mu=0.3)
SIZES = {"acceleration": 12.0, "torque": 0.02}  # rad/s^2, N m
LINKS, QUICK_LINKS = (10, 20, PAPER_LINKS, 100, 200), (PAPER_LINKS,)
MEMBERS, BATCH_LINKS, RATE, BATCH_SECONDS = 256, 20, 50.0, 2.0  # Hz, s
THREADS = (1, 2)
TIGHT = 1e-9  # m, tolerance of the reference for errors
BUDGET = 6.0  # s of processor time for one entry
AIM, BATCH_AIM = 60.0, 50_000.0  # us a step beyond its share of one run, at 50 links; member-steps/s


@dataclass(frozen=True)
class Ride:
    """A rope on an arm under commands (K,), one for each interval: as a stepper, and as one run with the same
    switches."""

    rope: hf.Rope
    command: str
    given: Array
    pegs: tuple[hf.Peg, ...] = ()

    def steps(self, tol: float = 1e-5) -> Callable[[], hf.State]:
        """Return a function that takes all steps."""
        stepper = hf.Stepper(self.rope, arm=ARM, command=self.command, tol=tol, pegs=self.pegs, refine=False)
        start = stepper.start()
        stepper.step(start, 0.0, DT)  # loads the kernels

        def run() -> hf.State:
            state = start
            for u in self.given:
                state = stepper.step(state, u, DT)
            return state

        return run

    def setup(self) -> hf.Setup:
        """Return the set-up as one run."""
        coef, angle, rate = np.zeros((self.given.size, 4, 6)), 0.0, 0.0
        for piece, u in zip(coef, self.given, strict=True):
            if self.command == "torque":
                piece[3, 0] = u
            else:
                piece[0, :3] = angle, rate, 0.5 * u
                angle, rate = angle + DT * (rate + 0.5 * DT * u), rate + DT * u
        moves = hf.Motion(DT * np.arange(self.given.size + 1), coef, np.ones(self.given.size + 1, dtype=np.bool_))
        driven = {"torque" if self.command == "torque" else "motion": moves}
        return hf.Setup(self.rope, arm=ARM, duration=DT * self.given.size, pegs=self.pegs, **driven)

    def whole(self) -> Callable[[], Array]:
        """Return a function that computes one run, on plain arrays without a peg, and returns the angles at the end."""
        setup = self.setup()
        end = setup.duration
        if self.pegs:
            return lambda: hf.simulate(setup, t_eval=[end]).q[-1]
        chain, drive = setup.chain(), setup.drive()

        def run() -> Array:
            rollout = Rollout(setup, np.array([0.0, end]), chain=chain, drive=drive)
            rollout.complete()
            return rollout.y[-1, rollout.links[0]]

        return run


def tip(rope: hf.Rope, q: Array) -> Array:
    """Tip (1, 2) from the first joint, m."""
    return hf.forward_kinematics(rope, q)[None, -1]


def rides(quick: bool) -> dict[str, Ride]:
    """All timed cases, by name."""
    count = round(SECONDS / DT)
    sense = 1.0 - 2.0 * (np.floor(DT * np.arange(count) / SWITCH + 0.5) % 2)
    found = {}
    for n in QUICK_LINKS if quick else LINKS:
        for command, size in SIZES.items():
            if command == "acceleration" or n == PAPER_LINKS:
                found[f"{n} links, {command}"] = Ride(cable(n, scaled=True), command, size * sense)
    dry = cable(20, scaled=True).replace(dry_friction=1e-3)
    found["20 links, acceleration, dry friction"] = Ride(dry, "acceleration", SIZES["acceleration"] * sense)
    found["20 links, acceleration, with a peg"] = Ride(
        cable(20, scaled=True), "acceleration", 12.0 * sense[:60], (PEG,)
    )
    return found


def measure(quick: bool, repeats: int, _peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of single steppers, of derivatives, and of batches."""
    every = rides(quick)
    runs = [run for ride in every.values() for run in (ride.steps(), ride.whole())]
    times, rows = alternately(runs, repeats, BUDGET), []
    for k, (name, ride) in enumerate(every.items()):
        one, whole = times[2 * k], times[2 * k + 1]
        beyond = [1e6 / ride.given.size * (a - b) for a, b in zip(one.processor, whole.processor, strict=False)]
        row = {
            "kind": "single",
            "name": name,
            "step_us": one.scaled(1e6 / ride.given.size),
            "in_run_us": whole.scaled(1e6 / ride.given.size),
            "beyond_us": statistics.median(beyond),
            "gap_mm": float(distance_mm(tip(ride.rope, one.result.q), tip(ride.rope, whole.result))[0]),
        }
        if not ride.pegs:
            row["error_mm"] = float(distance_mm(tip(ride.rope, one.result.q), tip(ride.rope, ride.steps(TIGHT)().q))[0])
        rows.append(row)
    return rows + [derivatives(n, repeats) for n in QUICK_LINKS if not quick] + batches(quick, repeats)


def derivatives(n: int, repeats: int) -> dict[str, Any]:
    """Cost of a step with A and B."""
    stepper = hf.Stepper(cable(n, scaled=True), arm=ARM)
    state = stepper.step(stepper.start(), 12.0, 0.5)
    (times,) = alternately([lambda: stepper.linearize(state, 12.0, DT)], repeats, BUDGET)
    return {"kind": "derivatives", "links": n, "step_us": times.scaled(1e6)}


def batches(quick: bool, repeats: int) -> list[dict[str, Any]]:
    """Member-steps a second, and the greatest error of any member's tip."""
    members, dt = 32 if quick else MEMBERS, 1.0 / RATE
    rope, count = cable(BATCH_LINKS, scaled=True), round(BATCH_SECONDS * RATE)
    found = []
    for command, size in SIZES.items():
        given = size * np.repeat(np.random.default_rng(5).uniform(-1.0, 1.0, (count // 10, members)), 10, axis=0)

        def run(threads: int, command: str = command, given: Array = given) -> Callable[[], hf.BatchState]:
            stepper = hf.BatchStepper(rope, members=members, arm=ARM, command=command, threads=threads)
            start = stepper.start()
            stepper.step(start, 0.0, dt)  # loads the kernels

            def steps() -> hf.BatchState:
                state = start
                for row in given:
                    state = stepper.step(state, row, dt)
                return state

            return steps

        runs = alternately([run(threads) for threads in THREADS], repeats, BUDGET)
        alone, errors = hf.Stepper(rope, arm=ARM, command=command, tol=TIGHT), []
        for m in range(members):
            state = alone.start()
            for u in given[:, m]:
                state = alone.step(state, u, dt)
            errors.append(float(distance_mm(tip(rope, runs[0].result.q[m]), tip(rope, state.q))[0]))
        for threads, times in zip(THREADS, runs, strict=True):
            rate = [members * count / seconds for seconds in times.clock]
            found.append(
                {
                    "kind": "batch",
                    "command": command,
                    "members": members,
                    "threads": threads,
                    "member_steps_per_s": statistics.median(rate),
                    "least": min(rate),
                    "most": max(rate),
                    "error_mm": {"median": statistics.median(errors), "greatest": max(errors)},
                }
            )
    return found


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown tables."""
    titles = ("rope and command", "step, µs (least-most)", "in one run, µs", "difference, µs", "gap, mm", "error, mm")
    lines = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|"]
    for row in rows:
        if row["kind"] == "single":
            step = row["step_us"]
            cells = [
                row["name"],
                f"{step['median']:.3g} ({step['least']:.3g}-{step['most']:.3g})",
                f"{row['in_run_us']['median']:.3g}",
                f"{row['beyond_us']:.3g}",
                f"{row['gap_mm']:.1g}",
                f"{row['error_mm']:.2g}" if "error_mm" in row else "",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "| batch | threads | member-steps/s (least-most) | greatest error of a member, mm | median |"]
    lines += ["|---" * 5 + "|"]
    for row in rows:
        if row["kind"] == "batch":
            rate = f"{row['member_steps_per_s']:.3g} ({row['least']:.3g}-{row['most']:.3g})"
            error = row["error_mm"]
            name = f"{row['members']} x {BATCH_LINKS} links, {row['command']}"
            lines.append(f"| {name} | {row['threads']} | {rate} | {error['greatest']:.2g} | {error['median']:.2g} |")
    slopes = [
        f"{row['step_us']['median']:.0f} µs at {row['links']} links" for row in rows if row["kind"] == "derivatives"
    ]
    return "\n".join(lines) + (
        f"\n\nThe paper's cable, friction scaled with n from {FRICTION:g} N m s/rad at {PAPER_LINKS} links, on an arm "
        f"of {1e3 * ARM.length:g} mm, {SECONDS:g} s at {1 / DT:.0f} Hz (with a peg 2 s): commands that change their "
        f"sign every {SWITCH:g} s, by `hf.Stepper` at the default tolerance, compared with one run with the same "
        "switches on plain arrays (with a peg: `simulate`, including its final energies). The gap is the distance "
        f"between the two tips at the end; the error is that of the tip against the stepper at {TIGHT:g} m. Aim: at "
        f"most {AIM:g} µs a step beyond its share of one run at {PAPER_LINKS} links. "
        + (f"A step with its derivatives A and B: {', '.join(slopes)}. " if slopes else "")
        + f"Batches by `hf.BatchStepper` at {RATE:g} Hz for {BATCH_SECONDS:g} s, each member with its own commands, "
        f"elapsed time; errors of every member against a single stepper at {TIGHT:g} m. Aim: at least {BATCH_AIM:,.0f} "
        f"member-steps/s on two threads. {NOTE}"
    )
