"""Measured data: link angles or marker positions with their times, gaps and noise, and readers for common files."""

from hyperflex.recording.mcap import JOINT_STATES, MCAP_FORMAT, MCAP_METADATA, POSES_IN_FRAME
from hyperflex.recording.read import read_recording
from hyperflex.recording.recording import Recording, unwrap

__all__ = [
    "JOINT_STATES",
    "MCAP_FORMAT",
    "MCAP_METADATA",
    "POSES_IN_FRAME",
    "Recording",
    "read_recording",
    "unwrap",
]
