"""The members of a batch: from ropes, motions and starts, one for all or one each, to the arrays that lanes need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.batch.members import LEVER, Members
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import Drive
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope, Setup
from hyperflex.motion import Motion
from hyperflex.simulation.rollouts import lever


def setups_of(
    ropes: Rope | Sequence[Rope],
    motions: Motion | Sequence[Motion] | None,
    rows: list[Array | None],
    arm: Arm | None,
    duration: float,
    tol: float,
) -> list[Setup]:
    """Return the set-up of each member; `rows` are the starts, (k, n) each."""
    rope_list = [ropes] if isinstance(ropes, Rope) else list(ropes)
    motion_list = [motions] if motions is None or isinstance(motions, Motion) else list(motions)
    counts = [len(rope_list), len(motion_list), *(1 if each is None else len(each) for each in rows)]
    count = max(counts)
    if 0 in counts or set(counts) - {1, count}:
        raise InvalidInput(
            "ropes, motions, q0 and qd0 do not fit together",
            got=counts,
            allowed="one for all members, or as many of each",
        )
    common = {(rope.n_links, rope.friction_model) for rope in rope_list}
    if len(common) > 1:
        raise InvalidInput(
            "ropes of a batch differ in links or friction model",
            got=sorted(common),
            allowed="the same for all",
            fix="Run one batch for each kind",
        )
    return [
        Setup(rope_list[m % len(rope_list)], motion_list[m % len(motion_list)], arm, duration=duration, tol=tol)
        for m in range(count)
    ]


def rows_of(name: str, value: npt.ArrayLike | None) -> Array | None:
    """Return a start as rows (k, n), one a member or one for all."""
    if value is None:
        return None
    given = checks.array(name, value, (-1,) if np.ndim(value) < 2 else (-1, -1))
    return np.atleast_2d(given)


def starts_of(setups: list[Setup], rows: list[Array | None]) -> Array:
    """Return the start of each member (M, 2 n + 2): angles, rates, no work and nothing lost."""
    count, n = len(setups), setups[0].rope.n_links
    result = np.zeros((count, 2 * n + 2))
    result[:, :n] = np.array([setup.rope.hanging_angle for setup in setups])[:, None]
    for name, value, columns in zip(("q0", "qd0"), rows, (slice(0, n), slice(n, 2 * n)), strict=True):
        if value is not None:
            result[:, columns] = checks.array(name, value, (len(value), n))
    return result


def members_of(chains: list[Chain], drives: list[Drive], starts: Array) -> Members:
    """Put what each member is made of side by side."""
    links = np.stack([np.stack([*c[:LEVER], lever(c)]) for c in chains])
    whole = np.array(
        [[c.tip_mass, c.gx, c.gy, d.arm_length, d.torque_limit] for c, d in zip(chains, drives, strict=True)]
    )
    padding = np.zeros((1, *drives[0].coef.shape[1:]))
    return Members(
        links,
        whole,
        starts,
        np.concatenate([d.breaks for d in drives]),
        np.concatenate([part for d in drives for part in (d.coef, padding)]),
        np.array([d.loop for d in drives]),
        np.concatenate([[0], np.cumsum([d.breaks.size for d in drives])]),
    )
