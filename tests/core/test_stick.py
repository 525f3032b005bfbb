"""Modes of joints with dry friction, and the search for the instant at which one changes."""

from collections.abc import Callable

import numpy as np
import pytest

from hyperflex.core import stiction as stick
from hyperflex.core.integrate import events
from tests.core.helpers import chain_of
from tests.reference import dense
from tests.reference.cases import State, random_grip, random_links, random_state
from tests.reference.dense import Links, Real
from tests.reference.stick import lawful


@pytest.mark.parametrize("reaction", [1.0, 0.0], ids=["relative", "printed"])
@pytest.mark.parametrize("n", [1, 2, 5, 20])
def test_what_stuck_joints_bear_is_the_multiplier_of_the_constraint(n, reaction):
    links, state, slip = random_links(n, 3, reaction=reaction, air=True), random_state(n, 3), random_grip(n, 4)
    workspace = stick.new_stiction_workspace(n)
    stick.constraint_torques(chain_of(links), state.q, state.w, slip, state.base, 0.03, workspace)
    answer = dense.accelerations(links, *state, torque=0.03, grip=slip)
    stuck = slip == 0.0
    # Torques are sums of n forces of the size m a times lengths; the accelerations are right to 1e-12 of the largest.
    scale = np.abs(answer.alpha).max() * (links.mass.sum() + links.tip_mass) * links.length.sum() ** 2
    np.testing.assert_allclose(workspace.load[stuck], answer.held[stuck], rtol=0, atol=float(1e-12 * scale))
    parents = np.append(state.base[3], state.w[:-1])
    slipping = (-links.viscous * (state.w - parents) - links.dry * slip)[~stuck]
    np.testing.assert_allclose(workspace.load[~stuck], slipping, rtol=0, atol=float(1e-12 * scale))


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_modes_at_rest_are_those_that_trying_all_of_them_finds(n):
    """Complete chains at rest relative to their base, with limits similar to the loads: some stick, some slip."""
    kinds = set()
    for seed in range(12):
        links, state = random_links(n, seed, air=True), random_state(n, seed)
        state = State(state.q, np.full(n, state.base[3]), state.base)
        held = np.abs(dense.accelerations(links, *state, grip=np.zeros(n)).held).astype(float)
        links = links._replace(dry=held * np.random.default_rng(seed).uniform(0.4, 1.6, n))
        slip, workspace = np.zeros(n), stick.new_stiction_workspace(n)
        assert stick.find_modes(chain_of(links), state.q, state.w, state.base, 0.0, 1.0, slip, workspace)
        np.testing.assert_array_equal(slip, lawful(links, *state))
        kinds |= set(slip)
    assert len(kinds) == 3 or n == 1


def obeys_the_law(links: Links, state: State, slip: Real) -> bool:
    """Whether modes of a chain all of whose joints are at rest obey Coulomb's law, by the dense equations."""
    answer = dense.accelerations(links, *state, dtype=float, grip=slip)
    turning = np.diff(answer.alpha, prepend=state.base[2])
    slack = 1e-9 * np.abs(answer.alpha).max()  # of two ways to solve for accelerations
    stuck = slip == 0.0
    held = (np.abs(answer.held[stuck]) <= links.dry[stuck] * (1.0 + 1e-9)).all()
    return bool(held and (slip[~stuck] * turning[~stuck] >= -slack).all())


@pytest.mark.parametrize(("n", "seeds"), [(1, 20), (2, 60), (5, 40), (12, 20)])
def test_friction_without_reaction_leaves_lawful_modes_as_well(n, seeds):
    """A crumpled chain may have several. Letting the worst joint go need not find one; following them does."""
    stubborn = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        links, base = random_links(n, seed, reaction=0.0), random_state(n, seed).base
        state = State(rng.uniform(-np.pi, np.pi, n), np.full(n, base[3]), base)
        held = np.abs(dense.accelerations(links, *state, grip=np.zeros(n)).held).astype(float)
        links = links._replace(dry=held * rng.uniform(0.1, 1.2, n))
        chain, slip, workspace = chain_of(links), np.zeros(n), stick.new_stiction_workspace(n)
        known = (chain, state.q, state.w, state.base, 0.0)
        assert stick.find_modes(*known, 1.0, slip, workspace)
        assert obeys_the_law(links, state, slip)
        stubborn += not stick.active_set_search(*known, 1.0, n, np.zeros(n), np.zeros(n), workspace)
        assert stick.continuation(
            *known, np.ones(n), slip, workspace
        )  # all of them, not only those that would not come right
        assert obeys_the_law(links, state, slip)
    assert stubborn > 0 or n == 1


def test_events_that_change_nothing_are_rounding_and_chatter_has_an_end():
    n = 3
    links, state = random_links(n, 1), random_state(n, 1)
    state = State(state.q, np.full(n, state.base[3]), state.base)
    slip, workspace = np.zeros(n), stick.new_stiction_workspace(n)
    known = (chain_of(links), state.q, state.w, state.base, 0.0)
    assert stick.find_modes(*known, 1.0, slip, workspace)

    def settled(chatter, before):
        answer: tuple[bool, float] = stick.decide_modes(*known, chatter, before.copy(), np.zeros(n), workspace)
        return answer

    assert settled(0.0, slip) == (True, 0.0)  # the first event may change nothing
    good, chatter = settled(1.0, slip)
    assert good
    assert stick.tolerance_factor(chatter, n) == pytest.approx(10.0)
    assert settled(1.0, slip + 1.0) == (True, 1.0)
    assert stick.tolerance_factor(stick.chatter_allowance(n) + 26.0, n) == 1e8  # and no more
    assert settled(stick.chatter_allowance(n) + stick.STICTION.hopeless, slip)[0]
    assert not settled(stick.chatter_allowance(n) + 1.0 + stick.STICTION.hopeless, slip)[0]
    state.w[:] += 2e-10 * np.arange(1, n + 1)  # rest, where limits are wider by a thousand
    settled(stick.chatter_allowance(n) + 3.0, slip)
    np.testing.assert_array_equal(state.w, state.base[3])


def test_a_joint_that_turns_slips_whatever_its_load():
    links, state = random_links(5, 1), random_state(5, 1)
    slip, workspace = np.zeros(5), stick.new_stiction_workspace(5)
    assert stick.find_modes(chain_of(links), state.q, state.w, state.base, 0.0, 1.0, slip, workspace)
    np.testing.assert_array_equal(slip, np.sign(np.diff(state.w, prepend=state.base[3])))


Course = tuple[Callable[[float], float], Callable[[float], float]]  # margin and slope
COURSES: list[tuple[Course, float, float]] = [  # and the step, and when the event is
    ((lambda t: 1.0 - t * t, lambda t: -2.0 * t), 1.7, 1.0),
    ((lambda t: np.cos(3.0 * t) + 0.2, lambda t: -3.0 * np.sin(3.0 * t)), 0.8, np.arccos(-0.2) / 3.0),
    ((lambda t: np.exp(-t) - 0.9, lambda t: -np.exp(-t)), 1.0, -np.log(0.9)),
    ((lambda t: t * (0.3 - t), lambda t: 0.3 - 2.0 * t), 1.0, 0.3),  # begins at zero, as a joint that has come loose
    ((lambda t: (t - 0.5) ** 2 - 0.01, lambda t: 2.0 * t - 1.0), 1.0, 0.4),  # falls below zero and comes back
]


def new_search(margins: int, locked: float = 0.0) -> events.Search:
    search = events.search_of(events.new_searches(1, margins + 1, 1, 9), 0)  # the last one: no end of the run
    search.locked[:margins], search.span[events.HIGH] = locked, np.inf
    return search


def event_time(courses: list[Course], step: float, locked: float = 0.0, late: float = 0.0) -> tuple[float, int]:
    """When a search for the first event of margins ends, and after how many attempts."""
    search, attempts, verdict = new_search(len(courses), locked), 0, events.AGAIN
    search.late[:] = late
    for i, (value, slope) in enumerate(courses):
        search.low[:, i], search.middle[:, i] = (value(0.0), slope(0.0)), (value(0.5 * step), slope(0.5 * step))
    while verdict == events.AGAIN:
        for i, (value, slope) in enumerate(courses):
            search.here[:, i] = value(step), slope(step)
        taken = step
        verdict, step = events.assess_step(search, step)
        attempts += 1
    assert verdict == events.EVENT
    return taken, attempts


@pytest.mark.parametrize(
    ("case", "locked"),  # a stuck joint does not begin at its limit
    [(k, locked) for k in range(len(COURSES)) for locked in (0.0, 1.0) if (k, locked) != (3, 1.0)],
)
def test_the_search_ends_at_the_first_event(case, locked):
    (value, slope), step, at = COURSES[case]
    taken, attempts = event_time([(value, slope)], step, locked)
    assert at <= taken + 1e-15
    assert taken - at <= 1.01 * stick.STICTION.instant + 4e-16 / abs(slope(at))  # and the rounding of the margin itself
    assert attempts <= 11  # halving alone would take 43
    if case < 3:  # as much later as is allowed: the middle of the first attempt shows where
        late, attempts = event_time([(value, slope)], step, locked, 1e-2)
        assert -1e-2 <= value(late) <= 0.0
        assert late >= at
        assert attempts <= (4 if locked else 3)


def test_a_dip_before_another_joint_s_event_is_found():
    """The second margin dips below zero in the middle, which its ends do not show; the first one's event is later."""
    line = (lambda t: 0.9 - t), (lambda t: -1.0)
    dip = (lambda t: np.cos(2.0 * np.pi * t) + 0.9), (lambda t: -2.0 * np.pi * np.sin(2.0 * np.pi * t))
    taken, _ = event_time([line, dip], 1.0)
    assert taken == pytest.approx(np.arccos(-0.9) / (2.0 * np.pi), abs=2 * stick.STICTION.instant)


def test_a_search_that_has_come_further_does_not_go_back_for_a_dip_before():
    """If friction acts on one link, every attempt has a middle; it is not the middle of the remaining span."""
    search, low = new_search(1, 1.0), 0.5
    search.low[0, 0] = 1.0
    for step, margin, middle in ((1.0, -1.0, np.inf), (low, 0.2, np.inf), (0.6, 0.1, 0.0)):
        search.here[0, 0], search.middle[0, 0] = margin, middle
        verdict, length = events.assess_step(search, step)
        assert verdict == events.AGAIN
    assert 0.6 < length < 1.0


def test_a_joint_that_comes_loose_does_not_stop_for_rounding():
    """It barely accelerates at first, so its rate is rounding for a long time; then it slips, and stops much later."""
    start, jerk, end, rounding = 3e-10, 1e3, 0.04, 4e-16

    def value(t):
        exact = start * t + jerk * t * t * (1.0 - t / end) / 2.0
        return 0.0 if t == 0.0 else rounding * (np.floor(exact / rounding) - (2.0 if t < 1e-9 else 0.0))

    def slope(t):
        return start + jerk * t * (1.0 - 1.5 * t / end)

    taken, attempts = event_time([(value, slope)], 0.1)
    assert taken == pytest.approx(end + 2.0 * start / jerk, abs=2 * stick.STICTION.instant)
    assert attempts <= 16
