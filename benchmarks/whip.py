"""Whips: 30 random targets in reach, planned on the rope itself, and on a rope identified from one short recording.

python -m benchmarks.whip                 results in benchmarks/results/whip.json and .md; the same command
                                          continues an interrupted run (whip.jsonl)
python -m benchmarks.whip --nominal       nominal plans only
python -m benchmarks.whip --impacts       also the impacts of the nominal plans on a peg of 10 mm at the target
python -m benchmarks.whip --beyond        also plans for targets that are called out of reach
python -m benchmarks.whip --only 7        one of them again
python -m benchmarks.whip --targets 3     draws new targets, with seed 3

Miss: distance of the tip from the target at its peak speed, which must be at least 5 m/s, at most 20 degrees from the
required direction. The goals: a median of at most 5 mm nominal, and of 30 mm on the identified rope. The peak is the
greatest one within 0.15 s of the planned time. On an identified rope the true motor starts each stroke slightly early
or late and follows with a lag that is not in the plan. All simulated.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from benchmarks.targets import Benchmark, markdown, publish

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.control import swing_period
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.identification import identify
from hyperflex.model import divided
from hyperflex.model.refine import stretched
from hyperflex.motion import lagged
from hyperflex.planning import (
    MotorLimits,
    Moves,
    Problem,
    SearchOptions,
    TipFeasibility,
    TipTarget,
    WhipMap,
    build_whip_map,
    check_whip_feasibility,
    plan_whip,
    simulate_impact,
)
from hyperflex.planning.tasks.tip import OPTIONS
from hyperflex.planning.tasks.whip import verify_whip

TARGETS = Path(__file__).parent / "whip-targets.json"
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
ARM = hf.Arm(length=0.105)
COUNT, SPEED, WITHIN = 30, 5.0, float(np.radians(20.0))
TIME_BUDGET = 15.0  # s
PERIODS = 3.0
HEAD = (
    "| planned on | targets | fast and directed as required | median miss, mm | with the others as infinite, mm | "
    "quartiles, mm | goal, mm; median time, s |"
)
GOALS = {"nominal": 5.0, "identified": 30.0, "identified, same links": 30.0, "identified, no tape": 30.0}  # mm, medians
PIECES = {"identified": 2, "identified, same links": 1, "identified, no tape": 2}  # of each link of the true rope
NAMES = {
    "nominal": "the rope itself",
    "identified": "the identified rope, links of the true one half as long",
    "identified, same links": "the identified rope",
    "identified, no tape": "the first identified one, with a fitted length",
}
FEWER = {"identified, no tape": 15}  # of the targets: fewer, because a fit of the length is slow
BEYOND = 30  # targets out of reach that are tried
BANDS = (OPTIONS.max_cost, 0.2, 0.3, 0.5, np.inf)  # m, of their cost
SPREAD = {"length": 0.01, "mass": 0.02, "friction": 0.2}  # standard deviations of a true rope, relative
TIMING, LAG = 2e-3, 0.010  # s: standard deviation of each rest of the motor; time constant of its first-order lag
TAPE = 5e-4  # relative standard deviation of a length measured with a tape
RATE, SECONDS, NOISE, MARKERS = 60.0, 3.0, 2e-3, 10  # Hz, s, m: the recording


def problem(rope: hf.Rope) -> Problem:
    return Problem(rope, ARM, MotorLimits(), PERIODS * swing_period(rope))


def seconds() -> Budget:
    """TIME_BUDGET of processor time, on one thread."""
    return Budget(TIME_BUDGET, threads=1, clock=time.process_time)


def targets() -> list[TipTarget]:
    """The committed targets."""
    return [TipTarget(least_speed=SPEED, angle_tolerance=WITHIN, **row) for row in json.loads(TARGETS.read_text())]


def drawn(seed: int, known: WhipMap) -> Iterator[tuple[dict[str, float], TipFeasibility]]:
    """Uniform points and directions over the region that the rope could touch, and whether they are in reach."""
    rng, far = np.random.default_rng(seed), CABLE.total_length + ARM.length
    while True:
        r, a, direction = far * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
        row = {"x": round(r * np.cos(a), 4), "y": round(r * np.sin(a), 4), "direction": round(direction, 4)}
        yield row, check_whip_feasibility(known, TipTarget(least_speed=SPEED, angle_tolerance=WITHIN, **row))


def draw(seed: int) -> list[dict[str, float]]:
    """Targets in reach."""
    return list(islice((row for row, told in drawn(seed, build_whip_map(problem(CABLE))) if told.feasible), COUNT))


def true_rope(index: int, pieces: int) -> hf.Rope:
    """A rope that differs from the cable like a real one, with each link divided into `pieces`."""
    rng = np.random.default_rng([5, index])
    length, mass, friction = (1.0 + std * rng.standard_normal() for std in SPREAD.values())
    rope = CABLE.replace(
        length=length * CABLE.length,
        com=length * CABLE.com,
        mass=mass * CABLE.mass,
        inertia=mass * length**2 * CABLE.inertia,
        friction=friction * CABLE.friction,
    )
    return divided(rope, pieces)


def recorded(true: hf.Rope, index: int) -> tuple[hf.Recording, Any]:
    """Markers on a rope that swings freely for SECONDS, drawn aside at the start; and the first joint of each."""
    rng = np.random.default_rng([6, index])
    t = np.arange(round(RATE * SECONDS) + 1) / RATE
    along = (np.arange(true.n_links) + 0.5) / true.n_links
    run = hf.simulate(true, duration=t[-1], t_eval=t, q0=0.9 + 0.5 * along, tol=1e-8)
    joints = true.n_links // MARKERS * (np.arange(MARKERS) + 1)
    places = run.joints[:, joints] + NOISE * rng.standard_normal((t.size, MARKERS, 2))
    return hf.Recording(t, places.reshape(t.size, -1), kind="markers", noise=NOISE), joints


def identified(true: hf.Rope, index: int, tape: bool) -> tuple[hf.Rope, dict[str, Any]]:
    """The cable identified from one recording: its friction, and its length unless measured with a tape.

    Markers are at known fractions of the rope.
    """
    recording, joints = recorded(true, index)
    parts = np.cumsum(true.length)[joints - 1] / true.total_length
    measured = true.total_length * (1.0 + TAPE * np.random.default_rng([7, index]).standard_normal())
    rope = CABLE.replace(**stretched(CABLE, measured / CABLE.total_length * CABLE.length)) if tape else CABLE
    begin, status = time.perf_counter(), ""
    # A marker's position does not scale with the rope's length in a fit, so a second fit starts from the new length.
    for free in [["friction:factor"]] if tape else 2 * [["friction:factor", "length:factor"]]:
        arc_lengths = np.minimum(parts * rope.total_length, rope.total_length)
        found = identify(
            recording,
            rope,
            free,
            setup=hf.RecordingSetup(arc_lengths=arc_lengths),
            options=hf.FitOptions(window=np.inf, train=np.inf, intervals=None),
        )
        rope, status = found.rope, found.message
    told = {
        "length": rope.total_length / true.total_length,
        "friction": rope.friction[0] / rope.total_mass / (true.friction[0] / true.total_mass),
        "status": status,
        "identify seconds": time.perf_counter() - begin,
    }
    return rope, told


def moved_late(moves: Moves, index: int) -> Moves:
    """The strokes of a motor with timing errors."""
    late = TIMING * np.random.default_rng([8, index]).standard_normal(moves.rests.size)
    return Moves(moves.side, moves.ends, moves.rests + late)


def nominal(index: int, mark: TipTarget, known: WhipMap, **options: Any) -> dict[str, Any]:
    """Plan for the cable itself; the miss is that of a run with a tight tolerance."""
    search = SearchOptions(index, **options)
    plan = plan_whip(CABLE, ARM, mark, whip_map=known, time_budget=seconds(), options=search)
    row: dict[str, Any] = {"success": plan.success, "reason": plan.message, "cost": plan.feasibility.cost}
    row |= {"runs": plan.runs, "seconds": plan.seconds, "doubt": 1e3 * plan.position_std}
    if plan.outcome is not None:
        seen = plan.outcome
        row |= {"miss": 1e3 * seen.miss, "speed": seen.speed, "off": float(np.degrees(seen.angle_error)), "t": seen.t}
        row |= {
            "greatest": seen.earlier_speed <= seen.speed,
            "finer": None if plan.finer_outcome is None else 1e3 * plan.finer_outcome.miss,
        }
    if plan.moves is not None:
        made = plan.moves
        row |= {"side": made.side, "ends": made.ends.tolist(), "rests": made.rests.tolist()}
    return row


def beyond(known: WhipMap) -> Iterator[tuple[dict[str, float], TipTarget, int]]:
    """Yield the first BEYOND targets called out of reach but near a peak of the map, and the number drawn so far."""
    count = 0
    for number, (row, told) in enumerate(drawn(3, known), start=1):
        if not told.feasible and np.isfinite(told.cost):
            yield row, TipTarget(least_speed=SPEED, angle_tolerance=WITHIN, **row), number
            count += 1
            if count == BEYOND:
                return


def blow(row: dict[str, Any], mark: TipTarget) -> dict[str, Any]:
    """Impact of a nominal whip on a small peg at the target."""
    if row.get("miss") is None:
        return {"touched": False}
    made = Moves(row["side"], np.array(row["ends"]), np.array(row["rests"]))
    found = simulate_impact(problem(CABLE), mark.point, mark.direction, made.motion(MotorLimits()), row["t"])
    return {
        "touched": found.success,
        "t": found.t,
        "impulse": found.impulse,
        "along": found.impulse_along,
        "energy": found.energy,
    }


def on_identified(index: int, mark: TipTarget, kind: str) -> dict[str, Any]:
    """Plan for an identified rope, and simulate the true one with a motor that has timing errors and a lag."""
    true = true_rope(index, PIECES[kind])
    rope, row = identified(true, index, tape=kind != "identified, no tape")
    plan = plan_whip(
        rope,
        ARM,
        mark,
        whip_map=build_whip_map(problem(rope)),
        time_budget=seconds(),
        options=SearchOptions(index, skip_feasibility=True),
    )
    row |= {"success": plan.success, "reason": plan.message, "doubt": 1e3 * plan.position_std, "seconds": plan.seconds}
    if plan.moves is None or plan.outcome is None:
        return row
    exact = plan.moves.motion(MotorLimits())
    late = moved_late(plan.moves, index).motion(MotorLimits())
    for name, motion in (("", lagged(late, LAG)), (" without lag", late), (" in time", exact)):
        seen = verify_whip(problem(true), mark, motion, plan.outcome.t)
        row[f"miss{name}"] = None if seen is None else 1e3 * seen.miss
        row[f"speed{name}"] = None if seen is None else seen.speed
        row[f"off{name}"] = None if seen is None else float(np.degrees(seen.angle_error))
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Misses of each kind, mm; infinite for a target without a plan."""
    found = {}
    for kind, goal in GOALS.items():
        those = [row for row in rows if row["kind"] == kind]
        if not those:
            continue
        misses = np.array([np.inf if row.get("miss") is None else row["miss"] for row in those])
        asked = [
            row.get("miss") is not None and row["speed"] >= SPEED and row["off"] <= np.degrees(WITHIN) for row in those
        ]
        counted = np.where(asked, misses, np.inf)
        found[kind] = {
            "targets": len(those),
            "fast and directed": int(sum(asked)),
            "median of all": shown(np.median(misses)),
            "median, others as infinity": shown(np.median(counted)),
            "quartiles": [shown(value) for value in np.quantile(misses, [0.25, 0.75], method="nearest")],
            "goal": goal,
            "seconds": float(np.median([row["seconds"] for row in those])),
        }
    return found


def shown(value: Any) -> float | None:
    """A number of a summary; None for infinity."""
    return round(float(value), 3) if np.isfinite(value) else None


def page(found: dict[str, Any]) -> str:
    """The results as Markdown."""
    lines = [HEAD, "|---" * 7 + "|"]
    for kind, r in found["summary"].items():
        lines.append(
            f"| {NAMES[kind]} | {r['targets']} | {r['fast and directed']} | {r['median of all']} | "
            f"{r['median, others as infinity']} | {r['quartiles'][0]}, {r['quartiles'][1]} | {r['goal']:g}; "
            f"{r['seconds']:.0f} |"
        )
    text = (
        "The paper's cable and motor; uniform targets in any direction over the region that the rope could touch, of "
        f"which those in reach are kept; at least {SPEED:g} m/s, at most {np.degrees(WITHIN):.0f} degrees off. Each "
        f"search takes {TIME_BUDGET:g} s. Identified: length 1 %, mass 2 %, friction 20 % off (standard deviations); "
        f"free swing of {SECONDS:g} s, {MARKERS} markers at {RATE:g} Hz with {1e3 * NOISE:g} mm of noise at known "
        f"fractions of the rope; friction is fitted, length is measured with a tape ({100 * TAPE:g} %) or also fitted, "
        f"mass is not improved. The motor's rests are {1e3 * TIMING:g} ms off, and it follows with a first-order lag "
        f"of {1e3 * LAG:g} ms that is not in the plan. Targets that the true rope cannot reach count as missed. "
        "Links of half the length in the true rope represent a model error. All simulated."
    )
    lines += [*identified_words(found["rows"]), *beyond_words(found["rows"])]
    blows = [row for row in found["rows"] if row["kind"] == "impact" and row["touched"]]
    if blows:
        middle = {name: float(np.median([row[name] for row in blows])) for name in ("impulse", "along", "energy")}
        lines.append(
            f"\nOn a peg of 10 mm behind the target {len(blows)} of the nominal whips strike, with a median impulse of "
            f"{1e3 * middle['impulse']:.1f} mN s ({1e3 * middle['along']:.1f} in the required direction) in 50 ms, and "
            f"lose {1e3 * middle['energy']:.0f} mJ in the impact."
        )
    kernels = {
        kind: sorted({row["kernels"] for row in found["rows"] if row["kind"] == kind}) for kind in found["summary"]
    }
    lines.append("\nKernels: " + "; ".join(f"{kind} {', '.join(hashes)}" for kind, hashes in kernels.items()) + ".")
    return markdown("Whips", text, lines, found["machine"], "whip")


def identified_words(rows: list[dict[str, Any]]) -> list[str]:
    """The effects of lag and timing, and the errors of length and friction."""
    lines = []
    for kind in PIECES:
        those = [row for row in rows if row["kind"] == kind]
        if those:
            without, exact = (middle(those, f"miss{name}") for name in (" without lag", " in time"))
            long, stiff = (np.array([row[name] for row in those]) - 1.0 for name in ("length", "friction"))
            lines.append(
                f"\n{NAMES[kind].capitalize()}: median miss without the lag {without:.1f} mm, also without timing "
                f"errors {exact:.1f} mm. Length {100 * np.sqrt((long**2).mean()):.3f} % off (root mean square), "
                f"friction over mass {100 * stiff.mean():+.1f} % on average, {100 * stiff.std():.1f} % standard "
                "deviation."
            )
    return lines


def middle(rows: list[dict[str, Any]], name: str) -> float:
    """Median of a number that is infinite if it is missing."""
    return float(np.median([np.inf if row.get(name) is None else row[name] for row in rows]))


def beyond_words(rows: list[dict[str, Any]]) -> list[str]:
    """Share of the targets called out of reach that are met nevertheless, by their cost."""
    those = [row for row in rows if row["kind"] == "beyond"]
    if not those:
        return []
    told = []
    for low, high in pairwise(BANDS):
        some = [row["success"] for row in those if low < row["cost"] <= high]
        if some:
            where = f"at {low:g} to {high:g} m" if np.isfinite(high) else f"over {low:g} m"
            told.append(f"{sum(some)} of {len(some)} {where}")
    met = sum(row["success"] for row in those)
    words = (
        f"\nOut of reach means farther than {OPTIONS.max_cost:g} m (missing speed and a wrong direction count as "
        f"distance) from every peak of the map. Of {max(row['drawn'] for row in those)} more targets, {len(those)} "
        f"near a peak were called out of reach. With `skip_feasibility=True` ({TIME_BUDGET:g} s each), {met} of them "
        f"are met within 1 mm with the required speed and direction: {', '.join(told)}."
    )
    return [words]


def measure(index: int, kind: str, mark: TipTarget, known: WhipMap) -> dict[str, Any]:
    """Plan and check one target."""
    return nominal(index, mark, known) if kind == "nominal" else on_identified(index, mark, kind)


def jobs(
    options: argparse.Namespace, known: WhipMap, rows: list[dict[str, Any]]
) -> Iterator[tuple[str, int, Callable[[], dict[str, Any]]]]:
    """The pending measurements and their functions; `rows` are the existing ones."""
    marks = targets()
    for kind in ["nominal"] if options.nominal else list(GOALS):
        for index, mark in enumerate(marks[: FEWER.get(kind, COUNT)]):
            yield kind, index, partial(measure, index, kind, mark, known)
    if options.impacts:
        for row in [row for row in rows if row["kind"] == "nominal"]:
            yield "impact", row["index"], partial(blow, row, marks[row["index"]])
    if options.beyond:
        for index, (place, mark, count) in enumerate(beyond(known)):
            yield "beyond", index, partial(refused, index, place, mark, count, known)


def refused(index: int, place: dict[str, float], mark: TipTarget, count: int, known: WhipMap) -> dict[str, Any]:
    """Plan for a target called out of reach."""
    return {**place, "drawn": count, **nominal(index, mark, known, skip_feasibility=True)}


def main() -> None:
    """Measure, print and write."""
    benchmark = Benchmark("whip", TARGETS, "target", "targets", draw, targets)
    parser = benchmark.parser(__doc__)
    parser.add_argument("--nominal", action="store_true", help="nominal plans only")
    parser.add_argument("--impacts", action="store_true", help="also impacts of the nominal plans")
    parser.add_argument("--beyond", action="store_true", help="also targets called out of reach")
    options = parser.parse_args()
    if benchmark.drew(options.seed):
        return
    marks, about = targets(), machine.describe()
    known = build_whip_map(problem(CABLE))
    if options.only is not None:
        for kind in ["nominal"] if options.nominal else list(GOALS):
            print(json.dumps(measure(options.only, kind, marks[options.only], known), indent=1))
        return
    notes = Path(options.out).with_suffix(".jsonl")
    rows = log.read(notes)
    log.warn_of_others(rows)
    finished = {(row["kind"], row["index"]) for row in rows}

    def add(kind: str, index: int, row: dict[str, Any]) -> None:
        rows.append({"index": index, "kind": kind, "kernels": SOURCE_HASH, **row})
        print(json.dumps(rows[-1]), flush=True)
        log.append(notes, rows[-1])

    for kind, index, work in jobs(options, known, rows):
        if (kind, index) not in finished:
            add(kind, index, work())
    publish(options.out, about, rows, summary, page)


if __name__ == "__main__":
    main()
