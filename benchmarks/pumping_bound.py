"""Bound on pumping: global searches for rests that bring |x| to 1.8 m 5 % faster than the best constant rest.

python -m benchmarks.pumping_bound CMA-ES 60     60 restarts of CMA-ES; seeds from 1000 on (--first)
python -m benchmarks.pumping_bound DE 3          differential evolution, 18,000 rollouts each
python -m benchmarks.pumping_bound starts 2      the best 24 of 2,500 random points, each followed by CMA-ES
python -m benchmarks.pumping_bound page          the page from the existing rows

The arm moves through the bottom, where free rests gain least. A search maximises |x| before a deadline over the rests
after the first half turn, which starts at t = 0, because a first rest would only shift the motion. A search ends when
it makes no progress. Each adds a line to benchmarks/results/pumping-bound.jsonl and takes minutes on one core.
Simulated.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from benchmarks import log, machine
from benchmarks.evolution import CmaEs
from benchmarks.pumping_cases import WANTED, caster

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.paper import T_MOVE, cable, casting_arm
from hyperflex.simulation import simulate_batch

RESULTS = Path(__file__).parent / "results" / "pumping-bound.jsonl"
PATH: Literal["under"] = "under"
BEST_CONSTANT = 7.4576  # s: 0.485 s of rest, by an event of the engine; rests in steps of 0.5 ms
DEADLINE = round(0.95 * BEST_CONSTANT, 4)  # s
SAMPLE_TIME, TOL = 0.02, 1e-4  # s, m
NEAR = 2e-3  # m


class Task:
    """The greatest |x| of the tip before a deadline, and the number of evaluations."""

    def __init__(self, deadline: float) -> None:
        self.deadline, self.rollouts = deadline, 0
        self.model, self.rope, self.arm = caster(PATH), cable(), casting_arm()
        self.t = np.unique(np.append(SAMPLE_TIME * np.arange(1, int(deadline / SAMPLE_TIME) + 1), deadline))

    def reach(self, rests: Array) -> Array:
        """Greatest |x| (m,), m, with rests (m, k), s, after each half turn."""
        self.rollouts += len(rests)
        starts = np.concatenate([np.zeros((len(rests), 1)), np.cumsum(rests + T_MOVE, axis=1)], axis=1)
        motions = [self.model.motion(row[row < self.deadline]) for row in starts]
        batch = simulate_batch(
            self.rope, motions, arm=self.arm, duration=self.deadline, t_eval=self.t, tol=TOL, threads=1
        )
        return np.asarray(np.nan_to_num(np.abs(batch.tip[:, :, 0]).max(axis=1)))


class Manner(NamedTuple):
    """Options of a climb: most generations, idle generations, cost of a rest out of bounds, m/s^2, and its
    correction."""

    most: int
    idle: int
    gain: float
    cost: float
    inside: Callable[[Array], Array]


def folded(points: Array) -> Array:
    """Rests within 0 and 1.6 s, turned back at either end."""
    rests = np.abs(points)
    return np.asarray(np.clip(np.where(rests > 1.6, 3.2 - rests, rests), 0.0, 1.6))


def cut(points: Array) -> Array:
    """Rests within 0 and 1.4 s, turned back at 0."""
    return np.asarray(np.clip(np.abs(points), 0.0, 1.4))


LONG, SHORT, LAST = (
    Manner(200, 25, 1e-4, 1e-3, folded),
    Manner(15, 12, 3e-4, 1e-2, cut),
    Manner(60, 12, 3e-4, 1e-2, cut),
)


def climb(
    task: Task, begin: Array, spread: float, rng: np.random.Generator, members: int, manner: Manner
) -> tuple[float, Array]:
    """CMA-ES until the last generation or until it is idle."""
    search, best, idle = CmaEs(begin, spread, np.ones(begin.size), members, rng), (-1.0, begin), 0
    for _ in range(manner.most):
        points = np.array(search.ask())
        tried = manner.inside(points)
        reach = task.reach(tried)
        search.tell(points, list(-reach + manner.cost * ((points - tried) ** 2).sum(axis=1)))
        idle += 1
        if reach.max() > best[0] + manner.gain:
            best, idle = (float(reach.max()), tried[reach.argmax()]), 0
        if idle > manner.idle or search.stop():
            break
    return best


def restart(task: Task, seed: int) -> tuple[float, Array]:
    """One CMA-ES of 4 to 8 rests, from the best of 200 random points."""
    rng = np.random.default_rng([77, seed])
    size, members = int(rng.integers(4, 9)), int(rng.choice([16, 30, 60]))
    points = rng.uniform(0.0, rng.choice([0.7, 1.2]), (200, size))
    begin = points[task.reach(points).argmax()]
    return climb(task, begin, float(rng.choice([0.1, 0.25])), rng, members, LONG)


def crowd(task: Task, seed: int) -> tuple[float, Array]:
    """Differential evolution of 150 members on 5 to 7 rests for 120 generations, then a climb."""
    from scipy.optimize import differential_evolution

    rng = np.random.default_rng([91, seed])
    size = int(rng.integers(5, 8))
    first = rng.uniform(0.0, 0.9, (150, size))
    found = differential_evolution(
        lambda x: -task.reach(x.T),
        [(0.0, 1.3)] * size,
        vectorized=True,
        updating="deferred",
        strategy="rand1bin",
        mutation=(0.4, 0.9),
        recombination=0.7,
        init=first,
        maxiter=120,
        tol=1e-3,
        polish=False,
        rng=rng,
    )
    return max((-float(found.fun), found.x), climb(task, found.x, 0.03, rng, 12, LAST), key=lambda one: one[0])


def starts(task: Task, seed: int) -> tuple[float, Array]:
    """The 24 best distinct ones of 2,500 random points, a short climb from each, a longer one from the best 5."""
    rng = np.random.default_rng([91, seed])
    points = rng.uniform(0.0, 0.9, (2500, int(rng.integers(5, 8))))
    kept: list[Array] = []
    for k in np.argsort(-task.reach(points)):
        if len(kept) < 24 and all(np.abs(points[k] - one).max() > 0.12 for one in kept):
            kept.append(points[k])
    short = sorted((climb(task, one, 0.06, rng, 12, SHORT) for one in kept), key=lambda one: -one[0])
    return max((climb(task, one, 0.03, rng, 12, LAST) for _, one in short[:5]), key=lambda one: one[0])


KINDS: dict[str, Callable[[Task, int], tuple[float, Array]]] = {"CMA-ES": restart, "DE": crowd, "starts": starts}
WORDS = {
    "CMA-ES": "CMA-ES, 4 to 8 rests, each from the best of 200 random points",
    "DE": "differential evolution, 5 to 7 rests, 150 members",
    "starts": "climbs from the best 24 of 2,500 random points, 5 to 7 rests",
}


def rows() -> list[dict[str, Any]]:
    """The results of earlier searches."""
    return log.read(RESULTS)


def page(found: list[dict[str, Any]]) -> str:
    """The results as Markdown."""
    words = (
        f"The best constant rest brings |x| to {WANTED:g} m after {BEST_CONSTANT:.2f} s; 5 % faster is {DEADLINE:.2f} "
        "s. The arm's half turns are those of the paper (stroke, speed, acceleration), so only the rests between them "
        "are free: a search maximises |x| before a deadline over the rests. Simulated."
    )
    lines = ["# Can pumping through the bottom be 5 % faster?", "", words]
    for deadline in sorted({row["deadline"] for row in found}):
        lines += [
            "",
            f"Before {deadline:g} s:",
            "",
            f"| search | searches | rollouts | greatest x, m | within {1e3 * NEAR:g} mm of it | rests of the best, s |",
            "|---" * 6 + "|",
        ]
        for kind in KINDS:
            those = sorted(
                (row for row in found if row["kind"] == kind and row["deadline"] == deadline),
                key=lambda row: -row["reach"],
            )
            if those:
                rests = ", ".join(f"{rest:.3f}" for rest in those[0]["rests"])
                near = sum(row["reach"] > those[0]["reach"] - NEAR for row in those)
                count = sum(row["rollouts"] for row in those)
                lines.append(f"| {WORDS[kind]} | {len(those)} | {count} | {those[0]['reach']:.3f} | {near} | {rests} |")
    best = max(row["reach"] for row in found if row["deadline"] == DEADLINE)
    verdict = (
        f"None reaches {WANTED:g} m before {DEADLINE:.2f} s; the best reaches {best:.3f} m at the end of a swing, "
        f"{1e3 * (WANTED - best):.0f} mm short. The time of arrival jumps: a swing that just fails costs half a "
        "period. A search cannot prove that nothing better exists, but different searches from different starts that "
        "end at the same rests make it unlikely."
    )
    kernels = ", ".join(sorted({row["kernels"] for row in found}))
    lines += ["", verdict, "", f"Kernels: {kernels}. {machine.sentence(machine.describe())}", ""]
    return "\n".join(lines)


def main() -> None:
    """Search, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=[*KINDS, "page"])
    parser.add_argument("count", nargs="?", type=int, default=1, help="searches")
    parser.add_argument("--first", type=int, default=1000, help="seed of the first one")
    parser.add_argument("--deadline", type=float, default=DEADLINE, help="s")
    options = parser.parse_args()
    if options.kind != "page":
        for seed in range(options.first, options.first + options.count):
            task, begin = Task(options.deadline), time.perf_counter()
            reach, rests = KINDS[options.kind](task, seed)
            row = {"kind": options.kind, "seed": seed, "deadline": options.deadline, "reach": round(reach, 4)}
            row |= {"rests": np.round(rests, 4).tolist(), "rollouts": task.rollouts, "kernels": SOURCE_HASH}
            row["seconds"] = round(time.perf_counter() - begin, 1)
            print(json.dumps(row), flush=True)
            log.append(RESULTS, row)
    files.write_text(RESULTS.with_suffix(".json"), json.dumps(rows(), indent=1) + "\n")
    files.write_text(RESULTS.with_suffix(".md"), page(rows()))


if __name__ == "__main__":
    main()
