"""Random chains and states for the tests, from a seed."""

from typing import NamedTuple

import numpy as np

from tests.reference.dense import Links, Real


class State(NamedTuple):
    """Angles q (n,), rates w (n,), and the base (7,) as the kernels take it."""

    q: Real
    w: Real
    base: Real


def random_grip(n: int, seed: int) -> Real:
    """Modes of n joints: slipping one way or the other, or stuck."""
    return np.random.default_rng(seed + 2000).choice([-1.0, 0.0, 1.0], n)


def random_links(
    n: int, seed: int, *, reaction: float = 1.0, joints: bool = True, tip: bool = True, air: bool = False
) -> Links:
    """A chain about 2 m and 0.1 kg as a whole, every link different; without `joints` neither friction nor springs."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.5, 1.5, n) * 2.0 / n
    mass = rng.uniform(0.3, 1.7, n) * 0.1 / n
    spread = rng.uniform(0.02, 0.3, n)
    on = 1.0 if joints else 0.0
    links = Links(
        length=length,
        mass=mass,
        com=rng.uniform(0.2, 0.9, n) * length,
        inertia=spread * mass * length**2,
        viscous=on * rng.uniform(0.0, 1e-3, n),
        dry=on * rng.uniform(0.0, 2e-3, n),
        stiffness=on * rng.uniform(0.0, 5e-2, n),
        rest=on * rng.normal(0.0, 0.2, n),
        drag=np.zeros(n),
        max_bend=np.full(n, np.inf),
        tip_mass=float(rng.uniform(0.005, 0.05)) if tip else 0.0,
        gx=float(rng.normal(0.0, 2.0)),
        gy=-9.81,
        reaction=reaction,
    )
    return links._replace(drag=rng.uniform(0.0, 5e-3, n)) if air else links


def random_state(n: int, seed: int) -> State:
    """A crumpled chain that turns at some rad/s on a base that moves in every way."""
    rng = np.random.default_rng(seed + 1000)
    q = np.cumsum(rng.normal(0.0, 2.0 / np.sqrt(n), n))
    w = np.cumsum(rng.normal(0.0, 5.0 / np.sqrt(n), n))
    base = np.array([*rng.normal(0.0, 5.0, 3), *rng.normal(0.0, 2.0, 4)])
    return State(q, w, base)
