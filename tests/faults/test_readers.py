"""Damaged files of every kind: bytes altered, cut, repeated, added. They are refused by name, or read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hyperflex as hf
from hyperflex.planning.uncertainty import RopePosterior
from hyperflex.vision import Camera, read_camera
from tests.exchange import bags
from tests.faults.bounds import apart, examples, refused_or_done

T = np.linspace(0.0, 0.5, 6)
ROPE = hf.Rope(length=[0.3, 0.3], mass=[0.1, 0.1], friction=1e-4, radius=0.002)
SETUP = hf.Setup(ROPE, hf.arm_swings(), hf.Arm(length=0.1), duration=0.02, pegs=[hf.Peg(0.5, -0.9, 0.05)])
MUJOCO = hf.Setup(ROPE, hf.arm_swings(), hf.Arm(length=0.1), duration=0.02)
CSV = "# time_unit: s\n# unit: deg\nframe,t,th1,th2\n" + "".join(
    f"{k},{t:.3f},{30 * np.cos(t):.4f},{'' if k == 2 else k}\n" for k, t in enumerate(T)
)


def of_file(write: Callable[[Path], object], suffix: str) -> Callable[[Path], bytes]:
    """Return what makes the bytes of a sound file."""

    def content(folder: Path) -> bytes:
        path = folder / f"sound{suffix}"
        write(path)
        return path.read_bytes()

    return content


def mat(path: Path, *, packed: bool = True) -> None:
    from scipy.io import savemat

    def cell(values: np.ndarray) -> np.ndarray:
        held = np.empty((1, 1), dtype=object)
        held[0, 0] = values
        return held

    t, states = np.linspace(0.0, 0.1, 11)[None], np.zeros((2, 11))
    pieces = {"Time_id": t, "Y_id": states, "Time_vad": t + 0.11, "Y_vad": states}
    savemat(path, {name: cell(values) for name, values in pieces.items()} | {"dt": 0.01}, do_compression=packed)


def camera(path: Path) -> None:
    Camera((640, 480), np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]), np.zeros(5)).write(path)


KINDS: dict[str, tuple[Callable[[Path], bytes], str, Callable[[Path], object]]] = {
    "recording.csv": (lambda _: CSV.encode(), ".csv", hf.read_recording),
    "recording.nc": (of_file(hf.Recording(T, np.zeros((6, 2))).to_netcdf, ".nc"), ".nc", hf.read_recording),
    "recording.mat": (of_file(mat, ".mat"), ".mat", hf.read_recording),
    "plain.mat": (of_file(lambda path: mat(path, packed=False), ".mat"), ".mat", hf.read_recording),
    "recording.mcap": (
        of_file(lambda path: hf.write_mcap(hf.Recording(T, np.zeros((6, 2)), noise=0.1), path), ".mcap"),
        ".mcap",
        hf.read_recording,
    ),
    "bag.db3": (bags.content_of("sqlite3"), ".db3", hf.read_recording),
    "bag.mcap": (bags.content_of("mcap"), ".mcap", hf.read_recording),
    "bag.yaml": (bags.metadata, ".yaml", lambda path: hf.read_recording(bags.described(path))),
    "setup.xml": (of_file(lambda path: hf.write_mjcf(MUJOCO, path), ".xml"), ".xml", hf.read_mjcf),
    "motion.csv": (lambda _: b"t,angle\n0,0.0\n0.5,0.1\n1,0.2\n", ".csv", hf.read_motion),
    "setup.toml": (lambda _: SETUP.dumps().encode(), ".toml", hf.Setup.from_toml),
    "rope.toml": (of_file(ROPE.to_toml, ".toml"), ".toml", hf.Rope.from_toml),
    "posterior.toml": (
        lambda _: (
            b'[rope]\nlength = [0.3]\nmass = [0.1]\n[identification]\nparameters = ["friction:factor"]\n'
            b'covariance = [[0.1]]\nvalues = {"friction:factor" = 1.0}\n'
        ),
        ".toml",
        RopePosterior.from_toml,
    ),
    "camera.toml": (of_file(camera, ".toml"), ".toml", read_camera),
    "trajectory.nc": (
        of_file(lambda path: hf.simulate(ROPE, duration=0.02).to_netcdf(path), ".nc"),
        ".nc",
        hf.read_trajectory,
    ),
}

PLACE = st.floats(0.0, 1.0, exclude_max=True)
CHANGE = st.one_of(
    st.tuples(st.just("flip"), PLACE, st.integers(0, 7)),
    st.tuples(st.just("set"), PLACE, st.integers(0, 255)),
    st.tuples(st.just("zero"), PLACE, st.integers(1, 200)),
    st.tuples(st.just("cut"), PLACE, st.none()),
    st.tuples(st.just("drop"), PLACE, st.integers(1, 40)),
    st.tuples(st.just("repeat"), PLACE, st.integers(1, 200)),
    st.tuples(st.just("insert"), PLACE, st.binary(min_size=1, max_size=20)),
    st.tuples(
        st.just("insert"),
        PLACE,
        st.sampled_from(
            [b"nan", b"1e999", b"-", b"[", b"]" * 9, b"{", b'"', b"\n", b"9" * 5000, b",", b"=", b"\0", b"."]
        ),
    ),
    st.tuples(st.just("insert"), PLACE, st.sampled_from([b"[" * 3000, b"{a=" * 3000, b"a." * 30_000, b"1_0", b"\xff"])),
)


def changed(content: bytes, changes: list[tuple[str, float, Any]]) -> bytes:
    data = bytearray(content)
    for what, part, value in changes:
        k = int(part * len(data))
        if what == "flip" and data:
            data[k] ^= 1 << value
        elif what == "set" and data:
            data[k] = value
        elif what == "zero":
            data[k : k + value] = bytes(len(data[k : k + value]))
        elif what == "cut":
            del data[k:]
        elif what == "drop":
            del data[k : k + value]
        elif what == "repeat":
            data[k:k] = data[k : k + value] * 3
        elif what == "insert":
            data[k:k] = value
    return bytes(data)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[bytes, Path]]:
    """The bytes of each kind of valid file, made once, and the folder of its variants."""
    folder, made = tmp_path_factory.mktemp("files"), {}

    def get(kind: str) -> tuple[bytes, Path]:
        make, suffix, _ = KINDS[kind]
        if kind not in made:
            made[kind] = make(folder)
        return made[kind], folder / f"damaged{suffix}"

    return get


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_reported_or_harmless(kind, sound):
    content, path = sound(kind)
    read = KINDS[kind][2]
    path.write_bytes(content)
    assert read(path) is not None

    @examples(15 if kind.endswith((".mcap", ".db3", ".yaml", ".xml")) else 8)
    @given(st.lists(CHANGE, min_size=1, max_size=3))
    def damage(changes):
        path.write_bytes(changed(content, changes))
        refused_or_done(lambda: read(path))

    apart(damage)
