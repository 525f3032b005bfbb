"""How the tip enters a slot after strokes, with exact derivatives by them, and what lacks to an entry in its middle."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.clearance import sampled_clearance
from hyperflex.planning.insert.slot import Slot, find_crossings, frame, passages, tip_speed
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.aim import position_std, swing_derivatives, swing_times
from hyperflex.planning.tip.joint_motion import JointMotion
from hyperflex.planning.tip.obstacle_gaps import BESIDE, SpareGaps, least_spare_gaps, margins
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.task import Aimed

LEVELS = (0.0, 0.5, 1.0)  # of the depth asked, at which the rope shall be in the middle of the gap
DEEPER = 1.1  # times the depth asked, that the tip shall reach
MARGIN = 0.35  # of the gap beside the rope
SLACK = 0.5  # part of the offset allowed, up to which it is left where depth or another gap fails
SLOWER = 1.02  # times the speed asked that the tip shall be slower: finer links differ by less
SPARSE = 4  # samples of which one is looked at for the arm's clearance


@dataclass(frozen=True, eq=False)
class Entry(Aimed):
    """A way of the tip through a slot until it is as deep as asked, or deepest, at time `t`.

    `offset` (3,), m, is where the rope crosses the line of the walls with the tip at LEVELS of the depth asked; of a
    tube where the tip is at the last two of these, too: (5,). `depth`, m, is the greatest that the tip reaches. Its
    `speed` at `t` is in m/s. `gaps` (G,), m, are least distances from the walls of all the rope but what follows the
    tip through, of each time that it crosses their line, and those from obstacles, less the clearance asked, of each
    time that it comes near one; they shall be `beside` (G,), m, at least. `doffset` (3 or 5, P), `ddepth` (P,) and
    `dgaps` (G, P) are derivatives. `clearance`, m, is the least distance of the rope from its own arm.
    """

    offset: Array
    depth: float
    gaps: Array
    doffset: Array
    ddepth: Array
    dgaps: Array
    beside: Array
    clearance: float
    speed: float

    @property
    def gap(self) -> float:
        """The least of the gaps, m; infinite without any."""
        return float(self.gaps.min(initial=np.inf))


class _Run:
    """A run with derivatives in the frame of a slot."""

    def __init__(self, slot: Slot, radius: float, motion: JointMotion) -> None:
        self.slot, self.motion = slot, motion
        self.depth, self.offset = frame(slot, motion.places)
        self.crossings = find_crossings(slot, radius, self.depth, self.offset)

    def changes(self, row: int) -> tuple[Array, Array]:
        """Return derivatives of depth and offset of all joints (n + 1, P + 2) at a row."""
        both = np.einsum("ax,jxp->ajp", self.slot.axes, self.motion.changes(row))
        return both[0], both[1]

    def at(self, k: int) -> tuple[float, Array]:
        """Return the offset of a crossing and its derivatives (P + 2,)."""
        row, link = int(self.crossings.row[k]), int(self.crossings.link[k])
        (d, u), (dd, du) = (self.depth[row], self.offset[row]), self.changes(row)
        sides = slice(link, link + 2)
        return _at_level(0.0, d[sides], u[sides], dd[sides], du[sides])[2:]

    def mouth(self, row: int) -> tuple[float, Array] | None:
        """Return the offset of the crossing that follows the tip through, and its derivatives; None without one."""
        found = np.flatnonzero(self.crossings.tip & (self.crossings.row == row))
        return self.at(int(found[0])) if found.size else None


def find_entry(problem: Problem, slot: Slot, strokes: Strokes, near: float) -> Entry | None:
    """Find the way of the tip through a slot that ends next to time `near`, s; None if there is none."""
    t = swing_times(near)
    derivatives = swing_derivatives(problem, strokes, t)
    if derivatives is None:
        return None
    motion = JointMotion(problem.rope, derivatives)
    run = _Run(slot, problem.rope.radius, motion)
    depth = run.depth[:, -1]
    found = list(zip(passages(depth, slot.depth), passages(depth, DEEPER * slot.depth), strict=True))
    if not found:
        return None
    (begin, end), (_, deepest) = min(found, key=lambda way: abs(t[way[0][1]] - near))
    told = [at for level in LEVELS if (at := _at_depth(run, level * slot.depth, begin, end)) is not None]
    if len(told) < len(LEVELS):
        return None
    late, dlate, _, _ = told[-1]
    if slot.tube > 0.0:
        told += [_tip_at(run, level * slot.depth, begin, end) for level in LEVELS[1:]]
    doffset = np.array([each[3] for each in told])
    asked = margins(problem, slot.point + np.array([[0.0], [slot.depth]]) * slot.axes[0])
    walls, others = _least_gaps(run, begin, end), least_spare_gaps(problem, motion, end + 1, asked)
    gaps, dgaps, beside = (np.concatenate(each) for each in zip(walls, others, strict=True))
    return Entry(
        strokes,
        float(t[end] + (late - 1.0) * (t[end] - t[end - 1])),
        dlate[:-2] * (t[end] - t[end - 1]),
        position_std(doffset / np.sqrt(len(doffset))),
        offset=np.array([each[2] for each in told]),
        depth=float(depth[deepest]),
        gaps=gaps,
        doffset=doffset[:, :-2],
        speed=tip_speed(t, depth, run.offset[:, -1], end),
        ddepth=run.changes(deepest)[0][-1, :-2],
        dgaps=dgaps[:, :-2],
        beside=beside,
        clearance=float(
            sampled_clearance(
                problem.rope, problem.arm, *(each[::SPARSE] for each in (derivatives.q, motion.places[:, 0]))
            ).min()
        ),
    )


def _at_depth(run: _Run, level: float, begin: int, end: int) -> tuple[float, Array, float, Array] | None:
    """Return when the tip is at a depth, in samples after the one before, and the rope's offset, with derivatives.

    Where the depth is not reached, or in the first sample beyond the walls, they are those at that sample.
    """
    depth = run.depth[:, -1]
    reached = np.flatnonzero(depth[begin : end + 1] >= level)
    row = begin + int(reached[0]) if reached.size else end
    if level > 0.0 and (row == begin or not reached.size):
        found = run.mouth(row)
        return None if found is None else (1.0, np.zeros(found[1].size), *found)
    (deep0, across0), (deep1, across1) = run.changes(row - 1), run.changes(row)
    first: tuple[float, Array] | None = (float(run.offset[row - 1, -1]), across0[-1])
    last: tuple[float, Array] | None = (float(run.offset[row, -1]), across1[-1])
    if level > 0.0:
        first, last = run.mouth(row - 1), run.mouth(row)
    if first is None or last is None:
        return None
    offset, doffset = (np.array(each) for each in zip(first, last, strict=True))
    return _at_level(level, depth[row - 1 : row + 1], offset, np.array([deep0[-1], deep1[-1]]), doffset)


def _tip_at(run: _Run, level: float, begin: int, end: int) -> tuple[float, Array, float, Array]:
    """Return the same of the tip's own offset at a depth; where that is not reached, at the row `end`."""
    depth, offset = run.depth[:, -1], run.offset[:, -1]
    reached = np.flatnonzero(depth[begin : end + 1] >= level)
    row = begin + int(reached[0]) if reached.size else end
    if not reached.size:
        change = run.changes(row)[1][-1]
        return 1.0, np.zeros(change.size), float(offset[row]), change
    both = [run.changes(row - 1), run.changes(row)]
    ddepth, doffset = (np.array([each[k][-1] for each in both]) for k in range(2))
    return _at_level(level, depth[row - 1 : row + 1], offset[row - 1 : row + 1], ddepth, doffset)


def _least_gaps(run: _Run, begin: int, end: int) -> SpareGaps:
    """Return the least gaps (G,) from the walls until the row `end`: one of each crossing.

    A crossing is what lies to one side of the gap's middle in samples without a pause. What follows the tip from
    `begin` on is left out.
    """
    found = run.crossings
    other = np.flatnonzero((found.row <= end) & ~(found.tip & (found.row >= begin)))
    gaps, changes = [], []
    for side in (1.0, -1.0):
        some = other[np.copysign(1.0, found.offset[other]) == side]
        for part in np.split(some, 1 + np.flatnonzero(np.diff(found.row[some]) > 1)):
            if part.size:
                k = int(part[found.gap[part].argmin()])
                offset, doffset = run.at(k)
                outwards = 1.0 if abs(offset) > 0.5 * (run.slot.width + run.slot.wall) else -1.0
                gaps.append(float(found.gap[k]))
                changes.append(side * outwards * doffset)
    change = np.array(changes).reshape(len(gaps), run.motion.run.dtip.shape[2])
    return SpareGaps(np.array(gaps), change, np.full(len(gaps), BESIDE))


def _at_level(level: float, a: Array, b: Array, da: Array, db: Array) -> tuple[float, Array, float, Array]:
    """Interpolate b (2,) to where a (2,) is at a level, along the line between both.

    Returns the part of the way from the first to the second, its derivatives, the value of b, and its derivatives, from
    those of a and b (2, P).
    """
    part = float((level - a[0]) / (a[1] - a[0]))
    dpart = -((1.0 - part) * da[0] + part * da[1]) / (a[1] - a[0])
    value = float(b[0] + part * (b[1] - b[0]))
    return part, dpart, value, (1.0 - part) * db[0] + part * db[1] + (b[1] - b[0]) * dpart


def entry_residuals(problem: Problem, slot: Slot, entry: Entry) -> tuple[Array, Array]:
    """Return the residuals (m,), m, and their Jacobian (m, P): the offsets, and depth and other gaps if they fail.

    As long as one of these fails, offsets count only beyond SLACK of what is allowed.
    """
    lacks = [(entry.depth - DEEPER * slot.depth, entry.ddepth)]
    lacks += zip((entry.gaps - entry.beside).tolist(), entry.dgaps, strict=True)
    failing = [each for each in lacks if each[0] < 0.0]
    slack = SLACK * _allowed_offset(problem, slot) if failing else 0.0
    beyond = np.maximum(np.abs(entry.offset) - slack, 0.0)
    residuals = np.append(np.copysign(beyond, entry.offset), [value for value, _ in failing])
    return residuals, np.array([*((beyond > 0.0)[:, None] * entry.doffset), *(change for _, change in failing)])


def _allowed_offset(problem: Problem, slot: Slot) -> float:
    """Return how far from the middle of the gap the rope may go through, m.

    At least MARGIN of the gap beside a rope in its middle shall be left, where it may not touch the walls.
    """
    return (1.0 - (0.0 if slot.touching else MARGIN)) * (0.5 * slot.width - problem.rope.radius)


def entry_shortfall(problem: Problem, slot: Slot, entry: Entry) -> float:
    """Return by how much an entry fails, m: in the gap beside the rope, its depth, other gaps, clearance and speed."""
    return float(
        max(0.0, np.abs(entry.offset).max() - _allowed_offset(problem, slot))
        + max(0.0, slot.depth - entry.depth)
        + max(0.0, -entry.gap)
        + max(0.0, problem.clearance - entry.clearance)
        + max(0.0, SLOWER * entry.speed / slot.max_speed - 1.0)
    )
