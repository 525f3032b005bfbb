"""Free swings in batch: the first strike of the rope on a peg, and the energy of its tail there.

No contact is simulated, so a swing costs some milliseconds. The score is a heuristic: at the strike the tail is taken
as a rigid body that turns about the peg, and its energy of turning is compared with the energy that lifts its centre of
mass over the top.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.core.batch import proximity
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.planning.clearance import clear_samples, samples_clear_of_arm
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.verification import at_limits, limit_bend
from hyperflex.simulation import Deadline

SAMPLE_TIME = 0.02  # s
COARSE_TOL = 1e-4  # m, of swings in a search; with 1e-3, no more than a quarter faster, the best were often errors
NEAR = 0.02  # m, gap below which the rope counts as striking
# Energy ratio, and turns of tail, above which more does not count; with more turns asked more of them do
MAX_RATIO, MAX_TAIL = 2.0, 2.0
HANGING_TAIL = 0.7  # turns of tail that hang from the peg in the end and do not wind
FOLDED = 0.3  # part of its score that a swing keeps in which the rope was folded flat before the strike
NEVER = -1.0  # score of a swing without a strike, less its distance in metres


@dataclass(frozen=True, eq=False)
class Strikes:
    """First strikes of M swings.

    `score` (M,): greater is better; below 0 without a strike. `energy_ratio` (M,): energy of turning about the peg over
    the energy that lifts the tail's centre of mass over the top. `tail_turns` (M,): length of the tail in turns about
    the peg. `t` (M,): last sample before the strike, s, NaN without a strike; `q`, rad, and `qd`, rad/s, (M, n): state
    there. `clear` (M,): samples before the rope comes too near an obstacle, or its arm before the strike.
    """

    score: Array
    energy_ratio: Array
    tail_turns: Array
    t: Array
    q: Array
    qd: Array
    clear: npt.NDArray[np.int64]

    def select(self, rows: Sequence[int]) -> "Strikes":
        """Return the strikes of some rows, each as often as it is named."""
        return Strikes(*(getattr(self, one.name)[list(rows)] for one in fields(self)))


def joined(parts: Sequence[Strikes]) -> Strikes:
    """Return the strikes of several batches as those of one."""
    return Strikes(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Strikes)))


def simulate_strikes(
    problem: Problem,
    peg: Peg,
    motions: Sequence[Motion],
    *,
    until: float = np.inf,
    time_budget: Deadline | None = None,
    threads: int | None = None,
) -> Strikes:
    """Simulate free swings from the start at t = 0 under each motion (M,), and find their first strikes on a peg.

    Or on one that the rope is to run behind, as of :func:`find_strikes`. Strikes are looked for `until` a time, s, at
    most. Swings that are not done when the time is over do not strike.
    """
    count = max(2, int(np.ceil(min(problem.time, until) / SAMPLE_TIME - 0.5)))
    t: Array = SAMPLE_TIME * np.arange(1.0, count + 1.0)
    swings = RolloutBatch.from_start(problem, [problem.rope] * len(motions), [], motions)
    how: dict[str, Any] = {"tol": COARSE_TOL, "keep": ("q", "qd"), "time_budget": time_budget, "threads": threads}
    batch = swings.run(problem.arm, t, **how)
    return find_strikes(problem, peg, motions, t, batch.q, batch.qd)


def find_strikes(
    problem: Problem,
    peg: Peg,
    motions: Sequence[Motion],
    t: Array,
    q: Array,
    qd: Array,
    own_arm: bool = True,
) -> Strikes:
    """Find the first strikes in samples q, qd (M, T, n) at times t (T,) of free swings under motions (M,).

    On the peg or on one that the rope is to run behind, whichever comes first: energies are about that one, turns about
    `peg`, of what reaches beyond it. A rope that comes too near an obstacle before, or with `own_arm` its arm or shaft,
    does not strike.
    """
    tips = {id(motion): arm_tip(problem.arm, motion, t) for motion in {id(each): each for each in motions}.values()}
    base, base_velocity = (np.stack(each) for each in zip(*(tips[id(motion)] for motion in motions), strict=True))
    rows, pegs = np.arange(len(motions)), (peg, *problem.behind)
    seen = [first_contact(q, base, problem.rope.length, each, problem.rope.radius) for each in pegs]
    which = np.stack([np.where(at > 0, at, t.size) for at, *_ in seen]).argmin(axis=0)
    at, link, least = (np.stack(part)[which, rows] for part in zip(*seen, strict=True))
    clear = clear_samples([problem.rope] * len(q), problem.obstacles, q, base, problem.clearance)
    if own_arm:
        before = np.where(at > 0, at, t.size)
        given = problem.rope, problem.arm, q, base, problem.clearance
        clear = np.minimum(clear, samples_clear_of_arm(*given, before))
    struck = (at > 0) & (at <= clear) & np.isfinite(q).all(axis=(1, 2))
    blocked = (at > 0) & ~struck & (clear < t.size)
    least += np.where(blocked, 1.0 - clear / np.maximum(at, 1), 0.0)
    at = np.where(struck, at, 1)
    state, joint = (q[rows, at], qd[rows, at]), (base[rows, at], base_velocity[rows, at])
    energies = [_tail(problem, each, peg, state, joint, link) for each in pegs]
    ratio, left = (np.stack(part)[which, rows] for part in zip(*energies, strict=True))
    tail = np.clip(left - HANGING_TAIL, 0.0, MAX_TAIL + problem.more_turns)
    share = np.where(samples_unfolded(problem.rope, q) < at, FOLDED, 1.0)
    return Strikes(
        np.where(struck, share * np.minimum(ratio, MAX_RATIO) * tail, NEVER - least),
        np.where(struck, ratio, 0.0),
        np.where(struck, left, 0.0),
        np.where(struck, t[at - 1], np.nan),
        q[rows, at - 1],
        qd[rows, at - 1],
        clear,
    )


def _tail(
    problem: Problem,
    struck: Peg,
    target: Peg,
    state: tuple[Array, Array],
    base: tuple[Array, Array],
    link: npt.NDArray[np.int64],
) -> tuple[Array, Array]:
    """As of :func:`tail_energy`, about the peg that is struck; turns are those about the target beyond it."""
    ratio, left = tail_energy(problem, struck, state, base, link)
    if struck is target:
        return ratio, left
    radius, axis = problem.rope.radius, struck.radius + problem.rope.radius
    beyond = 2.0 * np.pi * axis * left - np.hypot(target.x - struck.x, target.y - struck.y)
    return ratio, np.maximum(beyond, 0.0) / (2.0 * np.pi * (target.radius + radius))


def samples_unfolded(rope: Rope, q: Array) -> npt.NDArray[np.int64]:
    """Return after how many samples (M,) a rope at angles q (M, T, n) is first folded flat; T if it is not.

    What it does then depends on its contact with itself, which free swings do not simulate.
    """
    folded = at_limits(limit_bend(rope), q)
    return np.asarray(np.where(folded.any(axis=1), folded.argmax(axis=1), q.shape[1]))


def arm_tip(arm: Arm, motion: Motion, t: Array) -> tuple[Array, Array]:
    """Position, m, and velocity, m/s, of the rope's first joint (T, 2) at times t (T,), s."""
    angle, rate = motion.angle(t), motion.rate(t)
    position = np.stack([np.sin(angle), -np.cos(angle)], axis=-1) * arm.length + np.array(arm.pivot)
    return position, np.stack([np.cos(angle), np.sin(angle)], axis=-1) * (arm.length * rate)[:, None]


def first_contact(
    q: Array, base: Array, length: Array, peg: Peg, rope_radius: float
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Array]:
    """Return sample and link of the first strike on a peg, and the smallest gap until then, m, (M,) each.

    Sample 0 means no strike. `q` (M, T, n) are angles, rad, `base` (M, T, 2) positions of the rope's first joint, m,
    `length` (n,) or (M, n) those of the links, m, and `rope_radius` is in m. Of a flight that failed before its first
    sample the gap is not known: it is given as the rope's length.
    """
    at, link, least = np.zeros(len(q), np.int64), np.zeros(len(q), np.int64), np.zeros(len(q))
    lengths = np.array(np.broadcast_to(length, (len(q), q.shape[2])), dtype=np.float64, order="C")
    place = peg.x, peg.y, peg.radius + rope_radius, NEAR
    proximity.first_contacts(np.ascontiguousarray(q), np.ascontiguousarray(base), lengths, *place, at, link, least)
    return at, link, np.where(np.isfinite(least), least, lengths.sum(axis=1))


def mass_points(rope: Rope, q: Array, qd: Array, base: Array, velocity: Array) -> tuple[Array, Array]:
    """Positions, m, and velocities, m/s, of the links' centres of mass and of the tip (M, n + 1, 2).

    Angles `q` (M, n), rad, and rates `qd`, rad/s; `base`, m, and `velocity`, m/s, (M, 2) of the first joint.
    """
    along = np.stack([np.sin(q), -np.cos(q)], axis=-1)
    across = np.stack([np.cos(q), np.sin(q)], axis=-1) * qd[..., None]
    ends = base[:, None] + np.cumsum(rope.length[:, None] * along, axis=1)
    speeds = velocity[:, None] + np.cumsum(rope.length[:, None] * across, axis=1)
    back = (rope.length - rope.com)[:, None]
    return (
        np.concatenate([ends - back * along, ends[:, -1:]], axis=1),
        np.concatenate([speeds - back * across, speeds[:, -1:]], axis=1),
    )


def tail_energy(
    problem: Problem, peg: Peg, state: tuple[Array, Array], base: tuple[Array, Array], link: npt.NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return the energy ratio and the turns of tail (M,) of strikes with link `link` (M,); see :class:`Strikes`.

    `state` is (q, qd), (M, n) each, rad and rad/s; `base` position and velocity of the first joint, (M, 2) each, m and
    m/s.
    """
    rope = problem.rope
    places, speeds = mass_points(rope, *state, *base)
    places -= np.array([peg.x, peg.y])
    mass = np.append(rope.mass, rope.tip_mass) * (np.arange(rope.n_links + 1) >= link[:, None])
    momentum = (mass * (places[..., 0] * speeds[..., 1] - places[..., 1] * speeds[..., 0])).sum(axis=1)
    inertia = (mass * (places**2).sum(axis=2)).sum(axis=1)
    whole = mass.sum(axis=1)
    centre = (mass[..., None] * places).sum(axis=1) / whole[:, None]
    down = np.array(rope.gravity)
    weight = np.hypot(*down)
    lift = whole * (weight * np.hypot(*centre.T) + centre @ down)
    left = np.array([rope.length[k:].sum() for k in link]) / (2.0 * np.pi * (peg.radius + rope.radius))
    return 0.5 * momentum**2 / np.maximum(inertia * np.maximum(lift, 1e-12), 1e-300), left
