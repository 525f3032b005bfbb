"""Work on executors: the same to the bit however it is cut and who does it; workers that die lose nothing."""

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.envs import CrossingPolicy, score_policy
from hyperflex.errors import InvalidInput, WorkerLost
from hyperflex.executor import refuse_lost, run_chunks
from tests.refusals import refuses
from tests.workers import DiesOnce, fails, squares

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=8, radius=0.0025, friction=1e-4)
LIMITED = ROPE.replace(max_bend=2.0)


def processes(workers: int) -> ProcessPoolExecutor:
    """New processes forked from one that has loaded hyperflex: fast, and safe with threads."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["hyperflex.envs.swing", "hyperflex.simulation.batch", "tests.workers"])
    return ProcessPoolExecutor(workers, mp_context=context)


@pytest.fixture(scope="module")
def two() -> Iterator[Executor]:
    with processes(2) as pool:
        yield pool


def results(work: Any, count: int, executor: Executor | None, size: int) -> tuple[list[int], list[range]]:
    found: dict[int, list[int]] = {}
    lost = run_chunks(work, range(count), executor, size, found.__setitem__)
    return [each for low in sorted(found) for each in found[low]], lost


@pytest.mark.parametrize("size", [1, 4, 100])
def test_chunks_come_back_in_order(size):
    with ThreadPoolExecutor(3) as threads:
        for executor in (None, threads):
            assert results(squares, 10, executor, size) == ([k**2 for k in range(10)], [])


def test_errors_of_the_work_are_raised():
    with ThreadPoolExecutor(2) as threads, pytest.raises(ZeroDivisionError):
        results(fails, 10, threads, 3)


def test_what_cannot_be_sent_to_processes_is_refused_with_the_reason(two):
    refuses(r"cannot be given the work.*lambda", results, partial(squares, on_plan=lambda _: True), 4, two, 2)
    targets = [hf.Peg(2.5, 0.0, 0.03)]
    with pytest.raises(InvalidInput, match="defined at the top of a module"):
        hf.plan_cast(ROPE, hf.Arm(length=0.1), targets, options=hf.SearchOptions(executor=two), on_plan=lambda _: True)
    with pytest.raises(ZeroDivisionError):  # an error of the work itself is none of sending it
        results(fails, 10, two, 3)


def test_a_worker_that_dies_loses_nothing(tmp_path):
    with processes(2) as pool:
        assert results(DiesOnce(tmp_path, 3), 12, pool, 2) == ([k**2 for k in range(12)], [])
    assert len(list(tmp_path.iterdir())) == 1


def test_a_chunk_that_kills_each_worker_is_named(tmp_path):
    with processes(2) as pool:
        found, lost = results(DiesOnce(tmp_path, 3, times=99), 6, pool, 2)
    assert (found, lost) == ([0, 1, 16, 25], [range(2, 4)])
    with pytest.raises(WorkerLost, match="Workers died at episodes 2 to 3"):
        refuse_lost(lost, "episodes")


def same(left: hf.Batch, right: hf.Batch) -> None:
    assert left.status == right.status
    np.testing.assert_array_equal(left.reached, right.reached)
    assert list(left.values) == list(right.values)
    for name, value in left.values.items():
        np.testing.assert_array_equal(value, right.values[name])


@pytest.mark.parametrize("workers", [1, pytest.param(4, marks=pytest.mark.nightly)])
def test_a_batch_is_the_same_to_the_bit(workers):
    """In free flight; with one member that fails; with a rope in eleven that has joint limits; and about pegs."""
    motions = [hf.arm_swings(t_rest=0.3 + 0.02 * k) for k in range(11)]
    given: dict[str, Any] = {"arm": hf.Arm(), "duration": 0.4, "t_eval": [0.2, 0.4], "keep": ("tip", "q", "qd")}
    wild = np.zeros((11, 8))
    wild[5] = 1e9
    pegs = [[hf.Peg(0.3, -0.1 * k - 0.4, 0.03)] for k in range(3)]
    runs = (
        partial(hf.simulate_batch, ROPE, motions, **given),
        partial(hf.simulate_batch, ROPE, motions, qd0=wild, **given),
        partial(hf.simulate_batch, [ROPE, LIMITED, ROPE], **given),
        partial(hf.simulate_batch, ROPE, motions[:3], pegs=pegs, **{**given, "keep": ("q", "turns")}),
    )
    with np.errstate(all="ignore"):
        want = [run(threads=1) for run in runs]
        assert want[1].failed == [5]
        with processes(workers) as pool:
            for size in (1, 2, 64):
                for run, expected in zip(runs, want, strict=True):
                    same(run(executor=pool, chunk_size=size), expected)


def test_members_whose_chunk_is_lost_are_named(monkeypatch, two):
    monkeypatch.setattr("hyperflex.simulation.batch.run_chunks", lambda *given: [range(2)])
    batch = hf.simulate_batch(ROPE, [hf.arm_swings()] * 2, arm=hf.Arm(), duration=0.1, executor=two)
    assert batch.status == ("worker lost", "worker lost")
    assert "worker lost" in batch.message


def test_interrupted_batch_keeps_the_chunks_that_are_done(monkeypatch):
    def interrupted(work, items, executor, size, done):
        done(0, work(list(items[:size])))
        raise KeyboardInterrupt

    monkeypatch.setattr("hyperflex.simulation.batch.run_chunks", interrupted)
    with ThreadPoolExecutor(1) as pool, pytest.raises(hf.Interrupted) as stop:
        hf.simulate_batch(ROPE, [hf.arm_swings()] * 3, arm=hf.Arm(), duration=0.1, executor=pool, chunk_size=2)
    assert stop.value.partial.status == ("success", "success", "interrupted")
    assert np.isnan(stop.value.partial.tip[2]).all()


def test_scores_are_the_same(two):
    given: dict[str, Any] = {"seeds": range(3), "action": "timing", "dt": 0.05}
    scores = score_policy(CrossingPolicy, "hyperflex/Swing-v0", executor=two, chunk_size=2, **given)
    np.testing.assert_array_equal(scores.returns, score_policy(CrossingPolicy, "hyperflex/Swing-v0", **given).returns)


def test_what_is_no_executor_is_refused():
    for wrong in ({"executor": 4}, {"chunk_size": 0}):
        refuses(next(iter(wrong)), hf.simulate_batch, ROPE, arm=hf.Arm(), duration=0.1, **wrong)


@pytest.mark.nightly
def test_dask_runs_on_when_a_worker_is_killed(tmp_path):
    """A cluster of processes on this machine."""
    distributed = pytest.importorskip("distributed", reason="Dask comes with hyperflex[test]")
    motions = [hf.arm_swings(t_rest=0.3 + 0.02 * k) for k in range(8)]
    given: dict[str, Any] = {"arm": hf.Arm(), "duration": 0.2}
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        executor = client.get_executor()
        same(
            hf.simulate_batch(ROPE, motions, executor=executor, chunk_size=3, **given),
            hf.simulate_batch(ROPE, motions, **given),
        )
        assert results(DiesOnce(tmp_path, 3), 12, executor, 2) == ([k**2 for k in range(12)], [])
    assert len(list(tmp_path.iterdir())) == 1
