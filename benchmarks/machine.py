"""The machine and the versions of a measurement, and the installed peers.

Each module peers_*.py drives one simulator and has ``NAME``, ``ARM`` (how its arm is driven; ``DRIVE``: in
a few words) and ``contestants``.
"""

import argparse
import importlib
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

import hyperflex
from hyperflex.core.cache import SOURCE_HASH

PACKAGES = ("numba", "numpy", "scipy", "mujoco", "pin", "drake")

MODULES = {"hyperflex": "numba", "scipy": "scipy", "mujoco": "mujoco", "pinocchio": "pinocchio", "drake": "pydrake"}
INSTALL = {"mujoco": "pip install mujoco", "pinocchio": "pip install pin", "drake": "pip install drake"}


def describe() -> dict[str, str]:
    """Processor, cores, load and versions; packages that are not installed are omitted."""
    about = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "load before": load(),
        "system": platform.system(),
        "python": platform.python_version(),
        "hyperflex": hyperflex.__version__,
        "kernels' hash": SOURCE_HASH,
    }
    for name in PACKAGES:
        try:
            about[name] = version(name)
        except PackageNotFoundError:
            continue
    return about


def seeded(text: str | None, seed: int) -> tuple[int, dict[str, str]]:
    """Return the seed from a command line with the help `text` (default `seed`), and the result of :func:`describe`."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=seed)
    return parser.parse_args().seed, describe()


def sentence(about: dict[str, str]) -> str:
    """Machine and versions in one sentence of Markdown."""
    return f"Machine: {', '.join(f'{name} {value}' for name, value in about.items())}. Load: threads busy."


def load() -> str:
    """Mean number of busy threads of all programs over the last minute."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def installed(wanted: list[str]) -> tuple[dict[str, ModuleType], dict[str, str]]:
    """Import the modules of the named peers, with the install command of missing ones."""
    found, missing = {}, {}
    for name in wanted:
        try:
            importlib.import_module(MODULES[name])
        except ImportError as error:
            missing[name] = f"{error}; {INSTALL.get(name, '')}"
            continue
        found[name] = importlib.import_module(f"peers_{name}")
    return found, missing


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()
