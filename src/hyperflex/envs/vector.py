"""Environments of many ropes, and of a single one: actions, observations, episodes and their ends."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from hyperflex import checks
from hyperflex.checks import Array, ByName, Flags, Indices
from hyperflex.envs.actuators import ACTUATORS, QUARTER
from hyperflex.envs.worlds import World
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import MotorLimits, Problem, Uncertainty, scaled_rope

NOWHERE = Peg(1.0, 0.0, 0.05)  # placeholder where an environment has no target
FACTORS = ("length", "mass", "friction")  # of the rope, that a mismatch and a randomization name
RATE = 10.0  # rad/s, the unit of rates in an observation: makes numbers of about 1
BOUND = 100.0  # to which observations are clipped, so that their space is bounded
LIFTED = 0.1  # rad, to which a rope hangs from the vertical at the start


def default_rope(n_links: int) -> Rope:
    """Return the paper's cable, 2 m and 125 g, with the same friction of the whole rope for any number of links."""
    return Rope.uniform(length=2.0, mass=0.125, n_links=n_links, radius=0.0025, friction=1e-5 * n_links)


@dataclass(frozen=True, eq=False)
class EnvOptions:
    """Arguments that all environments take.

    Attributes
    ----------
    rope, arm : Rope, Arm, optional
        The model; by default the paper's cable on an arm of 105 mm.
    limits : MotorLimits
        Limits of the motor; by default the paper's.
    action : {"acceleration", "timing"}
        What an action is.
    observation : {"state", "markers"}
        ``"state"``: sine, cosine and rate of each link, then of the arm. ``"markers"``: sine, cosine and rate of the
        arm, then places x, y of the markers from the shaft, m, now, and an interval before. Rates are in units of
        10 rad/s. What the environment adds follows.
    markers : int
        Number of markers, the last one on the tip and the others evenly before it, each on a joint.
    dt : float
        Interval of an action, s.
    tol : float
        As in :func:`hyperflex.simulate`, m.
    mismatch : mapping of str to float
        Factors of ``length``, ``mass`` and ``friction`` of the true rope relative to the model.
    randomization : mapping of str to float
        Relative standard deviations of the same, and of ``mu`` of a peg, sampled in each episode.
    """

    rope: Rope | None = None
    arm: Arm = field(default_factory=Arm)
    limits: MotorLimits = field(default_factory=MotorLimits)
    action: str = "acceleration"
    observation: str = "state"
    markers: int = 5
    dt: float = 0.02
    tol: float = 1e-5
    mismatch: Mapping[str, float] = field(default_factory=dict)
    randomization: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, kind in (("arm", Arm), ("limits", MotorLimits)):
            checks.instance(name, getattr(self, name), kind)
        checks.choice("action", self.action, tuple(ACTUATORS))
        checks.choice("observation", self.observation, ("state", "markers"))
        checks.positive("dt", self.dt, "s")
        for name, known in (("mismatch", FACTORS), ("randomization", (*FACTORS, "mu"))):
            checks.keys(name, checks.mapping(name, getattr(self, name)), known)


class RopeVectorEnv(VectorEnv[Array, npt.NDArray[np.generic], Any], ABC):
    """Many ropes on arms, each with its own episode.

    Parameters
    ----------
    num_envs : int
        Number of members M.
    autoreset_mode : {"NextStep", "SameStep", "Disabled"} or gymnasium.vector.AutoresetMode
        When a member whose episode has ended starts a new one: at the next step, whose action it ignores; in the same
        step, with the last observation in ``info["final_obs"]``; or only by ``reset(options={"reset_mask": mask})``.
    max_episode_steps : int, optional
        Steps after which an episode is truncated; by default never.
    arguments
        Those of :class:`EnvOptions`.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.
    """

    metadata: ByName = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012
    n_links: ClassVar[int] = 20
    extra: ClassVar[int] = 0  # numbers that the environment adds to an observation
    world_class: ClassVar[type[World]]

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        render_mode: None = None,
        **arguments: Any,
    ) -> None:
        self.num_envs = checks.count("num_envs", num_envs)
        modes = [mode.value for mode in AutoresetMode]
        chosen = getattr(autoreset_mode, "value", autoreset_mode)
        self._mode = AutoresetMode(checks.choice("autoreset_mode", chosen, modes))
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        if render_mode is not None:
            raise InvalidInput("this environment draws nothing", got=render_mode, allowed="render_mode=None")
        self._longest = math.inf if max_episode_steps is None else checks.count("max_episode_steps", max_episode_steps)
        checks.keys("the arguments", arguments, [each.name for each in fields(EnvOptions)])
        options = EnvOptions(**{name: value for name, value in arguments.items() if value is not None})
        self.model = checks.instance("rope", options.rope or default_rope(self.n_links), Rope)
        self.arm, self.limits, self.dt = options.arm, options.limits, options.dt
        given = options.mismatch
        factors = [checks.positive(f"mismatch {name}", given.get(name, 1.0)) for name in FACTORS]
        true = scaled_rope(self.model, *factors)
        self._true = Problem(true, self.arm, self.limits) if options.randomization else true
        known = dict.fromkeys((*FACTORS, "mu", "lag", "timing"), 0.0)
        self._uncertainty = Uncertainty(**{**known, **options.randomization})  # type: ignore[arg-type]
        self.actuator = ACTUATORS[options.action](self.limits, self.dt, self.num_envs)
        self.world = self.world_class(true, self.arm, self.num_envs, options.tol)
        links, markers = true.n_links, checks.count("markers", options.markers, most=true.n_links)
        self._marked = options.observation == "markers"
        self._joints = np.round(np.linspace(0, links, markers + 1)[1:]).astype(np.intp)  # that bear markers
        self._frames = np.zeros((2, self.num_envs, 2 * markers))  # now and an interval before
        bound = np.full(3 + (4 * markers if self._marked else 3 * links) + self.extra, BOUND)
        single = self.actuator.space, spaces.Box(-bound, bound, dtype=np.float64)
        self.single_action_space, self.single_observation_space = single
        self.action_space, self.observation_space = (batch_space(each, self.num_envs) for each in single)
        self.generators: list[np.random.Generator] = []
        self.pegs = [NOWHERE] * self.num_envs  # the targets, as they are known
        self.steps, self._ended = np.zeros(self.num_envs, dtype=np.int64), np.zeros(self.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: ByName | None = None
    ) -> tuple[Array, ByName]:
        """Start episodes. Member i samples from `seed` + i; without a seed it continues its random sequence.

        Parameters
        ----------
        seed : int or sequence of int, optional
            For all members, or one each.
        options : dict, optional
            ``{"reset_mask": (M,) bool}``: the members to reset; by default all.
        """
        everyone = np.ones(self.num_envs, dtype=np.bool_)
        mask = (options or {}).get("reset_mask", everyone)
        if np.shape(mask) != (self.num_envs,) or np.asarray(mask).dtype != np.bool_ or not np.any(mask):
            raise InvalidInput("reset_mask is not of these members", got=mask, allowed=f"({self.num_envs},) of bool")
        members = range(self.num_envs)
        seeds = seed if isinstance(seed, Sequence) else [None if seed is None else seed + m for m in members]
        if len(seeds) != self.num_envs:
            raise InvalidInput("there are not as many seeds as members", got=len(seeds), allowed=str(self.num_envs))
        if not self.generators:
            self.generators, mask = [seeding.np_random()[0] for _ in members], everyone
        for m in np.flatnonzero(mask).tolist():
            if seeds[m] is not None:
                self.generators[m] = seeding.np_random(seeds[m])[0]
        self._begin(mask)
        return self._observe(), self._info(mask)

    def step(self, actions: npt.NDArray[np.generic]) -> tuple[Array, Array, Flags, Flags, ByName]:
        """Simulate an interval with actions (M, ...); return observations, rewards, terminated, truncated and info."""
        if not self.generators:
            raise InvalidInput("the environment has not begun", fix="Call reset() first")
        if self._mode is AutoresetMode.DISABLED and self._ended.any():
            raise InvalidInput(
                "episodes have ended",
                got=np.flatnonzero(self._ended).tolist(),
                fix='Call reset() first, for some of many with options={"reset_mask": mask}',
            )
        world, anew, everyone = self.world, self._ended, np.ones(self.num_envs, dtype=np.bool_)
        world.step(self.actuator.accelerations(actions, world.arm_angle, world.arm_rate), self.dt)
        self.steps = self.steps + 1
        places = world.places()
        self._frames = np.stack([self._frame(places), self._frames[0]])
        rewards, reached = self._score(places)
        rewards, terminated = np.where(world.failed | anew, 0.0, rewards), (reached | world.failed) & ~anew
        truncated = (self.steps >= self._longest) & ~anew
        self._ended = terminated | truncated
        self._begin(anew)  # with NextStep: in the other modes none has ended before a step
        seen, info = self._observe(), self._info(everyone)
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            ended, last = self._ended, np.full(self.num_envs, None, dtype=object)
            final = {name: value & ended if name.startswith("_") else value for name, value in info.items()}
            for m in np.flatnonzero(ended):
                last[m] = seen[m]
            self._ended = np.zeros_like(ended)
            self._begin(ended)
            finals = {"final_obs": last, "_final_obs": ended, "final_info": final, "_final_info": ended.copy()}
            seen, info = self._observe(), self._info(everyone) | finals
        return seen, rewards, terminated, truncated, info

    def _begin(self, mask: Flags) -> None:
        """Begin episodes of some members."""
        which = np.flatnonzero(mask)
        if not which.size:
            return
        q0, ropes, pegs = zip(*(self._draw(m) for m in which.tolist()), strict=True)
        self.world.begin(which, ropes, pegs, np.array(q0), -QUARTER)
        self.actuator.begin(which)
        self.steps[which], self._ended = 0, self._ended & ~mask
        places = self.world.places()
        self._frames[:, which] = self._frame(places)[which]
        self._start(which, places)

    def _draw(self, m: int) -> tuple[Array, Rope, Peg]:
        """Sample the start of a member's episode: the rope's angles (n,), rad, and the true rope and peg."""
        rng, rope = self.generators[m], self.model
        q0 = np.full(rope.n_links, rope.hanging_angle + rng.uniform(-LIFTED, LIFTED))
        self.pegs[m] = peg = self._target(rng)
        if isinstance(self._true, Rope):
            return q0, self._true, peg
        drawn = self._uncertainty.sample(1, self._true, peg, seed=int(rng.integers(2**31)))[0]
        return q0, drawn.rope, drawn.peg

    def _observe(self) -> Array:
        """Return the observations (M, ...)."""
        world, angle = self.world, self.world.arm_angle
        arm = np.stack([np.sin(angle), np.cos(angle), world.arm_rate / RATE], axis=1)
        links = [np.sin(world.q), np.cos(world.q), world.qd / RATE]
        parts = [arm, *self._frames] if self._marked else [*links, arm]
        seen = np.concatenate([*parts, self._extra()], axis=1)
        return np.asarray(np.clip(np.nan_to_num(seen), -BOUND, BOUND))

    def _frame(self, places: Array) -> Array:
        """Return the places of the markers (M, 2 K) among those of the joints, from the shaft, m."""
        return np.asarray((places[:, self._joints] - np.array(self.arm.pivot)).reshape(self.num_envs, -1))

    def _target(self, rng: np.random.Generator) -> Peg:
        """Return the target of a member's episode."""
        return NOWHERE

    def _extra(self) -> Array:
        """Return the additional observations of the environment (M, extra)."""
        return np.empty((self.num_envs, 0))

    @abstractmethod
    def _start(self, which: Indices, places: Array) -> None:
        """Initialise the reference quantities of the rewards of a new episode."""

    @abstractmethod
    def _score(self, places: Array) -> tuple[Array, Flags]:
        """Return rewards (M,), and whether episodes have reached their goal (M,)."""

    @abstractmethod
    def _values(self) -> ByName:
        """Return the values of the information, (M,) each."""

    def _info(self, which: Flags) -> ByName:
        """Return the information in Gymnasium's form: each value with a mask (M,) of its members."""
        info: ByName = {}
        for name, value in {**self._values(), "failed": self.world.failed}.items():
            info |= {name: np.array(value), f"_{name}": which.copy()}
        return info


class RopeEnv(gymnasium.Env[Array, Any], ABC):
    """A rope on an arm: the only member of a :class:`RopeVectorEnv`, with results bit for bit as among many members.

    The arguments are those of :class:`EnvOptions`. Raises InvalidInput if one cannot be used.
    """

    metadata: ByName = {"render_modes": []}  # noqa: RUF012
    vector_class: ClassVar[type[RopeVectorEnv]]

    def __init__(self, **arguments: Any) -> None:
        self.members = self.vector_class(1, autoreset_mode=AutoresetMode.DISABLED, **arguments)
        self.action_space = self.members.single_action_space
        self.observation_space = self.members.single_observation_space

    def reset(self, *, seed: int | None = None, options: ByName | None = None) -> tuple[Array, ByName]:
        """Start an episode; see :meth:`gymnasium.Env.reset`. There are no `options`."""
        super().reset(seed=seed)
        self.members.generators = [self.np_random]
        seen, info = self.members.reset()
        return seen[0], _first(info)

    def step(self, action: Any) -> tuple[Array, float, bool, bool, ByName]:
        """Simulate an interval with an `action`; see :meth:`gymnasium.Env.step`."""
        seen, rewards, terminated, _, info = self.members.step(np.asarray(action)[None])
        return seen[0], float(rewards[0]), bool(terminated[0]), False, _first(info)


def _first(info: Mapping[str, Any]) -> ByName:
    """Return the information of the first member alone."""
    return {name: value[0].item() for name, value in info.items() if not name.startswith("_")}
