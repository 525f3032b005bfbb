"""Batches with pegs: each member equals a single run for any number of threads, and clear errors."""

import itertools
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import hyperflex as hf
import hyperflex.budget
from hyperflex.budget import Budget
from hyperflex.simulation.batch import run_blocks
from hyperflex.winding import turns
from tests.refusals import refuses

ARM = hf.Arm(length=0.105)
PEGS = [[hf.Peg(x, -0.5, 0.04, 0.3, inertia=axle)] for x, axle in ((0.25, None), (0.3, 1e-5), (0.35, 1e-6))]
DURATION = 1.2
HOW = {"arm": ARM, "duration": DURATION, "tol": 1e-3, "contact_step": 1e-3}


def family() -> tuple[list[hf.Rope], list[hf.Motion]]:
    """Ropes of different lengths and motions of different rests, for three members."""
    ropes = [hf.Rope.uniform(size, 0.05, 10, 0.0025, friction=1e-3) for size in (0.7, 0.72, 0.66)]
    return ropes, [hf.arm_swings(0.5, rest) for rest in (0.1, 0.2, 0.3)]


def test_members_are_runs_of_their_own():
    ropes, motions = family()
    q0 = np.linspace(1.0, 1.3, 3)[:, None] + np.zeros(10)
    t = np.array([0.4, 0.8, DURATION])
    keep = ("tip", "q", "qd", "motor_torque", "motor_work", "dissipated_energy", "turns", "peg_angle", "peg_rate")
    batch = hf.simulate_batch(ropes, motions, pegs=PEGS, q0=q0, t_eval=t, keep=keep, threads=3, **HOW)
    touched = 0
    for m, (rope, motion, pegs) in enumerate(zip(ropes, motions, PEGS, strict=True)):
        alone = hf.simulate(rope, motion, pegs=pegs, q0=q0[m], t_eval=t, **HOW)
        n = alone.q.shape[1]
        np.testing.assert_array_equal(batch.q[m, :, :n], alone.q)
        assert np.isnan(batch.q[m, :, n:]).all()  # ropes of other lengths are cut otherwise
        for name in ("tip", "motor_torque", "motor_work", "dissipated_energy"):
            np.testing.assert_array_equal(getattr(batch, name)[m], getattr(alone, name))
        for name in ("peg_angle", "peg_rate"):
            one = getattr(alone, name)
            np.testing.assert_array_equal(batch.values[name][m], 0.0 if one is None else one)
        np.testing.assert_array_equal(batch.turns[m, :, 0], turns(alone, pegs[0]))
        touched += int(alone.attrs["contact_steps"] > 0 and alone.contact_loss[-1] > 0.0)
    assert touched == 3
    assert (np.abs(batch.peg_angle[1:, -1, 0]) > 1e-3).all()
    assert batch.status == ("success",) * 3
    np.testing.assert_array_equal(batch.reached, DURATION)
    one = hf.simulate_batch(ropes, motions, pegs=PEGS, q0=q0, t_eval=t, keep=keep, threads=1, **HOW)
    for name in keep:
        np.testing.assert_array_equal(one.values[name], batch.values[name])
    assert set(batch.dataset.dims) >= {"member", "time", "peg"}


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ({"pegs": [PEGS[0][0], PEGS[1]]}, "pegs holds something else"),
        ({"pegs": PEGS[:2]}, "do not fit together"),
        ({"pegs": [PEGS[0], PEGS[1], [*PEGS[2], *PEGS[0]]]}, "differ in number of pegs"),
        ({"pegs": PEGS, "step": 1e-3}, "step is not available with pegs"),
        ({"pegs": PEGS, "stiction_tolerance": 0.1}, "stiction_tolerance is not available with pegs"),
        ({"pegs": PEGS, "q0": np.zeros(4)}, "q0"),
        ({"pegs": PEGS, "t_eval": [2.0 * DURATION]}, "t_eval leaves the run"),
        ({"keep": ("turns",)}, "there are none"),
        ({"pegs": PEGS, "keep": ("temperature",)}, "keep"),
    ],
)
def test_what_does_not_fit_is_refused(what, words):
    ropes, motions = family()
    refuses(words, hf.simulate_batch, ropes, motions, **{**HOW, **what})


@pytest.mark.parametrize("threads", [1, 2])
def test_members_that_never_end_leave_time_to_the_others(threads):
    rope, aside = hf.Rope.uniform(0.7, 0.05, 10, 0.0025, friction=1e-3), [hf.Peg(1.5, -0.5, 0.04, 0.3)]
    motions = [hf.arm_swings(0.3, 0.05)] * threads + [hf.hold_arm()] * 2
    ticks = itertools.count()
    budget = Budget(1.0, clock=lambda: 1e-4 * next(ticks))  # which each check advances
    how = HOW | {"duration": 500.0, "time_budget": budget, "threads": threads}
    batch = hf.simulate_batch(rope, motions, pegs=aside, **how)
    assert batch.status == ("out of time",) * threads + ("success",) * 2
    assert np.isfinite(batch.tip[threads:]).all()


@pytest.mark.parametrize("pegs", [PEGS, []])
def test_a_budget_ends_all_members_those_that_have_not_begun_at_once(pegs):
    """Many members for a long time on one thread, and time for a few of them: by a clock that each check advances."""
    ropes, motions = family()
    ticks = itertools.count()
    budget = Budget(0.02, clock=lambda: 0.01 * next(ticks))
    how = {"pegs": pegs * 100, "time_budget": budget, **HOW, "duration": 1e4, "threads": 1}
    batch = hf.simulate_batch(ropes * 100, motions * 100, **how)
    assert set(batch.status) == {"out of time"}
    assert (batch.reached[-10:] == 0.0).all()
    assert "out of time" in batch.message
    how = {"pegs": pegs, "time_budget": 1e3, **HOW}
    assert set(hf.simulate_batch(ropes, motions, **how).status) == {"success"}


def test_blocks_that_a_thread_waits_for_end_at_an_interrupt(monkeypatch):
    """The main thread alone receives signals; others poll for them."""
    halt = np.zeros(1, dtype=np.int64)

    def interrupted():
        if threading.current_thread() is not threading.main_thread():
            raise KeyboardInterrupt

    def block(_low, _high):
        began = time.monotonic()
        while not halt[0] and time.monotonic() < began + 20.0:
            time.sleep(0.01)

    monkeypatch.setattr(hyperflex.budget, "raise_if_cancelled", interrupted)
    with ThreadPoolExecutor(1) as pool:
        stopped = pool.submit(run_blocks, block, 1, 2, 1, Budget(), None, halt).result()
    assert stopped.received
    assert halt[0] == 1
