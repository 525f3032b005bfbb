"""Environments: Gymnasium's checks, equality of members and single ones, episodes, limits, random draws."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import hyperflex as hf
import hyperflex.envs
from hyperflex.checks import Array
from hyperflex.envs.policies import members_of
from hyperflex.envs.vector import default_rope
from hyperflex.errors import InvalidInput
from hyperflex.planning import check_feasibility
from tests.refusals import refuses

IDS = ("hyperflex/Swing-v0", "hyperflex/Cast-v0")
DRAWN = {"randomization": {"length": 0.02, "friction": 0.3}, "mismatch": {"mass": 1.1}}


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize(
    ("action", "observation", "drawn"),
    [
        ("acceleration", "state", {}),
        ("acceleration", "markers", DRAWN),
        ("timing", "state", DRAWN),
        ("timing", "markers", {}),
    ],
)
def test_gymnasium_finds_nothing(name, action, observation, drawn):
    """Its warnings are errors here. Each pair of values of two options occurs."""
    env = gymnasium.make(name, action=action, observation=observation, **drawn).unwrapped
    check_env(env)
    assert env.observation_space.contains(env.reset(seed=0)[0])


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("action", ["acceleration", "timing"])
def test_members_are_single_environments(name, mode, action):
    """Three episodes, compared with Gymnasium's own vectorisation: values, ends and information."""
    arguments = {"max_episode_steps": 25, "action": action, "observation": "markers", **DRAWN}
    many = gymnasium.make_vec(name, num_envs=2, autoreset_mode=mode, **arguments)
    ones = SyncVectorEnv([lambda: gymnasium.make(name, **arguments)] * 2, autoreset_mode=AutoresetMode(mode))
    many.action_space.seed(3)
    seen = [envs.reset(seed=7)[0] for envs in (many, ones)]
    np.testing.assert_allclose(*seen, rtol=0, atol=1e-9)
    ends = 0
    for _ in range(80):
        actions = many.action_space.sample()
        (*left, info), (*right, other) = many.step(actions), ones.step(actions)
        for a, b in zip(left, right, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)
        assert sorted(info) == sorted(other)
        if left[3].any():
            ends += 1
            if mode == "SameStep":
                for a, b in zip(info["final_obs"], other["final_obs"], strict=True):
                    np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)
                assert sorted(info["final_info"]) == sorted(other["final_info"])
    assert ends == 3


def test_members_that_ended_wait_for_their_reset():
    envs = gymnasium.make_vec(IDS[0], num_envs=3, autoreset_mode="Disabled", max_episode_steps=2)
    refuses("has not begun", envs.step, np.zeros((3, 1)))
    envs.reset(seed=[1, 2, 1])
    envs.step(np.zeros((3, 1)))
    last, *_ = envs.step(np.ones((3, 1)))
    refuses("episodes have ended", envs.step, np.zeros((3, 1)))
    mask = np.array([True, False, True])
    seen, info = envs.reset(seed=[1, None, 1], options={"reset_mask": mask})
    np.testing.assert_array_equal(seen[0], seen[2])
    np.testing.assert_array_equal(seen[1], last[1])
    np.testing.assert_array_equal(info["_amplitude"], mask)
    refuses("reset_mask", envs.reset, options={"reset_mask": np.zeros(3, dtype=np.bool_)})
    refuses("seeds", envs.reset, seed=[1])


def test_arms_keep_to_the_motors_limits():
    limits = hf.MotorLimits(speed=5.0, acceleration=30.0, angles=(-1.8, 1.0))
    envs = hyperflex.envs.SwingVectorEnv(4, limits=limits)
    envs.reset(seed=0)
    rng, angles, rates = np.random.default_rng(1), [], []
    for _ in range(150):
        envs.step(np.sign(rng.uniform(-1.0, 1.0, (4, 1)) + np.array([[2.0], [-2.0], [0.0], [0.0]])))
        angles.append(envs.world.arm_angle)
        rates.append(envs.world.arm_rate)
    assert np.abs(rates).max() <= 5.0 + 1e-9
    beyond = 30.0 * 0.02**2 / 8.0 + 1e-9  # while the arm turns round within an interval
    assert np.min(angles) >= -1.8 - beyond
    assert np.max(angles) <= 1.0 + beyond
    np.testing.assert_allclose([np.max(angles), np.min(angles)], [1.0, -1.8], atol=1e-2)  # and use their range
    refuses("half turns", hyperflex.envs.SwingEnv, action="timing", limits=limits)


def test_half_turns_begin_when_requested_and_end_on_the_other_side():
    env = hyperflex.envs.SwingEnv(action="timing")
    env.reset(seed=0)
    half = env.members.actuator.half
    assert 2 * half * 0.02 >= 0.73 > 2 * (half - 1) * 0.02
    angles = []
    for action in (0, 1, *([1, 0] * half), 0, 1, *([0] * 2 * half)):
        env.step(action)
        angles.append(env.members.world.arm_angle[0])
    np.testing.assert_allclose(np.array(angles)[[0, 2 * half, -1]], np.pi / 2 * np.array([-1, 1, -1]), atol=1e-9)
    assert env.members.world.arm_rate[0] == pytest.approx(0.0, abs=1e-9)


def test_what_is_drawn():
    env = gymnasium.make(IDS[1], **DRAWN)
    true = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        stepper, _ = members_of(env).world._members[0]
        true.append((stepper.setup.rope.total_length, members_of(env).pegs[0]))
    assert true[0] == true[2]
    assert true[0][0] != true[1][0]
    assert true[0][1] != true[1][1]
    model = members_of(env).model
    assert stepper.setup.rope.mass.sum() == pytest.approx(1.1 * model.mass.sum())
    assert (hf.Peg(0.9, -0.8, 0.05),) == (hyperflex.envs.CastVectorEnv(target=hf.Peg(0.9, -0.8, 0.05)).target,)
    refuses("Perhaps 'friction' is meant", gymnasium.make, IDS[0], randomization={"frction": 0.1})
    refuses("mismatch mass", gymnasium.make, IDS[0], mismatch={"mass": -1.0})


def test_targets_are_in_reach_of_the_rope_that_is_given():
    cord, arm, limits = (
        hf.Rope.uniform(length=1.2, mass=0.05, n_links=15, friction=0.0),
        hf.Arm(length=0.15),
        hf.MotorLimits(),
    )
    for rope in (default_rope(40), cord):
        env = gymnasium.make(IDS[1], rope=rope, arm=arm)
        problem = hf.Problem(rope, arm, limits, side=-1)
        for seed in range(50):
            env.reset(seed=seed)
            peg = members_of(env).pegs[0]
            assert check_feasibility(problem, peg).feasible
            assert 0.3 <= abs(peg.x) / rope.total_length <= 0.55
            assert 0.3 <= -peg.y / rope.total_length <= 0.55
    with pytest.raises(InvalidInput, match=r"of 100 none is in reach.*Give target="):
        gymnasium.make(IDS[1], rope=hf.Rope.uniform(length=0.3, mass=0.02, n_links=10, friction=0.0)).reset(seed=0)


def wound(turns: float, peg: hf.Peg, count: int) -> Array:
    """Places (1, count + 1, 2) of joints that go round a peg."""
    angle = 2.0 * np.pi * np.linspace(0.0, turns, count + 1)
    return np.array([[peg.x, peg.y] + 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1)])


def test_a_cast_succeeds_when_the_rope_stays_wound():
    peg = hf.Peg(0.9, -0.8, 0.05)
    envs = hyperflex.envs.CastVectorEnv(target=peg)
    seen, _ = envs.reset(seed=0)
    np.testing.assert_allclose(seen[0, -3:], [0.9, -0.8, 0.05])
    begin = abs(envs._turns[0]) / 1.25
    rewards = [envs._score(wound(-turns, peg, 40))[0][0] for turns in (0.5, 1.5, 1.0)]
    assert begin + sum(rewards) == pytest.approx(1.0 / 1.25)
    ends = [envs._score(wound(-2.0, peg, 40)) for _ in range(50)]
    assert [bool(end[0]) for _, end in ends] == [False] * 49 + [True]
    assert begin + sum(rewards) + sum(reward[0] for reward, _ in ends) == pytest.approx(2.0)


def test_a_member_that_cannot_be_simulated_ends_alone():
    envs = hyperflex.envs.SwingVectorEnv(2, autoreset_mode="SameStep")
    envs.reset(seed=0)
    state = envs.world._state
    rates = np.array([np.zeros(20), np.full(20, 1e9)])
    envs.world._state = type(state)(**{**vars(state), "qd": rates})
    with np.errstate(all="ignore"):
        seen, rewards, terminated, truncated, info = envs.step(np.zeros((2, 1)))
    assert terminated.tolist() == [False, True]
    assert not truncated.any()
    assert info["final_info"]["failed"][1]
    assert rewards[1] == 0.0
    assert np.isfinite(seen).all()
    assert not envs.world.failed.any()


def test_the_package_registers_what_gymnasium_makes():
    code = "import gymnasium; print(gymnasium.make('hyperflex.envs:hyperflex/Swing-v0').spec.max_episode_steps)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["500"]
