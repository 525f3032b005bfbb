"""Exchange files: MuJoCo models of random ropes, and the cost of a million messages.

python benchmarks/exchange.py
"""

import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

import hyperflex as hf  # noqa: E402
from tests.exchange import bags, mujoco_ropes  # noqa: E402

MESSAGES = 1_000_000


def mjcf(path: Path) -> None:
    """Greatest relative error of masses and inertias of twenty ropes, and the distance between the tips after 2 s."""
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


def angles() -> tuple[np.ndarray, np.ndarray]:
    """Stamps, ns, and angles of three links."""
    rng = np.random.default_rng(0)
    return np.cumsum(rng.integers(500_000, 1_500_000, MESSAGES)), np.cumsum(
        rng.normal(size=(MESSAGES, 3)) * 1e-3, axis=0
    )


def cost(name: str, work: Callable[[Path], object], path: Path) -> None:
    """Processor time and peak memory of a separate process."""

    def measured() -> None:
        begin = time.process_time()
        work(path)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"{name}: {time.process_time() - begin:.1f} s of processor time, {peak:.0f} MB at most")

    process = multiprocessing.get_context("fork").Process(target=measured)
    process.start()
    process.join()


def write_mcap(path: Path) -> None:
    stamps, values = angles()
    hf.write_mcap(hf.Recording((stamps - stamps[0]) / 1e9, values), path)


def write_bag(path: Path) -> None:
    stamps, values = angles()
    names = ["a", "b", "c"]
    rows = ((int(t), bags.joint_state(int(t), names, x)) for t, x in zip(stamps, values, strict=True))
    bags.write(path, {"/joint_states": (bags.JOINT_STATE, rows)})


def read(path: Path) -> None:
    stamps, values = angles()
    got = hf.read_recording(path, angles="absolute")
    assert np.array_equal(got.data, values)
    assert np.array_equal(got.t, (stamps - stamps[0]) / 1e9)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        cost("MCAP, a million messages written", write_mcap, Path(folder) / "a.mcap")
        cost("MCAP, a million messages read", read, Path(folder) / "a.mcap")
        cost("(the bag written by rosbags)", write_bag, Path(folder) / "bag")
        cost("ROS 2 bag, a million messages read", read, Path(folder) / "bag")
        mjcf(Path(folder) / "rope.xml")
