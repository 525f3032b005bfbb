"""Members of a batch: from ropes, motions and starts to the arrays of the lanes."""

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.batch.rollouts import LEVER, Members, Terms
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import Drive
from hyperflex.core.integrate.step_size import FIRST_STEP
from hyperflex.core.integrate.steps import scheme
from hyperflex.errors import InvalidInput
from hyperflex.model import Obstacle, Rope, Setup, SetupFields, checked_obstacles
from hyperflex.motion import Motion
from hyperflex.simulation.arguments import setup_of
from hyperflex.simulation.rollouts import lever

MOST_MEMBERS = 1_000_000
# Order by tolerance, m: where lanes are full, an order costs p (p + 1) / 2 sweeps, so few cheap columns beat the high
# order that a lone rollout gets for nothing.
ORDERS = ((2e-6, 4), (1e-7, 5), (1e-8, 6), (0.0, 7))
INITIAL_CLOCK = (FIRST_STEP, np.inf, 0.0)  # clock of a member that begins, see Members


class BatchFields(SetupFields, total=False):
    """Fields of a set-up that :func:`simulate_batch` takes; `refine` cuts ropes as :func:`simulate` does."""

    refine: bool


def setups_of(
    ropes: Rope | Sequence[Rope], motions: Motion | Sequence[Motion] | None = None, **fields: Unpack[BatchFields]
) -> list[Setup]:
    """Return the set-up of each member.

    Ropes, motions, pegs, and q0 and qd0 of the ropes before they are cut, are one for all members, or one each; other
    `fields` of a set-up are the same for all.
    """
    common: dict[str, Any] = dict(fields)
    refine = checks.flag("refine", common.pop("refine", True))
    pegs = checks.sequence("pegs", common.pop("pegs", ()), "Peg, Wall and Ground, or a list of these for each member")
    if any(isinstance(each, Obstacle) for each in pegs):
        pegs = [pegs]
    starts = [None if (value := common.pop(name, None)) is None else value for name in ("q0", "qd0")]
    rows = [[None] if each is None else list(np.atleast_2d(checks.array("q0 or qd0", each, None))) for each in starts]
    obstacles = [checked_obstacles(each) for each in pegs] or [()]
    every: list[list[Any]] = [_each("ropes", ropes, Rope), _each("motions", motions, Motion), obstacles, *rows]
    counts = [len(each) for each in every]
    count = max(counts)
    if 0 in counts or set(counts) - {1, count}:
        what = "ropes, motions, pegs, q0 and qd0 do not fit together"
        raise InvalidInput(what, got=counts, allowed="one for all members, or as many of each")
    for rope in every[0]:
        checks.instance("rope of a member", rope, Rope)
    _alike("links or friction model", {(rope.n_links, rope.friction_model) for rope in every[0]})
    _alike("number of pegs", {len(each) for each in obstacles})

    def member(m: int) -> Setup:
        rope, motion, pegs, q0, qd0 = (each[m % len(each)] for each in every)
        parts = {"motion": motion, "pegs": pegs, "q0": q0, "qd0": qd0}
        return setup_of(rope, {**common, **parts}, refine=refine)[0]

    return [member(m) for m in range(count)]


def _each(name: str, given: object, kind: type) -> list[Any]:
    """Return what members have each; one entry if it is the same for all."""
    alone = given is None or isinstance(given, kind)
    return [given] if alone else checks.sequence(name, given, f"a {kind.__name__}, or one for each member")


def _alike(what: str, found: set[Any]) -> None:
    if len(found) > 1:
        fix = "Run one batch for each kind"
        raise InvalidInput(
            f"members of a batch differ in {what}", got=sorted(found), allowed="the same for all", fix=fix
        )


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
        np.ones(sum(d.breaks.size for d in drives), dtype=np.bool_),
        np.array([d.loop for d in drives]),
        np.concatenate([[0], np.cumsum([d.breaks.size for d in drives])]),
        np.tile(INITIAL_CLOCK, (len(chains), 1)),
    )


def terms_of(setup: Setup, chain: Chain, step: float = 0.0) -> Terms:
    """Return what all members have in common: the tolerance of one's set-up, or a chosen `step`, s."""
    table = scheme(next(order for least, order in ORDERS if setup.tol >= least))
    return Terms(0.0, setup.tol, chain.reaction, step, table.best, table.gap, table.rounding)
