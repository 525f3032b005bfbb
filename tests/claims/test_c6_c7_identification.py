"""Claims C6 and C7 of the source paper, section III: iterative revision, on the twin of its experiment."""

import numpy as np
import pytest

from hyperflex.paper import iterative_revision
from hyperflex.paper.identification import (
    FINER,
    POINTS,
    SMALL,
    SWINGS,
    WIDE,
    few_samples_do,
    finds_the_truth,
    guess,
    in_order,
    methods,
    per_sample,
    record,
    revised,
    settles,
    true_rope,
    whole_error,
)

pytestmark = pytest.mark.claims
INERTIA, FRICTION = true_rope().inertia[0], true_rope().friction[0]

each_swing = pytest.mark.parametrize("swing", SWINGS, ids=lambda swing: swing.key)


@each_swing
def test_c6_ir_settles_within_two_or_three_rounds(swing):
    # "Settled": the next revision moves neither J nor eta by more than a tenth of its standard deviation.
    claim = settles(swing)
    assert claim.measured <= 3, claim.note
    assert claim.holds


@each_swing
def test_c6_ir_finds_the_truth_within_its_uncertainty(swing):
    # 2 standard deviations: 95 % for each of J and eta. Measured 0.5 in the small swing, 0.9 in the wide one.
    claim = finds_the_truth(swing)
    assert claim.measured <= 2.0, claim.note
    # In the small swing J is compatible with 0, and the uncertainty says so; in the wide one eta is known within 1 %.
    assert revised(SMALL).std["inertia"] > INERTIA
    assert revised(WIDE).std["friction"] < 0.01 * FRICTION


@pytest.mark.nightly
def test_c6_ir_finds_the_truth_for_other_noise_too():
    # Of 6 numbers (J and eta, three recordings) 0.3 lie beyond 2 standard deviations, and 0.02 beyond 3.
    distances = [finds_the_truth(WIDE, seed).measured for seed in range(3)]
    assert max(distances) <= 3.0
    assert np.median(distances) > 0.1  # and the standard deviations are no more generous than they should be


@each_swing
def test_c6_errors_are_in_the_order_nf_cm_ir(swing):
    # IR from the measured start, which is worse than from the optimised one. The smaller ratio is 1.7 (small swing).
    claim = in_order(swing)
    assert claim.measured > 1.3, claim.note
    error = {method.name: method.error for method in methods(swing)}
    assert error["NF"] > error["CM"] > error["IR"] > error["IR(theta_0)"]


@each_swing
def test_c7_22_of_81_samples_suffice(swing):
    # 15 % is the paper's own figure (0.046 against 0.040). Measured 9 % and 3 %.
    claim = few_samples_do(swing)
    assert claim.measured <= 1.15, claim.note


def test_the_error_at_the_optimum_is_the_papers():
    # Noise of 0.01 rad rms: E of the truth is 81 x 5 x 1e-4 = 0.0405 rad^2, and 7 fitted numbers take 0.0007 of it.
    for swing in SWINGS:
        assert revised(swing).error == pytest.approx(0.040, rel=0.02)


def test_the_errors_of_the_papers_tables_come_out_in_the_small_swing():
    # Their unit is lost; read as sqrt(E / 81) in 0.01 rad. One angle, chosen to 0.05 rad, for four numbers: 15 %.
    found = {method.name: per_sample(method.error) for method in methods(SMALL)}
    found["first guess"] = per_sample(revised(SMALL).rounds[0].error)
    for name, printed in {"NF": 16.3, "CM": 2.62, "IR(theta_0)": 2.23, "first guess": 4.64}.items():
        assert found[name] == pytest.approx(printed, rel=0.15), name


def test_on_data_of_a_finer_chain_inertia_and_friction_are_biased():
    # Reported, not hidden: what 5 links need to move like 40 is not what each piece has. J comes out near the
    # cylinder's 5.1e-6 or above, nowhere near the paper's 0.143e-6, eta a fifth below; both by many deviations.
    for swing in FINER:
        found = revised(swing)
        assert found.success
        assert 5.0e-6 < found.best.inertia < 6.5e-6
        assert found.best.friction == pytest.approx(0.8 * FRICTION, rel=0.05)
        assert FRICTION - found.best.friction > 5.0 * found.std["friction"]
    # And where the swing is wide the misfit shows in the error too: 0.073 rad^2 where noise alone leaves 0.040.
    assert revised(FINER[1]).error > 1.5 * revised(WIDE).error


def test_step_four_as_it_is_printed_never_moves():
    found = revised(WIDE, profile="calculated")
    assert found.converged_after == 0
    assert found.error > 100.0 * revised(WIDE).error


@pytest.mark.nightly
def test_free_initial_rates_tell_less_but_the_same():
    # Half the simplex's usual rollouts, and J and eta from two revisions beyond the truth's neighbourhood: ten unknowns
    # take half a minute otherwise.
    start = guess().replace(inertia=np.full(5, 2.0 * INERTIA), friction=np.full(5, 1.1 * FRICTION))
    found = iterative_revision(record(WIDE), start, rates="free", rounds=2, max_evaluations=100)
    assert abs(found.best.friction - FRICTION) < 3.0 * found.std["friction"]
    assert abs(found.best.inertia - INERTIA) < 3.0 * found.std["inertia"]
    assert found.std["inertia"] > revised(WIDE).std["inertia"]


def test_a_revision_of_fewer_samples_is_checked_by_all_of_them():
    found = revised(SMALL, 22)
    assert found.samples == 22 * 5
    assert whole_error(SMALL, found) > found.error
    assert whole_error(SMALL, revised(SMALL)) == pytest.approx(revised(SMALL).error, rel=1e-12)
    assert record(SMALL).t.size == POINTS
