"""The demo's recording: simulated by a finer rope, said so, and made by the code that is here."""

from __future__ import annotations

import numpy as np
import pytest

from hyperflex.demo import twin


def test_the_bundled_file_is_what_the_generator_makes():
    bundled, made = twin.bundled(), twin.record()
    # Rounded to 1e-5 m on writing; another machine's rounding may move a simulated marker by far less than that.
    np.testing.assert_allclose(bundled.data, made.data, atol=1.1e-5)
    np.testing.assert_allclose(bundled.t, made.t, atol=1e-6)
    assert bundled.gaps == made.gaps > 0


def test_the_recording_says_that_it_is_simulated():
    recording = twin.bundled()
    assert "simulated" in recording.name
    assert "simulated" in recording.source
    assert "40 links" in recording.source
    assert "simulated" in twin.BUNDLED.read_text("utf-8").splitlines()[0]


def test_the_rope_that_made_it_is_finer_than_the_one_fitted():
    assert twin.fine_rope().n_links == 4 * twin.coarse_rope().n_links == 4 * twin.bundled().n_links
    for rope in (twin.fine_rope(), twin.coarse_rope()):
        assert rope.total_length == pytest.approx(2.0, rel=1e-14)
        assert rope.total_mass == pytest.approx(0.125, rel=1e-14)


def test_a_coarse_joint_does_the_work_of_fine_ones_in_series():
    # Bent evenly at rate k (rad/m/s), the power is sum of friction (k l)^2 over the inner joints: alike for both cuts,
    # but for the first link length, which has no inner joint.
    fine, coarse = twin.fine_rope(), twin.coarse_rope()
    power = [(rope.friction[1:] * rope.length[1:] ** 2).sum() for rope in (fine, coarse)]
    assert power[0] / power[1] == pytest.approx((39 / 40) / (9 / 10), rel=1e-12)
    assert fine.friction[0] == coarse.friction[0]


def test_the_noise_has_the_size_that_is_declared():
    spread = np.nanstd(twin.record().data - twin.record(noise=1e-12, lost=0.0).data)
    # 6,600 samples: the standard deviation is known within 0.9 % (one sigma).
    assert spread == pytest.approx(twin.NOISE, rel=0.03)


@pytest.mark.slow
def test_the_mapped_truth_is_what_a_fit_without_noise_finds():
    found = twin.fit(twin.record(noise=0.0, lost=0.0)).values
    for name, value in twin.mapped_truth().items():
        # The fit stops when parameters move by less than a tenth of their standard deviation, here 1 to 2 %.
        assert float(found[name][0]) == pytest.approx(value, rel=2e-3), name
