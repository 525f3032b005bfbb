"""Waiting time before the first result: imports, compilation cold and cached, the command line."""

import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from cast import paper_cast

import hyperflex
from hyperflex.model import Setup

# Numba's own cache in place of hyperflex.core.compiler: every kernel is optimised and kept separately
NUMBA_ALONE = """
import numba
from hyperflex.core import jit
def alone(function, counts=True, more=frozenset(), **how):
    return numba.njit(cache=True, error_model="numpy", fastmath=jit._FASTMATH | more, nogil=True, **how)(function)
jit._compiled = alone
"""
FIRST_CALL = """
import json, time
begin = time.perf_counter()
import hyperflex as hf
imported = time.perf_counter()
rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
motion, arm = hf.arm_swings(t_move=0.73, t_rest=0.53), hf.Arm(length=0.105)
hf.simulate(rope, motion, arm=arm, duration=10.0)
first, spent = time.perf_counter(), time.process_time()
hf.simulate(rope, motion, arm=arm, duration=10.0)
second = time.perf_counter()
hf.simulate_batch([rope] * 64, motion, arm=arm, duration=2.0)
print(json.dumps([imported - begin, first - imported, spent, second - first, time.perf_counter() - second]))
"""
IMPORTS = {"mujoco": "mujoco", "pinocchio": "pinocchio", "drake": "pydrake.all"}


def measure(quick: bool, repeats: int, peers: dict[str, ModuleType]) -> list[dict[str, Any]]:
    """Rows of {what, seconds: [...]}; `quick` omits the cold start."""
    rounds = 1 if quick else max(3, repeats)
    with tempfile.TemporaryDirectory(prefix="hyperflex-bench-") as folder:
        cache = {} if quick else {"HYPERFLEX_CACHE_DIR": folder}
        cold = [] if quick else [_first_call(cache)]
        _first_call(cache)
        cached = [_first_call(cache) for _ in range(rounds)]
        alone = [] if quick else [_first_call({"NUMBA_CACHE_DIR": f"{folder}/numba"}, NUMBA_ALONE) for _ in range(2)]
        rows = [
            *_rows("nothing compiled yet", cold),
            *_rows("numba's own cache, nothing compiled yet", alone[:1]),
            *_rows("numba's own cache, filled", alone[1:]),
            *_rows("kernels in the cache", cached),
        ]
        if importlib.util.find_spec("typer"):
            rows.append(
                {"what": "hyperflex simulate, kernels in the cache: whole command", "seconds": _commands(cache, rounds)}
            )
    for name, module in IMPORTS.items():
        if name in peers:
            seconds = [_run([sys.executable, "-c", f"import {module}"], {})[0] for _ in range(rounds)]
            rows.append({"what": f"{name}: process that imports it", "seconds": seconds})
    return rows


def _rows(state: str, calls: Sequence[tuple[float, ...]]) -> list[dict[str, Any]]:
    parts = (
        "import hyperflex",
        "first simulate, 10 s of casting",
        "processor time until then",
        "second simulate",
        "first simulate_batch, 64 members, 2 s",
        "whole process",
    )
    return [
        {"what": f"{state}: {part}", "seconds": list(values)}
        for part, values in zip(parts, zip(*calls, strict=True), strict=False)
    ]


def _first_call(environment: dict[str, str], before: str = "") -> tuple[float, ...]:
    """Seconds for import, first and second call, and for the whole process; `before` is code to run first."""
    seconds, output = _run([sys.executable, "-c", before + FIRST_CALL], environment)
    return (*json.loads(output), seconds)


def _commands(environment: dict[str, str], rounds: int) -> list[float]:
    """Seconds of ``hyperflex simulate`` on the paper's cast, including its NetCDF file; the first one is omitted."""
    cast = paper_cast()
    program = "from hyperflex.cli import main; main()"
    with tempfile.TemporaryDirectory(prefix="hyperflex-bench-") as folder:
        setup, out = Path(folder) / "cast.toml", Path(folder) / "cast.nc"
        Setup(cast.rope, cast.motion, cast.arm, duration=cast.duration).to_toml(setup)
        command = [sys.executable, "-c", program, "simulate", str(setup), "-o", str(out)]
        return [_run(command, environment)[0] for _ in range(rounds + 1)][1:]


def _run(command: list[str], environment: dict[str, str]) -> tuple[float, str]:
    """Elapsed seconds of a process, and its output."""
    source = str(Path(hyperflex.__file__).parents[1])
    path = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH")]))
    surroundings = {**os.environ, "PYTHONPATH": path, **environment}
    surroundings.pop("PYTHONDONTWRITEBYTECODE", None)  # keep bytecode, as pip does for an installation
    begin = time.perf_counter()
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True)
    return time.perf_counter() - begin, done.stdout


def text(rows: list[dict[str, Any]], _peers: dict[str, ModuleType]) -> str:
    """Return the Markdown table."""
    lines = ["| what | seconds, median (least-most) |", "|---|---|"]
    for row in rows:
        seconds = row["seconds"]
        spread = f"{statistics.median(seconds):.3g} ({min(seconds):.3g}-{max(seconds):.3g})"
        lines.append(f"| {row['what']} | {spread} |")
    return "\n".join(lines) + (
        "\n\nWaiting times of a user: elapsed seconds in fresh processes. Nothing compiled: HYPERFLEX_CACHE_DIR was an "
        "empty folder (one run); cached: the same folder afterwards. Numba's own cache: `cache=True` in place of "
        "hyperflex.core.compiler, which translates a kernel once, links it into its callers, and makes machine code "
        "only of what Python calls. `simulate` computes the paper's cast with 1001 outputs; the whole command also "
        "reads a TOML file and writes a NetCDF file."
    )
