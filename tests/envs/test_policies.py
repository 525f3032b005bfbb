"""Scripted policies, their scores, and the adapter for Stable-Baselines3."""

import importlib.util
import sys
from dataclasses import replace
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest

import hyperflex as hf
from hyperflex.envs import CrossingPolicy, PlannedCast, PumpingPolicy, Scores, score_policy, stable_baselines_env
from hyperflex.envs.policies import members_of
from hyperflex.envs.vector import default_rope
from hyperflex.errors import MissingPackage
from hyperflex.planning import Moves, check_feasibility
from tests.refusals import refuses

SWING, CAST = "hyperflex/Swing-v0", "hyperflex/Cast-v0"


def test_rules_swing_better_than_chance_and_with_either_action():
    chance = score_policy(lambda env: lambda _: env.action_space.sample(), SWING, seeds=[0, 1])
    again = score_policy(lambda env: lambda _: env.action_space.sample(), SWING, seeds=[1])
    assert chance.returns[1:].tolist() == again.returns.tolist()
    crossing = score_policy(CrossingPolicy, SWING, seeds=[1], action="timing")
    pumping = [score_policy(PumpingPolicy, SWING, seeds=[1], action=kind).mean for kind in ("timing", "acceleration")]
    assert chance.mean < 80.0 < crossing.mean < pumping[0]
    assert pumping[1] == pytest.approx(pumping[0], rel=1e-3)


def test_a_plan_is_carried_out():
    """The arm follows the motion that was planned; whether the rope winds is up to the planner."""
    target = hf.Peg(0.9, -0.8, 0.05)
    env = gymnasium.make(CAST, target=target)
    seen, _ = env.reset(seed=0)
    policy = PlannedCast(env, tries=0)
    assert policy(seen) == 0.0
    policy._motion = hf.arm_moves([-np.pi / 2, np.pi / 2, 0.3], [0.3, 0.4], [0.8, 0.9], [0.5, 0.3])
    gaps = []
    for k in range(100):
        seen, *_ = env.step(policy(seen))
        gaps.append(members_of(env).world.arm_angle[0] - float(policy._motion.angle(0.02 * (k + 1))))
    assert np.abs(gaps).max() < 5e-3
    refuses("needs accelerations", PlannedCast, gymnasium.make(CAST, action="timing"))
    refuses("no environment of hyperflex", PlannedCast, gymnasium.make("CartPole-v1"))


def test_a_plan_is_for_the_start_of_the_episode_and_the_first_that_winds_in_a_rehearsal_is_carried_out(monkeypatch):
    target, problem = (hf.Peg(0.78453362, -0.91275162, 0.05), hf.Problem(default_rope(40), hf.Arm(), hf.MotorLimits()))
    rests = np.array([0.0, 0.50848401, 0.40848401, 0.52848401, 0.50848401, 0.70848401, 0.30848401])
    ends = -0.5 * np.pi + 2.98451302 * (np.arange(7) % 2 == 0)
    winds = Moves(-1, np.append(ends, 0.5 * np.pi), np.append(rests, 0.36848401))
    reach = check_feasibility(problem, target)
    plans = [hf.CastPlan(problem, target, reach, each) for each in (None, winds)]
    misses = replace(plans[1], moves=replace(winds, rests=np.full(8, 0.2)))
    seen: list[tuple[int, bool]] = []

    def plan_cast(*_, conditions, options, on_plan, **given):
        np.testing.assert_array_equal(conditions.state0.q, world.q[0])
        assert conditions.side == -1
        found = (plans[0], misses, plans[1])[options.seed]
        seen.append((options.seed, found.moves is not None and on_plan(found)))
        return found

    monkeypatch.setattr("hyperflex.envs.policies.plan_cast", plan_cast)
    env = gymnasium.make(CAST, target=target)
    env.reset(seed=6)
    world = members_of(env).world
    policy, ended, info = PlannedCast(env, tries=5), False, {"is_success": False}
    assert seen == [(0, False), (1, False), (2, True)]
    assert members_of(env).steps[0] == 0
    while not ended:
        _, _, terminated, truncated, info = env.step(policy(None))
        ended = terminated or truncated
    assert info["is_success"]


def test_scores_have_an_interval():
    scores = Scores(np.random.default_rng(0).normal(5.0, 2.0, 200), np.zeros(200, dtype=np.bool_))
    low, high = scores.interval
    assert low < scores.mean < high
    assert high - low == pytest.approx(4.0 * scores.returns.std() / np.sqrt(200), rel=0.1)
    assert "200 episodes" in str(scores)


ASKED = ("reset", "step_async", "step_wait", "close", "get_attr", "set_attr", "env_method", "env_is_wrapped")


class VecEnv:
    """The part of stable_baselines3.common.vec_env.VecEnv that algorithms and the adapter touch."""

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self._seeds: list[int | None] = [None] * num_envs
        assert self.get_attr("render_mode") == [None] * num_envs
        assert all(name in vars(type(self)) for name in ASKED)  # abstract methods of the package

    def seed(self, seed: int) -> None:
        self._seeds = [seed + m for m in range(self.num_envs)]


def test_adapter_does_what_stable_baselines_asks(monkeypatch):
    """Against the package where it is there, else against the part of its VecEnv that it calls."""
    if importlib.util.find_spec("stable_baselines3") is None:
        for name in ("stable_baselines3", "stable_baselines3.common", "stable_baselines3.common.vec_env"):
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        sys.modules["stable_baselines3.common.vec_env"].VecEnv = VecEnv
    make = {"num_envs": 2, "autoreset_mode": "SameStep", "max_episode_steps": 3}
    envs = stable_baselines_env(gymnasium.make_vec(SWING, **make))
    plain = gymnasium.make_vec(SWING, **make)
    envs.seed(5)
    np.testing.assert_array_equal(envs.reset(), plain.reset(seed=5)[0])
    for k in range(7):
        actions = np.full((2, 1), 0.5)
        envs.step_async(actions)
        seen, rewards, ended, infos = envs.step_wait()
        other, want, _, truncated, info = plain.step(actions)
        np.testing.assert_array_equal(seen, other)
        np.testing.assert_allclose(rewards, want, rtol=1e-6)
        np.testing.assert_array_equal(ended, truncated)
        assert ended.all() == (k % 3 == 2)
        for m, each in enumerate(infos):
            assert each["TimeLimit.truncated"] == ended[m]
            assert ("terminal_observation" in each) == ended[m]
            if ended[m]:
                np.testing.assert_array_equal(each["terminal_observation"], info["final_obs"][m])
                assert each["amplitude"] == info["final_info"]["amplitude"][m] == pytest.approx(want[m])
    assert envs.get_attr("render_mode") == [None, None]
    assert envs.env_is_wrapped(gymnasium.Wrapper, 0) == [False]
    refuses("begin anew", stable_baselines_env, gymnasium.make_vec(SWING, num_envs=2))


def test_without_stable_baselines_its_command_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3.common", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MissingPackage, match="pip install stable-baselines3"):
        stable_baselines_env(gymnasium.make_vec(SWING, num_envs=2, autoreset_mode="SameStep"))
