"""Odd values for every argument of every public function and class: refused in words, or a right answer."""

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hyperflex as hf
from tests.faults.bounds import examples, refused_or_done
from tests.faults.counting import count

ROPE = hf.Rope(length=[0.3, 0.3], mass=[0.1, 0.1], friction=1e-4, radius=0.002)
PENDULUM = hf.Rope([0.3], [0.1], friction=2e-4)
CABLE = hf.Rope.uniform(1.0, 0.1, 5, radius=0.002, friction=1e-4)
ARM, PEG = hf.Arm(length=0.1), hf.Peg(0.3, -0.2, 0.03)
T = np.linspace(0.0, 2.0, 61)
HOLD, PUSH = hf.hold_arm(0.1), hf.torque_profile([0.0, 1.0], [0.0, 0.1])
SAMPLES = {"t": [0.0, 0.5, 1.0]}
START: dict[str, Any] = {"duration": 0.05, "q0": [0.1, 0.2], "qd0": [0.0, 0.1], "tol": 1e-4}


@functools.cache
def run() -> hf.Trajectory:
    return hf.simulate(ROPE, duration=0.1, q0=[0.1, 0.0], arm=ARM, pegs=[PEG])


@functools.cache
def swing() -> hf.Recording:
    truth = hf.simulate(hf.Rope([0.3], [0.1], friction=1e-4), duration=2.0, q0=[0.5], t_eval=T)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, truth.q.shape)
    return hf.Recording(T, truth.q + noise, noise=1e-3)


def stepper() -> hf.Stepper:
    made = hf.Stepper(ROPE, arm=ARM)
    made.start()
    return made


# What is called with which arguments; each is sound, and one of them is then replaced by something odd.
CALLS: dict[str, tuple[Callable[..., Any], Callable[[], dict[str, Any]]]] = {
    "Rope": (
        hf.Rope,
        lambda: {
            "length": [0.1, 0.1],
            "mass": [0.1, 0.1],
            "com": [0.05, 0.05],
            "inertia": [1e-5, 1e-5],
            "name": "rope",
            **dict.fromkeys(("friction", "dry_friction", "stiffness", "rest_angle", "drag", "tip_mass"), 1e-3),
            "max_bend": 1.0,
            "gravity": [0.0, -9.81],
            "friction_model": "relative",
            "radius": 0.001,
        },
    ),
    "Rope.uniform": (
        hf.Rope.uniform,
        lambda: (
            {"length": 1.0, "mass": 0.1, "n_links": 3, "radius": 0.002, "inertia": None, "friction": 1e-4}
            | {"drag_coefficient": 1.0, "air_density": 1.2, "tip_mass": 0.1}
        ),
    ),
    "Rope.replace": (ROPE.replace, lambda: {"mass": [0.1, 0.2], "gravity": (0.0, -9.81), "name": "other"}),
    "Rope.with_bend_radius": (ROPE.with_bend_radius, lambda: {"radius": 0.1}),
    "Rope.from_table": (hf.Rope.from_table, lambda: {"table": ROPE.table()}),
    "Rope.joints": (ROPE.joints, lambda: {"q": np.zeros(2), "base": np.zeros(2)}),
    "Arm": (
        hf.Arm,
        lambda: (
            dict.fromkeys(("length", "inertia", "mass", "com", "friction", "dry_friction"), 0.1)
            | {"torque_limit": 1.0, "pivot": (0.0, 0.0)}
        ),
    ),
    "Peg": (
        hf.Peg,
        lambda: {"x": 0.1, "y": 0.2, "radius": 0.1, "mu": 0.3, "restitution": 0.1, "inertia": 1.0, "bearing": 0.1},
    ),
    "Wall": (hf.Wall, lambda: {"x": 0.1, "y": 0.2, "x2": 0.1, "y2": 1.0, "mu": 0.3, "restitution": 0.1}),
    "Ground": (hf.Ground, lambda: {"x": 0.1, "y": 0.2, "nx": 0.1, "ny": 1.0, "mu": 0.3, "restitution": 0.1}),
    "Setup": (
        hf.Setup,
        lambda: (
            {"rope": ROPE, "motion": HOLD, "arm": ARM, "torque": None, **START, "arm_angle0": 0.0, "arm_rate0": 0.0}
            | {"method": "extrapolation", "step": None, "pegs": (PEG,), "contact_step": 1e-3, "tip_force": (0.0, 0.0)}
        ),
    ),
    "Setup.loads": (hf.Setup.loads, lambda: {"text": hf.Setup(ROPE).dumps()}),
    "Setup.from_toml": (hf.Setup.from_toml, lambda: {"path": "nowhere.toml"}),
    "refine_rope": (hf.refine_rope, lambda: {"rope": ROPE, "pegs": [PEG], "arm": ARM, "ratio": 0.3}),
    "hold_arm": (hf.hold_arm, lambda: {"angle": 0.1}),
    "move_arm": (hf.move_arm, lambda: {"start": 0.0, "end": 1.0, "duration": 1.0, "profile": "ramp", "ramp": 0.1}),
    "arm_moves": (
        hf.arm_moves,
        lambda: {"angles": [0.0, 1.0, 0.0], "rests": [0.1, 0.1], "durations": [0.3, 0.3], "ramps": 0.2},
    ),
    "arm_strokes": (
        hf.arm_strokes,
        lambda: {"starts": [0.1, 1.5], "t_move": 0.7, "profile": "ramp", "path": "under", "ramp": 0.1, "made": 0},
    ),
    "arm_swings": (
        hf.arm_swings,
        lambda: {"t_move": 0.7, "t_rest": 0.3, "profile": "ramp", "path": "under", "ramp": 0.1},
    ),
    "moving_pivot": (hf.moving_pivot, lambda: SAMPLES | {"x": [0.0, 0.1, 0.2], "y": [0.0, 0.1, 0.2]}),
    "sampled_motion": (hf.sampled_motion, lambda: SAMPLES | {"angle": [0.0, 0.1, 0.2]}),
    "torque_profile": (hf.torque_profile, lambda: SAMPLES | {"torque": [0.0, 0.1, 0.2]}),
    "Motion": (
        hf.Motion,
        lambda: {"breaks": HOLD.breaks, "coef": HOLD.coef, "switch": HOLD.switch, "loop": -1, "spec": {}},
    ),
    "Motion.then": (HOLD.then, lambda: {"other": hf.hold_arm(0.1), "at": 0.5}),
    "Motion.shifted": (HOLD.shifted, lambda: {"delay": 0.5}),
    "Motion.angle": (HOLD.angle, lambda: {"t": 0.5}),
    "simulate": (
        hf.simulate,
        lambda: (
            {"rope": ROPE, "motion": HOLD, "arm": ARM, **START, "t_eval": [0.0, 0.02, 0.05], "method": None}
            | {"step": None, "torque": None, "control_rate": None, "arm_angle0": None, "arm_rate0": None, "state": None}
            | {
                "until": None,
                "pegs": [PEG],
                "contact_step": 1e-3,
                "tip_force": (0.0, 0.1),
                "refine": False,
                "throw": True,
            }
            | {"time_budget": 1.0, "progress": False}
        ),
    ),
    "simulate a torque": (
        hf.simulate,
        lambda: (
            {"rope": ROPE, "arm": hf.Arm(0.1, 1e-3), "torque": 0.1, "arm_angle0": 0.1, "arm_rate0": 0.0}
            | {"duration": 0.05, "control_rate": None, "until": hf.angle_reached(2.0)}
        ),
    ),
    "simulate_batch": (
        hf.simulate_batch,
        lambda: (
            {"ropes": [ROPE, ROPE], "motions": HOLD, "arm": ARM, "duration": 0.05, "q0": [0.1, 0.2]}
            | {"qd0": [0.0, 0.0], "t_eval": [0.0, 0.05], "tol": 1e-4, "step": None, "keep": ("tip",), "pegs": ()}
            | {"contact_step": 2e-4, "refine": True, "time_budget": None, "threads": 1, "progress": False}
        ),
    ),
    "sensitivities": (
        hf.sensitivities,
        lambda: {"rope": ROPE, "motion": HOLD, "arm": ARM, **START, "t_eval": [0.0, 0.05], "wrt": ["friction", "q0"]},
    ),
    "predictability": (
        hf.predictability,
        lambda: {"rope": ROPE, "motion": HOLD, "arm": ARM, **START, "nudges": 1, "seed": 0, "sample_time": 0.05},
    ),
    "Stepper": (hf.Stepper, lambda: {"rope": ROPE, "arm": ARM, "command": "acceleration", "tol": 1e-4, "pegs": [PEG]}),
    "Stepper.step": (lambda **given: stepper().step(stepper().start(), **given), lambda: {"command": 0.1, "dt": 0.02}),
    "BatchStepper": (
        hf.BatchStepper,
        lambda: {"ropes": ROPE, "members": 2, "arm": ARM, "command": "acceleration", "tol": 1e-4, "threads": 1},
    ),
    "tip_crosses": (hf.tip_crosses, lambda: {"point": (0.0, 0.0), "direction": (1.0, 0.0), "sense": 1, "after": 0.0}),
    "angle_reached": (hf.angle_reached, lambda: {"angle": 0.1}),
    "phase_reached": (hf.phase_reached, lambda: {"phase": 0.1, "c": 1.0, "after": 0.0}),
    "tip_speed_peak": (hf.tip_speed_peak, lambda: {"after": 0.0}),
    "Recording": (
        hf.Recording,
        lambda: (
            {"t": [0.0, 0.1, 0.2], "data": np.zeros((3, 1)), "kind": "angles", "noise": 0.1, "rates": None}
            | {"convention": "", "name": "swing", "source": ""}
        ),
    ),
    "Recording.window": (lambda **given: swing().window(**given), lambda: {"start": 0.0, "end": 1.0}),
    "Recording.split": (lambda **given: swing().split(**given), lambda: {"time": 1.0}),
    "Recording.decimate": (lambda **given: swing().decimate(**given), lambda: {"step": 2}),
    "read_recording": (
        hf.read_recording,
        lambda: (
            {"path": "swing.csv", "kind": "angles", "time": "t", "time_unit": "s", "unit": "rad", "y_axis": None}
            | {
                "frame_rate": None,
                "scale": None,
                "zero": "hanging",
                "sense": "+x",
                "angles": "absolute",
                "wrapped": False,
            }
            | {"columns": ["th1"], "noise": 0.1, "max_rate": 300.0, "name": "swing"}
        ),
    ),
    "read_motion": (hf.read_motion, lambda: {"path": "nowhere.csv"}),
    "read_plan": (hf.read_plan, lambda: {"path": "nowhere.toml"}),
    "read_trajectory": (hf.read_trajectory, lambda: {"path": "nowhere.nc"}),
    "identify": (
        hf.identify,
        lambda: (
            {"recording": swing(), "rope_guess": PENDULUM, "free": ("friction",), "setup": None}
            | {"options": hf.FitOptions(window=1.0, intervals=None), "time_budget": None, "progress": False}
        ),
    ),
    "fit_regression": (
        hf.fit_regression,
        lambda: (
            {"rope": PENDULUM, **dict.fromkeys(("q", "qd", "qdd"), np.sin(T)[:, None]), "names": ("friction:shared",)}
            | {"pivot_velocity": None, "pivot_acceleration": None, "arm_angle": 0.0, "arm_rate": 0.0}
        ),
    ),
    "compare_models": (
        hf.compare_models,
        lambda: (
            {"recording": swing(), "rope_guess": PENDULUM, "models": None, "free": ("friction",), "links": ()}
            | {"setup": None, "options": None, "progress": False}
        ),
    ),
    "estimate_initial_state": (
        hf.estimate_initial_state,
        lambda: {"recording": swing(), "rope": PENDULUM, "rates": "rest", "start": None, "max_evaluations": 5},
    ),
    "iterative_revision": (
        hf.iterative_revision,
        lambda: (
            {"recording": swing(), "rope_guess": PENDULUM, "rates": "rest", "profile": "response", "rounds": 1}
            | {"max_evaluations": 5, "progress": None}
        ),
    ),
    "design_experiment": (
        hf.design_experiment,
        lambda: (
            {"rope": ROPE, "want": ("friction",), "candidates": [hf.Experiment("a", q0=[0.1, 0.2], duration=0.5)]}
            | {"arm": None, "noise": 0.002, "free": ("friction",), "progress": False}
        ),
    ),
    "Experiment": (
        hf.Experiment,
        lambda: (
            {"name": "a", "motion": HOLD, "q0": [0.1, 0.2], "qd0": [0.0, 0.0], "rate": 30.0, "duration": 0.5}
            | {"markers": 2, "noise": 1e-3, "torque_noise": None}
        ),
    ),
    "MotorLimits": (hf.MotorLimits, lambda: {"speed": 8.0, "acceleration": 20.0, "torque": 2.0, "angles": (-3.0, 3.0)}),
    "TipTarget": (
        hf.TipTarget,
        lambda: {"x": 0.1, "y": 0.2, "direction": 0.1, "least_speed": 1.0, "angle_tolerance": 0.1},
    ),
    "Problem": (hf.Problem, lambda: {"rope": CABLE, "arm": ARM, "limits": hf.MotorLimits(), "time": 1.0}),
    "plan_cast": (
        hf.plan_cast,
        lambda: (
            {"rope": CABLE, "arm": ARM, "target": hf.Peg(5.0, 0.0, 0.05), "limits": hf.MotorLimits()}
            | {"criteria": hf.WindCriteria(), "conditions": hf.Conditions(time_limit=2.0), "uncertainty": None}
            | {"time_budget": 0.1, "options": hf.SearchOptions(threads=1)}
        ),
    ),
    "plan_whip": (
        hf.plan_whip,
        lambda: (
            {"rope": CABLE, "arm": ARM, "target": hf.TipTarget(5.0, 0.0, 0.0), "limits": hf.MotorLimits()}
            | {"conditions": hf.Conditions(time_limit=2.0), "whip_map": None}
            | {"time_budget": 0.1, "options": hf.SearchOptions(threads=1)}
        ),
    ),
    "plan_insert": (
        hf.plan_insert,
        lambda: (
            {"rope": CABLE, "arm": ARM, "slot": hf.Slot(5.0, 0.0, 0.0), "limits": hf.MotorLimits()}
            | {"conditions": hf.Conditions(time_limit=2.0), "uncertainty": hf.Uncertainty()}
            | {"samples": 2, "time_budget": 0.1, "options": hf.SearchOptions(threads=1)}
        ),
    ),
    "measure_winding": (hf.measure_winding, lambda: {"run": run(), "peg": PEG}),
    "rope_slip": (hf.rope_slip, lambda: {"run": run(), "peg": PEG, "since": 0.05}),
    "rope_tension": (hf.rope_tension, lambda: {"run": run()}),
    "tug_test": (hf.tug_test, lambda: {"run": run(), "peg": PEG, "speed": 0.5, "distance": 0.005, "allowed": 0.005}),
    "forward_kinematics": (
        hf.forward_kinematics,
        lambda: {"rope": ROPE, "q": [0.1, 0.2], "arm": ARM, "arm_angle": 0.1},
    ),
    "mass_matrix": (hf.mass_matrix, lambda: {"rope": ROPE, "q": [0.1, 0.2], "arm": ARM, "arm_angle": 0.1}),
    "linearize": (
        hf.linearize,
        lambda: (
            {"rope": ROPE, "arm": ARM, "q": [0.1, 0.2], "qd": [0.0, 0.0], "arm_angle": 0.1, "arm_rate": 0.0}
            | {"command": "acceleration", "u": 0.0, "dt": 0.01}
        ),
    ),
}
# Made anew for each example: some can be used up.
ODD: dict[str, Callable[[], Any]] = {
    "None": lambda: None,
    "empty text": lambda: "",
    "text": lambda: "text",
    "number as text": lambda: "1.0",
    "bytes": lambda: b"x",
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "-inf": lambda: float("-inf"),
    "-1": lambda: -1,
    "0": lambda: 0,
    "2.5": lambda: 2.5,
    "huge": lambda: 1e308,
    "-huge": lambda: -1e308,
    "integer beyond floats": lambda: 10**400,
    "integer of 5000 digits": lambda: 10**5000,
    "tiny": lambda: 1e-320,
    "True": lambda: True,
    "complex": lambda: 1.0 + 1.0j,
    "empty list": list,
    "nested nothing": lambda: [[]],
    "list with nan": lambda: [float("nan"), 0.0],
    "list with None": lambda: [None, None],
    "ragged": lambda: [[0.1], [0.2, 0.3]],
    "seven numbers": lambda: [1.0] * 7,
    "two huge": lambda: [1e308, -1e308],
    "three axes": lambda: np.zeros((2, 3, 4)),
    "complex array": lambda: np.zeros(2, dtype=complex),
    "texts": lambda: np.array(["a", "b"]),
    "dates": lambda: np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[D]"),
    "mapping": lambda: {"a": 1.0},
    "set": lambda: {1.0, 2.0},
    "object": object,
    "function": lambda: abs,
    "class": lambda: float,
    "generator": lambda: (x for x in (0.1, 0.2)),
    "deep": lambda: functools.reduce(lambda inner, _: [inner], range(3000), []),
    "long text": lambda: "x" * 100_000,
    "path": Path,
    "half a surrogate pair": lambda: "\ud800",
    "rope": lambda: ROPE,
    "peg": lambda: PEG,
    "two ropes": lambda: [ROPE, ROPE],
}
CASES = [(name, argument) for name, (_, make) in CALLS.items() for argument in make()]


def odd_call(name: str, argument: str, odd: str) -> None:
    call, sound = CALLS[name]
    if odd in ("class", "function") and argument in ("progress", "torque"):
        return  # these are called, and fail in their own way
    count()
    refused_or_done(lambda: call(**{**sound(), argument: ODD[odd]()}), seconds=10.0)


@pytest.mark.filterwarnings("default")
@examples(60)
@given(st.sampled_from(CASES), st.sampled_from(sorted(ODD)))
def test_odd_arguments_are_refused_in_words(case, odd):
    odd_call(*case, odd)


def test_sound_arguments_pass(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, (call, sound) in CALLS.items():
        parameters = inspect.signature(call).parameters
        fields = any(each.kind is each.VAR_KEYWORD for each in parameters.values())
        assert set(sound()) <= set(parameters) or fields, name
        done = refused_or_done(lambda call=call, sound=sound: call(**sound()), seconds=60.0)
        assert done is not None or "read" in name or "from_toml" in name, name
