"""Files of motion trackers: recognised by content, and read to the last digit."""

import math

import numpy as np
import pytest

from hyperflex.recording import read_recording
from tests.recording.samples import ANGLE, COUNT, SAMPLES, TIP, Sample
from tests.refusals import refuses


def written(tmp_path, sample: Sample, suffix: str | None = None):
    path = tmp_path / f"swing{sample.suffix if suffix is None else suffix}"
    path.write_bytes(sample.content)
    return path


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("suffix", [None, ".dat"])
def test_a_file_is_read_to_the_last_digit(tmp_path, name, suffix):
    sample = SAMPLES[name](tmp_path)
    recording = read_recording(written(tmp_path, sample, suffix), **sample.arguments)
    # Both are the same decimals, converted to m and s: some roundings of the last bit. Tracker's axes are rotated, and
    # stamps since 1970 have 2e-7 s.
    loose = {"trk": 1e-12, "plotjuggler": 1e-6}.get(name, 1e-15)
    np.testing.assert_allclose(recording.t, sample.t, rtol=1e-15, atol=loose if name == "plotjuggler" else 1e-15)
    np.testing.assert_allclose(recording.data, sample.data, rtol=1e-14, atol=loose)
