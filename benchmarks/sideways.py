"""Planned casts that start out of their plane: predicted by ``hyperflex.sideways`` and simulated in MuJoCo in space.

python -m benchmarks.sideways FOLDER [FOLDER ...]     plans (``cast.toml``) in them: cost, strike and casts
python -m benchmarks.sideways FOLDER --part casts     one part; existing rows are not repeated

The chain is that of ``casts_mujoco``, but each joint is two hinges, across the plane and across the link (or a ball, as
a check). Links are thin rods. The target is a long cylinder: a rope that lies on it farther from the plane than half a
width would miss a target of that width.

- cost: processor times of the planar run, with a sample every 10 ms, and of one tilt.
- strike: MuJoCo simulates the rope, without divided links, until the planned first touch, without contact. It starts
  LEAD s before the touch with the state of a hyperflex run that began slightly out of the plane, so that no link leans
  by more than LEAN, and of one that began 1 degree out of it. Distances from the plane are compared, from the striking
  point to the rope's end. If the planar runs then differ by more than 1 % of the rope's length, the two programs do not
  simulate the same cast.
- start: like strike, but from the start of the cast, for the small tilt.
- casts: MuJoCo starts 20 ms before the first touch, with the predicted state, and winds the rope. If a link leans by
  more than 20 degrees earlier, MuJoCo starts there, while the first order is still accurate (with armature, because
  pairs of hinges are singular if a link is bent by 90 degrees to the side). A cast winds if it makes 1.25 turns in the
  planned direction for 0.3 s, within 1.3 s after the planar run first has them. A cast whose links lean by more than 90
  degrees (to first order) and that misses with 1 degree is not simulated with larger tilts: it counts as a failure.
"""

import argparse
import functools
import json
import math
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import casts_mujoco as planar
from benchmarks import log as lines
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.checks import Array
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.planning import WindCriteria

RESULTS = Path(__file__).parent / "results"
TILTS = (1.0, 2.0, 3.0)  # degrees; without a tilt, MuJoCo's run stays planar: ``casts_mujoco``
SMALL, LEAN = 0.1, 5.0  # degrees: tilt for which the first order is accurate, unless a link leans by more than LEAN
WIDTHS = (0.05, 0.1, 0.2, 0.4)  # m, of the target
STAY = 30  # samples with the turns required, in which a cast counts as wound
BEFORE = 0.02  # s before the first touch at which MuJoCo starts
LATE = 1.3  # s, after which a cast is given up
HOLDS = 20.0  # degrees, lean of a link up to which the first order errs by at most 5 %
STEP = 2.0 * planar.STEP  # s, of casts: turns and places on the target are then those of the planar step to 1 %
LEAD, SAMPLE = 2.0, 2.5e-3  # s
FLIGHT = 1e-4  # s, step of a flight without armature
PARTS = ("cost", "strike", "start", "casts")


def hinge_angles(arm: float, directions: Array) -> Array:
    """Return the angles (2 n,) of pairs of hinges, rad, of links along unit vectors (n, 3) on an arm at an angle."""
    frame, found = turn(0, arm), []
    for along in directions:
        local = frame.T @ along
        first, second = math.atan2(local[0], -local[2]), math.asin(local[1])
        found += [first, second]
        frame = frame @ turn(0, first) @ turn(1, second)
    return np.array(found)


def turn(kind: int, angle: float) -> Array:
    """Return the rotation (3, 3) of a hinge about -y (0) or x (1)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[[c, 0, -s], [0, 1, 0], [s, 0, c]], [[1, 0, 0], [0, c, -s], [0, s, c]]][kind])


def in_space(q: Array, lean: Array) -> Array:
    """Return unit vectors (n, 3) along links at angles q in the plane and `lean` out of it (n,), rad."""
    c = np.cos(lean)
    return np.stack([np.sin(q) * c, np.sin(lean), -np.cos(q) * c], axis=1)


class Flight:
    """A rope in space in MuJoCo, on the arm of a set-up, from a state at a time t, s."""

    def __init__(
        self,
        setup: hf.Setup,
        step: float,
        t: float,
        state: tuple[Array, Array, Array, Array],
        armature: float = planar.ARMATURE,
    ) -> None:
        import mujoco

        self.setup, self.t, self.mujoco = setup, t, mujoco
        self.model = planar.model(setup, step, spatial=True)
        self.model.dof_armature[1:] = armature
        self.data = mujoco.MjData(self.model)
        assert setup.motion is not None
        arm, rate = (float(each(np.array([t]))[0]) for each in (setup.motion.angle, setup.motion.rate))
        q, qd, x, v = state
        tiny = 1e-6

        def angles(dt: float) -> Array:
            return hinge_angles(arm + dt * rate, in_space(q + dt * qd, x + dt * v))

        self.data.qpos[:] = np.append(arm, angles(0.0))
        self.data.qvel[:] = np.append(rate, (angles(tiny) - angles(-tiny)) / (2.0 * tiny))
        self.links, self.tip = slice(2, 2 + setup.rope.n_links), self.model.site("tip").id
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        mujoco.mj_forward(self.model, self.data)

    def joints(self) -> Array:
        """Return the joints (n + 1, 3), m: x, out of the plane, y."""
        self.mujoco.mj_kinematics(self.model, self.data)
        return np.vstack([self.data.xpos[self.links], self.data.site_xpos[self.tip]])

    @property
    def stable(self) -> bool:
        """Whether MuJoCo has not reset the simulation because of an unstable state."""
        kinds = self.mujoco.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        return not any(self.data.warning[int(kind)].number for kind in bad)

    def run(self, until: float) -> None:
        """Step to a time, s."""
        step, data, motion = self.model.opt.timestep, self.data, self.setup.motion
        assert motion is not None
        count = round((until - self.t) / step)
        t = self.t + step * np.arange(count + 1)
        angle, rate, pull = motion.angle(t), motion.rate(t), planar.ARM * motion.acceleration(t + 0.5 * step)
        for k in range(count):
            data.qpos[0], data.qvel[0], data.qfrc_applied[0] = angle[k], rate[k], pull[k]
            if self.setup.rope.drag.any():
                data.xfrc_applied[self.links] = self.air()
            self.mujoco.mj_step(self.model, data)
            if data.ncon:
                self.model.opt.integrator = self.mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.t = float(t[-1])

    def air(self) -> Array:
        """Return the air's forces and torques (n, 6) on the links, as ``casts_mujoco.air`` in space."""
        rope, data, links = self.setup.rope, self.data, self.links
        along, speed = -data.xmat[links].reshape(-1, 3, 3)[:, :, 2], data.cvel[links]
        place = 0.5 * rope.length[:, None] * (1.0 + planar.POINTS)
        points = data.xpos[links][:, None] + place[..., None] * along[:, None]
        centre = data.subtree_com[self.model.body_rootid[self.links.start]]
        u = speed[:, None, 3:] + np.cross(speed[:, None, :3], points - centre)
        u -= (u * along[:, None]).sum(axis=2, keepdims=True) * along[:, None]
        weight = (0.5 * rope.drag * rope.length)[:, None] * planar.WEIGHTS
        force = -(weight * np.linalg.norm(u, axis=2))[..., None] * u
        moment = np.cross(points - data.xipos[links][:, None], force)
        return np.hstack([force.sum(axis=1), moment.sum(axis=1)])


@functools.lru_cache(1)
def predicted(path: Path) -> tuple[hf.Trajectory, hf.Sideways, int]:
    """Return a planar run, its motion sideways for a tilt of 1 rad, and the link that touches first."""
    setup = hf.Setup.from_toml(path)
    t = np.arange(0.0, setup.duration, SAMPLE)
    run = hf.simulate(setup, t_eval=t)
    assert run.contact_force is not None
    touching = run.contact_force.any(axis=2)
    first = int(touching.any(axis=1).argmax())
    link = int(touching[first].argmax())
    for share in np.linspace(1.0, 0.1, 10):  # a solution that grows without bound is available only up to some time
        known = run if share == 1.0 else hf.simulate(setup, t_eval=t[: int(share * first)])
        try:
            return run, hf.sideways(known, tilt=1.0), link
        except (hf.errors.InvalidInput, hf.errors.SimulationError) as error:
            print(f"{path}: {error}")
    raise ValueError(f"{path}: no motion out of the plane is available")


def strike(path: Path, name: str, step: float, tilt: float, lead: float = LEAD) -> dict[str, Any]:
    """Return distances from the plane at the first touch, m, in hyperflex and MuJoCo, after a flight of `lead` s."""
    whole, known, link = predicted(path)
    cut, plan = whole.setup, hf.read_plan(path)
    assert isinstance(plan, hf.CastPlan)
    rope = plan.problem.rope
    t = np.asarray(known.t)
    setup = cut.replace(rope=rope, duration=float(t[-1]), q0=None, qd0=None)
    run = hf.simulate(setup.replace(pegs=()), t_eval=t)
    own = hf.sideways(run, tilt=math.radians(tilt))
    lean = math.degrees(float(np.abs(own.angles).max())) / tilt
    begun = min(tilt, LEAN / lean) if tilt == SMALL else tilt
    own = hf.sideways(run, tilt=math.radians(begun))
    k = int(np.searchsorted(t, t[-1] - lead))
    flight = Flight(setup, step, float(t[k]), (run.q[k], run.qd[k], own.angles[k], own.rates[k]), 0.0)
    flight.model.opt.disableflags |= int(flight.mujoco.mjtDisableBit.mjDSBL_CONTACT)
    seen = [flight.joints()]
    for each in t[k + 1 :]:
        flight.run(float(each))
        seen.append(flight.joints())
    there, want = np.array(seen), own.joints[k:]
    first = int(np.searchsorted(rope.link_ends, cut.rope.link_ends[link] - 1e-9))
    apart = np.linalg.norm(there[..., [0, 2]] - run.joints[k:], axis=-1).max(axis=1)
    off = np.abs(there[..., 1] - want).max(axis=1)
    same = int(np.argmax(np.append(apart > 0.01 * rope.total_length, True))) or 1  # samples with the same planar cast
    return {
        "t": float(t[-1]),
        "length": rope.total_length,
        "growth": float(own.growth()[1][-1]),
        "begun": begun,
        "lean": lean * begun,
        "aside": float(np.abs(want[-1, first:]).max()),
        "aside in MuJoCo": float(np.abs(there[-1, first:, 1]).max()),
        "planar difference": float(apart[-1]),
        "same until": float(t[k + same - 1]),
        "error until then": float(off[:same].max() / np.abs(want[:same]).max()),
        "same": same == t.size - k,
        "stable": flight.stable,
    }


def cast(path: Path, name: str, step: float, tilt: float) -> dict[str, Any]:
    """Return turns in MuJoCo, and the distance from the plane at which the rope then lies on the target, m."""
    run, found, link = predicted(path)
    setup, lean, t = run.setup, math.radians(tilt), found.t
    assert run.contact_force is not None
    touch = run.t[run.contact_force.any(axis=(1, 2)).argmax()]
    most = tilt * np.maximum.accumulate(np.abs(found.angles).max(axis=1))  # degrees, of a tilt of 1 rad
    k = int(np.searchsorted(np.where(t > touch - BEFORE + 1e-9, math.inf, most), HOLDS)) - 1
    peg = setup.round_pegs[0]
    turns = planar.swept_turns(run.joints, peg)
    expected = float(turns[-1])
    enough = np.flatnonzero(turns * np.sign(expected) >= WindCriteria.turns)
    q, qd = found.run.q[k], found.run.qd[k]
    flight = Flight(setup, step, float(t[k]), (q, qd, lean * found.angles[k], lean * found.rates[k]))
    if touch - BEFORE > t[k]:  # as for planar casts
        flight.model.opt.timestep, whole = planar.STEP, flight.model.opt.integrator
        flight.model.opt.integrator = flight.mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        flight.run(touch - BEFORE)
        flight.model.opt.timestep, flight.model.opt.integrator = step, whole
    stop, seen, late, furthest = float(run.t[enough[0]]) + LATE, [], 0.0, 0.0
    while flight.t < stop - 1e-9 and late * np.sign(expected) < WindCriteria.turns:
        flight.run(min(flight.t + planar.LOOK, stop))
        seen.append(float(planar.swept_turns(flight.joints()[:, [0, 2]], peg)))
        if flight.data.ncon:
            furthest = max(furthest, float(np.abs(flight.data.contact.pos[:, 1]).max()))
        late = float(sorted(seen[-STAY:], key=abs)[0]) if len(seen) >= STAY else 0.0
    return {
        "turns": expected,
        "lean": float(most[-1]),
        "flown": float(touch - t[k]),
        "step": step,
        "turns in MuJoCo": late,
        "winds": bool(late * np.sign(expected) >= WindCriteria.turns) and flight.stable,
        "furthest": furthest,
        "aside": lean * float(np.abs(found.joints[-1, link:]).max()) if found.touch else None,
        "until": flight.t,
        "stable": flight.stable,
    }


def cost(path: Path, name: str, step: float, tilt: float) -> dict[str, Any]:
    """Return the processor time, s, of the planar run and of one tilt: the least of five."""
    setup = hf.Setup.from_toml(path)
    plain = setup.replace(pegs=(), duration=min(setup.duration, 8.0))
    t = np.arange(0.0, plain.duration, planar.LOOK)
    found = {}
    for which, each in (("cast", setup), ("flight", plain)):
        t = np.arange(0.0, each.duration, planar.LOOK)
        run = hf.simulate(each, t_eval=t)
        found[which] = least(lambda each=each, t=t: hf.simulate(each, t_eval=t))
        found[f"tilt of the {which}"] = least(lambda run=run: hf.sideways(run, tilt=math.radians(tilt)))
    return found


def least(work: Any) -> float:
    """Return the least processor time of five calls, s."""
    times = []
    for _ in range(5):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders to search, or set-ups of plans")
    parser.add_argument("--part", choices=PARTS, help="by default all")
    parser.add_argument("--step", type=float, help=f"of MuJoCo, s ({STEP:g}; flights {FLIGHT:g})")
    parser.add_argument("--count", type=int, default=1000, help="casts at most of each part")
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    log = None if options.out == "-" else Path(options.out) / "sideways.jsonl"
    rows, paths = lines.read(log), dict(planar.plans(options.folders))
    names = sorted(paths)
    random.Random(0).shuffle(names)
    lines.warn_of_others(rows)
    made = {(row["part"], row["name"], row["tilt"]) for row in rows}
    work: dict[str, Any] = {"cost": (cost, TILTS[:1]), "strike": (strike, (SMALL, TILTS[0])), "casts": (cast, TILTS)}
    work["start"] = functools.partial(strike, lead=math.inf), (SMALL,)
    for part in [options.part] if options.part else PARTS:
        measure, tilts = work[part]
        step = options.step or (FLIGHT if part in ("strike", "start") else STEP)
        for name, tilt in [(name, tilt) for tilt in tilts for name in names[: options.count]]:
            if (part, name, tilt) in made or (part == "casts" and name in lost(rows) and tilt > TILTS[0]):
                continue
            begin = time.process_time()
            try:
                row = {"part": part, "name": name, "tilt": tilt, **measure(paths[name], name, step, tilt)}
            except (hf.InvalidInput, hf.errors.SimulationError) as error:  # the solution grows too fast for the samples
                print(f"{name}: {error}")
                continue
            row |= {"seconds": time.process_time() - begin, "kernels": SOURCE_HASH}
            rows.append(row)
            print(json.dumps(row), flush=True)
            if log is not None:
                lines.append(log, row)
    text = page(rows)
    print(text)
    if log is not None:
        files.write_text(log.with_name("sideways.md"), text)


def page(rows: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    by = {part: [row for row in rows if row["part"] == part] for part in PARTS}
    text = ["# Motion out of the plane", "", "All simulated. " + machine.sentence(machine.describe()), ""]
    if some := by["cost"]:
        parts = [np.array([row[f"tilt of the {which}"] / row[which] for row in some]) for which in ("flight", "cast")]
        shown = "; ".join(
            f"of {which} {np.median(each):.2f} (median), {each.max():.2f} at most"
            for which, each in zip(("a flight without a target", "the cast with its contact"), parts, strict=True)
        )
        text += [
            "## Cost",
            "",
            f"Processor time of one tilt divided by that of the planar run, {len(some)} casts: {shown}.",
            "",
        ]
    text += struck(by["strike"], f"MuJoCo simulates the last {LEAD:g} s") + struck(
        by["start"], "MuJoCo simulates from the start"
    )
    if some := by["casts"]:
        text += [
            "## Do casts still wind?",
            "",
            "Casts that wind in MuJoCo, by the tilt at the start and the target's width. Here a cast winds if it makes",
            "1.25 turns for 0.3 s. This is weaker than for [planar casts in MuJoCo](casts-mujoco.md), whose result is",
            "the row without a tilt. A long target is 1 m wide. A few casts were not simulated because of their",
            "computing time, so up to as many more may wind.",
        ]
        text += [
            "",
            "| tilt, degrees | casts | not simulated | long target | "
            + " | ".join(f"{1e3 * w:g} mm" for w in WIDTHS)
            + " |",
        ]
        text += ["|---" * (4 + len(WIDTHS)) + "|"]
        flat = lines.read(RESULTS / "casts-mujoco.jsonl")
        text += [
            "| 0, planar | "
            + " | ".join([str(len(flat)), "0", *[str(sum(row["winds"] for row in flat))] * (1 + len(WIDTHS))])
            + " |"
        ]
        for tilt in TILTS:
            own = [row for row in some if row["tilt"] == tilt]
            left = len({row["name"] for row in flat} - {row["name"] for row in own} - lost(rows))
            wide = [sum(row["winds"] and row["furthest"] <= 0.5 * w for row in own) for w in WIDTHS]
            wound = sum(row["winds"] for row in own)
            text += [f"| {tilt:g} | {len(flat)} | {left} | {wound} | {' | '.join(map(str, wide))} |"]
        never = sorted({f"{row['name']} ({row['tilt']:g})" for row in some if not row["winds"]})
        text += [
            "",
            f"Casts that do not wind on any width (tilt in degrees): {', '.join(never) or 'none'}.",
            "",
        ]
    return "\n".join([*text, lines.made(rows), "", "Reproduce: `python -m benchmarks.sideways FOLDER`", ""])


def lost(rows: list[dict[str, Any]]) -> set[str]:
    """Return the casts that lean so far with the least tilt that they miss: larger tilts are not simulated."""
    casts = [row for row in rows if row["part"] == "casts" and row["tilt"] == TILTS[0]]
    return {row["name"] for row in casts if not row["winds"] and row["lean"] > 90.0}


def struck(rows: list[dict[str, Any]], words: str) -> list[str]:
    """Return the part of the page on distances from the plane at the strike."""
    if not rows:
        return []
    small, whole = ({row["name"]: row for row in rows if (row["tilt"] == SMALL) is each} for each in (True, False))
    text = [
        f"## At the strike: {words}",
        "",
        f"Begun {SMALL:g} degrees out of the plane, or less, so that no link leans by more than {LEAN:g} degrees, and",
        "1 degree. Growth: of the worst deviation until the first touch; lean: greatest angle of a link out of the",
        "plane, degrees, begun 1 degree out of it, to first order. Aside: the most from the place that strikes to the",
        "rope's end, mm a degree. Apart: planar difference of the programs at the strike, small tilt, % of the length.",
        "",
        "| cast | at, s | growth | lean | aside | MuJoCo, small tilt | error, % | apart | 1 degree | error, % |",
        "|---" * 10 + "|",
    ]
    for name, row in sorted(small.items()):
        two = whole.get(name)
        large = f"{1e3 * two['aside in MuJoCo']:.1f} | {100 * error(two):.1f}" if two and two["stable"] else " | "
        aside, there = (1e3 * row[key] / row["begun"] for key in ("aside", "aside in MuJoCo"))
        known = f"{row['t']:.2f} | {row['growth']:.3g} | {row['lean'] / row['begun']:.1f} | {aside:.1f} | {there:.1f}"
        apart = 100 * row["planar difference"] / row["length"]
        text += [f"| {name} | {known} | {100 * error(row):.1f} | {apart:.2g} | {large} |"]
    same, others = ([row for row in small.values() if row["same"] is each] for each in (True, False))
    text += [
        "",
        f"Small tilts: in {len(same)} of {len(small)} casts the two programs simulate the same cast. {spread(same)}",
    ]
    text += (
        [f"The other {len(others)}, {', '.join(row['name'] for row in others)}, are not predictable."] if others else []
    )
    for least, most, what in ((0.0, LEAN, "up to"), (LEAN, math.inf, "more than")):
        own = [row for row in whole.values() if row["stable"] and least < row["lean"] <= most]
        text += (
            [f"1 degree, {len(own)} casts whose links lean by {what} {LEAN:g} degrees: {spread(own)}"] if own else []
        )
    return [*text, ""]


def error(row: dict[str, Any]) -> float:
    """Return the error of the distance from the plane as a fraction of MuJoCo's."""
    return abs(row["aside"] / row["aside in MuJoCo"] - 1.0) if row["stable"] else math.inf


def spread(rows: list[dict[str, Any]]) -> str:
    """Describe the errors of the distances."""
    off = np.array([error(row) for row in rows])
    most = f"{100 * np.median(off):.2g} % (median), {100 * off.max():.2g} % at most"
    return f"Errors of the distances: {most}; {int((off <= 0.1).sum())} of {off.size} are within 10 %."


if __name__ == "__main__":
    main()
