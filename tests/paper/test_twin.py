"""The demo's video: simulated by a finer rope, said so, made by the code that is here, and tracked well."""

import numpy as np
import pytest

from hyperflex.demo import twin
from hyperflex.vision import VideoReader


@pytest.fixture(scope="module")
def tracked():
    return twin.track()


def test_the_bundled_video_is_what_the_generator_makes(tmp_path):
    twin.film(tmp_path / "made.mp4", seconds=1.0)
    with VideoReader(tmp_path / "made.mp4") as made, VideoReader(twin.BUNDLED) as bundled:
        pairs = list(zip(made, bundled, strict=False))
    assert len(pairs) == 30
    for ours, theirs in pairs:
        assert ours.time == theirs.time
        off = np.abs(ours.image.astype(int) - theirs.image)
        # Another release of x264 may choose other bits for the same picture; both are within a few levels of it.
        assert np.median(off) <= 2.0
        assert np.quantile(off, 0.999) <= 25.0


def test_the_markers_are_where_the_rope_was(tracked):
    """Within 3 mm rms (0.7 px), none farther off than its stated standard deviation allows."""
    recording = twin.recording(tracked)
    joints = twin.swing(recording.t).joints[:, :: twin.FINE // twin.COARSE]
    off = recording.data.reshape(joints.shape) - joints
    assert np.sqrt(np.nanmean(off[:, 1:] ** 2)) < 3e-3
    assert tracked.found_at < 0.2
    assert 0.9 < tracked.seen < 1.0
    assert ("simulated" in recording.name, "simulated" in recording.source) == (True, True)
    assert "40 links" in recording.source


@pytest.mark.nightly
def test_the_mapped_truth_is_what_a_fit_without_noise_finds():
    found = twin.fit(twin.exact()).values
    for name, value in twin.mapped_truth().items():
        # The fit stops when parameters move by less than a tenth of their standard deviation, here 1 to 2 %.
        assert float(found[name][0]) == pytest.approx(value, rel=2e-3), name
