"""Set-ups of the paper's casts and the tables behind its figures."""

from __future__ import annotations

import numpy as np
import pytest

from hyperflex.paper import READINGS, T_MOVE, cable
from hyperflex.paper import casting as results
from hyperflex.paper.casting import cast


def test_the_cable_is_the_papers():
    rope = cable()
    assert rope.n_links == 50
    assert rope.total_length == pytest.approx(2.0, rel=1e-14)
    assert rope.total_mass == pytest.approx(0.125, rel=1e-14)
    # Printed with four digits in the specification; the paper's own 3.37e-4 is a thousand times too large.
    assert rope.inertia[0] == pytest.approx(3.372e-7, rel=2e-4)
    assert cable("printed").friction_model == "printed"


def test_a_cast_starts_hanging_with_the_arm_to_the_left():
    start = cast(READINGS[0], "success")
    np.testing.assert_allclose(start.tip[0], [-0.105, -2.0], atol=1e-12)
    np.testing.assert_allclose(start.tip_velocity[0], 0.0, atol=1e-12)
    assert start.arm_angle[0] == -np.pi / 2


def test_the_arm_moves_in_the_intervals_and_rests_between_them():
    subject = cast(READINGS[2], "failure")
    t, (starts, ends) = subject.t[:, None], subject.intervals.T
    moves = ((t > starts) & (t < ends)).any(axis=1)
    resting = np.abs(np.gradient(subject.arm_angle, subject.t)) < 1e-9  # rounding of an angle of 4.7 rad over 2 ms
    # A central difference reaches one sample beyond each end of the 14 motions: 28 of 14001 samples.
    assert np.mean(moves == ~resting) > 0.995
    assert subject.intervals[1, 0] == pytest.approx(T_MOVE + 0.34)


@pytest.mark.parametrize("name", ["fig9", "fig10", "fig11", "fig12"])
def test_tables_have_equal_columns_units_and_a_source(name):
    table = getattr(results, name)()
    assert table.name == name
    sizes = {column.size for column in table.columns.values()}
    assert sizes == {1401}  # 14 s at 100 rows a second, both ends
    assert all(np.isfinite(column).all() for column in table.columns.values())
    assert table.notes["source"] == "simulated"
    assert "s" in table.notes["units"]
    assert next(iter(table.columns)) == "t"


def test_tables_hold_every_reading_and_outcome():
    columns = results.fig10().columns
    for reading in READINGS:
        for outcome in ("success", "failure"):
            for axis, name in enumerate("xy"):
                column = columns[f"{name}_{reading.key}_{outcome}"]
                np.testing.assert_array_equal(column, cast(reading, outcome).tip[::10, axis])


def test_portraits_and_tables_agree_on_when_the_arm_moves():
    moving = results.fig12().columns["moving_success"]
    # 0.73 s of each 1.26 s; 14 s hold 11 whole cycles and a bit that moves.
    assert moving.mean() == pytest.approx((11 * 0.73 + 0.14) / 14.0, abs=0.01)  # 12 cycles of samples, each 1/1400
