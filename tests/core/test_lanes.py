"""One linearly implicit Euler step in SIMD lanes against the dense solve: states side by side."""

import numpy as np
import pytest

from hyperflex.core.chain import lanes as ln
from tests.core.helpers import chain_of
from tests.reference import dense
from tests.reference.cases import random_grip, random_links, random_state


@pytest.mark.parametrize("reaction", [1.0, 0.0], ids=["relative", "printed"])
@pytest.mark.parametrize("air", [False, True], ids=["no-air", "air"])
@pytest.mark.parametrize("n", [1, 2, 5, 50])
@pytest.mark.parametrize("width", [ln.COLUMNS, ln.MEMBERS], ids=["columns", "members"])
def test_a_step_in_every_lane_is_the_dense_implicit_step(width, n, air, reaction):
    links = random_links(n, 2, reaction=reaction, air=air)
    k = len(width)
    states = [random_state(n, seed) for seed in range(k)]
    modes = [random_grip(n, seed) for seed in range(k)]  # stuck joints too, others in each lane
    steps, torques = 0.01 / np.arange(1, k + 1), 0.01 * np.arange(k)
    (flat, tip), base = ln.rows(width, n), np.zeros((9, k))
    data, end = flat.reshape(n + 2, ln.ROW, k), tip.reshape(ln.ROW, k)
    top, link = data[0], data[1 : n + 1]
    chain = chain_of(links)
    ln.load(width, chain, flat, tip)
    for j, state in enumerate(states):
        link[:, ln.Q, j], link[:, ln.W, j], base[:7, j] = state
        link[:, ln.SIN, j], link[:, ln.COS, j] = np.sin(state.q), np.cos(state.q)
        link[:, ln.SLIP, j] = modes[j]
        base[:2, j] -= chain.gx, chain.gy
    end[ln.STEP], end[ln.EXTERNAL] = steps, torques
    ln.euler(width, chain.reaction, ln.MORE, flat, tip, base)
    for j, (state, h, torque) in enumerate(zip(states, steps, torques, strict=True)):
        want = dense.accelerations(links, *state, torque=torque, h=h, grip=modes[j])
        w_end = state.w + h * np.asarray(want.alpha, float)
        # 1e-10 relative on the accelerations as for the single sweep; the end state scales them by the step.
        atol = 1e-10 * h * float(np.abs(want.alpha).max())
        np.testing.assert_allclose(link[:, ln.W, j], w_end, rtol=1e-14, atol=atol)
        np.testing.assert_allclose(link[:, ln.Q, j], state.q + h * w_end, rtol=1e-14, atol=h * atol)
        np.testing.assert_allclose(link[:, ln.SIN, j], np.sin(link[:, ln.Q, j]), rtol=0, atol=3e-16)  # for the next one
        np.testing.assert_allclose(link[:, ln.COS, j], np.cos(link[:, ln.Q, j]), rtol=0, atol=3e-16)
        velocity, rate = state.base[5:7], state.base[3]
        power = float(want.force @ velocity + want.torque * rate) + torque * state.w[0]
        scale = float(np.abs(want.force) @ np.abs(velocity)) + abs(float(want.torque) * rate)
        assert top[ln.WORK, j] == pytest.approx(h * power, abs=1e-10 * h * scale)
        lost = dense.dissipation(links, state.q, state.w, (state.base[4], rate), modes[j], velocity)
        # Terms of either sign with printed friction; 1e-10 of their usual size as everywhere.
        assert top[ln.LOST, j] == pytest.approx(h * lost, abs=1e-10 * h * max(abs(lost), 1e-2))


def test_regularized_friction_is_viscous_friction_that_dissipates_alike():
    """Its torque is the dry friction times the rate over its root of squares with the tolerance."""
    flat, _ = ln.rows(ln.MEMBERS, 5)
    state, base, tolerance = random_state(5, 1), np.zeros((9, 16)), 0.3
    link, own, dry = flat.reshape(7, ln.ROW, 16)[1:6], np.linspace(0.0, 1e-3, 5), np.linspace(1e-3, 0.0, 5)
    link[:, ln.W], link[:, ln.OWN], link[:, ln.LOSS] = state.w[:, None], own[:, None], dry[:, None]
    base[3] = state.base[3]
    ln.regularize(ln.MEMBERS, tolerance, flat, base)
    rate = np.diff(state.w, prepend=state.base[3])
    # a vector of rate and tolerance has its sine and cosine; 1e-14: rounding
    torque = own * rate + dry * np.sin(np.arctan2(rate, tolerance))
    np.testing.assert_allclose(link[:, ln.VISCOUS] * rate[:, None], np.tile(torque[:, None], 16), rtol=1e-14)
