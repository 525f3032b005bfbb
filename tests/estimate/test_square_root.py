"""Covariances by their square roots against the textbook's formulas, and changes carried without a matrix."""

import numpy as np

import hyperflex as hf
from hyperflex.estimate import EstimatedParameter
from hyperflex.estimate import square_root as sr
from hyperflex.estimate.parameters import ParameterStates
from hyperflex.estimate.process import Process
from tests.estimate.runs import ARM, SWINGS, rope


def test_update_keeps_what_is_left_of_a_wide_prior():
    """Deviations of 1e6 before and about 1 after: a difference of covariances would lose all its digits."""
    S, H = 1e6 * np.eye(3), np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
    across, upper = sr.innovation_factor(S, H)
    after = sr.updated(S, across, upper)
    np.testing.assert_allclose(after.T @ after, np.linalg.inv(H.T @ H), rtol=1e-6)


def test_the_omitted_part_is_below_the_allowed_error():
    rng = np.random.default_rng(1)
    least = np.array([1e-3] * 20 + [1e-1] * 20)
    sizes = np.logspace(0.0, -9.0, 40)
    rows = (sizes[:, None] * np.linalg.qr(rng.normal(size=(40, 40)))[0]) * least / 1e-3
    short = sr.compressed(rows, least)
    assert 5 < len(short) < 25
    lost = np.diagonal(rows.T @ rows - short.T @ short)
    assert np.all(lost > -1e-12)
    assert np.all(np.sqrt(np.maximum(lost, 0.0)) <= least)
    whole = sr.compressed(rows, 1e-15 * least)
    np.testing.assert_allclose(whole.T @ whole, rows.T @ rows, atol=1e-12)


def test_changes_are_carried_as_the_derivatives_say():
    """Against `sensitivities` at a tight tolerance: steps differ, and with them derivatives by some 1e-5."""
    cable, n = rope(10), 10
    states = ParameterStates([EstimatedParameter("friction", 0.1), EstimatedParameter("scale", 0.1)], cable, (), True)
    process, rng = Process(cable, states, SWINGS, ARM), np.random.default_rng(2)
    x = np.concatenate([rng.normal(0.0, 0.3, n), rng.normal(0.0, 2.0, n), [0.0, 0.0]])
    rows = rng.normal(size=(7, 2 * n + 2))
    end, moved = process.carry(x, rows, 1.0, 1.05)
    np.testing.assert_allclose(moved, rows @ process.predict(x, 1.0, 1.05).transition.T, atol=1e-9)
    run = hf.sensitivities(
        cable,
        SWINGS.shifted(-1.0),
        arm=ARM,
        duration=0.05,
        q0=x[:n],
        qd0=x[n : 2 * n],
        t_eval=[0.05],
        tol=1e-9,
        wrt=["q0", "qd0", {"friction": {"friction": cable.friction}}],
    )
    transition = np.concatenate([run.dq[-1], run.dqd[-1]])
    np.testing.assert_allclose(end[: 2 * n], np.concatenate([run.q[-1], run.qd[-1]]), atol=2e-4)
    np.testing.assert_allclose(moved[:, : 2 * n], rows[:, : 2 * n + 1] @ transition.T, atol=5e-3)
    np.testing.assert_array_equal(moved[:, 2 * n :], rows[:, 2 * n :])


def test_an_update_is_never_worse_than_the_state_before():
    """What is seen is steep where the state is expected and flat elsewhere: the whole first step goes far too far."""

    def compared(x):
        return 3.0 - 10.0 * np.arctan(5.0 * x), 50.0 / (1.0 + 25.0 * x[:, None] ** 2)

    def cost(x):
        return float(((x - 0.5) ** 2).sum() / 4.0 + (compared(x)[0] ** 2).sum())

    before, factor = np.array([0.5]), np.array([[2.0]])

    def begun(compared):
        left, jacobian = compared(before)
        return left, jacobian, *sr.innovation_factor(factor, jacobian)

    for rounds in (1, 2, 4):
        after, _ = sr.iterated_update(before, factor, compared, rounds, begun(compared))
        assert cost(after) < cost(before)
    assert cost(after) < 0.1

    def wrong(x):
        """Derivatives of the wrong sign: no step helps."""
        return x, np.array([[1.0]])

    after, rows = sr.iterated_update(before, factor, wrong, 4, begun(wrong))
    np.testing.assert_array_equal(after, before)
    assert abs(rows[0, 0]) < 1.0
