"""Members of a batch: from ropes, motions and starts to the arrays of the lanes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.batch.members import LEVER, Members, Terms
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import Drive
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.integrate.steps import scheme
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Obstacle, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation.contact.runs import refine_arguments
from hyperflex.simulation.rollouts import lever

MOST_MEMBERS = 1_000_000
# Order by tolerance, m: where lanes are full, an order costs p (p + 1) / 2 sweeps, so few cheap columns beat the high
# order that a lone rollout gets for nothing.
ORDERS = ((2e-6, 4), (1e-7, 5), (1e-8, 6), (0.0, 7))
INITIAL_CLOCK = (FIRST_STEP, np.inf, 0.0)  # clock of a member that begins, see Members


def setups_of(
    ropes: Rope | Sequence[Rope],
    motions: Motion | Sequence[Motion] | None = None,
    pegs: Sequence[Obstacle] | Sequence[Sequence[Obstacle]] = (),
    start: tuple[npt.ArrayLike | None, npt.ArrayLike | None] = (None, None),
    *,
    arm: Arm | None,
    refine: bool = False,
    **others: Any,
) -> list[Setup]:
    """Return the set-up of each member; all that it is made of is one for all members, or one each.

    `start` has angles, rad, and rates, rad/s, of the ropes before they are cut, each (n,) or (M, n); `others` are
    further arguments of Setup, the same for all.
    """
    every: list[Sequence[Any]] = [
        [ropes] if isinstance(ropes, Rope) else checks.sequence("ropes", ropes, "a Rope, or one for each member"),
        [motions]
        if motions is None or isinstance(motions, Motion)
        else checks.sequence("motions", motions, "a Motion, or one for each member"),
        _pegs_of(pegs),
        *(_rows(value) for value in start),
    ]
    for rope in every[0]:
        checks.instance("rope of a member", rope, Rope)
    counts = [len(each) for each in every]
    count = max(counts)
    if 0 in counts or set(counts) - {1, count}:
        raise InvalidInput(
            "ropes, motions, q0 and qd0, or pegs, do not fit together",
            got=counts,
            allowed="one for all members, or as many of each",
        )
    common = {(rope.n_links, rope.friction_model) for rope in every[0]}
    if len(common) > 1:
        raise InvalidInput(
            "ropes of a batch differ in links or friction model",
            got=sorted(common),
            allowed="the same for all",
            fix="Run one batch for each kind",
        )
    numbers = sorted({len(each) for each in every[2]})
    if len(numbers) > 1 or (pegs and numbers[0] == 0):
        allowed = "the same for all, at least one"
        raise InvalidInput("members have different numbers of pegs", got=numbers, allowed=allowed)

    def member(m: int) -> Setup:
        rope, motion, obstacles, q0, qd0 = (each[m % len(each)] for each in every)
        if refine and obstacles:
            rope, q0, qd0, _ = refine_arguments(rope, obstacles, arm, q0, qd0, None)
        return Setup(rope, motion, arm, q0=q0, qd0=qd0, pegs=obstacles, **others)

    return [member(m) for m in range(count)]


def _rows(value: npt.ArrayLike | None) -> list[Array | None]:
    """Return a start (n,) or (M, n) as rows, one a member or one for all."""
    return [None] if value is None else list(np.atleast_2d(checks.array("q0 or qd0", value, None)))


def _pegs_of(pegs: Sequence[Obstacle] | Sequence[Sequence[Obstacle]]) -> list[tuple[Obstacle, ...]]:
    """Return the pegs of each member; one entry if they are the same for all."""
    given = checks.sequence("pegs", pegs, "Peg, Wall and Ground, for all members, or a list of these for each")
    if all(isinstance(each, Obstacle) for each in given):
        return [tuple(given)]
    lists = [tuple(each) for each in given if isinstance(each, Sequence)]
    if len(lists) < len(given):
        raise InvalidInput("pegs mixes pegs and lists of pegs", allowed="pegs for all members, or a list of pegs each")
    return lists


def starts_of(setups: Sequence[Setup]) -> Array:
    """Return the start of each member (M, 2 n + 2): angles, rates, no work and nothing lost."""
    starts = np.array([np.concatenate(setup.start()) for setup in setups])
    return np.pad(starts, ((0, 0), (0, 2)))


def members_of(chains: list[Chain], drives: list[Drive], starts: Array) -> Members:
    """Return chains, drives and starts (M, 2 n + 2) of the members as kernel arrays."""
    links = np.stack([np.stack([*c[:LEVER], lever(c)]) for c in chains])
    whole = np.array(
        [[c.tip_mass, c.gx, c.gy, d.arm_length, d.torque_limit] for c, d in zip(chains, drives, strict=True)]
    )
    links.setflags(write=False)  # as those of a chain
    padding = np.zeros((1, *drives[0].coef.shape[1:]))
    return Members(
        links,
        whole,
        starts,
        np.concatenate([d.breaks for d in drives]),
        np.concatenate([part for d in drives for part in (d.coef, padding)]),
        np.array([d.loop for d in drives]),
        np.concatenate([[0], np.cumsum([d.breaks.size for d in drives])]),
        np.tile(INITIAL_CLOCK, (len(chains), 1)),
    )


def terms_of(setup: Setup, chain: Chain, step: float = 0.0) -> Terms:
    """Return what all members have in common: the tolerance of one's set-up, or a chosen `step`, s."""
    table = scheme(next(order for least, order in ORDERS if setup.tol >= least))
    return Terms(0.0, setup.tol, chain.reaction, step, table.best, table.gap, table.rounding)


def columns(name: str, n: int) -> slice | int:
    """Return where a quantity that a batch keeps stands in a state of n links."""
    columns: dict[str, slice | int] = {"q": slice(0, n), "qd": slice(n, 2 * n), "motor_work": 2 * n}
    return columns.get(name, 2 * n + 1)
