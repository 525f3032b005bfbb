"""Calls and commands that a signal ends at a chosen time, each in a forked process, and what came of each.

``python -m benchmarks.interrupting --seeds 3 --calls simulate --commands cast`` prints a name and a JSON
object a trial, with what is wrong in ``faults``; without ``--calls`` and ``--commands`` it tries all of them. The exit
code says whether anything was wrong.
"""

import argparse
import hashlib
import json
import os
import pickle
import random
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PATIENCE = 120.0  # s, after which a trial hangs
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Ended:
    """The end of a forked process: its report, and elapsed and processor time since the signal, s."""

    told: Any
    seconds: float
    processor_seconds: float
    length: float  # of it all, s


def forked(
    work: Callable[[], Any], after: float | None, number: int = signal.SIGINT, patience: float = PATIENCE
) -> Ended:
    """Run `work` in a forked process and send it a signal `after` so many seconds (None: never); return what it told.

    ``told`` is what `work` returned, "hangs", or "died of N" where the process ended without a word.
    """
    read, write = os.pipe()
    begin = time.monotonic()
    process = os.fork()
    if process == 0:
        os.close(read)
        _child(work, write)
    os.close(write)
    spent, sent = 0.0, begin
    if after is not None:
        time.sleep(after)
        sent, spent = time.monotonic(), _processor_time(process)
        os.kill(process, number)
    told: Any = "hangs"
    ended = spent
    if select.select([read], [], [], patience)[0]:
        with os.fdopen(read, "rb", closefd=False) as pipe:
            content = pipe.read()
        told, ended = pickle.loads(content) if content else (None, spent)
    else:
        os.kill(process, signal.SIGKILL)
    os.close(read)
    status = os.waitpid(process, 0)[1]
    if told is None:
        told = f"died of {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"exit {os.WEXITSTATUS(status)}"
    now = time.monotonic()
    return Ended(told, now - sent, ended - spent, now - begin)


def _child(work: Callable[[], Any], pipe: int) -> None:
    """Run `work`, write what it returned and the processor time, and leave."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    code = 1
    try:
        told = work()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        with os.fdopen(pipe, "wb") as file:
            pickle.dump((told, sum(os.times()[:2])), file)
        code = 0
    except KeyboardInterrupt:
        code = 130
    finally:
        os._exit(code)


def _processor_time(process: int) -> float:
    """Return the processor time that a process has taken, s."""
    fields = Path(f"/proc/{process}/stat").read_text("utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


# ---- calls


def call(work: Callable[[], Any]) -> Callable[[], dict[str, Any]]:
    """Return a function that tells how a call ended, and a fingerprint of its result or of its partial result."""

    def told() -> dict[str, Any]:
        try:
            try:
                result, how = work(), "finished"
            except KeyboardInterrupt as stop:
                result, how = getattr(stop, "partial", None), "interrupted"
        except Exception as error:  # noqa: BLE001 whatever else comes out is what is looked for
            result, how = f"{type(error).__name__}: {error}", "failed"
        return {"how": how, "kind": type(result).__name__, "marks": marks(result), "print": fingerprint(result)}

    return told


def marks(result: Any) -> list[str]:
    """Return what says of a result that it is partial."""
    status = getattr(result, "status", None)
    named = [str(getattr(result, name, "")) for name in ("message",)] + [str(getattr(result, "interrupted", ""))]
    named += sorted(set(status)) if isinstance(status, tuple) else [str(status)]
    return [word for word in named if word]


def fingerprint(result: Any) -> str:
    """Return a hash of the numbers of a result without times spent."""
    import numpy as np

    digest, seen = hashlib.sha256(), set[int]()

    def add(value: Any, depth: int = 0) -> None:
        if isinstance(value, np.ndarray):
            digest.update(value.tobytes())
        elif isinstance(value, (str, int, float, bytes, type(None))):
            digest.update(repr(value).encode())
        elif isinstance(value, (list, tuple)):
            for each in value:
                add(each, depth + 1)
        elif isinstance(value, dict):
            for key, each in value.items():
                if "seconds" not in str(key):
                    add(each, depth + 1)
        elif hasattr(value, "__dict__") and id(value) not in seen and depth < 6:
            seen.add(id(value))
            add({key: each for key, each in vars(value).items() if not key.startswith("_")}, depth + 1)

    add(result)
    return digest.hexdigest()[:16]


def calls() -> dict[str, Callable[[], Any]]:
    """Return calls of the API that take a second or more each; what they need is made here."""
    import numpy as np

    import hyperflex as hf
    from hyperflex.control import SwingModel, optimize_pumping
    from hyperflex.demo import twin
    from hyperflex.identification import profile

    arm, swings = hf.Arm(length=0.105), hf.arm_swings(t_move=0.73, t_rest=0.53)
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    long = hf.Rope.uniform(length=2.0, mass=0.125, n_links=1500, radius=0.0025, friction=5e-4)
    rods = hf.Rope(length=[0.3, 0.3], mass=[0.1, 0.1], friction=2e-4)
    t = np.linspace(0.0, 8.0, 401)
    clean = hf.simulate(rods, duration=8.0, t_eval=t, q0=[0.8, 0.5]).q
    noisy = hf.Recording(t, clean + np.random.default_rng(1).normal(0.0, 2e-3, clean.shape), noise=2e-3)
    guess = rods.replace(friction=1e-3, inertia=1.2 * rods.inertia)
    free = ["inertia", "friction"]
    fitted = hf.identify(noisy, guess, free, options=hf.FitOptions(intervals=None))
    peg, near = hf.Peg(0.3, -1.0, 0.03), hf.Peg(-0.7, -1.2, 0.04)
    many = [hf.arm_swings(t_move=0.73, t_rest=rest) for rest in np.linspace(0.4, 0.7, 128)]
    some = [hf.Peg(x, -1.0, 0.03) for x in np.linspace(0.2, 0.5, 24)]
    few = hf.Rope.uniform(length=2.0, mass=0.125, n_links=12, radius=0.0025, friction=5e-4)
    model = SwingModel(few, arm, t_move=0.4)
    return {
        "simulate": lambda: hf.simulate(cable, swings, arm=arm, duration=1e4, t_eval=np.arange(0.0, 1e4, 0.5)),
        "simulate long": lambda: hf.simulate(cable, swings, arm=arm, duration=1e5, t_eval=np.arange(0.0, 1e5, 100.0)),
        "simulate links": lambda: hf.simulate(long, swings, arm=arm, duration=200.0),
        "simulate contact": lambda: hf.simulate(cable, swings, arm=arm, duration=60.0, pegs=[peg]),
        "simulate callback": lambda: hf.simulate(
            cable, arm=hf.Arm(length=0.1, inertia=1e-3), torque=lambda *_: 0.01, control_rate=200.0, duration=30.0
        ),
        "simulate batch": lambda: hf.simulate_batch(cable, many, arm=arm, duration=20.0),
        "contact batch": lambda: hf.simulate_batch(cable, swings, arm=arm, duration=6.0, pegs=[[p] for p in some]),
        "sensitivities": lambda: hf.sensitivities(cable, swings, arm=arm, duration=60.0, wrt=["friction", "inertia"]),
        "predictability": lambda: hf.predictability(cable, swings, arm=arm, duration=30.0),
        "identify": lambda: hf.identify(noisy, guess, free, options=hf.FitOptions(intervals="profile")),
        "identify default": lambda: hf.identify(noisy, guess),
        "compare models": lambda: hf.compare_models(noisy, guess),
        "profile": lambda: [profile(fitted, name, points=4) for name in fitted.parameters],
        "revision": lambda: hf.iterative_revision(noisy, guess),
        "design": lambda: hf.design_experiment(rods, "friction"),
        "cast": lambda: hf.plan_cast(cable, arm, near, time_budget=20.0),
        "cast robust": lambda: hf.plan_cast(cable, arm, near, time_budget=20.0, uncertainty=hf.Uncertainty()),
        "whip": lambda: hf.plan_whip(few, arm, hf.TipTarget(0.3, -2.05), time_budget=10.0),
        "insert": lambda: hf.plan_insert(few, arm, hf.Slot(0.56, -1.9, -0.78), time_budget=10.0),
        "pumping": lambda: optimize_pumping(model, 0.9),
        "track": twin.track,
    }


# ---- commands


@dataclass(frozen=True)
class Left:
    """What a command has left: exit code, output, and the files in its folder."""

    code: int | str
    out: str
    err: str
    files: dict[str, bytes]

    @property
    def interrupted(self) -> bool:
        """Whether the exit code says so."""
        return self.code in {128 + signal.SIGINT, 128 + signal.SIGTERM}


def run_command(words: list[str], folder: Path, after: float | None, number: int = signal.SIGINT) -> tuple[Left, Ended]:
    """Run a command in a forked process, in a new folder, with a signal `after` a time, s."""
    folder.mkdir()

    def work() -> int | str:
        os.chdir(folder)
        if words[0] == "warm":  # a full cache is warm at once, and the user's is left alone
            os.environ["HYPERFLEX_CACHE_DIR"] = f"{folder}.cache"
        for name, stream in (("out", sys.stdout), ("err", sys.stderr)):
            os.dup2(os.open(f"{folder}.{name}", os.O_CREAT | os.O_WRONLY, 0o600), stream.fileno())
        from hyperflex.cli import main

        sys.argv = ["hyperflex", *words]
        try:
            main()
        except SystemExit as stop:
            code = stop.code
        sys.stdout.flush()
        return int(code or 0)

    sys.stdout.flush()
    ended = forked(work, after, number)
    files = {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    out, err = (Path(f"{folder}.{name}").read_text("utf-8") for name in ("out", "err"))
    return Left(ended.told, out, err, files), ended


def faults(left: Left, whole: Left) -> list[str]:
    """Return the faults in the files of a command, compared with those of an undisturbed one."""
    wrong = [f"left {name}" for name in left.files if ".part" in name]
    if "Traceback" in left.err or "Exception ignored" in left.err:
        wrong.append(left.err)
    if not left.interrupted:
        if left.code != whole.code or left.files.keys() != whole.files.keys():
            wrong.append(f"ended with {left.code} and {sorted(left.files)}: {left.err}")
        return wrong
    told = json.loads(left.out.splitlines()[-1]) if left.out else {}
    if told.get("error") != "interrupted" or "hyperflex: Interrupted" not in left.err:
        wrong.append(f"says {told} and {left.err!r}")
    for name, content in left.files.items():
        complete = content == whole.files.get(name) or "missing" in told
        if not complete and b"interrupted" not in content and b"interrupted" not in left.files.get("cast.toml", b""):
            wrong.append(f"{name} is marked nowhere")
    return wrong


def commands(folder: Path) -> dict[str, list[str]]:
    """Return commands that take some seconds, each with ``--json``; what they read is written to `folder`."""
    import numpy as np

    import hyperflex as hf
    import hyperflex.cli.app  # once, for all forked processes
    from hyperflex.demo import twin

    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    arm = hf.Arm(length=0.105)
    cable.to_toml(folder / "cable.toml")
    hf.Setup(cable, hf.arm_swings(t_move=0.73, t_rest=0.53), arm, duration=60.0).to_toml(folder / "swing.toml")
    rods = hf.Rope(length=[0.3, 0.3], mass=[0.1, 0.1], friction=2e-4)
    t = np.linspace(0.0, 8.0, 401)
    clean = hf.simulate(rods, duration=8.0, t_eval=t, q0=[0.8, 0.5]).q
    noisy = hf.Recording(t, clean + np.random.default_rng(1).normal(0.0, 2e-3, clean.shape), noise=2e-3)
    noisy.to_netcdf(folder / "swing.nc")
    rods.replace(friction=1e-3).to_toml(folder / "guess.toml")
    twin.guess().to_toml(folder / "rope.toml")
    twin.camera().write(folder / "camera.toml")
    arcs = ["--arc-lengths", ",".join(f"{each:g}" for each in twin.ARC_LENGTHS)]
    seen = ["--rope", f"{folder}/rope.toml", *arcs]
    task = ["--rope", f"{folder}/cable.toml", "--arm-length", "0.105"]
    each = {
        "simulate": ["simulate", f"{folder}/swing.toml", "-o", "run.nc"],
        "simulate --horizon": ["simulate", f"{folder}/swing.toml", "-o", "run.nc", "--horizon", "0.01"],
        "identify": ["identify", f"{folder}/swing.nc", "--rope", f"{folder}/guess.toml", "-o", "rope.toml"],
        "identify with a page": ["identify", f"{folder}/swing.nc", "--rope", f"{folder}/guess.toml", "-o", "found"],
        "cast": ["cast", *task, "--target", "-0.8", "-1.0", "--radius", "0.04", "-o", "."],
        "whip": ["whip", *task, "--target", "0.3", "-2.05", "-o", "."],
        "insert": ["insert", *task, "--slot", "0.56", "-1.9", "--direction", "-0.78", "-o", "."],
        "track": ["track", str(twin.BUNDLED), *seen, "--camera", f"{folder}/camera.toml", "-o", "markers.nc"],
        "watch": ["watch", str(twin.BUNDLED), *seen, "--camera", f"{folder}/camera.toml"],
        "reproduce": ["reproduce", "fig10", "fig12", "-o", "."],
        "demo": ["demo", "-o", "."],
        "warm": ["warm", "--workers", "1"],
    }
    each["watch"] += ["-o", "log.nc"]
    return {name: [*words, "--json"] for name, words in each.items()}


# ---- trials

SECONDS = 5.0  # of the processors, from a signal to the end; the kernels look more often than each second
LONGEST = 8.0  # s of a call in which it is interrupted
# Take minutes: their undisturbed results are not computed
ENDLESS = {"simulate long", "simulate links", "compare models", "warm"}
SEARCHES = {"cast", "cast robust", "whip", "insert", "pumping"}  # end by elapsed time: no two runs are equal
NO_PLAN = 4  # exit code of a search that finds nothing in its time


def call_faults(name: str, ended: Ended, whole: Ended) -> list[str]:
    """Return the faults in the end of a call, compared with an undisturbed one."""
    told = ended.told
    if not isinstance(told, dict) or told["how"] == "failed":
        return [f"ended with {told}"]
    wrong = _late(ended)
    if told["kind"] not in {whole.told["kind"], "NoneType"}:
        wrong.append(f"leaves a {told['kind']}")
    if told["how"] == "finished":
        return wrong if name in SEARCHES or told == whole.told else [*wrong, f"{told}, and undisturbed {whole.told}"]
    complete = told["print"] == whole.told["print"]  # the signal came after the last of the work
    if told["kind"] != "NoneType" and not complete and not {"interrupted", "True"} & set(told["marks"]):
        wrong.append(f"is marked nowhere: {told}")
    return wrong


def _late(ended: Ended) -> list[str]:
    seconds = ended.processor_seconds
    return [f"took {seconds:.1f} s of processor time to end"] if seconds > SECONDS else []


def moments(name: str, seeds: int, length: float) -> Iterator[tuple[float, int]]:
    """Yield random times, s, and the signals that are sent then."""
    for seed in range(seeds):
        yield random.Random(f"{name} {seed}").uniform(0.02, 1.0) * length, (signal.SIGINT, signal.SIGTERM)[seed % 2]


def interrupt_calls(names: list[str], seeds: int) -> None:
    """Interrupt calls at random times of the first `LONGEST` seconds."""
    every = calls()
    for name in names or every:
        whole = forked(call(every[name]), None) if name not in ENDLESS else None
        length = min(whole.length, LONGEST) if whole else LONGEST
        for after, _ in moments(name, seeds, length):
            ended = forked(call(every[name]), after)
            _tell(name, vars(ended) | {"after": after, "faults": call_faults(name, ended, whole or ended)})


def interrupt_commands(names: list[str], seeds: int, folder: Path) -> None:
    """Interrupt commands at random times by one signal and the other in turn."""
    every = commands(folder)
    for name in names or every:
        whole, length = Left(0, "", "", {}), LONGEST
        if name not in ENDLESS:
            whole, undisturbed = run_command(every[name], folder / name, None)
            length = undisturbed.length
        if whole.code not in {0, NO_PLAN}:
            _tell(f"hyperflex {name}", {"faults": [f"undisturbed: {whole.code} {whole.err}"]})
        for number, (after, sent) in enumerate(moments(name, seeds, length)):
            left, ended = run_command(every[name], folder / f"{name}-{number}", after, sent)
            told = {"after": after, "signal": sent, "seconds": ended.seconds, "processor": ended.processor_seconds}
            other = left if left.code in {0, NO_PLAN} and name in SEARCHES else whole
            wrong = faults(left, other) + (_late(ended) if left.interrupted else [])
            _tell(f"hyperflex {name}", told | {"code": left.code, "files": sorted(left.files), "faults": wrong})


def main() -> int:
    """Interrupt the named calls at random times, and print the results; return 1 after any fault."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--calls", nargs="*")
    parser.add_argument("--commands", nargs="*")
    chosen = parser.parse_args()
    neither = chosen.calls is None and chosen.commands is None
    if chosen.calls is not None or neither:
        interrupt_calls(chosen.calls or [], chosen.seeds)
    if chosen.commands is not None or neither:
        with tempfile.TemporaryDirectory() as made:
            interrupt_commands(chosen.commands or [], chosen.seeds, Path(made))
    return int(bool(_wrong))


_wrong: list[str] = []


def _tell(name: str, told: dict[str, Any]) -> None:
    _wrong.extend(told["faults"])
    sys.stdout.write(f"{name}\t{json.dumps(told)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
