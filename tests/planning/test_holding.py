"""Holding force of a wound rope: the tail's weight, the capstan equation, and the tug test."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import winding
from hyperflex.budget import Budget
from hyperflex.planning import WindCriteria, outcome
from hyperflex.planning.outcome import measure_holding_force, require_holding_force
from tests.planning.known import CABLE, PEG, planned


def test_the_tail_is_what_hangs_below_the_peg():
    run = planned().outcome.run
    tail = winding.measure_winding(run, PEG).tail
    # Quiet at the end: the tension towards the tip is the tail's weight, but for its last slow swinging (1 %).
    assert winding.measure_winding(run, PEG).after[-1] == pytest.approx(tail[-1], rel=0.01)
    length = tail[-1] / 9.81 / CABLE.total_mass * CABLE.total_length
    assert np.linalg.norm(run.tip[-1] - [PEG.x, PEG.y]) == pytest.approx(length, abs=0.08)  # peg and a link
    assert np.isnan(tail[0])


def test_a_tug_bears_at_least_what_the_rule_gives():
    held = measure_holding_force(planned().outcome.run, PEG)
    assert held.contact_angle / (2.0 * np.pi) == pytest.approx(
        abs(planned().outcome.turns), abs=0.7
    )  # both tangents are off it
    assert held.capstan_force == pytest.approx(held.tail_weight * np.exp(0.3 * held.contact_angle), rel=1e-12)
    # The rope on the peg has weight as well, and a tug turns the tangent: more than the rule, within a factor of 3.
    assert held.capstan_force < held.force < 3.0 * held.capstan_force
    assert held.tug.slipped


def test_a_tug_allows_the_slip_of_the_criteria():
    plan = replace(planned(), problem=replace(planned().problem, criteria=WindCriteria(max_slip=0.02)))
    tug = plan.measure_holding_force().tug
    assert tug.allowed == 0.02
    assert tug.slipped == (np.abs(tug.slip).max() > 0.02)


def test_a_rope_off_the_peg_holds_nothing():
    assert measure_holding_force(planned(winds=False).outcome.run, PEG) is None


def test_a_rope_that_ended_inside_the_peg_is_not_tugged():
    run, wider = planned().outcome.run, replace(PEG, radius=PEG.radius + 1e-3)
    assert measure_holding_force(replace(run, setup=replace(run.setup, pegs=(wider,))), wider) is None


def test_a_cast_that_holds_less_than_required_fails():
    cast = planned().outcome
    force = measure_holding_force(cast.run, PEG).force
    budget = Budget()
    assert require_holding_force(cast, PEG, WindCriteria(holding_force=0.9 * force), budget) is cast
    assert require_holding_force(cast, PEG, WindCriteria(holding_force=0.0), budget) is cast
    failed = require_holding_force(cast, PEG, WindCriteria(holding_force=1.1 * force), budget)
    assert (failed.wound, failed.held, failed.success) == (True, False, False)
    assert failed.message == f"its holding force is {force:.3g} N, {1.1 * force:.3g} N required"


@pytest.mark.parametrize(
    ("touched", "begins"),
    [
        ([], np.nan),
        ([1.0], 1.0),
        ([1.0, 1.1, 1.2, 3.0, 3.1, 3.2, 3.3], 3.0),  # it grazes, then comes for good
        ([1.0, 1.2, 1.4, 1.6, 3.0, 3.1], 1.0),  # breaks of 0.2 s are bounces
        ([1.0, 1.1, 2.0, 2.1], 1.0),
    ],
)
def test_the_strike_begins_the_longest_stay(touched, begins):
    t = np.round(np.arange(0.0, 4.0, 0.1), 1)
    assert outcome._longest_stay(t, np.isin(t, touched)) == pytest.approx(begins, nan_ok=True)


def test_contact_and_bend_are_those_of_the_run():
    """By the places of the joints, in place of angles."""
    cast = planned().outcome
    run = cast.run
    links = np.diff(run.joints, axis=1) / np.linalg.norm(np.diff(run.joints, axis=1), axis=2)[..., None]
    bend = np.arccos(np.clip((links[:, 1:] * links[:, :-1]).sum(axis=2), -1.0, 1.0)).max()
    assert cast.max_bend == pytest.approx(bend, abs=1e-6)
    assert not cast.folded
    stop = planned().motion.breaks[-1] + hf.WindCriteria.settle
    watched = winding.measure_winding(run, PEG).contact[run.t >= stop]
    assert cast.contact_angle == watched.min() < watched[-1]  # the required and the reported value are equal
    away = run.joints[-1] - [PEG.x, PEG.y]
    lies = np.flatnonzero(np.hypot(*away.T) < PEG.radius + 0.0025 + 0.002)
    angle = np.unwrap(np.arctan2(away[lies, 1], away[lies, 0]))
    assert watched[-1] == pytest.approx(abs(angle[-1] - angle[0]), abs=0.5)  # to the length of a link on the peg
    assert cast.touch_time <= cast.strike_time


def test_a_weight_on_an_upright_rope_pulls_only_along_it():
    """A rod rests on a peg near its tip, at 60 degrees from hanging: half of the tip's weight pulls along it."""
    rod = hf.Rope.uniform(length=1.0, mass=0.1, n_links=1, radius=0.004, tip_mass=0.05, friction=0.5)
    slope = np.radians(60.0)
    along, across = np.array([np.sin(slope), -np.cos(slope)]), np.array([np.cos(slope), np.sin(slope)])
    peg = hf.Peg(*(0.8 * along - 0.02401 * across), 0.02, 0.3)
    run = hf.simulate(rod, duration=0.5, q0=[slope], pegs=[peg], refine=False)
    assert winding.measure_winding(run, peg).after[-1] == pytest.approx(0.05 * 9.81 * np.cos(slope), rel=1e-3)
    assert winding.rope_tension(run)[-1, -1] == pytest.approx(0.05 * 9.81, rel=1e-3)
