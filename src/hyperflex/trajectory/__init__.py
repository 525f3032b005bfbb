"""Trajectories: what a rollout leaves behind, and its NetCDF file."""

from hyperflex.trajectory.netcdf import read_trajectory
from hyperflex.trajectory.run import State, Trajectory, swept

__all__ = ["State", "Trajectory", "read_trajectory", "swept"]
