"""Motion out of the plane in plans: reports, criteria and pictures of a cast."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.planning import Uncertainty, outcome
from hyperflex.planning.ensemble import strikes_in_plane
from hyperflex.planning.outcome import evaluate_cast
from hyperflex.report import CastReport
from tests.planning.known import PEG, planned, problem
from tests.refusals import refuses


def judged(**criteria):
    """The outcome of the known cast by other criteria."""
    run, stop = planned().run, float(planned().motion.breaks[-1])
    return evaluate_cast(replace(problem(), criteria=hf.WindCriteria(**criteria)), PEG, run, stop)


def test_a_cast_reports_how_far_to_the_side_it_strikes():
    seen, run = planned().outcome, planned().run
    found = hf.sideways(run, tilt=math.radians(1.0))
    assert found.touch == seen.touch_time
    assert seen.half_width <= np.abs(found.joints[-1]).max() * (1.0 + 1e-12)  # rounding: sums in another order
    near = np.abs(found.joints[-1] - seen.sideways).min(), np.abs(found.joints[-1] + seen.sideways).min()
    assert min(near) < run.setup.rope.length.max() * np.abs(found.angles[-1]).max()  # a joint of the link that strikes
    assert 0.0 < seen.sideways <= seen.half_width
    wider = judged(tilt=math.radians(2.0))
    assert wider.half_width == pytest.approx(2.0 * seen.half_width)
    assert judged(tilt=0.0).aside == pytest.approx(seen.aside)


def test_a_rope_too_far_aside_fails():
    most = planned().outcome.half_width
    assert judged(max_sideways=1.01 * most).success
    failed = judged(max_sideways=0.99 * most)
    assert not failed.success
    assert f"it is up to {1e3 * most:.0f} mm to the side" in failed.message


def test_a_plan_reports_that_links_lean_too_far_for_the_first_order():
    seen = planned().outcome
    assert seen.lean == pytest.approx(np.abs(hf.sideways(planned().run, tilt=math.radians(1.0)).angles).max())
    for lean, said in ((0.3, ""), (0.4, "Begun 1 degree out of the plane, a link leans by 22.9 degrees")):
        plan = replace(planned(), outcome=replace(seen, lean=lean))
        warning = CastReport(plan).warning
        assert said in warning
        assert ("a link leans" in warning) == bool(said)
        assert plan.summary()["outcome"]["lean"] == lean


def test_a_rope_that_does_not_strike_has_no_side():
    missed = planned(winds=False).outcome
    assert math.isnan(missed.half_width)
    assert math.isnan(missed.aside)


def test_a_rope_whose_side_is_not_known_fails(monkeypatch):
    monkeypatch.setattr(outcome, "_aside", lambda run: (math.nan, math.nan, math.nan, "it touches at once"))
    assert judged().success
    failed = judged(max_sideways=10.0)
    assert not failed.success
    assert "touches at once" in failed.message


def test_dry_friction_and_large_tilts_are_refused():
    dry = problem().rope.replace(dry_friction=1e-5)
    assert replace(problem(), rope=dry).rope is dry
    refuses("Leave dry friction out", replace, problem(), rope=dry, criteria=hf.WindCriteria(max_sideways=0.1))
    for kind in (hf.WindCriteria, Uncertainty):
        refuses("tilt is not small", kind, tilt=1.0)


def test_scenarios_draw_tilts_and_fail_by_them():
    narrow = replace(problem(), criteria=hf.WindCriteria(max_sideways=0.03))
    draws = Uncertainty(tilt=0.02).sample(400, narrow, PEG)
    assert np.std([each.tilt for each in draws]) == pytest.approx(0.02, rel=0.15)  # 4 standard deviations
    within = strikes_in_plane(narrow, draws, 1.5)
    assert within.mean() == pytest.approx(0.683, abs=0.09)  # within one standard deviation
    assert strikes_in_plane(problem(), draws, math.nan).all()
    assert not strikes_in_plane(narrow, draws, math.nan).any()
    same = Uncertainty(tilt=0.0).sample(3, narrow, PEG)
    assert [each.lag for each in same] == [each.lag for each in draws[:3]]
