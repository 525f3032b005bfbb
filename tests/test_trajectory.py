"""Trajectory: kinematics, energies, and NetCDF files that are whole, lossless and refused when they are not ours."""

import dataclasses

import numpy as np
import pytest

from hyperflex.errors import FileProblem
from hyperflex.model import Arm, Rope, Setup
from hyperflex.motion import arm_swings
from hyperflex.status import Status
from hyperflex.trajectory import State, Trajectory, read_trajectory
from tests.refusals import fails, refuses

SAMPLES, LINKS = 7, 3
LENGTH = np.array([0.3, 0.2, 0.5])


def made_up(seed: int = 1, **changes) -> Trajectory:
    """Return a trajectory of smooth made-up angles whose velocities are their exact derivatives."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 0.6, SAMPLES)
    phase = rng.uniform(0.0, 6.0, LINKS)
    q, qd, qdd = (f(3.0 * t[:, None] + phase) * 3.0**k for k, f in enumerate((np.sin, np.cos, lambda x: -np.sin(x))))
    base = np.stack([0.1 * t, -0.2 * t**2], axis=1)
    rope = Rope.uniform(length=1.0, mass=0.3, n_links=LINKS, friction=1e-3).replace(length=LENGTH, com=LENGTH / 2)
    setup = Setup(rope=rope, arm=Arm(length=0.1), motion=arm_swings(), duration=0.6)
    parts = {"t": t, "q": q, "qd": qd, "qdd": qdd, "base": base, "setup": setup}
    parts |= {
        "base_velocity": np.stack([np.full_like(t, 0.1), -0.4 * t], axis=1),
        "arm_angle": t - 1.0,
        "arm_rate": np.ones_like(t),
        "kinetic_energy": rng.uniform(size=SAMPLES),
        "potential_energy": rng.uniform(size=SAMPLES),
        "dissipated_energy": t**2,
        "motor_work": np.sin(t),
        "motor_torque": np.cos(t),
        "state": State(
            0.6, q[-1], qd[-1], 0.05, 0.5, 0.25, {"table": rng.uniform(size=(2, 3)), "order": 6, "err": 0.1}
        ),
        "start": State(0.0, q[0], qd[0]),
        "attrs": {"method": "extrapolation", "tol": 1e-6, "nothing": None},
    }
    return Trajectory(**{**parts, **changes})


def test_dataset_carries_units_and_the_setup():
    dataset = made_up().dataset
    assert set(dataset.dims) == {"time", "link", "joint", "axis"}
    for name in dataset.data_vars:
        assert dataset[name].attrs["units"], name
        assert dataset[name].attrs["long_name"], name
    assert dataset.attrs["source"] == "simulated"
    assert dataset.attrs["tol"] == 1e-6
    assert "nothing" not in dataset.attrs
    assert Setup.loads(dataset.attrs["setup"]).arm.length == 0.1
    assert dataset["tip"].sel(axis="y").shape == (SAMPLES,)


def test_arrays_are_read_only_and_fit():
    run = made_up()
    for name in ("q", "tip", "tip_velocity", "joints", "motor_torque"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(run, name)[0] = 0.0
    for name in ("q", "base", "arm_angle"):
        refuses("wrong shape", made_up, **{name: np.zeros((SAMPLES, LINKS + 1))})


def test_netcdf_keeps_every_bit(tmp_path):
    run = made_up(status=Status.NOT_FINITE, message="it blew up at 0.6 s")
    path = tmp_path / "run.nc"
    run.to_netcdf(path)
    back = read_trajectory(path)
    for name in ("t", "q", "qd", "qdd", "joints", "tip_velocity", "arm_angle", "energy_error", "motor_torque"):
        np.testing.assert_array_equal(getattr(back, name), getattr(run, name), err_msg=name)
    assert (back.status, back.message) == (run.status, run.message)
    assert back.attrs == {"method": "extrapolation", "tol": 1e-6}
    assert back.setup.dumps() == run.setup.dumps()
    for name in ("t", "step", "work", "dissipated"):
        assert getattr(back.state, name) == getattr(run.state, name)
    assert all(isinstance(getattr(back.state, name), float) for name in ("t", "step", "work", "dissipated"))
    np.testing.assert_array_equal(back.state.q, run.state.q)
    np.testing.assert_array_equal(back.state.qd, run.state.qd)
    assert back.state.checkpoint.keys() == run.state.checkpoint.keys()
    for name, value in run.state.checkpoint.items():
        np.testing.assert_array_equal(back.state.checkpoint[name], value, err_msg=name)
        assert type(back.state.checkpoint[name]) is type(value)


def test_missing_empty_truncated_and_foreign_files_are_named(tmp_path):
    import xarray as xr

    path = tmp_path / "run.nc"
    fails(FileProblem, r"no NetCDF-4 file .*run\.nc", read_trajectory, path)
    made_up().to_netcdf(path)
    whole = path.read_bytes()
    for size in (0, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        fails(FileProblem, r"cut off|empty|no NetCDF-4", read_trajectory, path)
    path.write_text("t,th1\n0,0\n")
    refuses("no NetCDF-4", read_trajectory, path)
    xr.Dataset({"q": ("time", [1.0])}).to_netcdf(path, engine="h5netcdf")
    refuses("not a hyperflex trajectory", read_trajectory, path)


def test_the_file_opens_in_xarray_as_the_dataset_of_the_run(tmp_path):
    import xarray as xr

    run = made_up()
    run.to_netcdf(tmp_path / "run.nc")
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as opened:
        xr.testing.assert_identical(opened.load(), run.dataset)


def test_a_long_setup_fits_into_the_file(tmp_path):
    from hyperflex.motion import sampled_motion

    run = made_up()
    t = np.linspace(0.0, 30.0, 30001)
    long = dataclasses.replace(run, setup=dataclasses.replace(run.setup, motion=sampled_motion(t, np.sin(t))))
    assert len(long.setup.dumps()) > 500_000  # HDF5 keeps at most 64 KiB of an attribute in its header
    long.to_netcdf(tmp_path / "run.nc")
    assert read_trajectory(tmp_path / "run.nc").setup.dumps() == long.setup.dumps()
