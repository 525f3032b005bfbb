"""Adapter of vector environments to VecEnv, the interface of Stable-Baselines3."""

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv

from hyperflex.checks import Array, ByName, Flags
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
        raise InvalidInput(
            "members begin anew in another way",
            got=envs.metadata.get("autoreset_mode"),
            fix='Make it with autoreset_mode="SameStep"',
        )

    class StableBaselinesVecEnv(VecEnv):  # type: ignore[misc]
        """A VecEnv whose members share their attributes and have no methods."""

        _seeds: Any

        def reset(self) -> Array:
            seen, info = envs.reset(seed=self._seeds)
            self._seeds = [None] * envs.num_envs
            self.reset_infos = _each(info, envs.num_envs)
            return np.asarray(seen)

        def step_async(self, actions: npt.NDArray[np.generic]) -> None:
            self._actions = actions

        def step_wait(self) -> tuple[Array, Array, Flags, list[ByName]]:
            seen, rewards, terminated, truncated, info = envs.step(self._actions)
            ended, infos = terminated | truncated, _each(info, envs.num_envs)
            final = _each(info.get("final_info", {}), envs.num_envs)
            for m in np.flatnonzero(ended).tolist():
                self.reset_infos[m] = infos[m]
                infos[m] = final[m] | {"terminal_observation": info["final_obs"][m]}
            for m, each in enumerate(infos):
                each["TimeLimit.truncated"] = bool(truncated[m] and not terminated[m])
            return seen, rewards.astype(np.float32), ended, infos

        def close(self) -> None:
            envs.close()

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            return [getattr(envs, attr_name)] * (envs.num_envs if indices is None else np.size(indices))

        set_attr = env_method = _refuse

        def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
            return [False for _ in self.get_attr("num_envs", indices)]

    return StableBaselinesVecEnv(envs.num_envs, envs.single_observation_space, envs.single_action_space)


def _refuse(_: object, name: str, *__: object, **___: object) -> None:
    raise InvalidInput(
        "members have neither attributes nor methods of their own", got=name, fix="Use the vector environment's"
    )


def _each(info: ByName, count: int) -> list[ByName]:
    """Convert Gymnasium's information to one dict per member."""
    plain = {name: value for name, value in info.items() if name[0] != "_" and not name.startswith("final_")}
    return [{name: value[m] for name, value in plain.items()} for m in range(count)]
