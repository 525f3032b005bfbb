"""Claim C8 of the source paper, Fig. 8: its online estimator, compared with ours and with trackers without dynamics.
Rendered."""

import numpy as np
import pytest

from hyperflex.paper.estimation import DRAWN, PART, captures_all, followed, in_time, seen
from hyperflex.paper.estimator import SAMPLES

pytestmark = pytest.mark.claims


def test_c8_the_capture_rate_goes_to_all():
    """0.995: one marker of 200. Measured 1 in each of ten swings, whatever the first frames lose."""
    claim = captures_all(DRAWN)
    assert claim.measured >= 0.995, claim.note
    assert claim.holds


def test_c8_the_first_frames_may_lose_markers():
    """Rates are not known at first: two frames lose markers, as in the paper; then errors fall."""
    run = followed("paper", DRAWN.seed)
    assert (run.captured_share[1:3] < 1.0).all()
    assert run.expected_error[1] > 0.1  # m; the rope is in the middle of its swing
    assert np.median(run.expected_error[10:]) < 0.005


def test_c8_looking_and_simulating_take_less_than_they_look_ahead():
    """Measured 0.06 to 0.2 of t_sim on a busy machine of two cores."""
    claim = in_time(DRAWN)
    assert claim.measured < 1.0, claim.note
    assert "T_v = " in claim.note
    assert "alpha = " in claim.note


def test_ours_captures_all_and_is_as_exact_as_is_required():
    """Asked: 3 mm at frames, 5 mm between, 2 % of speeds, 5 % of rates. Measured 1.5 mm, 2.4, 0.8 and 3.3 %."""
    found = followed("filter", DRAWN.seed).summary()
    assert found["captured"] >= 0.995
    assert found["tip"] < 3e-3
    assert found["between"] < 5e-3
    assert found["velocity"] < 0.02
    assert found["rates"] < 0.05


def test_without_a_marker_on_the_tip():
    """Asked: 10 mm."""
    found = followed("filter", DRAWN.seed, on_tip=False).summary()
    assert found["captured"] >= 0.995
    assert found["tip"] < 0.010


def test_trackers_without_dynamics_lose_a_third_or_more():
    """Measured 59 % captured at constant velocity and 40 % by the nearest blob; a marker moves 0.37 m in a frame."""
    assert followed("constant velocity", DRAWN.seed).summary()["captured"] < 0.75
    assert followed("nearest blob", DRAWN.seed).summary()["captured"] < 0.6


def test_the_state_is_continuous_between_frames():
    """The paper's estimator knows the tip at any time: its prediction determines the search region."""
    run = followed("paper", DRAWN.seed)
    assert not np.isnan(run.tip).any()
    np.testing.assert_allclose(run.tip[:-1, -1], run.expected[1:, -1], atol=1e-6)
    assert run.summary()["between"] < 0.01
    assert run.tip.shape[1] == SAMPLES + 1


def test_markers_are_1_5_mm_off():
    run = followed("filter", DRAWN.seed)
    off = (run.places - run.seen.truth.places[:, :, :2])[10:]
    assert np.sqrt(np.nanmean(off**2)) == pytest.approx(0.0015, rel=0.15)
    assert seen(DRAWN) is run.seen


def test_the_table_behind_the_figure():
    columns = PART.items["fig8"].table().columns
    assert len({len(column) for column in columns.values()}) == 1
    assert np.nanmax(np.abs(columns["x_paper"] - columns["x_true"])[-20:]) < 0.02
    assert (columns["visible"] <= 10.0).all()
