"""Scripted policies: rules for half turns, and planned casts.

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
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan, Conditions, SearchOptions, plan_cast

WINDS = 5.0  # s after the motion, in which the rope must wind


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
        """Return the action for an observation `seen`."""
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


class PlannedCast:
    """A cast that :func:`hyperflex.plan_cast` plans for the target of an episode, carried out in open loop.

    A plan is rehearsed with the model's rope in a separate environment, whose intervals of the arm and links at the
    peg differ from the planner's. The search ends with the first plan that succeeds there, too.

    Parameters
    ----------
    env : gymnasium.Env
        A :class:`CastEnv`, possibly wrapped, with actions that are accelerations, whose episode has begun.
    tries : int
        Searches at most, with other seeds; if no rehearsal succeeds, the last plan is carried out all the same.
    time_limit, time_budget : float
        As of :func:`hyperflex.plan_cast`, s; the time budget is that of a search.
    threads : int, optional
        As of :func:`hyperflex.plan_cast`.
    """

    def __init__(
        self,
        env: Any,
        *,
        tries: int = 2,
        time_limit: float = 9.0,
        time_budget: float = 15.0,
        threads: int | None = None,
    ) -> None:
        self._members, self._succeeds = members_of(env), False
        self._motion: Motion | None = None
        if isinstance(self._members.actuator, TimingActuator):
            raise InvalidInput("a planned cast needs accelerations", got="timing", allowed='action="acceleration"')
        model, arm, limits, world = (getattr(self._members, name) for name in ("model", "arm", "limits", "world"))
        begin = RopeState(0.0, world.q[0].copy(), world.qd[0].copy())
        given = Conditions(time_limit=time_limit, clearance=-np.inf, side=-1, state0=begin)
        for seed in range(tries):
            plan = plan_cast(
                model,
                arm,
                self._members.pegs[0],
                limits,
                conditions=given,
                time_budget=time_budget,
                options=SearchOptions(seed=seed, threads=threads),
                on_plan=self._rehearse,
            )
            self._motion = plan.motion or self._motion
            if self._succeeds:
                break

    def __call__(self, seen: Array) -> Any:
        """Return the action for an observation `seen`."""
        return self._action(self._members, self._motion)

    def _action(self, members: Any, motion: Motion | None) -> Any:
        t, given, world = members.dt * float(members.steps[0]), 0.0, members.world
        if motion is not None:
            angle, rate = motion.angle(t), motion.rate(t + members.dt)
            lag = float(angle) - world.arm_angle[0]
            given = (float(rate) - world.arm_rate[0]) / members.dt + 5.0 * lag  # 1/s^2: takes a lag back in a second
        return np.clip([given / members.limits.acceleration], -1.0, 1.0).astype(np.float32)

    def _rehearse(self, plan: CastPlan) -> bool:
        """Return whether a plan succeeds in an environment whose true rope is the model's."""
        members, motion = self._members, plan.required(plan.motion, "motion")
        given = {name: getattr(members, name) for name in ("arm", "limits", "dt")}
        twin = type(members)(rope=members.model, target=members.pegs[0], tol=members.world.tol, **given)
        twin.reset(seed=0)
        twin.world.begin(np.array([0]), [members.model], members.pegs, members.world.q, members.world.arm_angle[0])
        ended, end = False, motion.end + WINDS
        while not ended and members.dt * twin.steps[0] < end:
            _, _, terminated, _, info = twin.step(self._action(twin, motion)[None])
            ended, self._succeeds = bool(terminated[0]), bool(info["is_success"][0])
        return self._succeeds


def members_of(env: Any) -> Any:
    """Return the members of an environment that may be wrapped; refuse environments of other packages."""
    if not isinstance(env.unwrapped, RopeEnv):
        raise InvalidInput("this is no environment of hyperflex", got=env, allowed="hyperflex/Swing-v0, Cast-v0")
    return env.unwrapped.members


def swing_model(env: Any) -> SwingModel:
    """Return the model of half turns that an environment's arm can make in whole intervals."""
    members = members_of(env)
    timing = TimingActuator(members.limits, members.dt, 1)
    return SwingModel(members.model, members.arm, 2 * timing.half * timing.dt)
