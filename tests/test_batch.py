"""Batches: equal to single runs, the same for any number of threads, whole when a member fails or the user stops."""

import _thread
import copy
import pickle
import tracemalloc

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core.batch import rollouts as core
from hyperflex.simulation import batch as simulation_batch
from tests.refusals import left_by, refuses

ARM = hf.Arm(length=0.1)


def family(count: int, n: int = 8, seed: int = 0, **others: object) -> tuple[list[hf.Rope], list[hf.Motion]]:
    """Ropes and motions with every parameter drawn within 20 %."""
    rng = np.random.default_rng(seed)
    ropes, motions = [], []
    for _ in range(count):
        u = rng.uniform(0.8, 1.2, 6)
        ropes.append(
            hf.Rope(
                length=0.1 * u[0] * rng.uniform(0.8, 1.2, n),
                mass=0.005 * u[1] * rng.uniform(0.8, 1.2, n),
                friction=2e-4 * u[2],
                stiffness=1e-3 * u[3],
                tip_mass=0.01 * u[4],
                **others,
            )
        )
        motions.append(hf.arm_swings(0.6 * u[5], 0.4 * u[0]))
    return ropes, motions


@pytest.mark.parametrize(
    "others", [{}, {"friction_model": "printed"}, {"dry_friction": 1e-4}], ids=["relative", "printed", "dry"]
)
def test_members_equal_single_runs(others):
    ropes, motions = family(19, **others)  # more than the lanes, and not a multiple of them
    t = np.array([0.4, 1.0])
    keep = ("tip", "q", "qd", "motor_torque", "motor_work", "dissipated_energy")
    batch = hf.simulate_batch(ropes, motions, arm=ARM, duration=1.0, t_eval=t, tol=1e-7, keep=keep)
    assert batch.failed == []
    for m, (rope, motion) in enumerate(zip(ropes, motions, strict=True)):
        run = hf.simulate(rope, motion, arm=ARM, duration=1.0, t_eval=t, tol=1e-8)
        # Some forty steps of 1e-7 m each, in a rope of 0.8 m whose motion doubles small errors a few times in a second.
        np.testing.assert_allclose(batch.tip[m], run.tip, rtol=0, atol=2e-5)
        np.testing.assert_allclose(batch.q[m], run.q, rtol=0, atol=1e-3)
        np.testing.assert_allclose(batch.qd[m], run.qd, rtol=0, atol=5e-2)
        # Energies of some 0.1 J.
        np.testing.assert_allclose(batch.motor_work[m], run.motor_work, rtol=0, atol=1e-5)
        few = 1e-3 * np.ptp(run.motor_torque)
        np.testing.assert_allclose(batch.motor_torque[m], run.motor_torque, rtol=0, atol=few)
        np.testing.assert_allclose(batch.dissipated_energy[m], run.dissipated_energy, rtol=0, atol=1e-5)


def test_a_dry_neighbour_changes_nothing():
    ropes, motions = family(60, n=3)
    ropes[-1] = ropes[-1].replace(dry_friction=1e-4)
    ropes[7] = ropes[7].replace(dry_friction=1e-4)
    t = np.linspace(0.25, 1.0, 4)

    def run(threads):  # at this tolerance steps end on rounding, on which dry friction decides differently
        return hf.simulate_batch(
            ropes, motions, arm=ARM, duration=1.0, t_eval=t, tol=1e-12, keep=("q",), threads=threads
        ).q

    one = run(1)
    assert np.isfinite(one).all()
    for threads in (2, 5):
        np.testing.assert_array_equal(run(threads), one)


def test_one_rope_from_many_starts_on_a_sampled_motion():
    rope, motion = family(1, n=2)[0][0], hf.sampled_motion([0.0, 0.2, 0.5, 0.8], [0.0, 0.3, -0.2, 0.1])
    q0 = np.array([[0.0, 0.0], [1.0, 1.0], [0.3, -0.2]])
    how = {"arm": ARM, "duration": 1.0, "qd0": [0.1, 0.2], "t_eval": [0.0, 0.5, 1.0]}
    batch = hf.simulate_batch(rope, motion, q0=q0, keep=("q", "tip"), **how)
    assert batch.q.shape == (3, 3, 2)
    np.testing.assert_array_equal(batch.q[:, 0], q0)
    for row, start in enumerate(q0):
        alone = hf.simulate(rope, motion, q0=start, **how)
        np.testing.assert_allclose(batch.tip[row], alone.tip, atol=1e-4)  # 1e-6 a step and one second of them
    rates = hf.simulate_batch(rope, duration=0.5, qd0=np.ones((4, 2)))
    assert len(rates.status) == 4


def test_a_chosen_step_is_taken():
    ropes, motions = family(3)
    coarse = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.5, step=0.02)
    fine = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.5, step=0.01)
    exact = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.5, tol=1e-9)
    errors = [np.abs(b.tip - exact.tip).max() for b in (coarse, fine)]
    assert errors[1] < errors[0] / 8  # order 5 would give 32; half its logarithm shows that the step counts


def test_a_failing_member_fails_alone():
    ropes, motions = family(20)
    qd0 = np.zeros((20, 8))
    qd0[7] = 1e99  # its square is not a number any more
    batch = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.3, qd0=qd0)
    assert batch.failed == [7]
    assert batch.status[7] == "step too small"
    assert "t = 0 s" in batch.why(7)
    assert batch.why(6) == ""
    assert np.isnan(batch.tip[7]).all()
    good = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.3)
    keep = np.arange(20) != 7
    np.testing.assert_array_equal(batch.tip[keep], good.tip[keep])


def test_an_energy_balance_that_fails_is_reported(monkeypatch):
    ropes, motions = family(20)
    run = core.run_block

    def falsified(every, terms, low, high, t, y, *rest):
        run(every, terms, low, high, t, y, *rest)
        if low <= 5 < high:
            y[5 - low, :, -2] += 1.0  # J of motor work that was never done

    monkeypatch.setattr(core, "run_block", falsified)
    batch = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.3)
    assert batch.failed == [5]
    assert batch.status[5] == "energy not balanced"
    assert np.isnan(batch.tip[5]).all()


def test_memory_is_that_of_what_is_kept():
    ropes, motions = family(512)
    t = np.linspace(0.01, 0.2, 400)

    def peak(count):
        tracemalloc.start()
        batch = hf.simulate_batch(ropes[:count], motions[:count], arm=ARM, duration=0.2, t_eval=t, threads=1)
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert batch.tip.nbytes == count * t.size * 2 * 8
        return used - batch.tip.nbytes

    hf.simulate_batch(ropes[:1], motions[:1], arm=ARM, duration=0.2)  # compile first
    states = 256 * t.size * 18 * 8  # bytes that all states of 256 more members would take
    # Set-ups and parameters of a member take about 5 kB, beside 58 kB for its states at 400 times.
    assert peak(512) - peak(256) < 0.3 * states


def test_ctrl_c_keeps_finished_members(monkeypatch):
    ropes, motions = family(64)
    whole = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.3, threads=1)
    run = simulation_batch.core.run_block

    def interrupted(members, terms, low, *rest):
        if low >= 32:
            _thread.interrupt_main()
        else:
            run(members, terms, low, *rest)

    monkeypatch.setattr(simulation_batch.core, "run_block", interrupted)
    batch = left_by(lambda: hf.simulate_batch(ropes, motions, arm=ARM, duration=0.3, threads=1))
    assert batch.status[:32] == ("success",) * 32
    assert batch.status[32:] == ("interrupted",) * 32
    np.testing.assert_array_equal(batch.tip[:32], whole.tip[:32])
    assert np.isnan(batch.tip[32:]).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ropes": []}, "do not fit together"),
        ({"ropes": family(3)[0]}, "do not fit together"),
        ({"ropes": [family(1)[0][0], family(1, n=9)[0][0]]}, "differ in links"),
        ({"keep": ("wind",)}, "keep"),
        ({"t_eval": [0.0]}, "t_eval"),
        ({"q0": np.zeros((3, 8))}, "q0"),
        ({"step": 0.0}, "step"),
        ({"threads": 0}, "threads"),
    ],
)
def test_bad_input(change, words):
    ropes, motions = family(2)
    arguments: dict[str, object] = {"ropes": ropes, "motions": motions, "arm": ARM, "duration": 0.3} | change
    refuses(words, hf.simulate_batch, **arguments)


def test_a_batch_can_be_copied_and_sent():
    ropes, motions = family(2)
    batch = hf.simulate_batch(ropes, motions, arm=ARM, duration=0.1)
    for other in (copy.deepcopy(batch), pickle.loads(pickle.dumps(batch))):
        np.testing.assert_array_equal(other.tip, batch.tip)
        assert other.status == batch.status
    with pytest.raises(AttributeError, match="kept: tip"):
        _ = batch.q
