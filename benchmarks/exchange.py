"""Exchange files: do MuJoCo's models of random ropes hold their numbers and move alike?

python benchmarks/exchange.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

import hyperflex as hf  # noqa: E402
from tests.exchange import mujoco_ropes  # noqa: E402


def mjcf(path: Path) -> None:
    """Twenty ropes: the greatest relative error of masses and inertias, and the distance of the tips after 2 s."""
    numbers, tips = [], []
    for index, links in enumerate([1, 2, 3, 100, *np.random.default_rng(0).integers(4, 100, 16).tolist()]):
        setup = mujoco_ropes.draw(index, links)
        hf.write_mjcf(setup, path)
        model, _ = mujoco_ropes.load(path)
        bodies = [model.body(f"link{k}").id for k in range(links)]
        got = np.array([model.body_mass[bodies], model.body_inertia[bodies, 1]])
        wanted = np.array([setup.rope.mass, setup.rope.inertia])
        numbers.append(float(np.abs(got / wanted - 1.0).max()))
        tips.append(float(np.hypot(*(mujoco_ropes.tip(setup, path) - hf.simulate(setup).tip[-1]))))
    print(f"MJCF: {len(tips)} ropes, masses and inertias within {max(numbers):.1e};", end=" ")
    print(
        f"tips after {mujoco_ropes.DURATION:g} s within {1e3 * max(tips):.2g} mm, median {1e3 * np.median(tips):.1e} mm"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        mjcf(Path(folder) / "rope.xml")
