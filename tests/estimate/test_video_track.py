"""A video tracked as a whole: its threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from hyperflex.errors import InvalidInput
from hyperflex.estimate import RopeFilter, RopeTracker, track_video
from hyperflex.vision import Camera, MarkerColour, MarkerDetector, VideoWriter
from tests.estimate.runs import rope


def test_linear_algebra_keeps_to_one_thread_and_gives_the_others_back(tmp_path: Path) -> None:
    """Threads wait for each other at small matrices: two of them on two busy cores take ten times as long as one."""

    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    with VideoWriter(tmp_path / "dark.mp4", (320, 240)) as writer:
        for time in (0.0, 0.1, 0.2):
            writer.write(np.zeros((240, 320, 3), np.uint8), time)
    camera = Camera.facing((320, 240), pixels_per_metre=100.0, origin=(160.0, 10.0))
    colour, inside = MarkerColour(np.array([40.0, 30.0, 210.0])), []
    tracker = RopeTracker(RopeFilter(rope(5), [1.0, 2.0], camera=camera), MarkerDetector(colour))
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        with pytest.raises(InvalidInput, match="not found in the video"):
            track_video(tmp_path / "dark.mp4", tracker, progress=lambda _: inside.append(threads()))
        assert threads() == before
    assert inside == [{1}] * 3
