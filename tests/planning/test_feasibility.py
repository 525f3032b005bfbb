"""Feasibility of a target before any search: necessary conditions, remedies, the nearest feasible target."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import hyperflex as hf
from hyperflex.planning import MotorLimits, Problem, check_feasibility
from hyperflex.planning.feasibility import SWING, find_remedies, nearest_feasible, search_time
from tests.refusals import refuses

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
CAST_SETUP = Problem(CABLE, hf.Arm(length=0.105), MotorLimits())


def pulled(force: float) -> Problem:
    """Return the problem of a rope that must withstand a pull, N."""
    return replace(CAST_SETUP, criteria=hf.WindCriteria(holding_force=force))


def at(far: float, aside: float, radius: float = 0.03) -> hf.Peg:
    return hf.Peg(far * np.sin(aside), -far * np.cos(aside), radius)


@pytest.mark.parametrize(("far", "aside"), [(0.9, 0.46), (1.2, -1.1), (1.0, 0.1)])
def test_the_energy_is_that_of_rods(far, aside):
    """By quadrature along the rope, in place of sums over links."""
    slope, length = abs(aside), 2.0
    pendulum = 2.0 * length / 3.0  # of a rod
    wide = min(slope - np.arcsin(0.0325 / far) + SWING.gain * 0.21 / pendulum, SWING.widest[0])
    drop = quad(lambda s: s * (np.cos(slope) - np.cos(wide)), 0.0, length)[0]
    share = quad(lambda s: s**2, far, length)[0] / quad(lambda s: s**2, 0.0, length)[0]
    lift = quad(lambda s: (s - far) * (1.0 + np.cos(slope)), far, length)[0]
    # Links of 40 mm as points, one of which straddles the peg; their own inertia moves the pendulum by 1e-4.
    assert check_feasibility(CAST_SETUP, at(far, aside)).energy_ratio == pytest.approx(share * drop / lift, rel=0.04)


def test_a_target_below_leaves_no_room_to_swing():
    """The target directly below gets much less energy than another one, growing with the square of a stroke's
    contribution."""
    beside, below = (check_feasibility(CAST_SETUP, at(1.0, aside)).energy_ratio for aside in (0.1, 0.0))
    assert below < 0.3 * beside


@pytest.mark.parametrize(
    ("peg", "told"),
    [
        (at(2.5, 0.3), "ends 0.36 m short"),
        (at(2.0, 0.8), "with all of the rope round the target it makes 0.76"),
        (at(1.8, 0.8), "turns remains beyond"),
        (at(0.08, 1.0), "inside the arm's circle"),
        (at(0.9, 0.0), "too little energy"),
        (at(0.6, 2.5), "too little energy: it is higher than the rope swings"),
    ],
)
def test_the_reason_is_reported_for_targets_out_of_reach(peg, told):
    known = check_feasibility(CAST_SETUP, peg)
    assert not known.feasible
    assert told in known.message


def test_a_short_time_is_reported():
    short = replace(CAST_SETUP, time=0.1)
    assert "0.1 s are too short a time" in check_feasibility(short, at(0.9, 0.46)).message
    assert any("s to strike" in each for each in find_remedies(short, at(0.9, 0.46)))


def test_what_widens_a_swing_is_the_way_of_the_arms_tip_aside():
    """A quarter turn from the hanging position adds half as much as a half turn about it; the upward part adds
    nothing."""
    angles = [(-np.pi / 2, np.pi / 2), (0.0, np.pi), (0.0, np.pi / 2), (-np.pi, 0.0)]
    some = [replace(CAST_SETUP, limits=MotorLimits(100.0, 1e4, angles=each)) for each in angles]
    usual, *narrow = (check_feasibility(each, at(1.28, 0.67)).energy_ratio for each in some)
    assert narrow == pytest.approx([narrow[0]] * 3, rel=1e-3)
    assert narrow[0] < 0.6 * usual
    some = replace(CAST_SETUP, limits=MotorLimits(angles=(0.0, 1.0)))
    assert "a motor that turns from -1.57 to 1.57 rad" in find_remedies(some, at(1.12, 0.46))


def test_a_slow_motor_is_distinguished_from_little_energy():
    slow = replace(CAST_SETUP, limits=MotorLimits(speed=0.5, acceleration=5.0))
    assert check_feasibility(CAST_SETUP, at(0.9, 0.46)).feasible
    assert "motor is too slow" in check_feasibility(slow, at(0.9, 0.46)).message
    told = check_feasibility(slow, at(0.9, 1.5))
    assert told.energy_ratio < 0.0
    assert "motor is too slow" in told.message
    assert "higher than the rope swings" in told.message


@pytest.mark.parametrize(("tip", "widest"), [(0.0, SWING.widest[0]), (0.02, SWING.widest[1]), (0.5, SWING.widest[1])])
def test_a_rope_with_a_weight_at_its_end_swings_less_far_beyond_level(tip, widest):
    """Just below the widest swing there is energy left, just above it there is none."""
    who = replace(CAST_SETUP, rope=CABLE.replace(tip_mass=tip))
    assert check_feasibility(who, at(1.0, widest - 0.01)).energy_ratio > 0.0
    assert check_feasibility(who, at(1.0, widest + 0.01)).energy_ratio < 0.0


def test_a_motor_that_cannot_hold_the_hanging_rope_is_refused_before_a_search():
    asked = 0.125 * 9.81 * 0.105  # N m, weight times arm
    weak = replace(CAST_SETUP, limits=MotorLimits(torque=0.99 * asked))
    told = check_feasibility(weak, at(0.9, 0.46))
    assert told.impossible
    assert "too weak" in told.message
    assert "0.129 N m" in told.message
    assert check_feasibility(replace(CAST_SETUP, limits=MotorLimits(torque=1.01 * asked)), at(0.9, 0.46)).feasible
    low = MotorLimits(torque=0.99 * asked, angles=(-1.0, 3.0))  # on the left the arm begins 1 rad from hanging
    assert check_feasibility(replace(CAST_SETUP, limits=low), at(0.9, 0.46)).feasible


def test_the_pull_borne_is_that_of_the_end_that_hangs():
    """With a fourth of the mass in its outer half, which includes the end, it holds a fourth."""
    mass = np.repeat([1.0, 0.25], 25) * 0.0025
    light = hf.Rope(length=np.full(50, 0.04), mass=mass, friction=np.full(50, 5e-4), radius=0.0025)
    assert check_feasibility(replace(CAST_SETUP, rope=light), at(1.5, 0.9)).holding_force == pytest.approx(
        0.25 * check_feasibility(CAST_SETUP, at(1.5, 0.9)).holding_force
    )


def wound(far: float, aside: float, axis: float, more: int, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length (k,) and turns (k,) of a rope drawn as a polyline: from the shaft to a peg, counterclockwise round it with
    `more` whole turns and, from its left side, down with ends (k,) of several lengths."""
    centre = far * np.array([np.sin(aside), -np.cos(aside)])
    first = np.arctan2(*-centre[::-1]) + np.arccos(axis / far)
    angles = np.linspace(first, np.pi + 2.0 * np.pi * more, 20001)
    points = np.concatenate([-centre[None], axis * np.stack([np.cos(angles), np.sin(angles)], axis=-1)])
    around = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    tips = points[-1] - np.stack([np.zeros_like(ends), ends], axis=-1)
    swing = np.arctan2(tips[:, 1], tips[:, 0]) % (2.0 * np.pi) - np.pi
    turns = (around[-1] - around[0] + swing) / (2.0 * np.pi)
    return np.hypot(*np.diff(points, axis=0).T).sum() + ends, turns if angles[-1] > first else np.zeros_like(ends)


@pytest.mark.parametrize("aside", [0.0, 0.5, 0.9, 1.1, 1.6])
@pytest.mark.parametrize("radius", [0.03, 0.05])
def test_the_room_needed_is_that_of_a_rope_wound_and_hanging(aside, radius):
    far, axis = 1.0, radius + 0.0025
    ends = axis * np.linspace(SWING.hanging, 40.0, 20001)
    drawn = [wound(far, aside, axis, more, ends) for more in (0, 1, 2)]
    rooms = [(length[turns >= 1.25 + SWING.spare_turns] - far + axis).min(initial=np.inf) for length, turns in drawn]
    needed = min(rooms) / (2.0 * np.pi * axis)
    assert check_feasibility(CAST_SETUP, at(far, aside, radius)).needed_turns == pytest.approx(
        needed, abs=1e-3
    )  # ends 0.002 radii apart


def test_the_required_hold_counts():
    """The capstan equation on random ropes with one turn more or less; the largest hold counts."""
    peg, weight = at(1.36, 0.66, 0.04), 0.125 * 9.81 / 2.0
    known, bears = check_feasibility(CAST_SETUP, peg), []
    for more in (1, 2):
        (bare,), (turns,) = wound(1.36, 0.66, 0.0425, more, np.zeros(1))
        contact = 2.0 * np.pi * turns - np.arccos(0.0425 / 1.36)
        bears.append(weight * (2.0 - bare) * np.exp(0.3 * contact))
    assert known.holding_force == pytest.approx(max(bears), rel=1e-6)  # the polyline's arc is shorter by 1e-9
    assert check_feasibility(pulled(0.9 * known.holding_force), peg).feasible
    assert "required" in check_feasibility(pulled(1.1 * known.holding_force), peg).message


def test_what_is_down_is_where_gravity_points():
    """Gravity along x: the same target turned by a right angle."""
    turned = Problem(CABLE.replace(gravity=(9.81, 0.0)), CAST_SETUP.arm, CAST_SETUP.limits)
    here = check_feasibility(CAST_SETUP, hf.Peg(-0.4, -0.9, 0.03))
    assert check_feasibility(turned, hf.Peg(0.9, 0.4, 0.03)) == here


@pytest.mark.parametrize("links", [1, 3])
def test_a_rope_of_few_links_is_refused(links):
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=links, radius=0.0025, friction=0.0)
    refuses("too few links", Problem, rope, CAST_SETUP.arm, CAST_SETUP.limits)


def test_an_arm_without_length_is_refused():
    """It turns at the rope's first joint, which moves nothing: no cast, whip or insertion can be planned."""
    given = CAST_SETUP.rope, hf.Arm(0.0)
    for plan, target in (
        (hf.plan_cast, PEG),
        (hf.plan_whip, hf.TipTarget(1.0, -1.0)),
        (hf.plan_insert, hf.Slot(1.0, -1.0, 0.1)),
    ):
        refuses("arm has no length.*got 0.*more than 0 m.*first joint", plan, *given, target, time_budget=1.0)


PEG = hf.Peg(-0.8338, -1.0743, 0.04)
FAR = hf.Peg(1.72 * np.sin(0.9), -1.72 * np.cos(0.9), 0.04)  # some 10 cm beyond what is in reach in its direction
SLOW, LAZY, WEAK = (replace(CAST_SETUP, limits=MotorLimits(*pair)) for pair in ((0.8, 12.0), (8.6, 0.5), (0.8, 1.0)))


def distance(one: hf.Peg, other: hf.Peg) -> float:
    return float(np.hypot(one.x - other.x, one.y - other.y))


@pytest.mark.parametrize("peg", [FAR, hf.Peg(-FAR.x, FAR.y, 0.04), hf.Peg(0.14, -0.9, 0.03), hf.Peg(0.02, 0.05, 0.02)])
def test_the_nearest_place_is_in_reach_and_none_is_nearer(peg):
    found = nearest_feasible(CAST_SETUP, peg)
    assert check_feasibility(CAST_SETUP, found).feasible
    assert not check_feasibility(CAST_SETUP, peg).feasible
    assert (found.radius, found.mu) == (peg.radius, peg.mu)
    random = np.random.default_rng(1)
    far, angle = 0.97 * distance(found, peg) * np.sqrt(random.uniform(size=400)), random.uniform(-np.pi, np.pi, 400)
    assert not any(
        check_feasibility(CAST_SETUP, replace(peg, x=peg.x + r * np.sin(a), y=peg.y + r * np.cos(a))).feasible
        for r, a in zip(far, angle, strict=True)
    )


def test_what_the_nearest_place_shall_have_to_spare_and_hold_counts():
    plain, safe = (nearest_feasible(CAST_SETUP, FAR, margin=margin) for margin in (0.0, 0.5))
    firm = nearest_feasible(pulled(2.0), FAR)
    assert plain is not None and safe is not None and firm is not None  # noqa: PT018
    spares = [check_feasibility(CAST_SETUP, one).margin() for one in (plain, safe)]
    assert 0.0 <= spares[0] < 0.1
    assert 0.5 <= spares[1] < 0.6
    assert 0.05 < distance(plain, FAR) < min(0.15, distance(safe, FAR))
    assert plain.x == pytest.approx(round(plain.x, 3), abs=1e-12)  # a place that can be said
    assert check_feasibility(CAST_SETUP, firm).holding_force >= 2.0 > check_feasibility(CAST_SETUP, plain).holding_force


def test_a_motor_too_slow_for_everything_reaches_nothing():
    asleep = replace(CAST_SETUP, limits=MotorLimits(speed=0.01, acceleration=0.1))
    assert nearest_feasible(asleep, PEG) is None


NEAR = hf.Peg(0.068, -1.179, 0.025)  # under the arm


def of_length(length: float) -> hf.Rope:
    return hf.Rope.uniform(length, 0.0625 * length, 50, 0.0025, friction=5e-4)


@pytest.mark.parametrize(
    ("who", "target", "words", "changed"),
    [
        (SLOW, PEG, r"a motor of (\S+) rad/s", lambda speed: {"limits": MotorLimits(speed, 12.0)}),
        (LAZY, PEG, r"a motor of (\S+) rad/s\^2", lambda fast: {"limits": MotorLimits(8.6, fast)}),
        (WEAK, PEG, r"a motor of (\S+) rad/s and (\S+) rad/s\^2", lambda *pair: {"limits": MotorLimits(*pair)}),
        (CAST_SETUP, FAR, r"a rope of (\S+) m", lambda length: {"rope": of_length(length), "time": CAST_SETUP.time}),
        (CAST_SETUP, NEAR, r"an arm of (\S+) mm", lambda length: {"arm": hf.Arm(length=1e-3 * length)}),
        (replace(CAST_SETUP, time=1.5), PEG, r"(\S+) s to strike", lambda time: {"time": time}),
        (CAST_SETUP, FAR, r"a peg of (\S+) mm radius", lambda radius: replace(FAR, radius=1e-3 * radius)),
    ],
)
def test_a_remedy_helps_and_less_of_it_does_not(who, target, words, changed):
    assert not check_feasibility(who, target).feasible
    told = next(found for text in find_remedies(who, target) if (found := re.fullmatch(words, text)))
    numbers = np.array([float(text) for text in told.groups()])
    sense = -1.0 if "radius" in words else 1.0

    def helps(*numbers: float) -> bool:
        change = changed(*numbers)
        there, peg = (who, change) if isinstance(change, hf.Peg) else (replace(who, **change), target)
        turn = float(there.limits.fastest_moves([np.pi])[0][0])  # s, of a motor that is not too slow for the swing
        usual = "motor" not in words or turn <= 0.5 * there.period
        usual = usual and ("strike" not in words or there.time >= search_time(replace(there, time=1.5), peg))
        return usual and check_feasibility(there, peg).feasible

    assert helps(*numbers)  # rounded to what is enough
    assert not helps(*(numbers * (1.0 - sense * 0.02)))  # a factor is found to 1 %


def test_a_target_in_reach_needs_no_remedy():
    assert find_remedies(CAST_SETUP, PEG) == ()
