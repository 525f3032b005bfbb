"""Random throws of the paper's cable at pegs, arm at rest: those of ``benchmarks/throws.py``, by their number."""

import math
from typing import Any

import numpy as np

import hyperflex as hf

LINKS, LENGTH, MASS, RADIUS = 50, 2.0, 0.125, 0.0025
ROOM = 0.03  # m, least distance from the pegs at the start


def draw(index: int, duration: float) -> tuple[str, hf.Rope, dict[str, Any]]:
    """A cable and how it is thrown: pegs, angles and rates at the start."""
    rng = np.random.default_rng([1, index])
    kind = "rubbed" if index % 2 == 0 else "free"
    if kind == "rubbed":
        friction = 10.0 ** rng.uniform(-4.0, math.log10(5e-3))
    else:
        friction = float(rng.choice([0.0, 10.0 ** rng.uniform(-6.0, -4.0)]))
    tip = float(rng.choice([0.0, 0.02]))
    rope = hf.Rope.uniform(LENGTH, MASS, LINKS, RADIUS, friction=friction, tip_mass=tip)
    mu, count = rng.uniform(0.0, 1.0), rng.integers(1, 4)
    angle, far, radius = rng.uniform(-1.5, 1.5, count), rng.uniform(0.3, 1.6, count), rng.uniform(0.02, 0.05, count)
    pegs = [
        hf.Peg(float(d * np.sin(a)), float(-d * np.cos(a)), float(r), float(mu))
        for a, d, r in zip(angle, far, radius, strict=True)
    ]
    along = np.linspace(0.0, 1.0, LINKS)
    while True:
        q0 = rng.uniform(-2.8, 2.8) + rng.normal() * along
        joints = np.cumsum(rope.length[:, None] * np.stack([np.sin(q0), -np.cos(q0)], axis=1), axis=0)
        if all(np.hypot(*(joints - [p.x, p.y]).T).min() > p.radius + RADIUS + ROOM for p in pegs):
            break
    qd0 = rng.normal(0.0, 3.0) + rng.normal(0.0, 5.0) * along
    return kind, rope, {"pegs": pegs, "q0": q0, "qd0": qd0, "duration": duration}
