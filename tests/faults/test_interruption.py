"""Interruption: the rule of ``hyperflex.interruption``, and calls and commands that signals end at random times."""

import _thread
import contextlib
import inspect
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import interruption
from hyperflex.control import optimize_pumping
from hyperflex.core.tangent import forward_sensitivity
from hyperflex.demo import write_demo
from hyperflex.estimate import track_video
from hyperflex.files import atomic_path
from hyperflex.identification import Kind
from hyperflex.identification.uncertainty import covariance
from hyperflex.interruption import deferred, handle_signals, interruptible, raise_if_cancelled, stoppable
from hyperflex.paper import reproduce
from hyperflex.simulation import contact
from hyperflex.vision import calibrate_camera, track_bars
from tests.refusals import left_by

ROOT = Path(__file__).parents[2]
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=20, radius=0.0025, friction=5e-4)

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C cannot be sent to one process")


@pytest.fixture(autouse=True)
def usual_handler() -> Iterator[None]:
    """Handle Ctrl-C as Python does, whatever the tests' own parent has set."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def soon(seconds: float) -> Iterator[None]:
    """Send Ctrl-C to the main thread after a time, s, unless the block has ended."""
    timer = threading.Timer(seconds, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


def swallowed() -> None:
    """Be interrupted in a library that is called back and swallows it."""
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@interruptible(list)
def idle(result: list[int]) -> list[int]:
    return result


@interruptible(list)
def work(result: list[int]) -> list[int]:
    swallowed()
    return result


def test_a_signal_at_the_very_end_of_a_call_leaves_the_next_one_alone():
    def trace(frame, *_):
        if frame.f_code is handle_signals.__exit__.__code__:
            sys.settrace(before)
            signal.raise_signal(signal.SIGINT)

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        with pytest.raises(hf.Interrupted) as stop:
            idle([1])
    finally:
        sys.settrace(before)
    assert stop.value.partial == [1]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert idle([2]) == [2]


def test_what_a_library_swallows_comes_out_at_the_end_of_the_call():
    calls = []

    def loop():
        for _ in range(3):
            calls.append(1)
            work([1])

    assert left_by(loop) == [1]
    assert len(calls) == 1
    raise_if_cancelled()  # it is not pending any more


def test_what_a_library_swallows_is_raised_by_the_next_look_in_any_thread():
    heard = []

    def listen():
        try:
            raise_if_cancelled()
        except KeyboardInterrupt:
            heard.append(True)

    def work():
        with handle_signals():
            swallowed()
            thread = threading.Thread(target=listen)
            thread.start()
            thread.join()

    with pytest.raises(KeyboardInterrupt):
        work()
    assert heard


def test_what_a_library_makes_another_error_of_is_an_interrupt():
    def convert(interrupt):
        with handle_signals():
            if interrupt:
                swallowed()
            raise ValueError("cannot convert")

    with handle_signals(), stoppable() as stop:
        convert(interrupt=True)
    assert stop.received
    with pytest.raises(KeyboardInterrupt):
        convert(interrupt=True)
    with pytest.raises(ValueError, match="cannot"), handle_signals(), stoppable():
        convert(interrupt=False)


def test_the_partial_result_of_a_call_within_is_not_that_of_the_call() -> None:
    @interruptible(dict)
    def outer():
        return {"of": work([1])[0]}

    assert left_by(outer) is None


def test_a_partial_result_may_be_made_when_it_is_requested():
    made = []

    @interruptible(str)
    def late():
        raise hf.Interrupted(lambda: made.append(1) or "made")

    with pytest.raises(hf.Interrupted) as stop:
        late()
    assert made == []
    assert (stop.value.partial, stop.value.partial, made) == ("made", "made", [1])


def test_what_follows_a_caught_interrupt_may_take_long_until_the_second_one():
    with handle_signals():
        with stoppable() as stop:
            signal.raise_signal(signal.SIGINT)
        raise_if_cancelled()
        assert stop.received
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with stoppable():
            raise_if_cancelled()


def test_a_short_block_comes_to_its_end_first():
    done = []

    def move():
        with deferred():
            signal.raise_signal(signal.SIGINT)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        move()
    assert done


def test_a_handler_of_somebody_else_stays():
    heard = []
    signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    try:
        with handle_signals():
            signal.raise_signal(signal.SIGINT)
            raise_if_cancelled()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    assert heard


def test_a_run_is_interrupted_in_a_kernel_and_continues_bit_for_bit():
    how = {"arm": hf.Arm(length=0.105), "t_eval": np.arange(0.0, 1e4, 100.0)}
    hf.simulate(CABLE, hf.arm_swings(), arm=how["arm"], duration=0.1)
    clock = threading.Timer(0.3, _thread.interrupt_main)
    clock.start()
    part = left_by(lambda: hf.simulate(CABLE, hf.arm_swings(), duration=1e5, **how))
    clock.join()
    assert part.status == "interrupted"
    end = float(part.state.t)
    rest = hf.simulate(CABLE, hf.arm_swings(), arm=how["arm"], state=part.state, duration=1.0, t_eval=[end + 1.0])
    whole = hf.simulate(CABLE, hf.arm_swings(), arm=how["arm"], duration=end + 1.0, t_eval=[end + 1.0])
    np.testing.assert_array_equal(rest.q, whole.q)


def test_a_run_with_contact_is_interrupted_with_state_and_clock_that_fit_together(monkeypatch):
    """A signal is heard when the kernel returns, before the run knows how far it has come."""
    kernel, calls = contact.at.run, []

    def interrupted(*given):
        code = kernel(*given)
        calls.append(code)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return code

    how = {"arm": hf.Arm(length=0.1), "pegs": [hf.Peg(0.0, -0.5, 0.03)], "duration": 4.0, "contact_step": 1e-3}
    monkeypatch.setattr(contact.at, "run", interrupted)
    part = left_by(lambda: hf.simulate(CABLE, q0=[1.2] * 20, tol=1e-3, **how))
    assert (part.status, len(calls)) == ("interrupted", 3)
    whole = hf.simulate(CABLE, q0=[1.2] * 20, tol=1e-3, **(how | {"duration": part.state.t, "t_eval": [part.state.t]}))
    np.testing.assert_allclose(part.state.q, whole.q[-1], atol=1e-3)


def test_derivatives_of_a_long_run_are_interrupted(monkeypatch):
    """In the midst of the kernel that goes through the run's steps again."""
    kernel, states = forward_sensitivity.forward_sensitivities, []

    def interrupted(*given):
        with soon(0.02):
            kernel(*given)
        states.append(given[-3][-1])

    long = {"q0": [1.0] * 20, "duration": 200.0, "t_eval": [200.0], "wrt": ["qd0", "friction[:]"]}
    hf.sensitivities(CABLE, **(long | {"duration": 0.1, "t_eval": [0.1]}))
    monkeypatch.setattr(forward_sensitivity, "forward_sensitivities", interrupted)
    assert left_by(lambda: hf.sensitivities(CABLE, **long)) is None
    assert not states[0].any()  # it did not come to its end


def test_each_public_call_that_takes_long_leaves_as_interrupted():
    calls = (reproduce, write_demo, calibrate_camera, track_video, track_bars, optimize_pumping, hf.Stepper.step)
    assert all(hasattr(call, "__wrapped__") for call in (*calls, hf.BatchStepper.step, hf.Stepper.linearize))
    short = {"measure_winding", "refine_rope", "with_links", "forward_kinematics", "mass_matrix", "linearize"}
    short |= {"fit_regression", "rope_slip", "rope_tension"}
    rooms = ("hyperflex.motion", "hyperflex.simulation.events")  # of what takes no time
    for name in set(hf.__all__) - short:
        call = getattr(hf, name)
        if inspect.isfunction(call) and not (name.startswith(("read_", "write_")) or call.__module__.startswith(rooms)):
            assert hasattr(call, "__wrapped__"), name


@pytest.mark.parametrize("kind", [hf.Stepper, hf.BatchStepper])
def test_steps_are_interrupted_and_continue(monkeypatch, kind):
    stepper = kind(CABLE if kind is hf.Stepper else [CABLE] * 40, arm=hf.Arm(length=0.1))
    begin = stepper.start()
    after = stepper.step(begin, 1.0, 0.1)
    with soon(0.1):
        assert left_by(lambda: stepper.step(begin, 1.0, 1e4)) is None
    np.testing.assert_array_equal(stepper.step(begin, 1.0, 0.1).q, after.q)


@pytest.mark.parametrize(("grace", "known"), [(60.0, True), (0.0, False)])
def test_a_fit_is_kept_when_its_covariance_is_interrupted(monkeypatch, grace, known):
    """With deviations where they are found at once, and without any where they would take long."""
    derivatives, begun = covariance.window_models, []

    def interrupted(*given):
        begun.append(True)
        if len(begun) == 1:
            signal.raise_signal(signal.SIGINT)
        return derivatives(*given)

    monkeypatch.setattr(covariance, "window_models", interrupted)
    monkeypatch.setattr(covariance, "GRACE", grace)
    rod = hf.Rope([0.3], [0.1], friction=2e-4)
    swing = hf.simulate(rod, duration=4.0, q0=[0.8])
    found = left_by(lambda: hf.identify(hf.Recording(swing.t, swing.q), rod.replace(friction=1e-3), ["friction"]))
    assert found.status == "interrupted"
    assert found.rope.friction[0] == pytest.approx(2e-4, rel=1e-3)
    assert np.isfinite(found.std["friction"]).all() == known
    assert bool(found.intervals) == known
    assert found.has(Kind.NOT_ESTIMATED) != known
    assert (found.grade == "do not use") != known


def test_an_interrupt_while_files_are_put_in_place_leaves_no_part(tmp_path, monkeypatch):
    replace = os.fsync

    def interrupted(descriptor):
        signal.raise_signal(signal.SIGINT)
        replace(descriptor)

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "a.txt") as part:
        part.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "whole"


def test_what_a_killed_process_left_is_removed_by_the_next_write(tmp_path):
    names = [".a.0123abcd.part.txt", ".a.4567abcd.part.txt", ".b.0123abcd.part.txt"]
    for name in names:
        (tmp_path / name).write_text("half")
    long_ago = time.time() - 4000.0
    for name in names[::2]:
        os.utime(tmp_path / name, (long_ago, long_ago))
    with atomic_path(tmp_path / "a.txt") as part:
        part.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [*names[1:], "a.txt"]


@pytest.mark.parametrize(
    ("how", "code"),
    [("os.kill(os.getpid(), 15)", 143), ("exec('os.kill(os.getpid(), 15)')", 143), ("os.kill(os.getpid(), 2)", 130)],
)
def test_sigterm_is_ctrl_c_on_the_command_line_with_its_own_code(tmp_path, how, code):
    """Also where Python keeps a mark of it, as for code in a string (as of namedtuple) below ``python -m``."""
    head = "import os, signal; from hyperflex import demo; from hyperflex.cli import main\n"
    head += "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # whatever the tests' own parent has set
    (tmp_path / "stopped.py").write_text(f"{head}def work(*_): {how}\ndemo.write_demo = work\nmain()")
    words = [sys.executable, "-m", "stopped", "demo", "--json"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert (done.stderr.startswith("hyperflex: Interrupted"), done.stderr.count("\n")) == (True, 1)
    assert json.loads(done.stdout)["error"] == "interrupted"
    assert interruption.number() == signal.SIGINT


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_command_line_is_loaded_is_reported_with_its_code(number):
    code = "import os, signal, sys; from hyperflex.cli import main\nclass Finder:\n"
    code += f"    def find_spec(name, *_): return os.kill(os.getpid(), {int(number)}) if name == 'typer' else None\n"
    code += "sys.meta_path.insert(0, Finder)\nmain()"
    done = subprocess.run([sys.executable, "-c", code, "demo", "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + number
    assert done.stderr == "hyperflex: Interrupted.\n"
    assert json.loads(done.stdout) == {"error": "interrupted", "type": "Interrupted"}


def test_an_interrupt_waits_for_the_compiler():
    """In the middle of its work numba would be broken for the rest of the process."""
    from numba.core.compiler_lock import global_compiler_lock

    assert hf.simulate  # listens from its import on
    done = []

    def compile_something():
        with global_compiler_lock, global_compiler_lock:
            signal.raise_signal(signal.SIGINT)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        compile_something()
    assert done
