"""Scripted policies: rules for half turns.

A policy is made for an episode that has begun, ``policy = CrossingPolicy(env)``, and then returns an action for each
observation, ``policy(seen)``. It reads the environment's true state and its model, not the true rope.
"""

from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import CrossingRule, PumpingRule, Rule, SwingModel
from hyperflex.envs.actuators import TimingActuator
from hyperflex.envs.vector import RopeEnv
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState


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
        self._made, self._start = 0, 0.0

    def __call__(self, seen: Array) -> Any:
        """Return the action for what is `seen`."""
        members, world, begins = self._members, self._members.world, False
        if not self._timing.remaining[0]:
            now = members.dt * float(members.steps[0])
            if np.isnan(self._start):
                self._start = self._rule.next_start(RopeState(now, world.q[0], world.qd[0]), self._made)
            begins = now > self._start - 0.5 * members.dt
            if begins:
                self._made, self._start = self._made + 1, np.nan
        given = self._timing.accelerations(np.array([begins]), world.arm_angle, world.arm_rate)
        if isinstance(members.actuator, TimingActuator):
            return int(begins)
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
