"""Casting a rope round random targets: wound and held, in runs independent of the planner.

python -m benchmarks.casting                     the paper's cable and arm, 60 targets in reach; an hour or so
python -m benchmarks.casting --rope weighted     with 20 g at the tip; or tapered, cord, long: see ROPES
python -m benchmarks.casting --rope cord --seed 99 --ours   fresh targets
python -m benchmarks.casting --count 5 --out -   short; writes nothing
python -m benchmarks.casting --plans FOLDER      and keep the new plans, for benchmarks.casts_mujoco
python -m benchmarks.casting --seed 99 --ours --again 132   targets that were not held again, with this many s
python -m benchmarks.casting --outside           targets called out of reach, each searched ten times as long

For each target: a plan of hyperflex (60 s at most), the paper's motion (half turns with rests of 0.53 s) and its timing
rule (half turns as the tip passes below the shaft), both until the rope strikes the target; the arm then finishes its
half turn and rests. Each motion is run with 2.5 times the links, half the library's contact step and a fifth of its
tolerance; the planner's own verifications use twice the step and ten times the tolerance of the library. A rope is
wound if it makes 1.25 turns from the arm's tip to its end, and held if it slips by less than 5 mm in the next 2 s. A
slow pull at the arm's end then measures the load that it holds. All simulated. BLOCK targets are planned one after the
other, on all cores, and then checked. Rows are kept in casting.jsonl: the same command continues an interrupted run.

Other planners can take part: the ropes, the arm, the motor's limits and the targets are in ``problem`` and ``targets``,
which require numpy's generator only; the independent check is ``hyperflex.planning.verify_cast`` on ``problem(rope,
FINER)``. The time of the first successful plan is reported with that of the search.
"""

import argparse
import json
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from benchmarks import log as lines
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.budget import Budget
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL
from hyperflex.motion import Motion
from hyperflex.paper import T_REST, casting_arm
from hyperflex.planning import (
    Accuracy,
    CastOutcome,
    CastPlan,
    MotorLimits,
    Problem,
    check_feasibility,
    measure_holding_force,
    plan_cast,
    verify_cast,
)
from hyperflex.planning.rollouts import RolloutBatch, fly_to_strikes

RESULTS = Path(__file__).parent / "results"
LINKS = 50
FINER = 2.5  # times the links in the independent check
ACCURATE = Accuracy(0.2 * DEFAULT_TOL, 0.5 * DEFAULT_CONTACT_STEP)  # of the independent check
FRICTION = 5e-4  # N m s/rad, of each joint of LINKS links
TIP = {"nominal": 0.0, "weighted": 0.02}  # kg
SEED = 7  # of the targets


class Kind(NamedTuple):
    """A rope on an arm, SI units: friction of each joint, weight at the tip; taper of the mass to the tip."""

    length: float
    mass: float
    links: int
    radius: float
    friction: float
    tip: float
    arm: float | None  # None: the paper's
    taper: float = 1.0


ROPES = {
    "nominal": Kind(2.0, 0.125, LINKS, 0.0025, FRICTION, TIP["nominal"], None),
    "weighted": Kind(2.0, 0.125, LINKS, 0.0025, FRICTION, TIP["weighted"], None),
    "tapered": Kind(2.0, 0.125, LINKS, 0.0025, FRICTION, 0.01, None, taper=0.3),
    "cord": Kind(1.2, 0.06, 30, 0.003, 2e-4, 0.0, 0.2),
    "long": Kind(3.0, 0.25, 60, 0.004, 1e-3, 0.0, 0.15),
}
TIME_BUDGET, TENFOLD = 60.0, 10.0  # s
LEAST, GREATEST, MU = 0.02, 0.05, 0.3  # m, m
GOAL = {"nominal": 0.85, "weighted": 0.90, "tapered": 0.90, "cord": 0.90, "long": 0.90}
HALF_TURN = 0.73  # s
COLUMNS = (
    "Room: turns that the rope beyond the target could make round it. Energy: estimated energy of that part of the",
    "rope at the strike, divided by the energy that lifts it round. Hold: the pull, N, at which the wound rope slips.",
    "Next to it is the weight of the rope that hangs beyond the target times e^(mu theta), the capstan equation.",
    "Planned: the planner reports success. Checked: wound and held in the finer, independent run.",
)
BLOCK, CHECKS = 12, 2  # targets that are planned before they are checked, and checks at a time
LONGEST = 300.0  # s of processor time for a check; a cast whose check takes longer counts as failed


def problem(rope: str, finer: float = 1.0) -> Problem:
    """A rope of ROPES on its arm, with `finer` times its links.

    The friction per length and that of the hinge at the arm do not depend on the number of links, as in
    :func:`hyperflex.model.divided`. Neither does the mass per length, a line along the rope through the taper's two
    values at the middles of the first and the last of ``kind.links`` links.
    """
    kind = ROPES[rope]
    links = round(finer * kind.links)
    cable = hf.Rope.uniform(kind.length, kind.mass, links, kind.radius, tip_mass=kind.tip, friction=0.0)
    part = ((np.arange(links) + 0.5) * kind.links / links - 0.5) / (kind.links - 1)  # of the way, at links' middles
    share = 2.0 * (1.0 + (kind.taper - 1.0) * part) / (1.0 + kind.taper)
    friction = np.full(links, kind.friction * finer)
    friction[0] = kind.friction
    cable = cable.replace(friction=friction, mass=share * cable.mass, inertia=share * cable.inertia)
    return Problem(cable, casting_arm() if kind.arm is None else hf.Arm(length=kind.arm), MotorLimits())


def target(number: int, rope: str = "nominal", seed: int = SEED) -> hf.Peg:
    """A target anywhere about the arm, uniform in area up to the length of rope and arm."""
    random, known = np.random.default_rng([seed, number]), problem(rope)
    reach = known.rope.total_length + known.arm.length
    far, angle = reach * math.sqrt(random.uniform()), random.uniform(-math.pi, math.pi)
    return hf.Peg(far * math.sin(angle), -far * math.cos(angle), float(random.uniform(LEAST, GREATEST)), MU)


def targets(rope: str, count: int, within: bool = True, seed: int = SEED) -> list[int]:
    """Numbers of the first targets in reach, or out of reach although geometry allows them."""
    known, found, number = problem(rope), [], 0
    while len(found) < count:
        told = check_feasibility(known, target(number, rope, seed))
        if told.feasible if within else not (told.feasible or told.impossible):
            found.append(number)
        number += 1
    return found


def main() -> None:
    """Plan, check, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rope", choices=sorted(ROPES), default="nominal")
    parser.add_argument("--count", type=int, default=60, help="targets (60)")
    parser.add_argument("--time-budget", type=float, default=TIME_BUDGET, help="s of planning a target (60)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the targets ({SEED})")
    parser.add_argument("--again", type=float, metavar="S", help="s to plan a target that was not held again")
    parser.add_argument("--outside", action="store_true", help="targets called out of reach, ten times the time budget")
    parser.add_argument("--ours", action="store_true", help="hyperflex's plans alone, without the paper's two methods")
    parser.add_argument(
        "--plans", type=Path, help="folder for the successful plans of this call, as benchmarks.casts_mujoco reads them"
    )
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    about = machine.describe()
    drawn = "" if options.seed == SEED else f" seed {options.seed}"
    kind = f"{options.rope}{' outside' if options.outside else ''}{drawn}"
    time_budget = options.time_budget * (TENFOLD if options.outside else 1.0)
    numbers = targets(options.rope, options.count, within=not options.outside, seed=options.seed)
    log = None if options.out == "-" else Path(options.out) / "casting.jsonl"
    known = read(log, kind, time_budget)
    rows = [known[number] for number in numbers if number in known]
    lines.warn_of_others(rows, planned=True)
    missing = [n for n in numbers if n not in known]
    alone = options.outside or options.ours or options.rope not in TIP
    for found in done(options.rope, missing, time_budget, ours_alone=alone, seed=options.seed, plans=options.plans):
        rows.append(found)
        print(line(found), flush=True)
        if log is not None:
            lines.append(log, {"kind": kind, "time_budget": time_budget, **found})
    rows.sort(key=lambda row: int(row["number"]))
    by = f"{machine.sentence(about)} {lines.made(rows)} {lines.made(rows, 'planner')}"
    more = repeated(options, kind, log, [row["number"] for row in rows if not row["ours"]["success"]])
    page = f"# Casting: {kind}\n\n{text(rows, options.rope)}\n{again(rows, more, options.again)}{by}\n"
    print(page)
    if log is not None:
        name = f"casting-{kind.replace(' ', '-')}"
        data = json.dumps({"machine": about, "rows": rows, "again": more}, indent=1) + "\n"
        files.write_text(log.with_name(f"{name}.json"), data)
        files.write_text(log.with_name(f"{name}.md"), page)


def repeated(options: argparse.Namespace, kind: str, log: Path | None, failed: list[int]) -> list[dict[str, Any]]:
    """Rows of targets that were not held, planned again with another time budget."""
    if options.again is None:
        return []
    known = read(log, kind, options.again)
    rows = [known[number] for number in failed if number in known]
    missing = [number for number in failed if number not in known]
    for found in done(options.rope, missing, options.again, ours_alone=True, seed=options.seed, plans=options.plans):
        rows.append(found)
        print(line(found), flush=True)
        if log is not None:
            lines.append(log, {"kind": kind, "time_budget": options.again, **found})
    return sorted(rows, key=lambda row: int(row["number"]))


def again(rows: list[dict[str, Any]], more: list[dict[str, Any]], time_budget: float | None) -> str:
    """Describe the results of the targets that were planned again."""
    if not more:
        return ""
    held = [row["number"] for row in more if row["ours"]["success"]]
    whole = sum(row["ours"]["success"] for row in rows) + len(held)
    which = f" ({', '.join(map(str, held))})" if held else ""
    return (
        f"Those {len(more)} that were not held once more, with {time_budget:g} s each: {len(held)} held{which}, which "
        f"makes {whole} of {len(rows)}. {lines.made(more, 'planner')}\n\n"
    )


def read(log: Path | None, kind: str, time_budget: float) -> dict[int, dict[str, Any]]:
    """Rows of the same kind by number."""
    return {row["number"]: row for row in lines.read(log) if (row["kind"], row["time_budget"]) == (kind, time_budget)}


def done(
    rope: str, numbers: list[int], time_budget: float, ours_alone: bool, seed: int, plans: Path | None
) -> Iterator[dict[str, Any]]:
    """A row for each target when it has been checked."""
    known = problem(rope)
    for begin in range(0, len(numbers), BLOCK):
        planned = []
        for number in numbers[begin : begin + BLOCK]:
            told: list[float] = []  # s, when plans stood
            plan = plan_cast(
                known.rope,
                known.arm,
                target(number, rope, seed),
                time_budget=time_budget,
                options=hf.SearchOptions(skip_feasibility=True, seed=number),
                on_plan=lambda found, told=told: told.append(found.seconds),
            )
            planned.append((number, rope, plan, ours_alone, told[0] if told else None))
            if plans is not None and plan.success:
                plans.mkdir(parents=True, exist_ok=True)
                plan.to_toml(plans / f"{rope}-{seed}-{number}.toml")
        with ThreadPoolExecutor(CHECKS) as pool:
            for one in as_completed([pool.submit(entry, *each) for each in planned]):
                yield one.result()


def entry(number: int, rope: str, plan: CastPlan, ours_alone: bool, first: float | None) -> dict[str, Any]:
    """Check a plan and the paper's two methods."""
    peg, ways = plan.target, {"ours": plan.motion}
    if not ours_alone:
        ways |= {
            "paper's rests": until_strike(rope, peg, swinging()),
            "paper's timing": until_strike(rope, peg, timed(rope)),
        }
    told = {
        "number": number,
        "x": peg.x,
        "y": peg.y,
        "radius": peg.radius,
        "room": plan.feasibility.available_turns,
        "energy": plan.feasibility.energy_ratio,
        "seconds": plan.seconds,
        "first": first,
        "runs": plan.runs,
        "planned": plan.success,
        "reason": plan.message,
        "kernels": SOURCE_HASH,
        "planner": lines.planner(),
    }
    return told | {way: checked(rope, peg, motion) for way, motion in ways.items()}


def checked(rope: str, peg: hf.Peg, motion: Motion | None) -> dict[str, Any]:
    """Result of a motion in a finer run, and the load that the wound rope holds."""
    if motion is None:
        return {"success": False, "reason": "nothing to do"}
    fine = problem(rope, FINER)
    cast = verify_cast(fine, peg, motion, accuracy=ACCURATE, time_budget=LONGEST)
    row = {
        "success": cast.success,
        "wound": cast.wound,
        "turns": short(cast.turns),
        "slipped": short(cast.slip),
        "strike": short(cast.strike_time),
        "bend": short(cast.max_bend),
        "torque": short(cast.torque),
        "reason": cast.message,
    }
    return row | (bears(peg, cast) if cast.success else {})


def bears(peg: hf.Peg, cast: CastOutcome) -> dict[str, Any]:
    """Pull at which a wound rope slips, N, and the weight of its tail times e^(mu theta), N."""
    held = None if cast.run is None else measure_holding_force(cast.run, peg)
    if held is None:
        return {}
    return {"hold": short(held.force), "let go": held.tug.slipped, "tail times e^(mu theta)": short(held.capstan_force)}


def swinging() -> Motion:
    """The paper's casting motion."""
    return hf.arm_swings(t_move=HALF_TURN, t_rest=T_REST["success"])


def timed(rope: str) -> Motion:
    """The paper's timing rule on the true state, each half turn as the tip passes below the shaft."""
    from hyperflex.control import CrossingRule, SwingModel, TrueState, run_closed_loop

    model, known = SwingModel(problem(rope).rope, casting_arm(), HALF_TURN), problem(rope)
    return run_closed_loop(
        TrueState(known.rope, known.arm), CrossingRule(model, 0.0), model, duration=known.time
    ).motion


def until_strike(rope: str, peg: hf.Peg, motion: Motion) -> Motion | None:
    """A motion that ends with the half turn in which the rope strikes; None if it does not strike."""
    known = problem(rope)
    batch = RolloutBatch.from_start(known, [known.rope], [peg], [motion])
    struck = float(fly_to_strikes(known, peg, batch, Budget()).t[0])
    if math.isnan(struck):
        return None
    begins = [t for t in motion.switches(0.0, struck) if abs(float(motion.rate([t])[0])) < 1e-9]
    begin = begins[-1] if begins else 0.0
    stop = begin + HALF_TURN if abs(float(motion.rate([struck])[0])) > 1e-9 else struck
    return motion.then(hf.hold_arm(float(motion.angle([stop])[0])), stop)


def short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def line(row: dict[str, Any]) -> str:
    ours = row["ours"]
    return (
        f"{row['number']:4d} ({row['x']:+.2f}, {row['y']:+.2f}) r {row['radius']:.3f} planned {row['planned']!s:5} in "
        f"{row['seconds']:.0f} s, checked {ours['success']!s:5} {ours.get('turns')} {ours['reason'] or row['reason']}"
    )


def text(rows: list[dict[str, Any]], rope: str) -> str:
    """Results as Markdown."""
    lines = list(scores(rows))
    seconds = np.array([row["seconds"] for row in rows])
    median, most, late = np.median(seconds), seconds.max(), np.quantile(seconds, 0.95)
    lines += ["", *COLUMNS]
    lines += ["", f"Planning: median {median:.1f} s, 95 % within {late:.1f} s, at most {most:.1f} s a target."]
    first = [row["first"] for row in rows if row.get("first") is not None]
    if first:
        lines[-1] += f" Median time of the first successful plan: {np.median(first):.1f} s ({len(first)} plans)."
    lines += [f"Goal: {GOAL[rope]:.0%} wound and held. {agreement(rows)}.", ""]
    bends = [row["ours"]["bend"] for row in rows if row["ours"].get("bend") is not None and row["ours"]["success"]]
    if bends:
        folded = sum(bend > math.pi for bend in bends)
        lines[-1:] = [
            f"{folded} of {len(bends)} held ropes whose sharpest bend was recorded had folded through themselves.",
            "",
        ]
    head = ("number", "x", "y", "radius", "room", "energy", "planned", "s", "checked", "turns", "hold")
    lines += [f"| {' | '.join(head)} | tail e^(mu th) | why not |", "|" + "---|" * (len(head) + 2)]
    for row in rows:
        ours = row["ours"]
        cells = [row["number"], *(f"{row[k]:.3f}" for k in ("x", "y", "radius", "room", "energy"))]
        cells += [row["planned"], f"{row['seconds']:.0f}", ours["success"], ours.get("turns")]
        cells += [bore(ours), ours.get("tail times e^(mu theta)", ""), ours["reason"] or row["reason"]]
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def scores(rows: list[dict[str, Any]]) -> Iterator[str]:
    """The table of methods."""
    yield from ("| way | wound and held | of |", "|---|---|---|")
    for way in ("ours", "paper's rests", "paper's timing"):
        tried = [row[way]["success"] for row in rows if way in row]
        if tried:
            yield f"| {way} | {sum(tried)} | {len(tried)} |"
    sure = [row["ours"]["success"] for row in rows if row["planned"]]
    yield f"| ours, of plans reported to succeed | {sum(sure)} | {len(sure)} |"


def bore(ours: dict[str, Any]) -> str:
    """Pull at which the wound rope slipped, N, or a lower bound."""
    return "" if "hold" not in ours else f"{'' if ours['let go'] else '>= '}{ours['hold']}"


def agreement(rows: list[dict[str, Any]]) -> str:
    """How often the planner's result and the independent check agree."""
    agree = sum(row["planned"] == row["ours"]["success"] for row in rows)
    return f"The planner's result and the independent check agree on {agree} of {len(rows)}"


if __name__ == "__main__":
    main()
