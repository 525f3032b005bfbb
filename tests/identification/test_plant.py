"""What a camera would see, and its derivatives: against places by another route, and against central differences."""

import numpy as np
import pytest

from hyperflex.identification.model import Parameters, Plant, parse, pivot_places
from hyperflex.model import Arm, Rope
from hyperflex.motion import arm_swings
from hyperflex.sensors import Angles, Markers
from hyperflex.simulation import simulate

ROPE = Rope(
    length=[0.2, 0.25, 0.15],
    mass=[0.02, 0.03, 0.01],
    inertia=[1e-4, 2e-4, 5e-5],
    friction=[3e-4, 2e-4, 1e-4],
    stiffness=0.01,
    tip_mass=0.01,
)
ARCS = np.array([0.0, 0.11, 0.31, 0.6])
ARM, MOTION = Arm(0.1, pivot=(0.3, -0.2)), arm_swings(t_move=0.5, t_rest=0.3)
T = np.array([0.2, 0.31, 0.4, 0.62, 0.9])
STATE = np.array([0.3, 0.5, 0.9, 1.0, -2.0, 0.5])
WORDS = ["inertia", "com[1]", "mass:shared", "length", "friction:factor", "friction:taper", "stiffness[2]"]
WORDS += ["tip_mass", "gravity_angle", "delay", "origin_x", "origin_y", "arc"]


def plant(words: list[str], *, places: bool) -> Plant:
    parameters = Parameters(ROPE, parse(ROPE, words, ARCS if places else None, moved=True))
    return Plant(parameters, Markers(ARCS, (0.05, -0.02)) if places else Angles(), MOTION, ARM)


def test_places_are_those_of_the_joints_and_the_points_between():
    it = plant(["friction"], places=True)
    seen = it.predict(it.parameters.start, T, STATE)
    t, start = T - T[0], {"q0": STATE[:3], "qd0": STATE[3:]}
    run = simulate(ROPE, MOTION.shifted(-T[0]), arm=ARM, duration=t[-1], t_eval=t, tol=1e-9, **start)
    joints = run.joints  # (T, n + 1, 2), the first joint first
    between = [joints[:, 0], joints[:, 0] + 0.11 / 0.2 * (joints[:, 1] - joints[:, 0])]
    between += [joints[:, 1] + 0.11 / 0.25 * (joints[:, 2] - joints[:, 1]), joints[:, 3]]
    expected = np.stack(between, axis=1) + np.array([0.05, -0.02])
    # rollouts at 1e-7 of the length a step, here some tens of steps
    np.testing.assert_allclose(seen.reshape(T.size, 4, 2), expected, atol=1e-5)
    np.testing.assert_allclose(pivot_places(MOTION.shifted(-T[0]), ARM, T - T[0]), joints[:, 0], atol=1e-12)


@pytest.mark.parametrize("places", [False, True], ids=["angles", "places"])
def test_derivatives_are_those_of_differences(places):
    words = WORDS if places else WORDS[:-3]
    it = plant(words, places=places)
    x = it.parameters.start + 0.05
    seen = it.jacobian(x, T, STATE)
    value = it.predict(x, T, STATE)
    np.testing.assert_allclose(seen.channels, value, atol=1e-9)  # the same steps; only dense output in between

    def differences(step):
        def at(dx, ds):
            return np.asarray(it.predict(x + dx, T, STATE + ds))

        no_x, no_state = np.zeros(x.size), np.zeros(6)
        by_x = [(at(step * e, no_state) - at(-step * e, no_state)) / (2.0 * step) for e in np.eye(x.size)]
        by_state = [(at(no_x, step * e) - at(no_x, -step * e)) / (2.0 * step) for e in np.eye(6)]
        return np.stack(by_x, axis=2), np.stack(by_state, axis=2)

    shared, state = differences(1e-3)
    # Differences err by curvature (1e-6 of some tens) and by rollouts that choose other steps (1e-7 m over 1e-3).
    np.testing.assert_allclose(seen.shared, shared, atol=2e-3 * np.abs(shared).max())
    np.testing.assert_allclose(seen.state, state, atol=2e-3 * np.abs(state).max())


def test_a_state_or_rope_without_a_rollout_is_none():
    it = plant(["inertia"], places=False)
    assert it.predict(it.parameters.start, T, np.full(6, np.nan)) is None
    assert it.jacobian(it.parameters.start, T, np.full(6, np.nan)) is None
    assert it.predict(-it.parameters.start, T, STATE) is None  # no rope has such inertias


@pytest.mark.parametrize(("least", "fails"), [(1e-4, False), (1e-13, True)])
def test_a_rollout_of_far_too_many_steps_is_none(least, fails):
    """As the triple pendulum's, with its links in reverse order: a last link with next to no inertia whirls."""
    rope = Rope([0.2, 0.2], [0.1, 0.1], com=[0.1, 1e-7], inertia=[1e-3, least])
    it = Plant(Parameters(rope, parse(rope, ["inertia"])), Angles())
    seen = it.predict(it.parameters.start, np.linspace(0.0, 1.5, 150), np.array([0.3, 0.4, 0.0, 0.0]))
    assert (seen is None) == fails
