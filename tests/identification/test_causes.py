"""What a fit's misfit comes from: the cause that explains most is named first, with what explains the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from benchmarks.wrong_input import DOUBLE, FREE, noisy, swing

import hyperflex as hf

GUESS = DOUBLE.replace(inertia=5e-4, com=0.12, friction=3e-4)


def fitted(true: hf.Rope, guess: hf.Rope, free: Sequence[str], clock: float = 1.0) -> hf.Identification:
    t, q = swing(true, np.linspace(0.9, 0.6, true.n_links))
    return hf.identify(hf.Recording(clock * t, noisy(q)), guess, free, options=hf.FitOptions(intervals=None))


def reasons(found: hf.Identification) -> tuple[str, ...]:
    assert found.grade.name == "do not use"
    return found.grade.reasons


def test_friction_held_three_times_too_large_is_named_first() -> None:
    """It moves no ratio of moments and inertias, and friction over moment is told by none but itself."""
    guess = GUESS.replace(friction=3.0 * DOUBLE.friction)
    first = reasons(fitted(DOUBLE, guess, ["inertia", "com"]))[0]
    assert first.startswith("resistance is of another kind or size, or changes: with 'friction' free, 9")
    told = reasons(fitted(DOUBLE, guess, ["inertia"]))  # where other masses explain the same
    assert "'friction' free, 98" in told[0]
    assert not any(each.startswith("resistance is") for each in told)


def test_inertia_held_wrong_is_named_beside_what_explains_the_same() -> None:
    first = reasons(fitted(DOUBLE, DOUBLE.replace(inertia=1.03 * DOUBLE.inertia, drag=0.01), ["drag", "friction"]))[0]
    assert "'inertia'" in first
    assert "'com'" in first


def test_a_wrong_clock_is_told_beside_drag_that_was_left_out() -> None:
    told = reasons(fitted(DOUBLE.replace(drag=0.15), GUESS, FREE, clock=1.02))
    assert any("if times are multiplied by 0.98" in each and "'drag' free" in each for each in told)
    assert any("'drag'" in each and "98" in each for each in told)


def test_drag_is_found_though_little_of_it_shows_where_there_is_none() -> None:
    """To first order it explains less than a third, and nearly all once it is free."""
    chain = hf.Rope.uniform(length=1.0, mass=0.05, n_links=4, friction=3e-4, drag=0.05, dry_friction=3e-4)
    found = fitted(
        chain, chain.replace(drag=0.0, dry_friction=0.0, friction=6e-4), ["inertia:shared", "friction:shared"]
    )
    assert reasons(found)[0].startswith("resistance is of another kind or size, or changes: with 'drag' free, 9")
    assert "more links" not in str(found)


def test_deviations_grow_with_a_clock_that_is_off_also_beside_a_drag_of_nearly_nothing(data_dir: Path) -> None:
    """A drag that cannot become negative does not keep the other values from moving as gravity asks."""
    part = hf.read_recording(data_dir / "multiarm_triple" / "TriplePendulumDataForParameterEstimation.mat").window(
        22.0, 30.0
    )
    part, guess = part.decimate(5), hf.Rope(length=[0.1727, 0.2286, 0.2413], mass=0.1, friction=1e-4, drag=0.1)
    inertia = np.array([0.1687, 0.1644, 0.0377])  # over p1, by other parts of the recording
    stds = []
    for clock in (1.005, 1.01):
        found = hf.identify(
            hf.Recording(clock * part.t, part.data), guess, [*FREE, "drag"], options=hf.FitOptions(intervals=None)
        )
        stds.append(found.ratio_std["J/p1"])
        assert (np.abs(found.ratios["J/p1"] - inertia) < 2.0 * stds[-1]).all()
    assert (stds[1] > stds[0]).all()
