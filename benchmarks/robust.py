"""Casting a rope with uncertain parameters: stated and observed success, and the gain of the closed loop.

python -m benchmarks.robust --count 30           the first 30 targets of benchmarks.casting; hours
python -m benchmarks.robust --level 2            twice the standard deviations
python -m benchmarks.robust --count 30 --fine 4  the first 4 also checked on finer links, in --fine-draws draws
python -m benchmarks.robust --count 2 --out -    short; writes nothing

Each target is planned twice: for uncertain parameters (--time-budget), and for the expected ones only (--nominal), in
seconds of processor time on one thread. Both plans are then simulated in the same fresh draws of rope, peg, motor lag
and timing, with the uncertainty of a realistic identification (``hyperflex.planning.Uncertainty``); in open loop, and
the robust plan in closed loop too (``hyperflex.planning.follow`` on the true state of the drawn rope; simulated time
stops while it decides). A draw succeeds by the same definition as the stated success (``robust_page.definition``);
whether the rope is also held is reported separately.

All simulated. Rows are kept in robust.jsonl: the same command continues an interrupted run. It does not detect a
changed planner: remove the file then.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log as lines
from benchmarks import machine
from benchmarks.casting import ACCURATE, FINER, SEED, TIP, problem, target, targets
from benchmarks.robust_page import page

import hyperflex as hf
from hyperflex import files
from hyperflex.budget import Budget
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.errors import HyperflexError, SimulationError
from hyperflex.planning import (
    CastPlan,
    Moves,
    Problem,
    ScenarioStateSource,
    Uncertainty,
    check_feasibility,
    estimate_success_probability,
    follow_plan,
    plan_cast,
    verify_cast,
)
from hyperflex.planning.outcome import SAMPLE_TIME, evaluate_cast
from hyperflex.planning.rollouts import RolloutBatch, winding_scores
from hyperflex.planning.uncertainty import Scenario

RESULTS = Path(__file__).parent / "results"
STREAM = 31337  # of the draws; planner, stated success and closed loop use other seeds
HELD_TOL, HELD_STEP = 1e-3, 1e-3  # m, s, in checks of the hold, which require a finer run than checks of winding
PLANS = ("robust", "nominal")


def main() -> None:
    """Plan, check, print and write."""
    options = arguments()
    about = machine.describe()
    log = Log(None if options.out == "-" else Path(options.out) / "robust.jsonl")
    rows = []
    for number in targets(options.rope, options.count, seed=options.seed):
        fine, closed = len(rows) < options.fine, len(rows) < options.closed
        rows.append({plan: Case(options, log, number, plan).row(fine, closed) for plan in PLANS})
        print(line(number, rows[-1]), flush=True)
    lines.warn_of_others(log.used, planned=True)
    text = page(rows, vars(options)) + f"\n{machine.sentence(about)} {lines.made(log.used + log.made, 'planner')}\n"
    print(text)
    if log.path is not None:
        name = f"robust-{options.rope}" + (f"-level-{options.level:g}" if options.level != 1.0 else "")
        asked = {option: value for option, value in vars(options).items() if option != "out"}
        told = {"machine": about, "options": asked, "rows": rows}
        files.write_text(log.path.with_name(f"{name}.json"), json.dumps(told, indent=1) + "\n")
        files.write_text(log.path.with_name(f"{name}.md"), text)


def arguments() -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rope", choices=sorted(TIP), default="nominal")
    parser.add_argument("--count", type=int, default=30, help="targets (30)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the targets ({SEED})")
    parser.add_argument("--level", type=float, default=1.0, help="factor on all standard deviations (1)")
    parser.add_argument("--time-budget", type=float, default=90.0, help="s of robust planning a target (90)")
    parser.add_argument("--nominal", type=float, default=30.0, help="s of nominal planning a target (30)")
    parser.add_argument("--draws", type=int, default=40, help="draws in which each plan is simulated (40)")
    parser.add_argument("--closed", type=int, default=30, help="targets where closed loops follow (the first 30)")
    parser.add_argument("--closed-draws", type=int, default=40, help="of the draws, in closed loop (40)")
    parser.add_argument("--closed-nominal", type=int, default=0, help="the same for the nominal plan (0)")
    parser.add_argument("--fine", type=int, default=0, help="targets that are also checked on finer links (0)")
    parser.add_argument("--fine-draws", type=int, default=10, help="draws for that (10)")
    parser.add_argument("--threads", type=int, default=None, help="one a processor")
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    return parser.parse_args()


class Log:
    """Earlier results in a file, one per line; None keeps nothing."""

    def __init__(self, path: Path | None) -> None:
        self.path, rows = path, lines.read(path)
        self.known = {_name(each["key"]): each["found"] for each in rows}
        self.old = {_name(each["key"]): each for each in rows}
        self.used: list[dict[str, Any]] = []
        self.made: list[dict[str, Any]] = []

    def once(self, key: dict[str, Any], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the kept result of a task, or compute and keep it."""
        name = _name(key)
        if name in self.old:
            self.used.append(self.old[name])
        elif name not in self.known:
            found = self.known[name] = make()
            row = {"key": key, "kernels": SOURCE_HASH, "planner": lines.planner(), "found": found}
            self.made.append(row)
            if self.path is not None:
                lines.append(self.path, row)
        return self.known[name]


def _name(key: dict[str, Any]) -> str:
    return json.dumps(key, sort_keys=True)


@dataclass
class Case:
    """One target, planned with one of the two methods."""

    options: argparse.Namespace
    log: Log
    number: int
    plan: str

    def __post_init__(self) -> None:
        self.peg, self.known = target(self.number, self.options.rope, self.options.seed), problem(self.options.rope)
        self.uncertainty = uncertainty(self.options.level)

    def row(self, fine: bool, closed: bool) -> dict[str, Any]:
        """Everything about it."""
        options, peg = self.options, self.peg
        robust = self.plan == "robust"
        time_budget = options.time_budget if robust else options.nominal
        key = {
            "rope": options.rope,
            "seed": options.seed,
            "level": options.level,
            "number": self.number,
            "plan": self.plan,
        }
        made = self.log.once(key | {"work": "plan", "time_budget": time_budget}, lambda: self.planned(time_budget))
        row = {"number": self.number, "x": peg.x, "y": peg.y, "radius": peg.radius, **made}
        if made["throw"] is None:
            return row
        throw = read(made["throw"])
        loops = closed * (options.closed_draws if robust else options.closed_nominal)
        for work, count in (("open", options.draws), ("closed", loops), ("fine", options.fine_draws * fine)):
            if count:
                of = key | {"work": work, "draws": count, "throw": made["throw"]}
                row[work] = self.log.once(of, lambda work=work, count=count: getattr(self, work)(throw, count))
        return row

    def planned(self, time_budget: float) -> dict[str, Any]:
        """The plan and its stated success probability."""
        known = self.uncertainty if self.plan == "robust" else None
        arm, threads = self.known.arm, self.options.threads
        budget = Budget(time_budget, threads=1, clock=time.process_time)
        plan = plan_cast(
            self.known.rope,
            arm,
            self.peg,
            uncertainty=known,
            time_budget=budget,
            options=hf.SearchOptions(skip_feasibility=True, seed=self.number),
        )
        stated = plan.success_probability
        if (stated is None or not stated.samples) and plan.moves is not None:
            stated = estimate_success_probability(
                self.known,
                self.peg,
                plan.moves,
                self.uncertainty,
                options=hf.SearchOptions(seed=self.number, threads=threads),
            )
        return {
            "seconds": round(plan.seconds, 1),
            "planned": plan.success,
            "reason": plan.message,
            "stated": None if stated is None else [stated.successes, stated.samples],
            "throw": None if plan.moves is None else written(plan.moves),
        }

    def worlds(self, count: int, links: Problem | None = None) -> list[Scenario]:
        """Fresh draws, equal for all plans of a target and for any number of links."""
        return self.uncertainty.sample(count, links or self.known, self.peg, seed=[STREAM, self.number])

    def open(self, throw: Moves, count: int) -> dict[str, Any]:
        """Simulate a throw as planned."""
        return self.checked([(throw, world) for world in self.worlds(count)])

    def closed(self, throw: Moves, count: int) -> dict[str, Any]:
        """Follow a throw on the true state of each draw; an aborted throw is a failure."""
        begin, worlds = time.perf_counter(), self.worlds(count)
        plan = CastPlan(self.known, self.peg, check_feasibility(self.known, self.peg), throw)

        def one(k: int) -> tuple[Moves, bool, list[str]]:
            source = ScenarioStateSource(worlds[k], self.known.arm)
            try:
                done = follow_plan(plan, source, threads=1)
            except HyperflexError:
                return throw, True, ["failed"]
            return done.moves, not done.completed, [each.action for each in done.decisions]

        with ThreadPoolExecutor(self.options.threads or os.cpu_count()) as pool:
            found = list(pool.map(one, range(count)))
        words = [word for _, _, decided in found for word in decided]
        row = self.checked([(each, world) for (each, _, _), world in zip(found, worlds, strict=True)])
        for name in ("won", "held"):
            row[name] = [int(won and not gone) for won, (_, gone, _) in zip(row[name], found, strict=True)]
        row |= {word: words.count(word) for word in ("kept", "changed", "aborted", "failed")}
        return row | {"seconds": round(time.perf_counter() - begin, 1)}

    def checked(self, pairs: list[tuple[Moves, Scenario]]) -> dict[str, Any]:
        """The draws that succeed, and those in which the rope is also held."""
        motions = [world.executed_motion(moves.motion(self.known.limits)) for moves, world in pairs]
        ropes, pegs = [each.rope for _, each in pairs], [each.peg for _, each in pairs]
        batch = RolloutBatch.from_start(self.known, ropes, pegs, motions)
        found = winding_scores(self.known, batch, Budget(threads=self.options.threads))
        won = found.turns >= self.known.criteria.turns
        return {"won": won.astype(int).tolist(), "held": self.each(lambda pair: self.held(*pair), pairs)}

    def held(self, throw: Moves, world: Scenario) -> bool:
        """Whether the rope winds and slips by less than 5 mm in 2 s, with the links of the check."""
        motion, known = world.executed_motion(throw.motion(self.known.limits)), replace(self.known, rope=world.rope)
        stop = float(motion.breaks[-1])
        t = np.arange(0.0, stop + known.criteria.settle + known.criteria.watch, SAMPLE_TIME)
        try:
            run = hf.simulate(
                world.rope,
                motion,
                arm=known.arm,
                duration=float(t[-1]),
                pegs=[world.peg],
                tol=HELD_TOL,
                contact_step=HELD_STEP,
                t_eval=t,
                refine=False,
            )
        except SimulationError:
            return False
        return evaluate_cast(known, world.peg, run, stop).success

    def fine(self, throw: Moves, count: int) -> dict[str, Any]:
        """Check a throw in the first draws with 2.5 times the links, refined near the peg, and shorter steps."""
        known = problem(self.options.rope, FINER)

        def one(world: Scenario) -> tuple[bool, bool]:
            one = replace(known, rope=world.rope)
            cast = verify_cast(one, world.peg, world.executed_motion(throw.motion(known.limits)), accuracy=ACCURATE)
            return cast.wound and cast.clearance > known.clearance, cast.success

        found = self.each(one, self.worlds(count, known))
        return {"won": [int(wound) for wound, _ in found], "held": [int(held) for _, held in found]}

    def each(self, what: Callable[[Any], Any], over: list[Any]) -> list[Any]:
        """Apply a function to several items on threads."""
        with ThreadPoolExecutor(self.options.threads or os.cpu_count()) as pool:
            return list(pool.map(what, over))


def uncertainty(level: float) -> Uncertainty:
    """The uncertainty of a realistic identification, its standard deviations times `level`."""
    return Uncertainty(**{name: level * std for name, std in vars(Uncertainty()).items() if isinstance(std, float)})


def written(throw: Moves) -> dict[str, Any]:
    """A throw as plain numbers."""
    return {name: np.asarray(value).tolist() for name, value in asdict(throw).items()}


def read(numbers: dict[str, Any]) -> Moves:
    """A throw from plain numbers."""
    return Moves(**{name: np.array(value) if isinstance(value, list) else value for name, value in numbers.items()})


def line(number: int, row: dict[str, Any]) -> str:
    """A short result of a target."""
    told = []
    for plan, found in row.items():
        parts = [f"{plan} {found['seconds']:.0f} s"]
        if found["stated"]:
            parts.append(f"stated {found['stated'][0]}/{found['stated'][1]}")
        for work in ("open", "closed", "fine"):
            if work in found:
                one = found[work]
                parts.append(f"{work} {sum(one['won'])}/{len(one['won'])} held {sum(one['held'])}")
        told.append(" ".join(parts))
    return f"{number:4d} " + "; ".join(told)


if __name__ == "__main__":
    main()
