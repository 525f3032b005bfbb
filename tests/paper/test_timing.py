"""The table behind Fig. 13."""

import numpy as np

from hyperflex.paper import READINGS
from hyperflex.paper.timing import LEADS, PART, timed


def test_the_table_holds_every_reading_and_lead():
    table = PART.items["fig13"].table()
    assert {column.size for column in table.columns.values()} == {2001}  # 20 s at 100 rows a second, both ends
    assert len(table.columns) == 1 + 4 * len(READINGS) * len(LEADS)
    subject = timed(READINGS[1], 0.2)
    np.testing.assert_array_equal(table.columns["r_under_printed_20"], subject.spiral.r[::2])
    moving = table.columns["moving_under_printed_20"]
    for start, end in subject.intervals[:10]:
        inside = (table.columns["t"] > start) & (table.columns["t"] < end)
        assert moving[inside].all()
    # Ten half turns of 0.73 s and the rests between them: sampled every 10 ms, so 0.2 s for twenty ends.
    until = subject.intervals[9, 1]
    assert abs(0.01 * moving[table.columns["t"] < until].sum() - 7.3) < 0.2


def test_levels_are_medians_so_that_a_whip_spike_does_not_count():
    subject = timed(READINGS[0], 0.0)
    t, r = subject.spiral.t, subject.spiral.r
    last = r[(t >= 17.5) & (t < 20.0)]
    assert np.mean(last <= subject.levels[-1]) > 0.49
    assert subject.levels[-1] < 0.6 * last.max()
