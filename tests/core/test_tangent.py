"""The tangent of one Euler step against differences of the dense step in extended precision; packed instructions."""

from typing import Any

import numpy as np
import pytest

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import MUTUAL, ONE_SIDED, Chain
from hyperflex.core.tangent import air as dg
from hyperflex.core.tangent import step as tg
from tests.reference import dense
from tests.reference.cases import State, random_links, random_state
from tests.reference.dense import Real

K = len(ln.COLUMNS)
STEPS = np.array([0.02, 0.004, 1e-4, 0.0])  # one a lane; 0: the explicit accelerations
LINKS = ("length", "mass", "com", "inertia", "viscous", "stiffness", "rest", "drag")
# weights of a difference of sixth order at -3..3, in units of the spacing
STENCIL = np.array([-1, 9, -45, 0, 45, -9, 1], dtype=np.longdouble) / 60


class Direction:
    """A change of everything that a step depends on; each field as in State, Links or the step."""

    def __init__(self, n: int) -> None:
        self.q, self.w, self.base, self.torque, self.stretch = np.zeros(n), np.zeros(n), np.zeros(7), 0.0, 0.0
        self.links = {name: np.zeros(n) for name in LINKS}
        self.tip_mass, self.gx, self.gy = 0.0, 0.0, 0.0


def random_direction(n: int, seed: int, *, parameters: bool) -> Direction:
    """A change of state and base, and with `parameters` of all other inputs, in proportion to usual values."""
    rng = np.random.default_rng(seed)
    it = Direction(n)
    it.q, it.w, it.base = rng.normal(size=n), rng.normal(size=n), rng.normal(size=7)
    if parameters:
        sizes = (0.1, 0.01, 0.1, 1e-5, 1e-3, 0.05, 1.0, 1e-3)
        it.links = {name: size * rng.normal(size=n) for name, size in zip(LINKS, sizes, strict=True)}
        it.tip_mass, it.gx, it.gy = 0.01 * rng.normal(), *rng.normal(size=2)
        it.torque, it.stretch = 0.01 * rng.normal(), rng.normal()
    return it


def dense_step(links: Any, state: State, torque: Any, h: Any, way: Any, it: Direction) -> Real:
    """Angles and rates (2 n,) after an Euler step from everything moved by `way` along a direction."""
    wide = np.longdouble
    moved = {name: np.asarray(getattr(links, name), wide) + way * change for name, change in it.links.items()}
    whole = {name: wide(getattr(links, name)) + way * wide(getattr(it, name)) for name in ("tip_mass", "gx", "gy")}
    q, w = np.asarray(state.q, wide) + way * it.q, np.asarray(state.w, wide) + way * it.w
    base = np.asarray(state.base, wide) + way * it.base
    h = wide(h) * (1 + way * wide(it.stretch))
    new = links._replace(**moved, **whole)
    alpha = dense.accelerations(new, q, w, base, wide(torque) + way * wide(it.torque), h).alpha
    w_end = w + h * alpha
    return np.concatenate([q + h * w_end, w_end, alpha])


def slope(links: Any, state: State, torque: float, h: float, it: Direction) -> Real:
    """Derivative of the dense step by a difference of sixth order: rounding 5e-16 of the step.

    Truncation is below that, but for 2e-11 where a stretch of a link begins to move against the air the other way: the
    third derivative of its drag jumps there.
    """
    gap = np.longdouble(2e-4)
    points = [dense_step(links, state, torque, h, (k - 3) * gap, it) for k in range(7)]
    return np.asarray(STENCIL @ np.stack(points) / gap, float)


def chain_of(links: Any, bears: tuple[int, ...]) -> Chain:
    return Chain(*(getattr(links, name) for name in Chain._fields[:-1]), reaction=bears)


def seeds_of(links: Any, it: Direction) -> Real:
    """A direction's seeds (n, SEEDS): the kernels know m a and J + m a^2."""
    seeds = np.zeros((len(it.q), tg.SEEDS))
    change = it.links
    for name in ("length", "mass", "viscous", "stiffness", "rest", "drag"):
        seeds[:, getattr(tg, name.upper())] = change[name]
    seeds[:, tg.MA] = links.com * change["mass"] + links.mass * change["com"]
    seeds[:, tg.INERTIA] = change["inertia"] + links.com**2 * change["mass"]
    seeds[:, tg.INERTIA] += 2.0 * links.mass * links.com * change["com"]
    return seeds


def kernel_slopes(
    chain: Chain, links: Any, state: State, torque: float, pair: list[Direction], *, grip: Real, simple: bool
) -> Real:
    """Derivatives (lane, direction, 3 n) of angles, rates and accelerations by the kernels."""
    n = len(state.q)
    (flat, tip), base = ln.rows(ln.COLUMNS, n), np.tile(np.append(state.base, [0.0, 0.0])[:, None], K)
    rows = flat.reshape(n + 2, ln.ROW, K)
    ln.load(ln.COLUMNS, chain, flat, tip)
    ln.set_slip(ln.COLUMNS, flat, grip)
    rows[1 : n + 1, ln.Q], rows[1 : n + 1, ln.W] = state.q[:, None], state.w[:, None]
    rows[1 : n + 1, ln.SIN], rows[1 : n + 1, ln.COS] = np.sin(state.q)[:, None], np.cos(state.q)[:, None]
    base[0] -= chain.gx
    base[1] -= chain.gy
    rows[n + 1, ln.STEP], rows[n + 1, ln.EXTERNAL] = STEPS, torque
    tg.save_trig(flat)
    ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, flat, tip, base)
    tg.prepare(chain.reaction, flat)
    air = np.zeros((n + 2) * dg.ROW * K)
    dg.begin(flat, base, air)
    for d, it in enumerate(pair):
        rows[1 : n + 1, tg.DQ + d], rows[1 : n + 1, tg.DW + d] = it.q[:, None], it.w[:, None]
        ax, ay, alpha, rate, angle, _, _ = it.base
        rows[0, [tg.DQ + d, tg.DW + d, tg.PX + d, tg.PY + d, tg.ALPHA + d, tg.RHS + d]] = np.array(
            [angle, rate, ax - it.gx, ay - it.gy, alpha, it.torque]
        )[:, None]
        air.reshape(n + 2, dg.ROW, K)[0, [dg.DVX + d, dg.DVY + d]] = it.base[5:, None]
        rows[n + 1, tg.BX + d] = it.tip_mass * rows[n, ln.PX]
        rows[n + 1, tg.BY + d] = it.tip_mass * rows[n, ln.PY]
    links_seeds, stretch = np.stack([seeds_of(links, it) for it in pair]), np.array([it.stretch for it in pair])
    if not simple:
        dg.write_torques(flat, air, links_seeds)
    tg.step(chain.reaction, tg.STATE if simple else tg.ALL, flat, links_seeds, stretch)
    slots = [[tg.DQ + d, tg.DW + d, tg.ALPHA + d] for d in range(2)]
    return np.array([[rows[1 : n + 1, slot, j].T.ravel() for slot in slots] for j in range(K)])


def compare(got: Real, links: Any, state: State, torque: float, pair: list[Direction], what: str = "") -> None:
    """Angles, rates and accelerations of every lane against the dense step's."""
    for j, h in enumerate(STEPS):
        for d, it in enumerate(pair):
            want = slope(links, state, torque, h, it)
            # 1e-10 of the largest, as for the sweep itself: condition of the mass matrix times rounding; that of the
            # accelerations, some 100 rad/s^2, stays where the derivatives are small
            atol = 1e-10 * max(float(np.abs(want).max()), 1e-3)
            np.testing.assert_allclose(got[j, d], want, rtol=0.0, atol=atol, err_msg=what)


@pytest.mark.parametrize(("reaction", "bears"), [(1.0, MUTUAL), (0.0, ONE_SIDED)], ids=["relative", "printed"])
@pytest.mark.parametrize("n", [1, 2, 7])
def test_tangent_is_the_derivative_of_the_dense_step(n, reaction, bears):
    state, grip = random_state(n, 5), np.ones(n)
    for parameters in (False, True):
        links = random_links(n, 4, reaction=reaction, air=parameters)._replace(dry=np.zeros(n))
        chain = chain_of(links, bears)
        pair = [random_direction(n, seed, parameters=parameters) for seed in (1, 2)]
        got = kernel_slopes(chain, links, state, 0.01, pair, grip=grip, simple=not parameters)
        compare(got, links, state, 0.01, pair)


@pytest.mark.parametrize("name", [*LINKS, "tip_mass", "gx", "gy", "torque", "stretch"])
def test_each_parameter_by_itself(name):
    n = 3
    links = random_links(n, 6, air=True)._replace(dry=np.zeros(n))
    state, chain = random_state(n, 7), chain_of(links, MUTUAL)
    for i in range(n if name in LINKS else 1):
        it = Direction(n)
        if name in LINKS:
            scale = 0.1 if name == "rest" else float(getattr(links, name)[i])
            it.links[name][i] = 0.1 * scale
        else:
            setattr(it, name, 0.003)
        got = kernel_slopes(chain, links, state, 0.01, [it, it], grip=np.ones(n), simple=False)
        compare(got, links, state, 0.01, [it, it], what=f"{name}[{i}]")


def test_stuck_joints_move_as_one():
    """A joint locked by the kernels against one whose viscous friction is beyond all bounds."""
    n, stuck = 5, [0, 3]
    links = random_links(n, 8, air=True)._replace(dry=np.full(n, 1e-3))
    state, grip = random_state(n, 9), np.ones(n)
    grip[stuck] = 0.0
    pair = [random_direction(n, seed, parameters=True) for seed in (3, 4)]
    state.w[0], state.w[3] = state.base[3], state.w[2]
    for it in pair:  # no change may make a stuck joint slip, nor its step longer while the base turns
        it.w[0], it.w[3] = it.base[3], it.w[2]
        it.links["viscous"][stuck] = 0.0
    kernels = links._replace(dry=np.where(grip == 0.0, 1e-3, 0.0))
    got = kernel_slopes(chain_of(kernels, MUTUAL), links, state, 0.01, pair, grip=grip, simple=False)
    wall = links._replace(dry=np.zeros(n), viscous=np.where(grip == 0.0, 1e7, links.viscous))
    for j, h in enumerate(STEPS[:2]):
        for d, it in enumerate(pair):
            want = slope(wall, state, 0.01, h, it)[: 2 * n]
            # A friction of 1e7 N m s lets a joint slip by 1e-9 of what it would; the acceleration of the base that
            # the step's length multiplies adds no more.
            np.testing.assert_allclose(got[j, d, : 2 * n], want, rtol=0.0, atol=1e-7 * np.abs(want).max())
