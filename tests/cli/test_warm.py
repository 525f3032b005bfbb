"""``hyperflex warm``: after it, typical calls compile nothing."""

import os
import subprocess
import sys
import time

import numba
import pytest

from hyperflex.cli import warm
from hyperflex.cli.app import run
from hyperflex.core import cache

needs_compiler = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

CALLS = """
import pickle

import numpy as np
import hyperflex as hf
from hyperflex.core.jit import compiling
from hyperflex.estimate import ChangeTests, EstimatedParameter, Observations, RopeFilter, TrackingTask
from hyperflex.planning.clearance import rope_clearance
from hyperflex.sensors import MotorTorque
from hyperflex.vision import Camera, MarkerColour

rope = hf.Rope.uniform(length=1.2, mass=0.1, n_links=6, radius=0.004, friction=4e-4)
dry = rope.replace(dry_friction=np.full(6, 1e-3))
airy = rope.replace(drag=np.full(6, 1e-3))
short = rope.with_bend_radius(0.1)
arm, motor, peg = hf.Arm(length=0.1), hf.Arm(length=0.1, inertia=1e-3), hf.Peg(0.05, -0.7, 0.02)
free = hf.Peg(0.05, -0.7, 0.02, inertia=1e-6)
swing, torque = hf.arm_swings(), hf.torque_profile([0.0, 0.1], [0.0, 0.01])
# the filter comes first: a kernel that is there takes arrays that may be written to, but is compiled for them alone
swung = hf.simulate(rope, duration=3.0, q0=np.full(6, 0.7), t_eval=np.arange(0.0, 3.0, 0.02))
states = [EstimatedParameter("friction", 0.1)]
seen = RopeFilter(rope, [0.4, 0.8, 1.2], readout=0.01, parameters=states, tests=ChangeTests())
for t, joints in zip(swung.t[:70], swung.joints[:70]):
    seen.update(Observations(t, joints[[2, 4, 6]], std=0.002, rows=[-0.5, 0.0, 0.5]))
runs = [hf.simulate(each, swing, arm=arm, duration=0.1) for each in (rope, dry, airy, short)]
hf.simulate(rope, swing, arm=arm, duration=0.1, step=1e-4)
hf.simulate(rope, swing, arm=arm, duration=0.3, until=hf.tip_speed_peak())
hf.simulate(rope, torque=torque, arm=motor, duration=0.1)
hf.simulate(rope, torque=lambda *_: 0.01, arm=motor, duration=0.1, control_rate=100.0)
wound = hf.simulate(rope, swing, arm=arm, duration=0.3, pegs=[peg])
hf.simulate(dry, swing, arm=arm, duration=0.1, pegs=[free])
hf.simulate(rope, duration=0.1, state=runs[0].state)
hf.sideways(runs[0], tilt=0.01).growth()
hf.tug_test(wound, peg)
hf.measure_winding(wound, peg)
options = hf.SearchOptions(seed=1, skip_feasibility=True)
assert hf.plan_cast(rope, arm, hf.Peg(0.3, -0.8, 0.02), time_budget=2.0, options=options).runs > 0
rope_clearance(runs[0])
hf.forward_kinematics(pickle.loads(pickle.dumps(rope)), np.zeros(6))
hf.simulate_batch([rope, dry], swing, arm=arm, duration=0.1)
hf.simulate_batch([rope, rope], swing, arm=arm, duration=0.1, pegs=[peg])
hf.sensitivities(dry, swing, arm=arm, duration=0.1, wrt=["q0", "friction", "dry_friction", "drag", "motion.t_rest"])
hf.predictability(rope, swing, arm=arm, duration=0.2)
for command in ("acceleration", "angle", "torque"):
    stepper = hf.Stepper(rope, arm=motor, command=command)
    stepper.linearize(stepper.step(stepper.start(), 0.1, dt=0.02), 0.1, dt=0.02)
    batch = hf.BatchStepper([rope, dry], arm=motor, command=command)
    batch.step(batch.start(), np.zeros(2), dt=0.02)
beside = hf.Stepper(rope, arm=arm, pegs=[peg])
beside.step(beside.start(), 0.1, dt=0.02)
rest = np.zeros(6)
hf.mass_matrix(rope, rest)
hf.forward_kinematics(rope, rest)
hf.linearize(rope, arm, rest, rest)
MotorTorque(motor).measure(rope, motor, hf.State(0.0, rest, rest))
hf.identify(hf.Recording(swung.t, swung.q + 1e-3 * np.cos(97.0 * swung.t)[:, None], kind="angles"), rope)
view = Camera.facing((640, 480), pixels_per_metre=200.0, origin=(320.0, 20.0))
TrackingTask(rope, np.array([0.4, 0.8, 1.2]), view, [MarkerColour((30.0, 30.0, 200.0))], arm).rehearse()
print(compiling())
"""


@pytest.fixture(scope="module")
def warmed() -> None:
    """The cache of this machine, filled."""
    if not numba.config.DISABLE_JIT:
        assert run(["warm", "--json"]) == 0


@needs_compiler
@pytest.mark.nightly
def test_typical_calls_compile_nothing(warmed):
    done = subprocess.run([sys.executable, "-c", CALLS], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert float(done.stdout) == 0.0


@needs_compiler
@pytest.mark.nightly
def test_second_time_there_is_nothing_to_do(warmed, hyperflex_json):
    code, result = hyperflex_json("warm")
    assert (code, result["compiled"], result["already_there"]) == (0, 0, result["kernels"])
    assert result["kernels"] > 200


@needs_compiler
@pytest.mark.parametrize(
    ("folder", "lanes", "told"),
    [("file/cache", warm.LANES, "cannot be kept in"), ("cache", (("nothing of this name",),), "KeyError")],
)
def test_a_folder_and_a_process_that_fail(tmp_path, monkeypatch, hyperflex_json, folder, lanes, told):
    (tmp_path / "file").touch()
    monkeypatch.setenv("HYPERFLEX_CACHE_DIR", str(tmp_path / folder))
    monkeypatch.setattr(warm, "LANES", lanes)
    code, result = hyperflex_json("warm", "--workers", "1")
    assert (code, told in result["error"]) == (2, True)


def test_without_the_compiler():
    done = subprocess.run(
        [sys.executable, "-m", "hyperflex", "warm"],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Nothing to do" in done.stdout


def test_kernels_of_other_versions_are_removed_when_they_are_old(tmp_path):
    own, (old, new, foreign) = cache.kernels_folder().name, ("kernels-old", "kernels-new", "kernels-foreign")
    for name in (own, old, new, foreign):
        (tmp_path / name).mkdir()
        file = tmp_path / name / ("notes.txt" if name == foreign else "run-1.nbc")
        file.write_bytes(b"kernel")
        os.utime(file, (0.0, 0.0) if name != new else None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYPERFLEX_CACHE_DIR", str(tmp_path))
        warm._remove_old(tmp_path)
    assert {place.name for place in tmp_path.iterdir()} == {own, new, foreign}


@needs_compiler
def test_a_second_process_compiles_meanwhile(tmp_path, monkeypatch):
    monkeypatch.setenv("HYPERFLEX_CACHE_DIR", str(tmp_path))
    with warm.compiling_ahead("dense"):
        for _ in range(600):
            if cache.compiled([("hyperflex.core.chain.articulated_body", "mass_matrix")]):
                break
            time.sleep(0.1)
    assert cache.compiled([("hyperflex.core.chain.articulated_body", "mass_matrix")]) == 1
