"""Contact with round pegs against closed forms: the capstan, a mass on a string that winds up, impacts, energy."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from tests.core.helpers import rise
from tests.reference.random_throws import draw
from tests.reference.wrapping import capstan, laid, slipped
from tests.refusals import refuses

PEG = hf.Peg(0.0, 0.0, 0.02, 0.3)
AXIS = 0.0225  # m, of the rope on the peg


def on_a_peg(turns: float, mu: float) -> tuple[hf.Rope, hf.Peg]:
    """The paper's cable, as long as is needed, cut as the library cuts it for a peg."""
    peg = hf.Peg(0.0, 0.0, 0.02, mu)
    length = 0.25 + 2.0 * math.pi * turns * AXIS
    coarse = hf.Rope.uniform(length, 0.0625 * length, math.ceil(length / 0.04), 0.0025, friction=5e-4, gravity=(0, 0))
    return hf.refine_rope(coarse, [peg], arm=hf.Arm(length=0.3, pivot=(-AXIS - 0.3, 0.1))), peg


@pytest.mark.parametrize("turns", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("mu", [0.1, 0.3, 0.5])
def test_a_wound_rope_slips_where_the_capstan_law_says(mu, turns):
    """Quasi-static, at the links that the library picks: holds 3 % below exp(mu theta), slips 3 % above."""
    rope, peg = on_a_peg(turns, mu)
    swept = 2.0 * math.pi * turns
    limit = math.exp(mu * swept)
    times = np.array([0.0, 0.5, 1.5, 1.6, 3.0])
    ratios = limit * np.array([0.8, 0.97, 0.97, 1.03, 1.03])
    run = hf.simulate(capstan(rope, peg, swept, times, ratios))
    way = slipped(run, swept)
    # Slip is 1 mm in 1 s, sustained. Between 0.5 and 1.5 s the pull is 3 % below the limit, then 3 % above.
    assert abs(way[150] - way[60]) < 1e-3
    assert way[-1] - way[200] > 1e-3
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]


@pytest.mark.parametrize(("mu", "turns"), [(0.3, 1.0), (0.5, 2.0)])
def test_what_sticks_does_not_creep(mu, turns):
    rope, peg = on_a_peg(turns, mu)
    swept = 2.0 * math.pi * turns
    times = np.array([0.0, 0.5, 11.0])
    ratios = 0.95 * math.exp(mu * swept) * np.array([0.8, 1.0, 1.0])
    way = slipped(hf.simulate(capstan(rope, peg, swept, times, ratios)), swept)
    # The goal of the project: below 0.1 mm/s at 0.95 of the limit over 10 s. It is some nm/s: hold a tenth of the goal.
    assert abs(way[-1] - way[100]) / 10.0 < 1e-5


def test_a_mass_on_a_string_winds_up_round_a_peg():
    """Without weight the mass keeps its speed v, and the free length l obeys l^2 = l0^2 - 2 R v t (an involute)."""
    peg, speed, free = hf.Peg(0.0, 0.0, 0.02, 0.5), 2.0, 0.5
    rope = hf.Rope.uniform(0.6, 5e-3, 100, friction=1e-5, tip_mass=0.2, gravity=(0.0, 0.0))
    axis = 0.02 * (1.0 + 1e-6)
    q0 = laid(rope.length, (-axis, 0.1), axis, 0.0)
    qd0 = np.where(np.cumsum(rope.length) > 0.1 + 1e-9, speed / free, 0.0)
    still = hf.moving_pivot([0.0, 1.0], [-axis, -axis], [0.1, 0.1])
    run = hf.simulate(rope, still, duration=1.0, q0=q0, qd0=qd0, pegs=[peg], refine=False)
    left = np.sqrt(free**2 - 2.0 * 0.02 * speed * run.t)
    turned = (free - left) / 0.02
    # A polygon of corners d = 0.3 is 0.75 % longer than its circle, and the rope has 2.5 % of the mass.
    np.testing.assert_allclose(run.q[:, -1], turned, rtol=0, atol=0.02 * turned[-1])
    assert turned[-1] > 4.3
    # The mass keeps its energy: what joints and contact take of it is below 1 %.
    assert run.kinetic_energy[-1] == pytest.approx(run.kinetic_energy[0], rel=0.01)


def throws(seed: int) -> tuple[hf.Rope, dict[str, object]]:
    """A cable that falls on one to three pegs, in some random way, the arm at rest."""
    rng = np.random.default_rng(seed)
    rope = hf.Rope.uniform(1.0, 0.0625, 30, 0.0025, friction=10.0 ** rng.uniform(-4.0, -2.3))
    pegs = [
        hf.Peg(d * math.sin(a), -d * math.cos(a), rng.uniform(0.02, 0.05), rng.uniform(0.0, 1.0))
        for d, a in zip(rng.uniform(0.3, 0.8, 2), rng.uniform(-1.0, 1.0, 2), strict=True)
    ]
    side = rng.choice([-1.0, 1.0])
    q0 = side * rng.uniform(1.5, 2.5) + rng.normal(0.0, 0.2) * np.linspace(0.0, 1.0, 30)
    return rope, {"pegs": pegs, "q0": q0, "duration": 1.0}


@pytest.mark.parametrize("seed", range(4))
def test_energy_never_grows_in_random_throws(seed):
    rope, how = throws(seed)
    run = hf.simulate(rope, **how)
    # The goals of the project, for joints with friction of 1e-4 N m s/rad and more.
    assert rise(run.energy_error) < 1e-5
    assert rise(-run.contact_loss) < 1e-5  # contact gives nothing back
    assert run.attrs["contact_deepest"] < 2e-4
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]
    assert run.attrs["contact_steps"] > 0


@pytest.mark.parametrize(
    ("number", "duration", "limit"), [(277, 1.75, 1e-3), (750, 0.33, 1e-5), (760, 0.77, 1e-5), (864, 1.29, 1e-5)]
)
def test_a_throw_that_went_wrong_once_keeps_the_goals(number, duration, limit):
    """A link that touched hid another (277), samples in long steps (750) or lossy ones (760), no modes (864)."""
    kind, rope, how = draw(number, duration)
    run = hf.simulate(rope, refine=False, **how)
    # The goals of the project: 1e-5 J with joint friction of 1e-4 N m s/rad and more, 1e-3 J with less.
    assert rise(run.energy_error) < limit, kind
    assert rise(-run.contact_loss) < limit
    assert run.attrs["contact_deepest"] < 2e-4
    assert run.attrs["contact_unsolved"] <= 0.005 * run.attrs["contact_steps"]


def test_a_whole_set_up_is_not_cut():
    setup = hf.Setup(
        hf.Rope.uniform(length=1.0, mass=0.1, n_links=4, friction=0.0), duration=0.1, pegs=[hf.Peg(0.5, -0.5, 0.03)]
    )
    refuses("a whole set-up is not cut", hf.simulate, setup, refine=True)


def test_nothing_passes_a_peg_at_fifty_metres_a_second():
    """A rod on a long radius sweeps past at 50 m/s at its end, on a peg as thin as a pencil; it stops there."""
    peg = hf.Peg(0.9, 0.0, 0.004, 0.3)
    rod = hf.Rope(length=[1.0], mass=[0.05], radius=0.0025, gravity=(0.0, 0.0))
    run = hf.simulate(rod, duration=0.1, q0=[0.0], qd0=[50.0], pegs=[peg], refine=False)
    # It rests on the peg at the angle at which its axis is tangent to the circle of both radii.
    resting = 0.5 * math.pi - math.asin(0.0065 / 0.9)
    assert run.q[-1, 0] == pytest.approx(resting, abs=1e-5)
    assert abs(run.qd[-1, 0]) < 2e-3  # pushed out of a micrometre's penetration at a millimetre a second at most
    # Restitution zero: all of its energy is gone, and it went into the contact.
    energy = 0.5 * (0.05 / 3.0 + 0.25 * 0.05 * 0.0025**2) * 50.0**2
    assert run.contact_loss[-1] == pytest.approx(energy, rel=1e-6)


def test_a_rope_that_meets_no_peg_moves_as_without():
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=20, radius=0.0025, friction=5e-4)
    how = {"arm": hf.Arm(length=0.105), "duration": 3.0, "tol": 1e-8}
    alone = hf.simulate(cable, hf.arm_swings(), **how)
    beside = hf.simulate(cable, hf.arm_swings(), pegs=[hf.Peg(0.0, 3.0, 0.05)], refine=False, **how)
    assert beside.attrs["contact_steps"] == 0
    # Both within ten times the tolerance a step.
    np.testing.assert_allclose(beside.tip, alone.tip, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(beside.contact_force, 0.0)


def depth(run: hf.Trajectory, peg: hf.Peg) -> float:
    """How deep the last sample's links lie in a peg, m."""
    steps = run.setup.rope.length[:, None] * np.stack([np.sin(run.q[-1]), -np.cos(run.q[-1])], axis=1)
    begin = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])[:-1] - [peg.x, peg.y]
    part = np.clip(-(begin * steps).sum(axis=1) / (steps**2).sum(axis=1), 0.0, 1.0)
    gap = np.hypot(*(begin + part[:, None] * steps).T).min()
    return float(peg.radius + run.setup.rope.radius - gap)


@pytest.mark.parametrize(("rate", "distance"), [(8.0, 0.36), (20.0, 0.42)])
def test_a_coarse_run_is_not_held_up_where_a_whole_rope_winds_up(rate, distance):
    """A cord that turns about its end until all of it is wound and its tip comes to lie on the peg at speed.

    With steps as short as those of a run to the usual tolerance these two took 4,071 and 2,371 steps, of which 1,200
    are the least. Modes may be left unsolved at the tip for some of them; no energy appears, and nothing sinks.
    """
    cord = hf.Rope.uniform(length=1.2, mass=0.06, n_links=30, radius=0.003, friction=2e-4)
    peg, given = hf.Peg(distance, 0.0, 0.0266, mu=0.3), {"duration": 1.2, "t_eval": [1.2], "refine": False}
    given |= {"q0": np.full(30, 0.5 * np.pi + 0.35), "qd0": np.full(30, -rate), "tol": 1e-3, "contact_step": 1e-3}
    run = hf.simulate(cord, pegs=[peg], **given)
    assert run.attrs["contact_steps"] < 2000
    assert run.attrs["contact_unsolved"] < 0.05 * run.attrs["contact_steps"]
    assert run.attrs["energy_appeared"] < 1e-5
    assert run.attrs["contact_deepest"] < 5e-4


@pytest.mark.parametrize("deep", [5.6e-5, 8e-5])
def test_a_rope_that_starts_too_deep_is_pushed_out_in_usual_steps(deep):
    """A run that continues from a coarse one starts in this way. It may gain little energy for any step length."""
    rope, peg = hf.Rope.uniform(1.0, 0.06, 40, 0.003, friction=2e-4), hf.Peg(0.4, -0.15, 0.04, 0.3)
    fallen = hf.simulate(hf.Setup(rope, q0=[1.6] * 40, duration=2.0, pegs=(peg,), tol=1e-3, contact_step=1e-3))
    higher = replace(peg, y=peg.y + deep)
    start = replace(fallen.setup, q0=fallen.q[-1], qd0=fallen.qd[-1], pegs=(higher,))
    begun = replace(start, duration=0.2)
    assert hf.simulate(begun).attrs["contact_steps"] < 1000  # 40,000 where each was as short as can be
    left = [depth(hf.simulate(replace(start, duration=span)), higher) for span in (0.2, 6.0)]
    assert left[1] < left[0] < 1.05 * deep
    assert left[1] < 4e-5


@pytest.mark.parametrize(("number", "duration"), [(205, 1.6), (521, 0.62), (655, 1.7)])
@pytest.mark.nightly
def test_samples_within_hard_steps_keep_the_energy(number, duration):
    """Where one shorter step does not, a sample is reached by several.

    Straight between the ends of a step the energy of these was off by 94, 0.04 and 0.13 mJ. Throws are chaotic: of
    which a sample lies in a hard step changes with the kernels.
    """
    _, rope, how = draw(number, duration)
    run = hf.simulate(rope, refine=False, **how)
    assert rise(run.energy_error) < 1e-6  # as the steps do
