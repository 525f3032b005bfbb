"""Adapter of vector environments to VecEnv, the interface of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, MissingPackage


def stable_baselines_env(envs: VectorEnv[Any, Any, Any]) -> Any:
    """Return a vector environment of Gymnasium as a VecEnv of Stable-Baselines3.

    Parameters
    ----------
    envs : gymnasium.vector.VectorEnv
        With ``autoreset_mode="SameStep"``, which VecEnv requires.

    Raises
    ------
    InvalidInput
        If the environment has another ``autoreset_mode``.
    MissingPackage
        Without Stable-Baselines3.
    """
    try:
        from stable_baselines3.common.vec_env import VecEnv
    except ImportError as missing:
        raise MissingPackage("Stable-Baselines3 is missing. Install it: pip install stable-baselines3.") from missing
    if envs.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
        fix = 'Make it with autoreset_mode="SameStep"'
        raise InvalidInput("members begin anew in another way", got=envs.metadata.get("autoreset_mode"), fix=fix)
    return type("StableBaselinesVecEnv", (_Adapter, VecEnv), {})(envs)


class _Adapter:
    """The methods of a VecEnv, implemented with a vector environment of Gymnasium; the class is made on import."""

    _seeds: list[int | None]
    _actions: npt.NDArray[np.generic]
    reset_infos: list[dict[str, Any]]

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)  # type: ignore[call-arg]

    def reset(self) -> Array:
        """Reset all episodes, with the seeds set by ``seed``, if any."""
        seen, info = self.envs.reset(seed=self._seeds)  # type: ignore[arg-type] # one a member, as VectorEnvs take them
        self._seeds = [None] * self.envs.num_envs
        self.reset_infos = _each(info, self.envs.num_envs)
        return np.asarray(seen)

    def step_async(self, actions: npt.NDArray[np.generic]) -> None:
        """Store the actions (M, ...) of the next interval."""
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Simulate the interval; return observations, rewards, ends of episodes, and information, one per member."""
        seen, rewards, terminated, truncated, info = self.envs.step(self._actions)
        ended, final = terminated | truncated, info.get("final_info", {})
        infos = _each(info, self.envs.num_envs)
        for m in np.flatnonzero(ended).tolist():
            self.reset_infos[m] = infos[m]
            infos[m] = _each(final, self.envs.num_envs)[m] | {"terminal_observation": info["final_obs"][m]}
        for m, each in enumerate(infos):
            each["TimeLimit.truncated"] = bool(truncated[m] and not terminated[m])
        return seen, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: int | Sequence[int] | None = None) -> list[Any]:
        """Return the attribute `attr_name`, which all members share, once for each of `indices`."""
        return [getattr(self.envs, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: int | Sequence[int] | None = None) -> None:
        """Refuse: members share their attributes."""
        raise InvalidInput("members have no own attributes", got=attr_name, fix="Make another environment")

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **named: Any) -> list[Any]:
        """Refuse: members have no methods."""
        raise InvalidInput("members have no own methods", got=method_name, fix="Use the vector environment's")

    def env_is_wrapped(self, wrapper_class: type, indices: int | Sequence[int] | None = None) -> list[bool]:
        """Return that no member is wrapped."""
        return [False] * self._count(indices)

    def _count(self, indices: int | Sequence[int] | None) -> int:
        return self.envs.num_envs if indices is None else np.size(indices)


def _each(info: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Convert Gymnasium's information to one dict per member."""
    plain = {name: value for name, value in info.items() if name[0] != "_" and not name.startswith("final_")}
    return [{name: value[m] for name, value in plain.items()} for m in range(count)]
