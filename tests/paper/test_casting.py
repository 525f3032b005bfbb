"""Set-ups of the paper's casts and the tables behind its figures."""

import numpy as np
import pytest

from hyperflex.paper import READINGS, T_MOVE, cable
from hyperflex.paper.casting import OUTCOMES, PART, cast


def test_the_cable_is_the_papers():
    rope = cable()
    assert rope.n_links == 50
    assert rope.total_length == pytest.approx(2.0, rel=1e-14)
    assert rope.total_mass == pytest.approx(0.125, rel=1e-14)
    # Printed with four digits in the specification; the paper's own 3.37e-4 is a thousand times too large.
    assert rope.inertia[0] == pytest.approx(3.372e-7, rel=2e-4)
    assert cable("printed").friction_model == "printed"


def test_a_cast_starts_hanging_with_the_arm_to_the_left():
    start = cast(READINGS[0], "success").run
    np.testing.assert_allclose(start.tip[0], [-0.105, -2.0], atol=1e-12)
    np.testing.assert_allclose(start.tip_velocity[0], 0.0, atol=1e-12)
    assert start.arm_angle[0] == -np.pi / 2


def test_the_arm_moves_in_the_intervals_and_rests_between_them():
    subject = cast(READINGS[2], "failure")
    t, (starts, ends) = subject.t[:, None], subject.intervals.T
    moves = ((t > starts) & (t < ends)).any(axis=1)
    resting = np.abs(np.gradient(subject.run.arm_angle, subject.t)) < 1e-9  # rounding of an angle of 4.7 rad over 2 ms
    # A central difference reaches one sample beyond each end of the 14 motions: 28 of 14001 samples.
    assert np.mean(moves == ~resting) > 0.995
    assert np.mean(subject.moving == moves) > 0.998  # but for the starts themselves
    assert subject.intervals[1, 0] == pytest.approx(T_MOVE + 0.34)


@pytest.mark.parametrize("name", ["fig9", "fig10", "fig11", "fig12"])
def test_tables_have_equal_columns_units_and_a_source(name):
    table = PART.items[name].table()
    sizes = {column.size for column in table.columns.values()}
    assert sizes == {1401}  # 14 s at 100 rows a second, both ends
    assert all(np.isfinite(column).all() for column in table.columns.values())
    assert table.notes["source"] == "simulated"
    assert "s" in table.notes["units"]
    assert next(iter(table.columns)) == "t"


def test_tables_hold_every_reading_and_outcome():
    columns = PART.items["fig10"].table().columns
    for reading in READINGS:
        for outcome in ("success", "failure"):
            for axis, name in enumerate("xy"):
                column = columns[f"{name}_{reading.key}_{outcome}"]
                np.testing.assert_array_equal(column, cast(reading, outcome).run.tip[::10, axis])


@pytest.fixture(scope="module")
def every():
    return [cast(reading, outcome) for reading in READINGS for outcome in OUTCOMES]


def drawn(name):
    return PART.items[name].draw()


def test_figures_that_cut_spikes_off_say_where_and_how_high_they_are(every):
    greatest_r = max(each.spiral.r.max() for each in every)
    greatest_v = max(np.abs(each.spiral.scaled_velocity).max() for each in every)
    for figure, greatest in ((drawn("fig11"), greatest_r), (drawn("fig12"), greatest_v)):
        top = figure.axes[0].get_ylim()[1]
        assert greatest > top  # else there is nothing to say
        assert f"cut off at {top:g} m" in figure.get_supxlabel()
        assert f"{greatest:.1f} m" in figure.get_supxlabel()
