"""``hyperflex warm``: compile all kernels in advance, in several processes."""

import contextlib
import importlib
import os
import pkgutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import Any

from hyperflex import checks
from hyperflex.cli import output
from hyperflex.cli.command import Workers
from hyperflex.errors import FileProblem, HyperflexError, MissingPackage
from hyperflex.progress import progress_bar

OLD = 90 * 86_400.0  # s, after which kernels of other versions are removed
POLL = 0.2  # s, between two checks of what has been compiled
COMMAND = (sys.executable, "-c", "import sys; from hyperflex.cli.warm import call; call(sys.argv[1:])")


def warm(
    workers: Workers = 2,
) -> None:
    """Compile all kernels in advance.

    This takes about 80 s of processor time, once for each version. Without it each kernel is compiled when it is first
    needed. Kernels of friction_model="printed", which only the paper's own figures use, are not compiled.

    The compiled kernels are in the user's cache folder, or in the folder named by HYPERFLEX_CACHE_DIR. Kernels of other
    versions are removed when they are 90 days old.
    """
    import numba

    from hyperflex.core import cache

    count = checks.count("--workers", workers, most=len(LANES))
    begin = time.monotonic()
    if numba.config.DISABLE_JIT:
        output.show({"kernels": 0, "compiled": 0}, "Nothing to do: NUMBA_DISABLE_JIT is set, nothing is compiled.")
        return
    kernels = every_kernel()
    before = cache.compiled(kernels)
    if why := unwritable(cache.folder()):
        fix = "HYPERFLEX_CACHE_DIR names another folder."
        raise FileProblem(f"Compiled kernels cannot be kept in {cache.folder()}: {why}. {fix}")
    spent = _compile(kernels, count)
    _remove_old(cache.folder())
    result = {
        "kernels": len(kernels),
        "compiled": cache.compiled(kernels) - before,
        "already_there": before,
        "seconds": time.monotonic() - begin,
        "processor_seconds": spent,
        "folder": cache.folder(),
    }
    done = f"Compiled {result['compiled']} of {len(kernels)} kernels"
    if not result["compiled"]:
        done = "Nothing to do: all kernels are compiled"
    output.show(result, f"{done} ({result['seconds']:.0f} s). They are in {cache.folder()}.")


@contextlib.contextmanager
def compiling_ahead(*names: str) -> Iterator[subprocess.Popen[str]]:
    """Let a second process compile the kernels of some calls (see `CALLS`) meanwhile."""
    with subprocess.Popen([*COMMAND, *names], stdin=DEVNULL, stdout=DEVNULL, stderr=PIPE, text=True) as worker:
        try:
            yield worker
        finally:
            worker.terminate()


def _remove_old(folder: Path) -> None:
    """Remove the kernels of other versions that are `OLD` s old; what cannot be removed stays."""
    from hyperflex.core import cache

    for place in folder.glob("kernels-*/"):
        kernels = [] if place == cache.kernels_folder() else list(place.glob("*.nbc"))
        with contextlib.suppress(OSError):
            if kernels and time.time() - max(path.stat().st_mtime for path in kernels) > OLD:
                for path in kernels:
                    path.unlink(missing_ok=True)
                place.rmdir()


def every_kernel() -> list[tuple[str, str]]:
    """Return module and name of every kernel."""
    from hyperflex import core
    from hyperflex.core.jit import KERNELS

    for each in pkgutil.walk_packages(core.__path__, f"{core.__name__}."):
        importlib.import_module(each.name)
    return KERNELS


def unwritable(folder: Path) -> str:
    """Return why nothing can be written in a folder, or in the first one above it that exists; empty if it can."""
    try:
        tempfile.TemporaryFile(dir=next(each for each in (folder, *folder.parents) if each.exists())).close()
    except OSError as error:
        return str(error.strerror)
    return ""


def _compile(kernels: list[tuple[str, str]], count: int) -> float:
    """Run the lanes in `count` processes, and return the processor time that they took, s."""
    from hyperflex.core import cache

    begin, lanes = _children_time(), [sum(LANES[k::count], ()) for k in range(count)]
    with contextlib.ExitStack() as stack:
        workers = [stack.enter_context(compiling_ahead(*lane)) for lane in lanes]
        with progress_bar(0.0, len(kernels), True, "compiling", "kernels") as report:
            while {worker.poll() for worker in workers} <= {None, 0} and any(each.poll() is None for each in workers):
                report(cache.compiled(kernels))  # type: ignore[misc]  # asked for
                time.sleep(POLL)
        for worker in workers:
            if worker.poll():
                said = worker.stderr.read().splitlines()  # type: ignore[union-attr]  # a pipe
                last = said[-1] if said else f"exit status {worker.returncode}"
                raise HyperflexError(f"a process that compiled kernels failed: {last}. Compiled kernels are kept.")
    return _children_time() - begin


def call(names: list[str]) -> None:
    """Make some of the calls that compile kernels, one after the other."""
    for name in names:
        with contextlib.suppress(MissingPackage):  # what an extra needs, and is not there
            CALLS[name]()


def _children_time() -> float:
    """Return the processor time of all processes that this one has waited for, s."""
    times = os.times()
    return times.children_user + times.children_system


def _simulate() -> None:
    hf, rope, how, _ = _parts()
    hf.sideways(hf.simulate(rope, **how))
    hf.simulate(rope, **how, step=1e-4)
    hf.simulate(rope, torque=lambda *_: 0.0, arm=hf.Arm(length=0.1, inertia=1e-3), duration=0.02, control_rate=100.0)
    hf.predictability(rope, **how | {"duration": 0.1})
    hf.forward_kinematics(rope, [0.0] * rope.n_links)


def _dry() -> None:
    hf, rope, how, _ = _parts()
    hf.simulate(rope.replace(dry_friction=[1e-3] * rope.n_links), **how)


def _dry_batch() -> None:
    hf, rope, how, _ = _parts()
    hf.simulate_batch([rope.replace(dry_friction=[1e-3] * rope.n_links)], how.pop("motion"), **how)


def _sensitivities() -> None:
    hf, rope, how, _ = _parts()
    hf.sensitivities(rope, **how, wrt="friction")
    rest = [0.0] * rope.n_links
    hf.linearize(rope, how["arm"], rest, rest)
    stepper = hf.Stepper(rope, arm=how["arm"])
    stepper.linearize(stepper.start(), 0.1, dt=0.02)


def _batch() -> None:
    hf, rope, how, _ = _parts()
    hf.simulate_batch([rope, rope], how.pop("motion"), **how)
    stepper = hf.BatchStepper([rope, rope], arm=how["arm"])
    stepper.step(stepper.start(), [0.0, 0.0], dt=0.02)


def _contact() -> None:
    """Compile the steps in contact alone: under a force there is no free flight."""
    hf, rope, how, peg = _parts()
    hf.simulate(rope, **how, pegs=[peg], tip_force=(0.01, 0.0))


def _wound() -> None:
    hf, rope, how, peg = _parts()
    run = hf.simulate(rope, **how, pegs=[peg])
    hf.tug_test(run, peg)
    stepper = hf.Stepper(rope, arm=how["arm"], pegs=[peg])
    stepper.step(stepper.start(), 0.1, dt=0.02)


def _plan() -> None:
    """Compile how planners measure distances at the samples of flights, with their kinds of arguments."""
    import numpy as np

    from hyperflex.core.batch import proximity

    _, rope, _, _ = _parts()
    flights, places, length = np.zeros((1, 2, rope.n_links)), np.zeros((1, 2, 2)), rope.length
    links, gap, count = np.arange(rope.n_links), np.empty((2, 2, rope.n_links)), np.zeros(1, np.int64)
    proximity.first_contacts(flights, places, length[None].copy(), 0.0, 0.0, 0.1, 0.1, count, count, np.zeros(1))
    proximity.samples_apart(flights, places, length, 0.0, 0.0, 1, count, count)
    proximity.arm_gaps(flights[0], places[0], length, links, 1, gap)


def _dense() -> None:
    import numpy as np

    from hyperflex import dynamics
    from hyperflex.sensors import MotorTorque

    hf, rope, how, _ = _parts()
    rest, arm = np.zeros(rope.n_links), how["arm"]
    hf.mass_matrix(rope, rest)
    dynamics.bias(rope, rest, rest)
    MotorTorque(arm).measure(rope, arm, hf.State(0.0, rest, rest))


def _vision() -> None:
    import numpy as np

    from hyperflex.vision import Camera, MarkerColour, MarkerDetector, Renderer, RopeMotion, Scene

    camera = Camera.facing((320, 240), pixels_per_metre=150.0, origin=(160.0, 20.0), exposure=0.01)
    motion = RopeMotion([0.0, 1.0], np.zeros((2, 4)), np.ones((2, 4)), [0.25] * 4)
    image = Renderer(camera, motion, Scene(np.array([0.5, 1.0]), marker_diameter=0.08)).image(0.5)
    MarkerDetector(MarkerColour.from_click(image, camera.project([[0.0, -0.5]])[0])).find(image)


def _estimate() -> None:
    import numpy as np

    from hyperflex.estimate import TrackingTask, curve_arc_lengths
    from hyperflex.vision import Camera, MarkerColour, RopeLook

    _, rope, how, _ = _parts()
    camera = Camera.facing((320, 240), pixels_per_metre=150.0, origin=(160.0, 20.0), exposure=0.01, readout=0.01)
    colour = MarkerColour(np.array([40.0, 30.0, 210.0]), area=40.0)
    TrackingTask(rope, np.array([0.25, 0.5, 0.75, 1.0]), camera, [colour], how["arm"]).rehearse()
    look = RopeLook(np.array([40.0, 40.0, 40.0]), 2.0)
    TrackingTask(rope, curve_arc_lengths(rope), camera, [], how["arm"], look=look).rehearse()


def _parts() -> tuple[Any, Any, dict[str, Any], Any]:
    """Return hyperflex, a small rope, a set-up for it, and a peg."""
    import hyperflex as hf

    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=4, radius=0.005, friction=5e-4)
    return hf, rope, {"motion": hf.arm_swings(), "arm": hf.Arm(length=0.1), "duration": 0.02}, hf.Peg(0.05, -0.7, 0.02)


CALLS: dict[str, Callable[[], None]] = {
    "simulate": _simulate,
    "dry": _dry,
    "sensitivities": _sensitivities,
    "batch": _batch,
    "dry_batch": _dry_batch,
    "contact": _contact,
    "plan": _plan,
    "dense": _dense,
    "wound": _wound,
    "vision": _vision,
    "estimate": _estimate,
}
# What one process compiles while another does the other: they share little, and "wound" needs what "simulate" has made.
LANES = (
    ("simulate", "dry", "plan", "sensitivities", "estimate"),
    ("contact", "batch", "dry_batch", "dense", "wound", "vision"),
)
