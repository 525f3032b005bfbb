"""Measured data: link angles or marker positions with their times, gaps and noise, and readers for common files."""

from hyperflex.recording.read import read_recording
from hyperflex.recording.recording import Recording, unwrap

__all__ = ["Recording", "read_recording", "unwrap"]
