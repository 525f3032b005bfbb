"""Many rollouts beside pegs or with joint limits: each as :func:`simulate` runs it, members on threads."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core import status
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Obstacle, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation.contact.runs import beside, finer
from hyperflex.simulation.contact.start import check_limits, check_outside
from hyperflex.simulation.outcome import conclude
from hyperflex.simulation.rollouts import limits, prepare, progress_bar
from hyperflex.simulation.time_budget import INTERRUPTED, OutOfPatience, impatient
from hyperflex.simulation.time_budget import NAME as TOO_SLOW
from hyperflex.trajectory import Trajectory, swept

TURNS = "turns"
# name: shape of one sample, as dimensions
SHAPES: dict[str, tuple[str, ...]] = {
    "tip": ("axis",),
    "q": ("link",),
    "qd": ("link",),
    "motor_work": (),
    "dissipated_energy": (),
    TURNS: ("peg",),
    "peg_angle": ("peg",),
    "peg_rate": ("peg",),
}


@dataclass(frozen=True)
class Members:
    """What the members of such a batch are made of; lists have one entry for all members, or one each."""

    ropes: list[Rope]
    motions: Sequence[Motion | None]
    pegs: list[tuple[Obstacle, ...]]
    q0: Array | None  # (n,) or (M, n), of the ropes before they are cut
    qd0: Array | None
    arm: Arm | None
    refine: bool
    patience: float | None  # s of processor time for each
    others: dict[str, Any]  # of Setup

    @property
    def count(self) -> int:
        """Number of members."""
        starts = [len(v) for v in (self.q0, self.qd0) if v is not None and v.ndim == 2]
        return max(len(self.ropes), len(self.motions), len(self.pegs), *starts)

    def setup(self, m: int) -> Setup:
        """Return the set-up of member m."""
        rope, motion = self.ropes[m % len(self.ropes)], self.motions[m % len(self.motions)]
        pegs = self.pegs[m % len(self.pegs)]
        start = (self.q0, self.qd0)
        q0, qd0 = (None if v is None else np.broadcast_to(v, (self.count, rope.n_links))[m] for v in start)
        if self.refine:
            rope, q0, qd0, _ = finer(rope, pegs, self.arm, q0, qd0, None)
        return Setup(rope, motion, self.arm, q0=q0, qd0=qd0, pegs=pegs, **self.others)


def beside_of(
    ropes: Rope | Sequence[Rope],
    motions: Motion | Sequence[Motion] | None,
    pegs: Sequence[Obstacle] | Sequence[Sequence[Obstacle]],
    start: tuple[npt.ArrayLike | None, npt.ArrayLike | None],
    **others: Any,
) -> Members:
    """Make members of what :func:`simulate_batch` takes, and refuse what does not fit together."""
    q0, qd0 = (None if value is None else np.asarray(value, dtype=np.float64) for value in start)
    rope_list = [ropes] if isinstance(ropes, Rope) else list(ropes)
    motion_list = [motions] if motions is None or isinstance(motions, Motion) else list(motions)
    members = Members(rope_list, motion_list, pegs_of(pegs), q0, qd0, **others)
    check_fit(members)
    return members


def pegs_of(pegs: Sequence[Obstacle] | Sequence[Sequence[Obstacle]]) -> list[tuple[Obstacle, ...]]:
    """Return the pegs of each member; one entry if they are the same for all."""
    given = list(pegs)
    if all(isinstance(each, Obstacle) for each in given):
        return [tuple(given)]  # type: ignore[arg-type]
    lists = [tuple(each) for each in given if isinstance(each, Sequence)]
    if len(lists) < len(given):
        raise InvalidInput("pegs mixes pegs and lists of pegs", allowed="pegs for all members, or a list of pegs each")
    return lists


def check_fit(members: Members) -> None:
    """Refuse lists of different lengths, and pegs of different numbers."""
    sizes = [len(members.ropes), len(members.motions), len(members.pegs)]
    if 0 in sizes or set(sizes) - {1, members.count}:
        raise InvalidInput(
            "ropes, motions and pegs do not fit together", got=sizes, allowed="one for all members, or as many of each"
        )
    numbers = sorted({len(each) for each in members.pegs})
    if len(numbers) > 1:
        raise InvalidInput("members have different numbers of pegs", got=numbers, allowed="the same for all")
    links = sorted({rope.n_links for rope in members.ropes})
    if len(links) > 1:
        raise InvalidInput("ropes of a batch differ in links", got=links, allowed="the same number for all")
    for name, value in (("q0", members.q0), ("qd0", members.qd0)):
        if value is not None:
            checks.array(name, value, (links[0],) if np.ndim(value) == 1 else (members.count, links[0]))


def run_members(
    members: Members, t: Array, keep: tuple[str, ...], threads: int, progress: bool
) -> tuple[dict[str, Array], list[str], Array]:
    """Run all members; Ctrl-C keeps those that are finished.

    Returns
    -------
    values : dict of str to (M, T, ...) float64
        What was kept; NaN from where a member failed, and beyond the links that a rope has.
    names : (M,) list of str
        "ok", the name of the failure, or INTERRUPTED.
    reached : (M,) float64
        Time that each member reached, s.
    """
    setups = [members.setup(m) for m in range(members.count)]
    for m, setup in enumerate(setups):
        check_outside(setup, who=f"the rope of member {m}")
        check_limits(setup, who=f"the rope of member {m}")
    sizes = {"link": max(s.rope.n_links for s in setups), "axis": 2, "peg": len(setups[0].round_pegs)}
    values = {k: np.full((len(setups), t.size, *(sizes[d] for d in SHAPES[k])), np.nan) for k in keep}
    names, reached = [INTERRUPTED] * len(setups), np.zeros(len(setups))

    def one(m: int) -> None:
        run = _run(setups[m], t, members.patience)
        for name, target in values.items():
            found = _kept(run, name)
            whole: tuple[slice, ...] = tuple(slice(0, size) for size in found.shape)
            target[m][whole] = found
        reached[m], names[m] = run.state.t, run.status

    with ThreadPoolExecutor(threads) as pool, progress_bar(0, len(setups), progress, "members") as report:
        futures = [pool.submit(one, m) for m in range(len(setups))]
        try:
            for done, future in enumerate(futures):
                future.result()
                if report is not None:
                    report(done + 1)
        except KeyboardInterrupt:
            for future in futures:
                future.cancel()
    return values, names, reached


def _run(setup: Setup, t: Array, patience: float | None) -> Trajectory:
    """Run one member with outputs at t (T,), s; the trajectory holds what holds."""
    chain = setup.chain()
    bounds = limits(setup, chain, setup.duration)
    rollout = prepare(chain, setup.drive(), setup.start(), np.append(0.0, t), bounds)
    try:
        code = beside(rollout, setup, None).finish(impatient(None, patience))
        name = status.NAMES[code]
    except OutOfPatience:
        code, name = status.RUNNING, TOO_SLOW
    return conclude(rollout, setup, code, name, throw=False, skip=1)


def _kept(run: Trajectory, name: str) -> Array:
    """Return one of the quantities of SHAPES (T, ...)."""
    if name != TURNS:
        value = getattr(run, name)
        return np.zeros((run.t.size, len(run.setup.round_pegs))) if value is None else np.asarray(value)
    centres = np.array([[peg.x, peg.y] for peg in run.setup.round_pegs])
    return np.stack([swept(run.joints - centre).sum(axis=1) for centre in centres], axis=1) / (2.0 * np.pi)
