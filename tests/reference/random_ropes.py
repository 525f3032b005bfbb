"""Random ropes of every kind that a user may bring, each from a seed and a number, for the sweep and for the tests."""

from typing import Any, NamedTuple

import numpy as np

import hyperflex as hf

Random = np.random.Generator

PAPER_DAMPING = 5e-4 / (2.5e-3 * 0.04**2)  # 1/s, eta / (m l^2) of the paper's cable
TOLERANCES = (1e-7, 1e-4)  # m
WILDEST = 30.0  # rad/s


class Case(NamedTuple):
    """One random rope with all that a run needs."""

    number: int
    setup: hf.Setup
    kind: dict[str, Any]  # what was drawn, in words and numbers
    ordinary: bool  # up to 100 links, all damped within two decades of the paper's cable: it must not fail


def draw(seed: int, number: int, most_links: int = 300) -> Case:
    """Return case `number` of the sweep that begins with `seed`; the same for ever."""
    rng = np.random.default_rng([seed, number])
    rope, about_rope = random_rope(rng, most_links)
    q0, qd0, about_start = random_start(rng, rope.n_links)
    drive, about_drive = random_drive(rng, rope)
    tol = log_uniform(rng, *TOLERANCES)
    duration = float(rng.uniform(1.0, 5.0))
    setup = hf.Setup(rope, q0=q0, qd0=qd0, tol=tol, duration=duration, **drive)
    kind = {"links": rope.n_links, "tol": tol, "duration": duration, **about_rope, **about_start, **about_drive}
    damping = rope.friction / (rope.mass * rope.length**2) / PAPER_DAMPING
    ordinary = rope.n_links <= 100 and damping.min() >= 1e-2 and damping.max() <= 1e2
    return Case(number, setup, kind, bool(ordinary))


def draw_stuck(seed: int, number: int, most_links: int = 300) -> Case:
    """Return a randomly bent rope at rest, whose dry friction is 1.05 to 3 times the moment of its weight."""
    rng = np.random.default_rng([seed, number, 1])
    rope, about = random_rope(rng, most_links)
    n = rope.n_links
    q0 = rng.uniform(-np.pi, np.pi) + np.cumsum(rng.normal(0.0, 2.0 / np.sqrt(n), n))
    beyond = np.append(np.cumsum((rope.mass[1:])[::-1])[::-1], 0.0) + rope.tip_mass
    across = np.stack([np.cos(q0), np.sin(q0)], axis=1)
    weight = (rope.mass * rope.com + rope.length * beyond) * (across @ rope.gravity)
    borne = np.abs(np.cumsum(weight[::-1])[::-1])  # by each joint, for all that hangs from it
    bears = float(rng.uniform(1.05, 3.0))
    rope = rope.replace(dry_friction=bears * borne + 1e-12, stiffness=0.0, friction_model="relative")
    kind = {"links": n, **about, "bears": bears}
    return Case(number, hf.Setup(rope, q0=q0, duration=10.0), kind, ordinary=False)


def log_uniform(rng: Random, low: float, high: float) -> float:
    """Return a number between `low` and `high` whose logarithm is evenly distributed."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def taper(rng: Random, n: int, least: float) -> Any:
    """Factors (n,) along the rope, mean 1: even, falling or rising by up to 1 / `least`, or every link by chance."""
    kind = rng.choice(["even", "falling", "rising", "scattered"], p=[0.4, 0.3, 0.1, 0.2])
    if kind == "even":
        return np.ones(n)
    if kind == "scattered":
        factors = np.exp(rng.uniform(np.log(np.sqrt(least)), 0.0, n))
    else:
        factors = np.geomspace(1.0, log_uniform(rng, least, 1.0), n)[:: 1 if kind == "falling" else -1]
    return factors / factors.mean()


def random_rope(rng: Random, most_links: int) -> tuple[hf.Rope, dict[str, Any]]:
    """A rope of 1 to `most_links` links, 0.2 to 5 m, 10 g to 2 kg, eta 0 to 5e-2 N m s/rad."""
    n = int(log_uniform(rng, 1.0, most_links + 1.0))
    length, mass = log_uniform(rng, 0.2, 5.0), log_uniform(rng, 0.01, 2.0)
    lengths = length / n * taper(rng, n, 0.1)
    masses = mass / n * taper(rng, n, 0.01)
    weight = 9.81 * mass * length
    eta = 0.0 if rng.random() < 0.15 else log_uniform(rng, 1e-7, 5e-2)
    tip = 0.0 if rng.random() < 0.3 else mass * log_uniform(rng, 1e-3, 1e1)
    stiffness = log_uniform(rng, 1e-4, 1e1) * weight if rng.random() < 0.25 else 0.0
    dry = log_uniform(rng, 1e-5, 3e-2) * weight if rng.random() < 0.2 else 0.0
    rope = hf.Rope(
        length=lengths,
        mass=masses,
        radius=float(rng.choice([0.0, 0.0025, 0.01])),
        friction=eta * taper(rng, n, 0.1),
        stiffness=stiffness * taper(rng, n, 0.1),
        rest_angle=rng.normal(0.0, 1.0, n) / np.sqrt(n) if rng.random() < 0.5 else 0.0,
        dry_friction=dry * taper(rng, n, 0.1),
        tip_mass=tip,
        friction_model=str(rng.choice(["relative", "printed"], p=[0.8, 0.2])),
    )
    about = {"length": length, "mass": mass, "eta": eta, "tip_mass": tip, "stiffness": stiffness, "dry": dry}
    return rope, {**about, "friction_model": rope.friction_model}


def random_start(rng: Random, n: int) -> tuple[Any, Any, dict[str, Any]]:
    """Angles and rates (n,): hanging, straight, wound or crumpled; still, turning or trembling up to WILDEST."""
    posture = str(rng.choice(["hanging", "straight", "wound", "crumpled"], p=[0.2, 0.4, 0.3, 0.1]))
    q0 = {
        "hanging": np.zeros(n),
        "straight": np.full(n, rng.uniform(-np.pi, np.pi)),
        "wound": rng.uniform(-np.pi, np.pi) + np.cumsum(rng.normal(0.0, 2.0 / np.sqrt(n), n)),
        "crumpled": rng.uniform(-np.pi, np.pi, n),
    }[posture]
    speed = log_uniform(rng, 0.1, WILDEST)
    rates = str(rng.choice(["still", "turning", "waving", "trembling"], p=[0.3, 0.3, 0.2, 0.2]))
    qd0 = {
        "still": np.zeros(n),
        "turning": np.full(n, speed * rng.choice([-1.0, 1.0])),
        "waving": speed * np.cumsum(rng.normal(0.0, 1.0 / np.sqrt(n), n)),
        "trembling": speed * rng.uniform(-1.0, 1.0, n),
    }[rates]
    return q0, qd0, {"posture": posture, "rates": rates, "speed": 0.0 if rates == "still" else speed}


def random_drive(rng: Random, rope: hf.Rope) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arguments of Setup that move the rope: nothing, swings, one move, a shaken point, or a torque on the arm."""
    kind = str(rng.choice(["fixed", "swings", "move", "point", "torque"], p=[0.3, 0.35, 0.1, 0.1, 0.15]))
    profile = str(rng.choice(["bang-bang", "ramp", "minimum-jerk"]))
    arm_length = log_uniform(rng, 0.02, 0.5)
    drive: dict[str, Any] = {}
    if kind == "swings":
        path = str(rng.choice(["under", "over"]))
        drive["motion"] = hf.arm_swings(rng.uniform(0.3, 1.0), rng.uniform(0.0, 0.8), profile, path)
    elif kind == "move":
        drive["motion"] = hf.move_arm(0.0, rng.uniform(-6.0, 6.0), rng.uniform(0.1, 1.0), profile)
    elif kind == "point":
        t = np.linspace(0.0, 5.0, 26)
        size = 0.1 * rope.total_length
        drive["motion"] = hf.moving_pivot(t, *(size * rng.uniform(-1.0, 1.0, (2, 26))))
    elif kind == "torque":
        most = log_uniform(rng, 1e-2, 1.0) * 9.81 * rope.total_mass * arm_length
        drive["torque"] = hf.torque_profile(np.linspace(0.0, 5.0, 11), most * rng.uniform(-1.0, 1.0, 11))
        inertia = rope.total_mass * arm_length**2 * log_uniform(rng, 1e-2, 1e1)
        drive |= {"arm_angle0": rng.uniform(-1.0, 1.0), "arm_rate0": rng.normal(0.0, 2.0)}
        drive["arm"] = hf.Arm(arm_length, inertia, friction=float(rng.choice([0.0, 1e-3])))
    if kind in ("swings", "move"):
        drive["arm"] = hf.Arm(arm_length)
    return drive, {"drive": kind}
