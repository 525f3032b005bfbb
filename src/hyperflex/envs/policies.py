"""Scripted policies: the rules of the paper and of this package for half turns, and planned casts carried out.

A policy is made for an episode that has begun, ``policy = CrossingPolicy(env)``, and then gives an action for each
observation, ``policy(seen)``. These look at the environment's true state and know its model, not the true rope.
"""

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import CrossingRule, PumpingRule, Rule, SwingModel
from hyperflex.envs.actuators import TimingActuator
from hyperflex.envs.vector import RopeEnv
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.motion import Motion
from hyperflex.planning import plan_cast

TRIES, TIME, BUDGET = 3, 9.0, 6.0  # plans for a target, time until the strike, s, and time for a plan, s
GAIN = 5.0  # 1/s^2, of the arm's lag behind a planned motion


class RulePolicy:
    """Half turns that a rule of :mod:`hyperflex.control` starts, as actions of either kind.

    Parameters
    ----------
    env : gymnasium.Env
        A :class:`RopeEnv`, possibly wrapped, whose episode has begun.
    rule : Rule
        Decides at each rest of the arm, from the true state, when the next half turn starts.
    """

    def __init__(self, env: Any, rule: Rule) -> None:
        self._members, self._rule = members_of(env), rule
        self._timing = TimingActuator(self._members.limits, self._members.dt, 1)
        self._made, self._left, self._start = 0, 0, 0.0

    def __call__(self, seen: Array) -> Any:
        """Return the action for what is `seen`."""
        members, begins = self._members, False
        if self._left == 0:
            now = members.dt * float(members.steps[0])
            if np.isnan(self._start):
                state = RopeState(now, members.world.q[0], members.world.qd[0])
                self._start = self._rule.next_start(state, self._made)
            begins = now > self._start - 0.5 * members.dt
            if begins:
                self._made, self._left, self._start = self._made + 1, 2 * self._timing.half, np.nan
        self._left = max(0, self._left - 1)
        if isinstance(members.actuator, TimingActuator):
            return int(begins)
        world = members.world
        given = self._timing.accelerations(np.array([int(begins)]), world.arm_angle, world.arm_rate)
        return (given / members.limits.acceleration).astype(np.float32)


class CrossingPolicy(RulePolicy):
    """The paper's rule: each half turn starts when the tip is about to cross the vertical through the shaft.

    `env` is as of :class:`RulePolicy`; `lead`, s, as of :class:`hyperflex.control.CrossingRule`.
    """

    def __init__(self, env: Any, lead: float = 0.0) -> None:
        super().__init__(env, CrossingRule(swing_model(env), lead))


class PumpingPolicy(RulePolicy):
    """Half turns that start when the model predicts the greatest swing, by :class:`hyperflex.control.PumpingRule`.

    `env` is as of :class:`RulePolicy`.
    """

    def __init__(self, env: Any) -> None:
        model = swing_model(env)
        super().__init__(env, PumpingRule(model, model.rope.total_length + model.arm.length))


class PlannedCast:
    """A cast that :func:`hyperflex.plan_cast` plans for the target of an episode, carried out in open loop.

    Parameters
    ----------
    env : gymnasium.Env
        A :class:`CastEnv`, possibly wrapped, with actions that are accelerations, whose episode has begun.
    tries : int
        Plans at most, with other seeds, until one begins with the arm where it is and succeeds; else the last one that
        begins there is carried out, or none.
    time_limit, time_budget : float
        As of :func:`hyperflex.plan_cast`, s.
    threads : int, optional
        As of :func:`hyperflex.plan_cast`.
    """

    def __init__(
        self,
        env: Any,
        *,
        tries: int = TRIES,
        time_limit: float = TIME,
        time_budget: float = BUDGET,
        threads: int | None = None,
    ) -> None:
        self._members = members_of(env)
        if isinstance(self._members.actuator, TimingActuator):
            raise InvalidInput("a planned cast needs accelerations", got="timing", allowed='action="acceleration"')
        self._motion: Motion | None = None
        given: dict[str, Any] = {"time_limit": time_limit, "time_budget": time_budget, "threads": threads}
        model, arm, limits = self._members.model, self._members.arm, self._members.limits
        for seed in range(tries):
            plan = plan_cast(model, arm, self._members.pegs[0], limits, seed=seed, clearance=-np.inf, **given)
            if plan.throw is None:
                break
            if plan.throw.side < 0:
                self._motion = plan.throw.motion(limits)
                if plan.success:
                    break

    def __call__(self, seen: Array) -> Any:
        """Return the action for what is `seen`."""
        members, world = self._members, self._members.world
        t, given = members.dt * float(members.steps[0]), 0.0
        if self._motion is not None:
            angle, rate = self._motion.angle(t), self._motion.rate(t + members.dt)
            given = (float(rate) - world.arm_rate[0]) / members.dt + GAIN * (float(angle) - world.arm_angle[0])
        return np.clip([given / members.limits.acceleration], -1.0, 1.0).astype(np.float32)


def members_of(env: Any) -> Any:
    """Return the members of an environment that may be wrapped; refuse what is none of this package."""
    if not isinstance(env.unwrapped, RopeEnv):
        raise InvalidInput("this is no environment of hyperflex", got=env, allowed="hyperflex/Swing-v0, Cast-v0")
    return env.unwrapped.members


def swing_model(env: Any) -> SwingModel:
    """Return the model of half turns that an environment's arm can make in whole intervals."""
    members = members_of(env)
    timing = TimingActuator(members.limits, members.dt, 1)
    return SwingModel(members.model, members.arm, 2 * timing.half * timing.dt)
