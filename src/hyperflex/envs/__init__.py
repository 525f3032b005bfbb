"""Environments for reinforcement learning, by Gymnasium's interface; to import this package registers them.

From then on ``gymnasium.make("hyperflex/Swing-v0")`` and ``gymnasium.make("hyperflex/Cast-v0")`` work, and so does
Gymnasium's make_vec, for many of them at once. They need ``pip install 'hyperflex[gym]'``.
"""

from typing import TYPE_CHECKING

from hyperflex import extras
from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.envs.cast import CastEnv, CastVectorEnv
    from hyperflex.envs.policies import CrossingPolicy, PlannedCast, PumpingPolicy, RulePolicy
    from hyperflex.envs.scores import Scores, score_policy
    from hyperflex.envs.stable_baselines import stable_baselines_env
    from hyperflex.envs.swing import SwingEnv, SwingVectorEnv
    from hyperflex.envs.vector import EnvOptions, RopeEnv, RopeVectorEnv

extras.require(("gymnasium",), "gym", "Environments")


def _register() -> None:
    from gymnasium.envs.registration import register, registry

    for name, steps in (("Swing", 500), ("Cast", 750)):
        if f"hyperflex/{name}-v0" not in registry:
            where = f"hyperflex.envs.{name.lower()}:{name}"
            one, many = f"{where}Env", f"{where}VectorEnv"
            register(f"hyperflex/{name}-v0", one, max_episode_steps=steps, vector_entry_point=many)


_register()
__getattr__, __dir__, __all__ = attach(__name__, __file__)
