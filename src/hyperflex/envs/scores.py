"""Scores of policies: returns of whole episodes from given seeds, and their mean with an interval."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from hyperflex import checks
from hyperflex.checks import Array, ByName, Flags
from hyperflex.executor import checked_chunks, refuse_lost, run_chunks

Policy = Callable[[Array], Any]
SEEDS = range(200)  # of the benchmark
CHUNK = 8  # episodes


@dataclass(frozen=True, eq=False)
class Scores:
    """Episodes of a policy.

    Attributes
    ----------
    returns : (S,) float64
        Sum of the rewards of each episode.
    successes : (S,) bool
        ``info["is_success"]`` at its end; False where an environment has none.
    """

    returns: Array
    successes: Flags

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(self.returns.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean return, by a bootstrap of the episodes with fixed random numbers."""
        rows = np.random.default_rng(0).integers(self.returns.size, size=(2000, self.returns.size))
        low, high = np.quantile(self.returns[rows].mean(axis=1), [0.025, 0.975])
        return float(low), float(high)

    def __str__(self) -> str:
        low, high = self.interval
        succeeded = f", {self.successes.sum()} successes" if self.successes.any() else ""
        return f"{self.mean:.4g} ({low:.4g} to {high:.4g}, {self.returns.size} episodes{succeeded})"


def score_policy(
    make_policy: Callable[[Any], Policy],
    environment: str,
    *,
    seeds: Sequence[int] = SEEDS,
    executor: Executor | None = None,
    chunk_size: int | None = None,
    **arguments: Any,
) -> Scores:
    """Play an episode from each seed, and return the scores.

    Parameters
    ----------
    make_policy : callable
        Called with the environment when an episode has begun; returns the policy for it, a function of the observation
        that returns an action: ``CrossingPolicy``, or ``lambda env: lambda seen: model.predict(seen)[0]``. The
        environment's action space is seeded, so that random policies, too, do the same each time.
    environment : str
        ``"hyperflex/Swing-v0"`` or another that :func:`gymnasium.make` makes.
    seeds : sequence of int
        Of the episodes; by default the 200 of the benchmark.
    executor : concurrent.futures.Executor, optional
        Where episodes are played: processes, or other machines (``docs/how-to/many-machines.md``). Then `make_policy`
        must be one that can be pickled. Results do not depend on it.
    chunk_size : int, optional
        Episodes of a chunk; by default CHUNK.
    arguments
        Of the environment.

    Raises
    ------
    WorkerLost
        If episodes kill the workers of the executor.
    """
    numbers = [checks.count("seed", seed, least=0) for seed in seeds]
    executor, size = checked_chunks(executor, chunk_size, CHUNK)
    ends: dict[int, list[tuple[float, bool]]] = {}
    work = partial(_episodes, make_policy=make_policy, environment=environment, arguments=arguments)
    refuse_lost(run_chunks(work, numbers, executor, size, ends.__setitem__), "episodes")
    returns, successes = zip(*(end for low in sorted(ends) for end in ends[low]), strict=True)
    return Scores(np.array(returns), np.array(successes))


def _episodes(
    seeds: list[int], make_policy: Callable[[Any], Policy], environment: str, arguments: ByName
) -> list[tuple[float, bool]]:
    """Play an episode from each seed; return the sums of the rewards, and whether they were successes."""
    env, ends = gymnasium.make(environment, **arguments), list[tuple[float, bool]]()
    for seed in seeds:
        seen, info = env.reset(seed=seed)
        env.action_space.seed(seed)
        policy, total, over = make_policy(env), 0.0, False
        while not over:
            seen, reward, terminated, truncated, info = env.step(policy(seen))
            total, over = total + float(reward), terminated or truncated
        ends.append((total, bool(info.get("is_success", False))))
    env.close()
    return ends
