"""Claims C2, C3 and C4 of the source paper, section IV: casting by swinging, open loop."""

import numpy as np
import pytest

from hyperflex.paper import READINGS
from hyperflex.paper.casting import (
    PART,
    cast,
    concentration,
    run,
    steady_step_phase,
    straight_phase,
    success_over_failure,
)

pytestmark = pytest.mark.claims

each_reading = pytest.mark.parametrize("reading", READINGS, ids=lambda reading: reading.key)

# Greatest |x| of the tip, m, in each 2 s from 0 to 14 s, found by an independent prototype (RK4 at 2e-4 s) and printed
# with two decimals.
PROTOTYPE = {
    ("under_relative", "success"): (0.61, 1.08, 1.30, 1.79, 1.98, 2.05, 2.06),
    ("under_relative", "failure"): (0.61, 1.03, 1.07, 1.03, 1.18, 1.10, 1.08),
    ("under_printed", "success"): (0.61, 1.08, 1.38, 1.79, 1.99, 2.05, 2.05),
    ("under_printed", "failure"): (0.60, 1.01, 1.16, 1.21, 1.12, 1.13, 1.10),
    ("over_relative", "success"): (0.60, 0.99, 1.29, 1.49, 1.63, 1.81, 1.84),
    ("over_relative", "failure"): (0.65, 1.26, 1.53, 1.61, 1.57, 1.01, 0.80),
    ("over_printed", "success"): (0.57, 0.99, 1.26, 1.54, 1.64, 1.81, 1.84),
    ("over_printed", "failure"): (0.61, 1.17, 1.48, 1.65, 1.56, 1.06, 0.88),
}


@each_reading
@pytest.mark.parametrize("outcome", ["success", "failure"])
def test_reach_agrees_with_an_independent_prototype(reading, outcome):
    # Two decimals were printed, so half a centimetre; 1 mm more for the integrators, which agree far better than that.
    np.testing.assert_allclose(cast(reading, outcome).reaches, PROTOTYPE[reading.key, outcome], atol=0.006)


@each_reading
def test_c2_a_rest_of_053_s_succeeds_and_034_s_fails(reading):
    # Threshold 1.6: the four readings give 1.73 to 1.87, so it leaves 8 % to whatever the paper leaves open.
    claim = success_over_failure(reading)
    assert claim.measured >= 1.6, claim.note
    assert claim.holds


@each_reading
def test_c3_theta_is_straight_for_the_success(reading):
    # Threshold 0.995: R^2 is 0.9984 to 0.9994; 0.995 allows an rms of 7 % of the line's own standard deviation.
    claim = straight_phase(reading)
    assert claim.measured >= 0.995, claim.note
    assert claim.measured <= 1.0


@each_reading
def test_c3_reports_the_failures_straightness_beside_the_success(reading):
    swing = cast(reading, "failure").spiral
    late = swing.t >= 2.0
    correlation = np.corrcoef(swing.t[late], swing.theta[late])[0, 1]  # its square is R^2 of a straight line
    note = straight_phase(reading).note
    assert f"the failure's R^2, for information: {correlation**2:.4f}" in note
    assert ("does not tell the two apart" in note) == (correlation**2 >= 0.995)


@pytest.mark.parametrize("reading", [r for r in READINGS if r.path == "over"], ids=lambda reading: reading.key)
def test_c4_r_rises_at_one_phase_over_the_top(reading):
    # Threshold 0.9: phases within about a fourteenth of the half cycle (one standard deviation). Found: 0.92, 0.93.
    claim = steady_step_phase(reading)
    assert claim.measured >= 0.9, claim.note
    # Fig. 12: the radius grows while the arm rests, that is in the later part of the half cycle.
    assert "when the arm rests" in claim.note


@pytest.mark.parametrize("reading", [r for r in READINGS if r.path == "under"], ids=lambda reading: reading.key)
def test_c4_is_not_met_through_the_bottom_and_the_report_reports_it(reading):
    # Through the bottom the phase wanders by half a cycle while the rope is pumped up: 0.45 and 0.51, nowhere near 0.9.
    # Should this ever rise above 0.7, the statement in the report and in the documentation is wrong and must change.
    claim = steady_step_phase(reading)
    assert not claim.holds
    assert claim.measured < 0.7, claim.note


def test_every_claim_is_measured_in_every_reading():
    listed = PART.claims()
    assert len(listed) == 4 * len(READINGS)
    assert {claim.name for claim in listed} == {"C1", "C2", "C3", "C4"}
    assert sum(claim.holds for claim in listed) == 14  # all but C4 through the bottom


def test_measures_do_not_hang_on_the_tolerance_of_the_integrator():
    reading = READINGS[0]
    rough = run(reading, 0.53, tol=1e-6)
    fine = cast(reading, "success")
    # A hundredfold change of the tolerance per step; 1 mm is a sixth of the tolerance on the reach above.
    late = (rough.t >= 10.0) & (rough.t <= 14.0)
    assert abs(np.abs(rough.tip[late, 0]).max() - fine.reach(10.0, 14.0)) < 1e-3
    assert np.abs(rough.energy_error).max() < 1e-3 * np.ptp(rough.motor_work)


def test_concentration_tells_one_phase_from_many():
    assert concentration(np.full(7, 0.95)) == pytest.approx(1.0, abs=1e-15)
    assert concentration(np.array([0.98, 0.02])) > 0.9  # neighbours across the end of the cycle
    assert concentration(np.arange(8) / 8.0) < 1e-15
