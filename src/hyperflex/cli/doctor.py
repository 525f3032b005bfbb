"""``hyperflex doctor``: whether packages, kernels, folders and on demand a camera are sound, and how fast runs are."""

import importlib.metadata
import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from hyperflex import __version__, vision
from hyperflex.cli import output
from hyperflex.cli.output import Rows
from hyperflex.cli.warm import every_kernel, unwritable
from hyperflex.errors import HyperflexError

SPACE = 1e9  # bytes that should be free
LOOKS = 3  # timed runs; the best counts
WRONG = "wrong"  # what a needed thing is that does not work
DEVELOPERS = {"test", "lint", "docs", "bench", "dev", "all"}  # extras that a run does not use


@dataclass(frozen=True)
class Finding:
    """What was found of one thing: ``good``, ``missing`` (an extra, or kernels yet to be compiled) or ``wrong``."""

    name: str
    state: str
    found: str
    fix: str = ""


def doctor(
    source: Annotated[int | None, "Number of a camera, from 0, to take a picture with. [default: none]"] = None,
    no_speed: Annotated[bool, "Do not time a run."] = False,
) -> None:
    """Check the installation and measure its speed.

    The command checks packages, extras, compiled kernels and folders. It changes nothing, and opens no camera unless
    --source names it. The exit code is 2 if a required part fails.
    """
    found = [_interpreter(), *_packages(), _kernels(), *_folders()]
    if source is not None:
        found.append(_camera(source))
    speed = None if no_speed else _speed()
    if speed is not None:
        found.append(Finding("speed", "good", f"{speed:.3g} s of processor time for 1 s of a cable of 50 links"))
    wrong = [each.name for each in found if each.state == WRONG]
    result = {"version": __version__, "wrong": wrong, "processor_seconds_per_simulated_second": speed}
    output.show(
        result | {"findings": [asdict(each) for each in found]},
        Rows(
            f"{len(wrong)} wrong: {', '.join(wrong)}" if wrong else "Nothing is wrong",
            [(f"{each.state:<9}{each.name}", f"{each.found} {each.fix}") for each in found],
        ),
        code=output.ExitCode.REFUSED if wrong else 0,
    )


def _interpreter() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    machine = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, {cores} cores"
    return Finding("hyperflex", "good", f"{__version__} in {Path(__file__).parents[1]}; {machine}")


def _packages() -> Iterator[Finding]:
    """Yield what is found of the required packages, all in one, and of each extra."""
    try:
        requirements = importlib.metadata.requires("hyperflex") or []
    except importlib.metadata.PackageNotFoundError:
        yield Finding("packages", WRONG, "hyperflex is not installed, its folder alone is there.", "pip install it.")
        return
    packages: dict[str, dict[str, str]] = {}
    for each in requirements:
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", each)
        name = re.split(r"[\s\[<>=!~;]", each, maxsplit=1)[0]
        if name != "hyperflex":
            packages.setdefault(extra[1] if extra else "", {})[name] = _version(name)
    for group, versions in sorted(packages.items()):
        if group in DEVELOPERS:
            continue
        title, needed, state = f"extra {group}", f"'hyperflex[{group}]'", "missing"
        if not group:
            title, needed, state = "packages", "--force-reinstall hyperflex", WRONG
        if lacking := ", ".join(name for name, version in versions.items() if not version):
            yield Finding(title, state, f"without {lacking}.", f"pip install {needed} brings them.")
        else:
            yield Finding(title, "good", ", ".join(f"{name} {version}" for name, version in versions.items()))


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _kernels() -> Finding:
    import numba

    from hyperflex.core import cache

    if numba.config.DISABLE_JIT:
        return Finding("kernels", WRONG, "NUMBA_DISABLE_JIT is set: nothing is compiled, and runs take very long.")
    every, folder = every_kernel(), cache.folder()
    there = cache.compiled(every)
    if trouble := unwritable(folder):
        fix = "Without it kernels are compiled in every process: name another in HYPERFLEX_CACHE_DIR."
        return Finding("kernels", WRONG, f"{folder} cannot be written to ({trouble}).", fix)
    fix = "" if there else "hyperflex warm compiles them in advance."
    return Finding("kernels", "good" if there else "missing", f"{there} of {len(every)} compiled, in {folder}.", fix)


def _folders() -> Iterator[Finding]:
    for name, folder in (("this folder", Path.cwd()), ("temporary files", Path(tempfile.gettempdir()))):
        trouble, free = unwritable(folder), shutil.disk_usage(folder).free
        if trouble:
            yield Finding(name, WRONG, f"{folder} cannot be written to ({trouble}).", "Work in a folder of your own.")
        else:
            state, fix = (WRONG, "Make room: runs are large.") if free < SPACE else ("good", "")
            yield Finding(name, state, f"{folder}, {free / 1e9:.2g} GB free", fix)


def _camera(number: int) -> Finding:

    name = f"camera {number}"
    try:
        with vision.LiveCamera(number) as source:
            frame = next(iter(source))
            width, height = source.image_size
            shade = float(frame.image.mean())
            return Finding(name, "good", f"{width} x {height} px, times by its {source.stamps}, mean level {shade:.0f}")
    except HyperflexError as error:
        return Finding(name, WRONG, str(error))


def _speed() -> float:
    """Return the processor time that a second of the source paper's cable takes, s; the best of a few runs."""
    import hyperflex as hf

    cable, duration = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4), 2.0
    times = [time.process_time()]
    for _ in range(LOOKS + 1):  # the first may compile
        hf.simulate(cable, hf.arm_swings(), arm=hf.Arm(), duration=duration)
        times.append(time.process_time())
    return min(after - before for before, after in pairwise(times)) / duration
