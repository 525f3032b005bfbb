"""Learning from each cast on a rope that differs from the planned one: parameters only, motion only, and both.

python -m benchmarks.learning --plans FOLDER     casts planned for the benchmark's ropes, or read from FOLDER if kept
python -m benchmarks.learning --count 2 --out -  short; writes nothing

Each cast is planned for a rope of ``benchmarks.casting`` with the air drag of a cylinder, and then simulated with
another one: links half as long, length + 3 %, friction + 20 %, a motor with a lag of 15 ms, and one of two effects
(``--lacks``): an arm that bends, which the model omits; or twice the drag, which all methods but one learn. The
measurements of a cast are those of a camera and a drive: ten markers at 100 Hz with an error of 2 mm, the arm's angle
with an error of 1 mrad, and whether the rope wound, by the criteria of the plan in a complete run with contact
(``hyperflex.planning.verify_cast``). Each target has five casts, the first as planned. "true rope" learns nothing: it
plans with the true rope's length, friction and drag, in the time of one replanning. Rows are kept in learning.jsonl:
the same command continues an interrupted run. Other methods omit one part of the learning; try them on other plans than
those of the results.
"""

import argparse
import itertools
import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from benchmarks import log as lines
from benchmarks import machine
from benchmarks.casting import problem, target

import hyperflex as hf
from hyperflex import files
from hyperflex.budget import Budget
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.execution import CastLog, LearningOptions, learn_cast
from hyperflex.model import divided
from hyperflex.model.properties import LINK_NAMES
from hyperflex.motion import lagged
from hyperflex.planning import (
    CastPlan,
    Problem,
    check_feasibility,
    plan_cast,
    read_plan,
    scaled_rope,
    verify_cast,
)
from hyperflex.recording import Recording
from hyperflex.report import save_png
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure
from hyperflex.sensors import Markers
from hyperflex.trajectory import interpolated

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULTS = Path(__file__).parent / "results"
ROPES = ("nominal", "weighted", "tapered", "cord")
SEED = 924  # of the targets
GIVEN = LearningOptions(wins=1, threads=1, planning=20.0, clock=time.process_time)
UNLEARNED = tuple(each for each in GIVEN.prior if each.name != "drag")
WAYS = {
    "parameters": replace(GIVEN, motion=False),
    "motion": replace(GIVEN, parameters=False),
    "both": GIVEN,
    "both, drag unknown": replace(GIVEN, prior=UNLEARNED),
}
LESS = {
    "variations": replace(GIVEN, varied=0),
}
ABLATIONS = {f"both without {part}": options for part, options in LESS.items()}
TRUE = "true rope"
EFFECTS = {
    "arm": "The arm bends: no parameter describes it",
    "drag": "Twice the air drag: a parameter describes it, except in the last method",
}
CASTS = 5
CODE = ("planning", "simulation", "execution")  # packages whose code determines a row
LONGER, STIFFER, AIRIER, PIECES, LAG = 1.03, 1.20, 2.0, 2, 0.015  # true rope and motor; factors, pieces of a link, s
FLEXIBLE, SAG, BAR = 0.85, math.radians(1.0), 0.01  # part of an arm that bends, its bend, rad, and its mass, kg
CYLINDER = 1.2 * 1.204  # kg/m^3, drag coefficient times air density: times a rope's radius it is the drag, kg/m^2
PARTS, RATE = np.arange(1.0, 11.0) / 10.0, 100.0  # positions of the markers along the rope; Hz
NOISE, ENCODER = 2e-3, 1e-3  # m, rad


def planned_problem(rope: str) -> Problem:
    """A problem of the casting benchmark, its rope with the air drag of a cylinder: half of density, c and diameter."""
    known = problem(rope)
    return replace(known, rope=known.rope.replace(drag=CYLINDER * known.rope.radius))


def true_problem(planned: Problem, lacks: str) -> Problem:
    """The same problem with the true rope, and with more drag if the model lacks it."""
    rope = scaled_rope(divided(planned.rope, PIECES), LONGER, 1.0, STIFFER)
    return replace(planned, rope=rope.replace(drag=AIRIER * rope.drag) if lacks == "drag" else rope)


def on_bending_arm(problem: Problem, side: int) -> Problem:
    """The same rope on an arm that bends: most of it is a first link, held by a spring (a pseudo-rigid body).

    The weight of the hanging rope bends it by SAG, the pull of the swinging rope by a multiple of that.
    """
    rope, part = problem.rope, FLEXIBLE * problem.arm.length
    moment = part * math.hypot(*rope.gravity) * (rope.mass.sum() + rope.tip_mass)
    first = dict.fromkeys(LINK_NAMES, 0.0) | {
        "length": part,
        "mass": BAR,
        "com": 0.5 * part,
        "inertia": BAR * part**2 / 12.0,
        "stiffness": moment / SAG,
        "friction": 0.2 * part * math.sqrt(BAR * moment / SAG),
        "max_bend": math.inf,
    }
    links = {name: np.append(value, getattr(rope, name)) for name, value in first.items()}
    held = problem.limits.start_angle(side)
    angle = held
    for _ in range(20):
        angle = held - SAG * math.sin(angle) * (1.0 + 0.5 * BAR / (rope.mass.sum() + rope.tip_mass))
    whole = hf.Rope(**links, tip_mass=rope.tip_mass, gravity=rope.gravity, radius=rope.radius)
    q0 = (angle, *problem.start[0])
    arm = replace(problem.arm, length=problem.arm.length - part)
    return replace(problem, rope=whole, arm=arm, side=side, q0=q0, qd0=(0.0,) * len(q0))


def caster(plan: CastPlan, lacks: str) -> Callable[[CastPlan], CastLog]:
    """Makes casts with the true rope, each measured with independent errors."""
    rigid, random = true_problem(plan.problem, lacks), np.random.default_rng(SEED)
    arcs = PARTS * rigid.rope.total_length + (FLEXIBLE * rigid.arm.length if lacks == "arm" else 0.0)

    def carry_out(cast: CastPlan) -> CastLog:
        motion = cast.required(cast.motion, "motion")
        made = lagged(motion, LAG)
        true = on_bending_arm(rigid, 1 if motion.angle(0.0) > 0.0 else -1) if lacks == "arm" else rigid
        outcome = verify_cast(true, plan.target, made)
        run = outcome.run
        if run is None:
            raise RuntimeError(f"the true rope was not simulated to the end: {outcome.message}")
        t = np.arange(0.0, float(run.t[-1]), 1.0 / RATE)
        rope, q = run.setup.rope, interpolated(run.t, run.q, run.qd, t)
        seen = Markers(arcs).predict(rope, q, true.arm.tip(made.angle(t)))
        recording = Recording(t, seen + NOISE * random.standard_normal(seen.shape), "markers", noise=NOISE)
        angle = made.angle(t) + ENCODER * random.standard_normal(t.size)
        return CastLog(recording, PARTS * plan.problem.rope.total_length, angle, outcome.success)

    return carry_out


def make_plans(folder: Path, rope: str, count: int, seed: int) -> None:
    """Plan for the first targets in reach, and keep plans that succeed in a folder, until it has enough."""
    known, numbers = planned_problem(rope), kept(folder, rope)
    number = max(numbers, default=-1)
    while len(kept(folder, rope)) < count:
        number += 1
        peg = target(number, rope, seed)
        if check_feasibility(known, peg).feasible:
            search = hf.SearchOptions(seed=number, threads=1)
            plan = plan_cast(known.rope, known.arm, peg, time_budget=60.0, options=search)
            print(f"plan for {rope} {number}: {plan.message or 'succeeds'}", flush=True)
            if plan.success:
                folder.mkdir(parents=True, exist_ok=True)
                plan.to_toml(folder / f"{rope}-{number}.toml")


def kept(folder: Path, rope: str) -> list[int]:
    """Numbers of the targets whose plans are kept in a folder."""
    return sorted(int(path.stem.rpartition("-")[2]) for path in folder.glob(f"{rope}-*.toml"))


def made(plan: CastPlan, way: str, lacks: str) -> list[dict[str, Any]]:
    """Make the casts of one method; return their records."""
    carry_out = caster(plan, lacks)
    if way != TRUE:
        done = learn_cast(plan, carry_out, attempts=CASTS, options=(WAYS | ABLATIONS)[way], report=print)
        names = ("wound", "position", "speed", "lag", "problem")
        return [
            {name: getattr(each, name) for name in names} | {"factors": dict(each.factors)} for each in done.attempts
        ]
    known = plan.problem
    rope = scaled_rope(known.rope, LONGER, 1.0, STIFFER)
    rope = rope.replace(drag=AIRIER * rope.drag) if lacks == "drag" else rope
    budget = Budget(GIVEN.planning, threads=1, clock=time.process_time)
    found = plan_cast(rope, known.arm, plan.target, known.limits, time_budget=budget)
    wound = found.motion is not None and bool(carry_out(found).wound)
    return [{"wound": wound, "position": math.nan, "problem": found.message}]


def main() -> None:
    """Learn, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5, help="targets of each rope with a plan that succeeds (5)")
    parser.add_argument("--ropes", nargs="*", choices=ROPES, default=ROPES)
    parser.add_argument("--ways", nargs="*", choices=[*WAYS, TRUE, *ABLATIONS], default=list(WAYS))
    parser.add_argument("--lacks", choices=("arm", "drag"), default="arm", help="what the model lacks (arm)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the targets ({SEED})")
    parser.add_argument("--plans", type=Path, default=Path("plans"), help="folder of plans (plans)")
    parser.add_argument("--kept", action="store_true", help="make no casts, only the page of all existing targets")
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    about, log = machine.describe(), None if options.out == "-" else Path(options.out) / "learning.jsonl"
    rows = [] if options.kept else learned(options, log)
    rows = rows if log is None else lines.read(log)
    if not rows:
        raise SystemExit("no rows are kept yet; run without --kept")
    text = f"{page(rows)}\n{machine.sentence(about)} {lines.made(rows)} {lines.made(rows, 'code')}\n"
    print(text)
    if log is not None:
        files.write_text(log.with_name("learning.md"), text)
        save_png(figure(rows), log.with_name("learning.png"))


def learned(options: argparse.Namespace, log: Path | None) -> list[dict[str, Any]]:
    """Rows of all targets and methods, from the log or new."""
    known, rows = {json.dumps(each["key"]): each for each in lines.read(log)}, []
    for count, rope in itertools.product(range(1, options.count + 1), options.ropes):
        make_plans(options.plans, rope, count, options.seed)
    for index in range(options.count):
        for rope, way in itertools.product(options.ropes, options.ways):
            number = kept(options.plans, rope)[index]
            key = {"rope": rope, "seed": options.seed, "number": number, "way": way, "lacks": options.lacks}
            row = known.get(json.dumps(key))
            if row is None:
                plan = read_plan(options.plans / f"{rope}-{number}.toml")
                assert isinstance(plan, CastPlan)
                attempts = made(plan, way, options.lacks)
                row = {"key": key, "kernels": SOURCE_HASH, "code": lines.sources(*CODE), "attempts": attempts}
                if log is not None:
                    lines.append(log, row)
                print(f"{rope} {number} {way}: {' '.join(map(shown, attempts))}", flush=True)
            rows.append(row)
    return rows


def won(row: dict[str, Any], casts: int) -> bool:
    """Whether the rope wound within `casts` casts."""
    return any(each["wound"] for each in row["attempts"][:casts])


def page(rows: list[dict[str, Any]]) -> str:
    """The page of results."""
    ropes = ", ".join(dict.fromkeys(row["key"]["rope"] for row in rows))
    text = ["# Learning from each cast", ""]
    text.append(
        f"Planned casts ({ropes} of the casting benchmark), each made with a rope that differs from the planned one: "
        "links half as long, length + 3 %, friction + 20 %, motor lag 15 ms, and an effect that the planned model "
        "lacks; ten markers at 100 Hz with an error of 2 mm. All simulated. A cast succeeds if the run of the true "
        "rope meets all criteria of the plan. The learner gets the exact information whether the rope wound, which a "
        f'camera provides for most casts. "{TRUE}" knows the true rope, but not the bending of the arm, and makes one '
        f"cast, planned in {GIVEN.planning:g} s of processor time. Goal of both: 17 of 20 targets within five casts. "
        f"Targets of seed {SEED} were used when the options were chosen."
    )
    for lacks, about in EFFECTS.items():
        some = [row for row in rows if row["key"]["lacks"] == lacks]
        if some:
            text += ["", f"## {about}", "", *table(some)]
    return "\n".join([*text, "", "    python -m benchmarks.learning --plans FOLDER --lacks arm"]) + "\n"


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Lines of the rows with one effect: number of successful targets by each cast, and the distance of each cast."""
    of = {way: [row for row in rows if row["key"]["way"] == way] for way in (*WAYS, TRUE, *ABLATIONS)}
    of = {way: some for way, some in of.items() if some}
    targets = [row for k, row in enumerate(rows) if not any(alike(row, each) for each in rows[:k])]
    heads = " | ".join(f"by cast {k}" for k in range(1, CASTS + 1))
    text = [f"| learned | {heads} | of |", "|---" * (CASTS + 2) + "|"]
    for way, some in of.items():
        wins = [str(sum(won(row, k) for row in some)) for k in range(1, CASTS + 1)]
        text.append(
            f"| {way} | {' | '.join(wins[:1] if way == TRUE else wins)}{' |' * 4 * (way == TRUE)} | {len(some)} |"
        )
    text += ["", "Distance of each cast from its intended strike, mm (w: wound):", ""]
    text += ["| rope | seed | target | " + " | ".join(of) + " |", "|---" * (len(of) + 3) + "|"]
    for row in targets:
        same = {way: [each for each in some if alike(each, row)] for way, some in of.items()}
        cells = [" ".join(shown(each) for found in some for each in found["attempts"]) for some in same.values()]
        key = row["key"]
        text.append(f"| {key['rope']} | {key['seed']} | {key['number']} | {' | '.join(cells)} |")
    return text


def alike(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two rows have the same target."""
    return all(one["key"][name] == other["key"][name] for name in ("rope", "seed", "number"))


def shown(attempt: dict[str, Any]) -> str:
    """An attempt in short."""
    away = f"{1e3 * attempt['position']:.0f}" if math.isfinite(attempt["position"]) else "?"
    return away + "w" * bool(attempt["wound"])


def figure(rows: list[dict[str, Any]]) -> "Figure":
    """Share of the targets that each method has wound by each cast."""
    with new_figure(6.4, 3.8, "Learning from each cast: targets wound, simulated") as drawn:
        axis = drawn.subplots()
        for way, colour in zip(WAYS, (BLUE, RED, INK, GREEN), strict=True):
            some = [row for row in rows if row["key"]["way"] == way and row["key"]["lacks"] == "arm"]
            if some:
                part = [100.0 * float(np.mean([won(row, k) for row in some])) for k in range(1, CASTS + 1)]
                axis.plot(range(1, CASTS + 1), part, color=colour, marker="o", label=f"{way} ({len(some)})")
        axis.axhline(85.0, color=GREY, linestyle=":", label="goal")
        axis.set(xlabel="casts made", ylabel="targets wound, %", ylim=(0.0, 100.0))
        axis.set_xticks(range(1, CASTS + 1))
        legend(drawn, axis, place="lower center", columns=3)
    return drawn


if __name__ == "__main__":
    main()
