"""Trajectories and their NetCDF files."""

from hyperflex.trajectory.netcdf import read_trajectory
from hyperflex.trajectory.run import State, Trajectory, swept

__all__ = ["State", "Trajectory", "read_trajectory", "swept"]
