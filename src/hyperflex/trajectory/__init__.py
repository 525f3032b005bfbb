"""Trajectories: the result of a rollout, the state to go on from, and their NetCDF file."""

from hyperflex.trajectory.netcdf import read_trajectory
from hyperflex.trajectory.run import State, Trajectory, swept

__all__ = ["State", "Trajectory", "read_trajectory", "swept"]
