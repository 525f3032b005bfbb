"""Trajectories: the result of a rollout, the state to go on from, and their NetCDF file."""

from hyperflex.trajectory.netcdf import read_trajectory
from hyperflex.trajectory.run import State, Trajectory, interpolated, swept

__all__ = ["State", "Trajectory", "interpolated", "read_trajectory", "swept"]
