"""Environments: steps per second, and the scores of scripted, random and learned policies over 200 seeds.

python -m benchmarks.gym                        speed and scripted scores, with earlier learned ones; an hour
python -m benchmarks.gym --seeds 10 --out -     short; writes nothing
python -m benchmarks.gym --learn Swing 0        train a policy with Stable-Baselines3 (to be installed) and score it

Seeds are 0 to 199, arguments the environments' defaults; intervals are 95 % of the mean return, by a bootstrap. To
enter a policy, play the same episodes with ``hyperflex.envs.score_policy``. Rows are kept in gym.jsonl: the same
command continues an interrupted run. Times of learning and planning are processor times of all threads, so that other
programs do not matter. All simulated.
"""

import argparse
import copy
import functools
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from benchmarks import log as lines
from benchmarks import machine

from hyperflex import files
from hyperflex.envs import CrossingPolicy, PlannedCast, PumpingPolicy, Scores, score_policy, stable_baselines_env

RESULTS = Path(__file__).parent / "results"
MEMBERS, STEPS, ROUNDS, AIM = 256, 300, 5, 50_000.0  # members, steps a round, rounds, steps/s
LIMIT, PART = 600.0, 0.9  # s of learning; part of the scripted return
EVERY = {"Swing": 20.0, "Cast": 60.0}  # s between two evaluations
SURE = 1.1  # times PART at which learning ends, because the best result on few other seeds is optimistic
PLANNING = 15.0  # s of planning a cast, twice at most
TRIED = {"Swing": range(1000, 1050), "Cast": range(1000, 1032)}  # seeds that learning evaluates
TOGETHER = {"Swing": 64, "Cast": 16}  # members that learn
DT, REPEAT = 0.02, 3  # s of a step, and steps for which a learned policy holds its action
LEARNING: dict[str, Any] = {"n_steps": 128, "batch_size": 2048, "n_epochs": 6, "gamma": 0.99}
SWINGING = 0.004  # of Swing's reward, in units of a whole reach, that is added to Cast's reward while learning
LEARNING |= {"learning_rate": 6e-4, "ent_coef": 0.01}


class RandomPolicy:
    """Actions drawn from the action space."""

    def __init__(self, env: Any) -> None:
        self.space = env.action_space

    def __call__(self, seen: Any) -> Any:
        return self.space.sample()


class Encouraged(gymnasium.vector.VectorWrapper):  # type: ignore[type-arg]
    """Members of Cast with an additional reward for swinging: random actions almost never produce a cast."""

    def step(self, actions: Any) -> Any:
        """Take an interval."""
        seen, rewards, *rest = self.env.step(actions)
        members = self.unwrapped
        far = members.world.places()[:, -1, 0] - members.arm.pivot[0]  # type: ignore[attr-defined]
        reach = members.arm.length + members.model.total_length  # type: ignore[attr-defined]
        return seen, rewards + SWINGING * np.abs(far) / reach, *rest


SCRIPTED: dict[str, dict[str, Callable[[Any], Any]]] = {
    "Swing": {"random": RandomPolicy, "crossing": CrossingPolicy, "pumping": PumpingPolicy},
    "Cast": {
        "random": RandomPolicy,
        "pumping": PumpingPolicy,
        "planned": functools.partial(PlannedCast, tries=2, time_budget=PLANNING, threads=1),
    },
}
BEST = "pumping"  # of the scripted policies of Swing


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--learn", nargs=2, metavar=("NAME", "SEED"), help="Swing or Cast, and the seed of learning")
    parser.add_argument("--only", choices=sorted(SCRIPTED), help="scores of one environment alone")
    parser.add_argument("--out", default=str(RESULTS), help="folder, or - for none")
    options = parser.parse_args()
    log = None if options.out == "-" else Path(options.out) / "gym.jsonl"
    rows = lines.read(log)

    def keep(row: lines.Row) -> None:
        rows.append(row)
        print(row, flush=True)
        if log is not None:
            lines.append(log, row)

    seeds = range(options.first, options.first + options.seeds)
    if options.learn:
        learn(options.learn[0], int(options.learn[1]), seeds, rows, keep)
        return
    time.monotonic = time.process_time  # the planner's clock
    for name in [options.only] if options.only else SCRIPTED:
        for policy, make in SCRIPTED[name].items():
            score(name, policy, make, seeds, rows, keep)
    if options.only:
        return
    page = f"# Environments: speed and scores\n\n{text(rows, speed())}\n\n{machine.sentence(machine.describe())}\n"
    print(page)
    if log is not None:
        files.write_text(log.with_name("gym.md"), page)


def score(
    name: str,
    policy: str,
    make: Callable[[Any], Any],
    seeds: range,
    rows: list[lines.Row],
    keep: Callable[[lines.Row], None],
) -> Scores:
    """Play the remaining seeds."""
    known = {row["seed"]: row for row in rows if (row.get("name"), row.get("policy")) == (name, policy)}
    for seed in seeds:
        if seed not in known:
            found = score_policy(make, f"hyperflex/{name}-v0", seeds=[seed])
            row = {"name": name, "policy": policy, "seed": seed, "return": found.mean}
            known[seed] = row | {"success": bool(found.successes[0])}
            keep(known[seed])
    return scores_of([known[seed] for seed in seeds])


def scores_of(rows: list[lines.Row]) -> Scores:
    """Scores of rows."""
    return Scores(np.array([row["return"] for row in rows]), np.array([row["success"] for row in rows]))


def learn(name: str, seed: int, seeds: range, rows: list[lines.Row], keep: Callable[[lines.Row], None]) -> None:
    """Train by PPO until the return is PART of the best scripted policy's or the time is over; score the best."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)
    environment = f"hyperflex/{name}-v0"
    best = "pumping" if name == "Swing" else "planned"
    scripted = [row["return"] for row in rows if (row.get("name"), row.get("policy")) == (name, best)]
    aim = SURE * PART * float(np.mean(scripted)) if scripted else np.inf
    given = {"dt": REPEAT * DT, "max_episode_steps": gymnasium.spec(environment).max_episode_steps // REPEAT}
    envs = gymnasium.make_vec(environment, num_envs=TOGETHER[name], autoreset_mode="SameStep", **given)
    envs = Encouraged(envs) if name == "Cast" else envs
    model = PPO("MlpPolicy", stable_baselines_env(envs), seed=seed, device="cpu", **LEARNING)
    begin, clock, looks = time.process_time(), time.perf_counter(), [0.0]

    class Looking(BaseCallback):  # type: ignore[misc]
        """Ends learning."""

        reached, kept = -np.inf, model.policy.state_dict()

        def _on_step(self) -> bool:
            return self.reached < aim and time.process_time() - begin < LIMIT

        def _on_rollout_end(self) -> None:
            if time.process_time() - begin > looks[-1] + EVERY[name]:
                found = play(model, environment, TRIED[name]).mean
                looks.append(time.process_time() - begin)
                print(f"{name} {seed}: {self.num_timesteps} steps, {looks[-1]:.0f} s, {found:.1f}", flush=True)
                if found > self.reached:
                    self.reached, self.kept = found, copy.deepcopy(model.policy.state_dict())

    model.learn(1_000_000_000, callback=(looking := Looking()))
    model.policy.load_state_dict(looking.kept)
    spent = {"seconds": time.process_time() - begin, "clock": time.perf_counter() - clock}
    policy = f"PPO, seed {seed}"
    keep({"name": name, "learned": policy, "steps": looking.num_timesteps, **spent})
    scores = play(model, environment, seeds)
    for each, total, success in zip(seeds, scores.returns, scores.successes, strict=True):
        row = {"name": name, "policy": policy, "seed": each}
        keep(row | {"return": float(total), "success": bool(success)})


def play(model: Any, environment: str, seeds: range) -> Scores:
    """Scores of a learned policy, all episodes in one batch: members equal single environments to the bit.

    An action is held for REPEAT steps.
    """
    envs = gymnasium.make_vec(environment, num_envs=len(seeds), autoreset_mode="Disabled")
    seen, _ = envs.reset(seed=seeds[0])
    total, success, actions = np.zeros(len(seeds)), np.zeros(len(seeds), dtype=bool), None
    going, count = ~success, 0
    while going.any():
        actions, count = actions if count % REPEAT else model.predict(seen, deterministic=True)[0], count + 1
        seen, reward, terminated, truncated, info = envs.step(actions)
        total, ended = total + going * reward, terminated | truncated
        success |= going & info.get("is_success", success)
        going &= ~ended
        if ended.any():
            seen, _ = envs.reset(options={"reset_mask": ended})
    return Scores(total, success)


def speed() -> tuple[float, float, float]:
    """Median, least and most steps per elapsed second of many members."""
    envs = gymnasium.make_vec("hyperflex/Swing-v0", num_envs=MEMBERS)
    envs.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, MEMBERS, 1))
    rates = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        for each in actions:
            envs.step(each)
        rates.append(STEPS * MEMBERS / (time.perf_counter() - begin))
    return statistics.median(rates), min(rates), max(rates)


def text(rows: list[lines.Row], rate: tuple[float, float, float]) -> str:
    """Results as Markdown."""
    titles = ("environment", "policy", "episodes", "return (95 %)", "of the best scripted", "successes", "learned in")
    found = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|"]
    for name, each in SCRIPTED.items():
        learned = {row["learned"]: row for row in rows if row.get("name") == name and "learned" in row}
        played = {
            policy: [row for row in rows if (row.get("name"), row.get("policy")) == (name, policy)]
            for policy in (*each, *sorted(learned))
        }
        every = {policy: scores_of(some) for policy, some in played.items() if some}
        best = max(every[policy].mean for policy in each if policy in every)
        for policy, scores in every.items():
            low, high = scores.interval
            spent = learned.get(policy)
            told = f"{spent['seconds']:.0f} s, {spent['steps']:,} steps" if spent else ""
            part = scores.mean / best
            won = f"{scores.successes.sum()} of {scores.returns.size}" if name == "Cast" else ""
            cells = [
                name,
                policy,
                str(scores.returns.size),
                f"{scores.mean:.4g} ({low:.4g} to {high:.4g})",
                f"{part:.0%}",
                won,
                told,
            ]
            found.append(f"| {' | '.join(cells)} |")
    many = TOGETHER
    return "\n".join(found) + (
        f"\n\nEpisodes have the seeds 0 to 199, or as many of them as stated. {MEMBERS} members of Swing (20 links, 50 "
        f"Hz) take {rate[0]:,.0f} steps per elapsed second ({rate[1]:,.0f} to {rate[2]:,.0f}); the goal is {AIM:,.0f}. "
        f"Learned: PPO of Stable-Baselines3 on {many['Swing']} members (Cast: {many['Cast']}, with a small additional "
        "reward for swinging, because random actions almost never produce a cast), until its return on other seeds is "
        f"{SURE * PART:.0%} of the best scripted policy's (goal: {PART:.0%}), or after {LIMIT:.0f} s of processor time "
        "(all threads). `crossing` is the paper's rule, `pumping` predicts with the model (without a target), "
        f"`planned` simulates the plan that `plan_cast` finds in {PLANNING:g} s of processor time, at most twice, and "
        "carries it out. All policies observe the true state; the true rope is that of the model."
    )


if __name__ == "__main__":
    main()
