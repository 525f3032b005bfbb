"""Measured data: link angles or marker positions with their times, gaps and noise, and readers for common files."""

from hyperflex.recording.content import Content
from hyperflex.recording.declare import FASTEST, Declarations, Raw, to_recording
from hyperflex.recording.messages import JOINT_STATES, MCAP_FORMAT, MCAP_METADATA, POSES_IN_FRAME
from hyperflex.recording.read import propose, python_line, read_channels, read_recording
from hyperflex.recording.recording import UNIT, Recording, unwrap

__all__ = [
    "FASTEST",
    "JOINT_STATES",
    "MCAP_FORMAT",
    "MCAP_METADATA",
    "POSES_IN_FRAME",
    "UNIT",
    "Content",
    "Declarations",
    "Raw",
    "Recording",
    "propose",
    "python_line",
    "read_channels",
    "read_recording",
    "to_recording",
    "unwrap",
]
