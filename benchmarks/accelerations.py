"""Cost of one evaluation of the accelerations against the number of links, checked before it is timed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import figures
import numba
import numpy as np
from cast import cable
from clock import NOTE, alternately

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.chain import articulated_body as kernels

SIZES = (10, 25, 50, 100, 200, 400, 1000, 2000)
QUICK = (10, 50)
STEP = 0.005  # s, of the implicit sweep
AGREEMENT = 1e-5  # relative; MuJoCo factors a mass matrix whose condition grows with n, and differs by 3e-7 at n = 400
# links up to which a peer is timed: Pinocchio's Data holds tensors of n^3 numbers, MuJoCo's time tends to n^3
LARGEST = {"pinocchio": 200, "mujoco": 400, "drake": 400}


@dataclass
class Case:
    """A rope on a wall in a bent, moving state: absolute angles q (n,), rad, and rates w (n,), rad/s."""

    rope: hf.Rope
    q: Array
    w: Array

    @property
    def relative(self) -> tuple[Array, Array]:
        """Angles and rates of the joints."""
        return np.diff(self.q, prepend=0.0), np.diff(self.w, prepend=0.0)

    @property
    def torque(self) -> Array:
        """Friction of the joints, N m."""
        return -self.rope.friction * self.relative[1]


def case(n_links: int) -> Case:
    """Make the state of a rope of n links; always the same."""
    random = np.random.default_rng(3)
    return Case(cable(n_links), random.normal(0.0, 0.5, n_links), random.normal(0.0, 3.0, n_links))


@numba.njit(error_model="numpy")
def _sweeps(chain, q, w, grip, base, h, alpha, work, count):  # type: ignore[no-untyped-def]
    """`count` sweeps, each on its own state, so that the compiler cannot skip any."""
    total = 0.0
    for _ in range(count):
        q[0] += 1e-15
        kernels.accelerations(chain, q, w, grip, base, 0.0, h, alpha, work)
        total += alpha[0]
    return total


@dataclass
class Timed:
    """Something to time: `run` evaluates `count` times and returns the absolute accelerations (n,) at the end."""

    name: str
    run: Callable[[], Array]
    count: int
    implicit: bool = False


def own(state: Case, h: float) -> Timed:
    """hyperflex's sweep, looped in compiled code; h = 0 is the explicit one."""
    n = state.q.size
    chain, grip, base = state.rope.chain(), np.ones(n), np.zeros(7)
    alpha, work = np.empty(n), np.empty(6 * n)
    count = max(20, 200_000 // n)

    def run() -> Array:
        _sweeps(chain, state.q.copy(), state.w, grip, base, h, alpha, work, count)
        return alpha.copy()

    return Timed("hyperflex, implicit" if h else "hyperflex, explicit", run, count, implicit=h > 0.0)


def pinocchio(peer: ModuleType, state: Case) -> Iterator[Timed]:
    """ABA in its own loop; from Python in both conventions; and with friction made implicit by an armature."""
    import pinocchio as pin

    built, count = peer.model(state.rope), max(20, 20_000 // state.q.size)
    data, (q, v), torque = built.createData(), state.relative, state.torque
    soft = built.copy()
    soft.armature = STEP * state.rope.friction

    def python(model: object, convention: object) -> Callable[[], Array]:
        def run() -> Array:
            for _ in range(count):
                joints = pin.aba(model, data, q, v, torque, convention)
            return np.cumsum(joints)

        return run

    loop = peer.Loop(built, q, v, torque, count)
    world, local = pin.Convention.WORLD, pin.Convention.LOCAL
    yield Timed("Pinocchio ABA, own loop", lambda: np.cumsum(loop.run()[:, -1]), count)
    yield Timed("Pinocchio ABA, WORLD, from Python", python(built, world), count)
    yield Timed("Pinocchio ABA, LOCAL, from Python", python(built, local), count)
    yield Timed("Pinocchio ABA, WORLD, friction as armature", python(soft, world), count, implicit=True)


def mujoco(peer: ModuleType, state: Case) -> Iterator[Timed]:
    """``mj_forward``: kinematics, mass matrix, its factors, forces, accelerations."""
    import mujoco

    compiled = peer.model(state.rope, None, "Euler", 1e-4)
    data, count = mujoco.MjData(compiled), max(3, 50_000 // state.q.size**2)
    data.qpos[:], data.qvel[:] = state.relative

    def run() -> Array:
        for _ in range(count):
            mujoco.mj_forward(compiled, data)
        return np.cumsum(data.qacc)

    yield Timed("MuJoCo mj_forward", run, count)


def drake(peer: ModuleType, state: Case) -> Iterator[Timed]:
    """``EvalTimeDerivatives`` after setting the state, as its explicit integrators do."""
    plant = peer.Rig(state.rope, None).plant
    context, count = plant.CreateDefaultContext(), max(10, 5_000 // state.q.size)
    full = np.concatenate(state.relative)

    def run() -> Array:
        for _ in range(count):
            context.SetContinuousState(full)
            derivatives = plant.EvalTimeDerivatives(context)
        return np.cumsum(derivatives.CopyToVector()[state.q.size :])

    yield Timed("Drake time derivatives", run, count)


PEERS = {"pinocchio": pinocchio, "mujoco": mujoco, "drake": drake}


def measure(quick: bool, repeats: int, peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {links, what, microseconds: {...}, disagreement}; a peer that disagrees is an error."""
    rows = []
    for n in QUICK if quick else SIZES:
        state = case(n)
        timed = [own(state, 0.0), own(state, STEP)]
        for name, largest in LARGEST.items():
            if name in peers and n <= largest:
                timed += PEERS[name](peers[name], state)
        true = {item.implicit: item.run() for item in timed[:2]}
        for item, times in zip(timed, alternately([x.run for x in timed], repeats, 2.0), strict=True):
            want = true[item.implicit]
            gap = float(np.abs(times.result - want).max() / np.abs(want).max())
            if not gap < AGREEMENT:
                raise RuntimeError(f"{item.name} at n = {n} differs from hyperflex by {gap:.2g} of the largest")
            cost = times.scaled(1e6 / item.count)
            rows.append({"links": n, "what": item.name, "microseconds": cost, "disagreement": gap})
    return rows


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown table: one column for each number of links."""
    sizes = sorted({row["links"] for row in rows})
    lines = ["| microseconds at n = | " + " | ".join(map(str, sizes)) + " |", "|---" * (len(sizes) + 1) + "|"]
    for what in dict.fromkeys(row["what"] for row in rows):
        found = {row["links"]: row["microseconds"]["median"] for row in rows if row["what"] == what}
        lines.append(f"| {what} | " + " | ".join(f"{found[n]:.3g}" if n in found else "" for n in sizes) + " |")
    worst = max(row["disagreement"] for row in rows)
    note = (
        "\n\nMedian time of one evaluation of all accelerations of a bent, moving rope on a wall. Each peer's "
        f"accelerations differ from hyperflex's by at most {worst:.1g} of the largest one (checked before timing). "
        "hyperflex and Pinocchio's own loop run without Python between two evaluations; a call from Python adds about "
        f"a microsecond. Implicit: friction at the end of a step of {STEP:g} s. Pinocchio is omitted above n = "
        f"{LARGEST['pinocchio']} (its data contain n^3 numbers), MuJoCo and Drake above {LARGEST['mujoco']}."
    )
    return "\n".join(lines) + note + f" {NOTE}" + verdict(rows)


def verdict(rows: list[dict[str, Any]]) -> str:
    """Speed-up of the two sweeps over each peer at the paper's n = 50."""
    at = {row["what"]: row["microseconds"]["median"] for row in rows if row["links"] == 50}
    explicit, implicit = at["hyperflex, explicit"], at["hyperflex, implicit"]
    others = [f"{v / explicit:.1f} and {v / implicit:.1f} ({k})" for k, v in at.items() if not k.startswith("hyper")]
    return f"\n\nSpeed-up of the explicit and the implicit sweep at n = 50: {', '.join(others)}." if others else ""


def figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw time against n."""
    groups: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        groups.setdefault(row["what"], []).append((row["links"], row["microseconds"]["median"]))
    figures.against_links(groups, "One acceleration of all links", "microseconds", path)
