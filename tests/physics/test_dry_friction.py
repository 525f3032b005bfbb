"""Coulomb's friction: closed forms, an integration with events by scipy, and joints that stick when they should."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import hyperflex as hf
from hyperflex.core.integrate.rollout import REJECTED, TAKEN
from hyperflex.motion import Motion
from hyperflex.simulation import Rollout
from tests.reference import stick
from tests.reference.arm import bang_bang_swings, links_of

DRY, LENGTH, MASS = 0.02, 0.5, 0.1
WEIGHT, INERTIA = 0.5 * MASS * 9.81 * LENGTH, MASS * LENGTH**2 / 3.0  # N m, kg m^2
ROD = hf.Rope(length=[LENGTH], mass=[MASS], dry_friction=DRY)


def half_swings(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles at which a rod let go at `angle` comes to rest, one after the other, and when; the last one sticks."""
    angles, times = [angle], [0.0]
    while WEIGHT * abs(np.sin(angle)) > DRY:
        # Energy: what gravity gives is what friction takes.
        side = np.sign(angle)

        def twice_kinetic(x: float, a: float = angle) -> float:
            return 2.0 / INERTIA * (WEIGHT * (np.cos(x) - np.cos(a)) - DRY * abs(x - a))

        least = side * np.arcsin(DRY / WEIGHT)  # here the rod is fastest
        end = brentq(twice_kinetic, least, -angle, xtol=1e-15, rtol=1e-15)
        # dt = dx / rate; x = middle + half sin(u) takes the square roots at both ends away.
        middle, half = 0.5 * (angle + end), 0.5 * abs(angle - end)

        def slowness(u: float, m: float = middle, h: float = half, f: object = twice_kinetic) -> float:
            return float(h * np.cos(u) / np.sqrt(f(m + h * np.sin(u))))

        nodes, weights = np.polynomial.legendre.leggauss(60)
        times.append(
            times[-1] + np.pi / 2 * sum(w * slowness(np.pi / 2 * u) for u, w in zip(nodes, weights, strict=True))
        )
        angle = end
        angles.append(angle)
    return np.array(angles), np.array(times)


@pytest.mark.parametrize("how", [{"tol": 1e-11}, {"step": 5e-4}], ids=["extrapolation", "rk4"])
def test_a_rod_swings_to_rest(how):
    angles, times = half_swings(1.0)
    assert angles.size == 7
    near = 1e-7  # s
    t = np.sort(np.concatenate([times[1:] - near, times[1:], times[1:] + near, [times[-1] + 5.0]]))
    run = hf.simulate(ROD, duration=20.0, q0=[1.0], t_eval=t, **how)
    before, at, after = (run.qd[k:-1:3, 0] for k in range(3))
    # A dozen steps of 1e-11 m a half swing; times of rest follow the angles. RK4 at 0.5 ms errs by some 1e-10.
    np.testing.assert_allclose(run.q[1:-1:3, 0], angles[1:], rtol=0, atol=2e-9)
    assert (np.abs(at) < 1e-7).all()  # rates near rest: 30 rad/s^2 times 3e-9 s, the quadrature's error in it
    assert (np.sign(before[:-1]) == -np.sign(after[:-1])).all()  # it turns back within 1e-7 s of when it should
    assert before[-1] != 0.0
    assert after[-1] == 0.0
    assert run.qd[-1, 0] == 0.0
    assert run.qdd[-1, 0] == 0.0
    assert run.q[-1, 0] == run.q[-2, 0]  # not a bit in 5 s
    assert np.abs(run.energy_error).max() < 1e-9  # J, of 0.1 J


def test_regularized_friction_tends_to_stiction():
    """A rod comes to rest a little later, and then creeps; the energy account closes."""
    angles, times = half_swings(1.0)
    errors = []
    for tolerance in (0.04, 0.02, 0.01):
        how = {"stiction_tolerance": tolerance, "keep": ("q", "qd", "dissipated_energy"), "tol": 1e-9}
        swung = hf.simulate_batch(ROD, q0=[1.0], t_eval=times[1:], duration=20.0, **how)
        errors.append(float(np.abs(swung.q[0, :-1, 0] - angles[1:-1]).max()))
        lost = WEIGHT * (np.cos(swung.q[0, :, 0]) - np.cos(1.0))
        # at the turns kinetic energy is that of creeping, below 1e-5 J
        np.testing.assert_allclose(swung.dissipated_energy[0], lost, rtol=0, atol=1e-5)
        crept = hf.simulate_batch(ROD, q0=[0.5 * DRY / WEIGHT], duration=0.2, **how)
        # the part of dry friction that holds the rod is sin(a) for tan(a) = rate / tolerance
        part = WEIGHT * np.sin(crept.q[0, 0, 0]) / DRY
        # 2 %: in 0.2 s the load falls by a tenth and the rate by 0.7 of itself a second, with a delay of up to 26 ms
        assert -crept.qd[0, 0, 0] == pytest.approx(tolerance * np.tan(np.arcsin(part)), rel=0.02)
    assert errors[0] < 1e-3
    assert errors[2] < 0.4 * errors[1] < 0.16 * errors[0]  # of nearly second order in the tolerance


def test_regularized_friction_converges_with_a_fixed_step():
    how = {"q0": [1.0], "t_eval": [0.5, 1.0, 1.5], "duration": 2.0, "stiction_tolerance": 0.04, "keep": ("q",)}
    exact = hf.simulate_batch(ROD, tol=1e-9, **how).q
    errors = [float(np.abs(hf.simulate_batch(ROD, step=step, **how).q - exact).max()) for step in (4e-3, 2e-3, 1e-3)]
    # 2e-5, 1e-6 and 2e-8 rad: the default tolerance takes a method of high order
    assert errors[0] < 4e-5
    assert errors[2] < 0.2 * errors[1] < 0.04 * errors[0]


def test_a_spring_loses_the_same_each_half_swing():
    """Between turns a harmonic oscillation about +-dry/stiffness: each turn is 2 dry/stiffness nearer, on time."""
    stiffness, dry, start = 0.05, 2e-3, 0.5
    rope = hf.Rope(length=[LENGTH], mass=[MASS], stiffness=stiffness, dry_friction=dry, gravity=(0.0, 0.0))
    half = np.pi * np.sqrt(INERTIA / stiffness)
    turns = np.arange(1, 7)  # 0.5 rad loses 0.08 rad a half swing, and sticks below 0.04 rad
    run = hf.simulate(rope, duration=10.0, q0=[start], t_eval=np.append(half * turns, 10.0), tol=1e-10)
    want = (start - 2 * dry / stiffness * turns) * (-1.0) ** turns
    np.testing.assert_allclose(
        run.q[:-1, 0], want, rtol=0, atol=1e-8
    )  # a dozen steps a half swing of 1e-10 m, six times
    assert abs(want[-1]) < dry / stiffness
    # the sixth output lies at the last turn, within the rounding of its time, on either side of it
    assert abs(run.q[-1, 0] - run.q[-2, 0]) < 1e-12


@pytest.mark.parametrize("how", ["single", "batch"])
def test_a_rod_on_a_wheel_comes_loose_when_its_inertia_is_too_much(how):
    """The wheel turns by c t^3: the rod's joint must give 6 c t INERTIA, and cannot from dry / (6 c INERTIA) on."""
    c, end = 0.4, 2.0
    coef = np.zeros((1, 4, 6))
    coef[0, 0, 3] = c
    wheel = Motion(np.array([0.0, 10.0]), coef, np.ones(2, dtype=bool))
    rope = hf.Rope(length=[LENGTH], mass=[MASS], dry_friction=DRY, gravity=(0.0, 0.0))
    loose = DRY / (6 * c * INERTIA)
    assert 0.9 < loose < 1.1
    t = np.array([0.5, loose, 1.5, end])
    late = np.maximum(t - loose, 0.0)
    # Loose, it feels a constant torque.
    want = c * np.minimum(t, loose) ** 3 + 3 * c * loose**2 * late + 0.5 * DRY / INERTIA * late**2
    kept = {"arm": hf.Arm(length=0.0), "duration": end, "t_eval": t, "tol": 1e-11}
    if how == "single":
        run = hf.simulate(rope, wheel, **kept)
        got, lost = run.q[:, 0], run.dissipated_energy[-1]
        assert run.qd[0, 0] == run.arm_rate[0]
        np.testing.assert_allclose(run.qdd[:, 0], np.minimum(6 * c * t, DRY / INERTIA), rtol=1e-9)
    else:
        batch = hf.simulate_batch([rope] * 2, wheel, keep=("q", "dissipated_energy"), **kept)
        got, lost = batch.q[1, :, 0], batch.dissipated_energy[1, -1]
    # The scheme is exact for these polynomials, and outputs within a step are as accurate as the run's tolerance; a
    # millisecond's error in the instant would show as 1e-9 rad already.
    np.testing.assert_allclose(got, want, rtol=0, atol=kept["tol"])
    assert lost == pytest.approx(DRY * (c * end**3 - want[-1]), rel=1e-9)  # friction times the way that it slipped


@pytest.mark.parametrize("friction_model", ["relative", "printed"])
def test_two_joints_stick_and_slip_in_turn(friction_model):
    rope = hf.Rope(
        length=[0.3, 0.2], mass=[0.1, 0.05], friction=1e-4, dry_friction=[0.1, 0.02], friction_model=friction_model
    )
    first = next(bang_bang_swings(1.6, 0.3, 5.0))

    def base(t):
        return first.base(t, 0.1)

    q0, w0 = np.array([-1.3, -0.3]), np.array([0.0, 0.0])
    want, events = stick.integrate(links_of(rope), base, 0.0, first.end, q0, w0)
    kinds = {(event.joint, event.loose) for event in events}
    assert len(events) >= 4
    assert {(0, False), (1, True)} <= kinds  # joints stick, and come loose
    t = np.unique([*(event.time for event in events), first.end])
    run = hf.simulate(
        rope, hf.arm_swings(1.6, 0.3), arm=hf.Arm(length=0.1), duration=1.0, q0=q0, qd0=w0, t_eval=t, tol=1e-12
    )
    np.testing.assert_allclose(np.concatenate([run.q[-1], run.qd[-1]]), want, rtol=0, atol=1e-8)
    slip = np.diff(run.qd, axis=1, prepend=run.arm_rate[:, None])
    for event in events:
        k = int(np.searchsorted(t, event.time))
        # Accelerations of some 100 rad/s^2: a rate below 1e-7 rad/s says that the instant is right to 1e-9 s.
        assert abs(slip[k, event.joint]) < 1e-7


def test_nothing_creeps_below_the_limit():
    """For 10 s: a rod held up; a stiff chain on a casting arm; and a held link from which another one swings."""
    held = hf.simulate(ROD.replace(dry_friction=0.2), duration=10.0, q0=[0.5], t_eval=[0.0, 10.0])
    assert (held.q == 0.5).all()
    rope = hf.Rope.uniform(length=0.3, mass=0.03, n_links=6, friction=0.0, dry_friction=0.3)
    start = -np.pi / 2 + np.linspace(0.1, 0.6, 6)
    cast = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=10.0, q0=start)
    bends = np.diff(cast.q, axis=1, prepend=cast.arm_angle[:, None])
    assert np.abs(bends - bends[0]).max() < 1e-12  # rounding of the angles; 1e-6 is required
    two = hf.Rope(length=[0.3, 0.3], mass=[0.05, 0.05], dry_friction=[0.6, 0.0])
    load = hf.simulate(two, duration=10.0, q0=[0.4, 1.5])
    assert np.abs(load.q[:, 1]).max() > 1.0
    assert (load.q[:, 0] == 0.4).all()
    assert (load.qd[:, 0] == 0.0).all()
    # The holding torque does no friction work.
    np.testing.assert_array_equal(load.dissipated_energy, 0.0)


def test_a_sampled_arm_carries_what_sticks():
    """Through the knots of a spline, which the steps do not stop at."""
    grid = np.linspace(0.0, 3.0, 16)
    motion = hf.sampled_motion(grid, 0.8 * np.sin(2 * grid))
    run = hf.simulate(ROD.replace(dry_friction=0.4), motion, arm=hf.Arm(length=0.1), duration=3.0, q0=[0.3])
    assert np.abs(run.q[:, 0] - run.arm_angle - 0.3).max() < 1e-13  # the angles' own rounding


def messy(n: int, seed: int, **changes: object) -> tuple[hf.Rope, np.ndarray]:
    rng = np.random.default_rng(seed)
    rope = hf.Rope(
        length=0.5 / n * rng.uniform(0.5, 1.5, n),
        mass=0.1 / n * rng.uniform(0.5, 1.5, n),
        dry_friction=3e-3 * rng.uniform(0.0, 1.0, n) * (rng.random(n) < 0.8),
        friction=1e-5,
        stiffness=1e-3 * (seed % 2),
        **changes,
    )
    return rope, np.cumsum(rng.normal(0.0, 1.0 / np.sqrt(n), n))


@pytest.mark.parametrize("seed", range(6))
def test_chains_with_many_dry_joints(seed):
    n = (3, 6, 12)[seed % 3]
    rope, q0 = messy(n, seed)
    t = np.linspace(0.02, 0.4, 20)
    kept = {"arm": hf.Arm(length=0.1), "duration": 0.4, "q0": q0, "t_eval": t}
    motion = hf.arm_swings(0.3, 0.2)
    run = hf.simulate(rope, motion, tol=1e-8, **kept)
    fine = hf.simulate(rope, motion, tol=1e-11, **kept)
    # A hundred steps of 1e-8 m in links of 5 to 20 cm; errors grow some tenfold in 0.4 s (they do so without friction).
    np.testing.assert_allclose(run.q, fine.q, rtol=0, atol=2e-5)
    np.testing.assert_allclose(run.qd, fine.qd, rtol=0, atol=2e-3)
    assert np.abs(run.energy_error).max() < 1e-6  # J, of some 0.1 J: ten times tol over half a metre a step
    batch = hf.simulate_batch(rope, motion, keep=("q", "dissipated_energy"), tol=1e-9, **kept)
    np.testing.assert_allclose(batch.q[0], fine.q, rtol=0, atol=2e-5)
    np.testing.assert_allclose(batch.dissipated_energy[0], fine.dissipated_energy, rtol=0, atol=1e-7)


def test_events_of_many_joints_are_as_exact_as_the_steps_and_found_at_once():
    """A cast of 24 links whose joints stick and slip continually, compared with a hundredth of the tolerance."""
    rope = hf.Rope.uniform(1.0, 0.06, 24, 0.0025, friction=3e-4, dry_friction=1e-3)
    setup = hf.Setup(rope, hf.arm_swings(), hf.Arm(length=0.1), duration=1.5)
    coarse, fine = (hf.simulate(replace(setup, tol=tol), t_eval=[1.5]) for tol in (1e-5, 1e-7))
    assert np.abs(coarse.tip - fine.tip).max() < 1e-4  # ten times the tolerance, as promised
    assert (np.diff(coarse.qd) == 0.0).any()  # what sticks is at rest, to the last bit
    run = Rollout(setup, np.array([0.0, 1.5]))
    run.complete()
    tried, rejected = run.progress.clock[TAKEN], run.progress.clock[REJECTED]
    # One attempt goes beyond the event and the next ends at it, 414 for 195 steps; to 1e-13 s it were 996 for 159.
    assert tried < 2.5 * (tried - rejected)


def test_folded_chains_find_their_way_with_printed_friction():
    """Without the reaction on the parent a fold may answer friction the wrong way; lawful modes exist all the same."""
    rope = hf.Rope(length=[0.1] * 5, mass=[0.02] * 5, dry_friction=1e-2, friction_model="printed")
    starts = np.cumsum(np.random.default_rng(1).normal(0.0, 1.0, (60, 5)), axis=1)[48:56]
    batch = hf.simulate_batch([rope] * len(starts), q0=starts, t_eval=[2.0], duration=2.0, keep=("q",), tol=1e-9)
    assert set(batch.status) == {"success"}
    for q0, q in zip(starts, batch.q, strict=True):
        run = hf.simulate(rope, q0=q0, duration=2.0, tol=1e-9)
        # What stuck joints take from the rope is a parabola in each step, not under error control: J, of 0.1 J.
        assert np.abs(run.energy_error).max() < 1e-4
        # Some hundred steps that err by 1e-9 m in links of 10 cm; errors grow tenfold in these folds.
        np.testing.assert_allclose(run.q[-1], q[-1], rtol=0, atol=1e-5)
