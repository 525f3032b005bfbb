"""Identification of a drive, against a finer one: current loop, encoder steps, jitter, torque and speed limits."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import FileProblem
from hyperflex.hardware import (
    DriveFit,
    DriveModel,
    DriveRecord,
    DriveZero,
    SimulatedMotor,
    identify_drive,
    plan_test_motion,
)
from hyperflex.planning import MotorLimits, Uncertainty
from tests.hardware.twin import Truth, drawn, record_of
from tests.refusals import refuses


@pytest.fixture(scope="module")
def record() -> DriveRecord:
    return record_of(Truth())


@pytest.fixture(scope="module")
def fit(record) -> DriveFit:
    return identify_drive(record)


def truths(truth: Truth) -> dict[str, float]:
    found = {"lag": truth.lag, "rate_limit": truth.rate_limit, "backlash": truth.backlash}
    if truth.tells_torque:
        found |= {"inertia": truth.inertia, "friction": truth.friction, "dry_friction": truth.dry_friction}
        found["weight_torque"] = truth.weight
    return found


def test_lag_and_rate_limit_are_found(fit):
    """Within 1 ms and 2 %, which a cast requires; an encoder step is 1.5 mrad, and stamps jitter by 1 ms."""
    assert fit.success
    assert not fit.doubt
    assert fit.lag == pytest.approx(Truth().lag, abs=1e-3)
    assert fit.values["rate_limit"] == pytest.approx(Truth().rate_limit, rel=0.02)
    assert fit.values["inertia"] == pytest.approx(Truth().inertia, rel=0.1)
    assert fit.residual < 2.0 * math.tau / 4096
    assert not fit.intervals.keys() & {"delay", "frequency", "damping", "feedforward"}  # they were too narrow


@pytest.mark.nightly
def test_twenty_drives():
    inside = []
    for seed in range(20):
        truth = drawn(seed)
        fit = identify_drive(record_of(truth))
        assert fit.lag == pytest.approx(truth.lag, abs=1e-3), seed
        assert fit.values["rate_limit"] == pytest.approx(truth.rate_limit, rel=0.02), seed
        known = truths(truth)
        inside += [fit.intervals[name][0] <= known[name] <= fit.intervals[name][1] for name in known]
    assert np.mean(inside) >= 0.93


@pytest.mark.nightly
def test_a_drive_outside_the_model_class_is_doubted():
    """Cogging of 2 % of the stall torque, and twice the dry friction near rest; the quantities of a cast are right."""
    right = drawn(40)
    assert not identify_drive(record_of(right)).doubt
    truth = replace(right, cogging=0.02 * right.stall, sticking=1.0)
    fit = identify_drive(record_of(truth))
    assert "cogging" in fit.doubt
    assert "more friction near rest" in fit.doubt
    assert fit.lag == pytest.approx(truth.lag, abs=1e-3)
    assert fit.values["rate_limit"] == pytest.approx(truth.rate_limit, rel=0.02)


def test_lag_of_the_model_is_its_delay_at_constant_speed():
    model = DriveModel(0.01, 50.0, 1.2, 0.3, hold=0.005)
    t = np.arange(0.0, 3.0, 0.005)
    grid, angle, *_ = model.respond(t, 2.0 * t, np.full(t.size, 2.0))
    late = grid[-1] - angle[-1] / 2.0
    at = np.arange(2.0, 2.9, 1e-3)  # over many periods of the held goal
    late = float(np.mean(at - np.interp(at, grid, angle) / 2.0))
    assert late == pytest.approx(model.lag, abs=1e-4)  # a step of the model is 0.25 ms
    assert model.lag == pytest.approx(0.01 + 0.0025 + 2.0 * 1.2 * 0.7 / 50.0)


@pytest.mark.parametrize("limits", [{}, {"rate_limit": 3.0, "slope": 60.0, "acceleration_limit": 150.0}])
@pytest.mark.parametrize("hold", [0.0, 5e-3])
def test_the_model_moves_as_its_equations_say(limits, hold):
    """Against an integration in steps of 20 microseconds; the model takes 250, at speeds up to 4.5 rad/s."""
    model = DriveModel(4e-3, 80.0, 0.8, 0.6, viscous=3.0, weight=15.0, hold=hold, current_lag=1e-3, **limits)
    t = np.arange(0.0, 0.5, 5e-3)
    angles, rates = 0.5 * np.sin(9.0 * t) ** 2, 4.5 * np.sin(18.0 * t)
    grid, angle, rate, effort = model.respond(t, angles, rates)
    y, v, e, seen = 0.0, 0.0, 0.0, []
    h = 2e-5
    for now in np.arange(0.0, grid[-1] + h, h):
        k = np.searchsorted(t, max(now + 0.5 * h - 4e-3, 0.0), "right") - 1
        goal = angles[k] + (0.0 if hold else rates[k] * max(now + 0.5 * h - 4e-3 - t[k], 0.0))
        speed = v + 0.5 * h * (e - 3.0 * v - 15.0 * math.sin(y))
        most = min(model.acceleration_limit, model.slope * (model.rate_limit - speed) + 3.0 * model.rate_limit)
        least = -min(model.acceleration_limit, model.slope * (model.rate_limit + speed) + 3.0 * model.rate_limit)
        wanted = max(
            least, min(most, 80.0**2 * (goal - y - 0.5 * h * v) + 128.0 * (0.6 * rates[k] - speed) + 3.0 * speed)
        )
        seen.append((now, y, v, e))
        e += (wanted - e) * -math.expm1(-h / 1e-3)
        v += h * (e - 3.0 * speed - 15.0 * math.sin(y))
        y += h * v
    fine = np.array(seen).T
    assert angle == pytest.approx(np.interp(grid, fine[0], fine[1]), abs=2e-4)
    assert rate == pytest.approx(np.interp(grid, fine[0], fine[2]), abs=0.01)
    middle = grid[1:] - 0.5 * np.diff(grid)
    missed = effort[1:] - np.interp(middle, fine[0], fine[3])  # most where a goal is new within a step
    assert np.sqrt(np.mean(missed**2)) < 0.02 * np.abs(effort).max()


def test_without_reaching_it_the_rate_limit_is_not_reported(record):
    """The first 7 s of the motion have the slower moves."""
    columns = (getattr(record, each.name)[record.sent < 7.0] for each in fields(record))
    fit = identify_drive(DriveRecord(*columns))
    assert "rate_limit" not in fit.values
    assert fit.reached[0] == pytest.approx(1.15, rel=0.01)
    assert math.isinf(fit.model.rate_limit)


def test_the_identified_drive_is_the_planners_motor(fit):
    assert isinstance(fit.motor(), SimulatedMotor)
    assert fit.motor().lag == fit.lag
    limits = fit.motor_limits(hf.MotorLimits(speed=20.0))
    assert 0.97 * Truth().rate_limit < limits.speed < 1.01 * Truth().rate_limit
    problem = hf.Problem(hf.Rope.uniform(1.0, 0.05, n_links=5, friction=0.0), hf.Arm(), hf.MotorLimits())
    lags = [each.lag for each in Uncertainty(drive=fit).sample(50, problem, hf.Peg(0.5, -0.5, 0.03))]
    assert np.mean(lags) == pytest.approx(fit.lag, abs=2.0 * fit.lag_std)
    assert "identified lag" in Uncertainty(drive=fit).describe()
    assert "lag 10 ms" not in Uncertainty(drive=fit).describe()


def test_a_file_gives_the_same_drive(fit, tmp_path):
    fit.to_toml(tmp_path / "drive.toml")
    again = DriveFit.from_toml(tmp_path / "drive.toml")
    assert (again.values, again.intervals, again.model) == (fit.values, fit.intervals, fit.model)
    (tmp_path / "other.toml").write_text("[drive]\nvalues = 3\n")
    refuses("no identified drive", DriveFit.from_toml, tmp_path / "other.toml")
    with pytest.raises(FileProblem):
        DriveFit.from_toml(tmp_path / "none.toml")
    refuses("no record", again.plot)
    assert len(fit.plot().axes) == 3


def test_the_test_motion_keeps_to_its_limits():
    limits = MotorLimits(speed=6.0, acceleration=60.0, angles=(-0.2, 1.0))
    motion = plan_test_motion(limits, 0.1)
    t = np.linspace(0.0, motion.breaks[-1], 20000)
    assert (motion.angle(t) >= -0.2).all()
    assert (motion.angle(t) <= 1.0).all()
    assert np.abs(motion.rate(t)).max() <= 6.0
    assert np.abs(motion.acceleration(t)).max() <= 60.0
    assert motion.angle(t[-1:])[0] == pytest.approx(0.1)
    refuses("no room", plan_test_motion, MotorLimits(angles=(-0.1, 0.2)), 0.0)


def test_zero_file(tmp_path):
    DriveZero(1.5, -1, "moteus:/dev/ttyACM0").to_toml(tmp_path / "zero.toml")
    assert DriveZero.from_toml(tmp_path / "zero.toml") == DriveZero(1.5, -1, "moteus:/dev/ttyACM0")
    (tmp_path / "other.toml").write_text("[zero]\nangle = 3\n")
    refuses("no zero of a drive", DriveZero.from_toml, tmp_path / "other.toml")
    refuses("direction", DriveZero, 0.0, 2)
