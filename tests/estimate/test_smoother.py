"""The linear smoother against the textbook's, and Gauss-Newton over frames against scipy's least squares."""

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.estimate import ChangeTests, EstimatedParameter, MovingHorizon, Observations, RopeFilter, smooth
from hyperflex.estimate.interval import Interval, Measured, Smoothed, Step, smooth_linear
from hyperflex.estimate.observations import InputFrame
from tests.estimate.runs import pushed_rates

SIZE = 5  # of the state
PENDULUM = hf.Rope.uniform(length=0.5, mass=0.1, n_links=2, radius=0.004, friction=2e-3)
ARCS = [0.25, 0.5]


def linear_problem(seed: int, noise_rows: int, frames: int = 7) -> tuple[Array, Array, list[Step], list[Measured]]:
    """A linear model drawn by chance; with fewer rows than states its noise is singular."""
    rng = np.random.default_rng(seed)
    steps = [
        (np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0], rng.normal(size=SIZE), rng.normal(size=(noise_rows, SIZE)))
        for _ in range(frames - 1)
    ]
    seen = [3, 0, 2, 2, 0, 1, 4]
    measurements = [(rng.normal(size=m), rng.normal(size=(m, SIZE))) for m in seen]
    return rng.normal(size=SIZE), rng.normal(size=(SIZE, SIZE)), steps, measurements


def rauch_tung_striebel(
    mean: Array, rows: Array, steps: list[Step], measurements: list[Measured]
) -> tuple[list[Array], list[Array], float]:
    """The smoother as textbooks print it, with covariances and their inverses."""
    known, predicted, likelihood = [], [(mean, rows.T @ rows)], 0.0
    for k, (z, h) in enumerate(measurements):
        x, p = predicted[-1]
        s = h @ p @ h.T + np.eye(len(z))
        gain = p @ h.T @ np.linalg.inv(s)
        left = z - h @ x
        size = np.linalg.slogdet(2.0 * np.pi * s)[1] if len(z) else 0.0
        likelihood -= 0.5 * (left @ np.linalg.solve(s, left) + size)
        known.append((x + gain @ left, p - gain @ h @ p))
        if k < len(steps):
            f, c, n = steps[k]
            predicted.append((f @ known[-1][0] + c, f @ known[-1][1] @ f.T + n.T @ n))
    means, covariances = [known[-1][0]], [known[-1][1]]
    for k in reversed(range(len(steps))):
        gain = known[k][1] @ steps[k][0].T @ np.linalg.inv(predicted[k + 1][1])
        means.append(known[k][0] + gain @ (means[-1] - predicted[k + 1][0]))
        covariances.append(known[k][1] + gain @ (covariances[-1] - predicted[k + 1][1]) @ gain.T)
    return means[::-1], covariances[::-1], likelihood


def covariances(found: list[Smoothed]) -> list[Array]:
    return [each.rows.T @ each.rows for each in found]


@pytest.mark.parametrize("noise_rows", [SIZE, 2, 0], ids=["full", "singular", "none"])
def test_linear_smoother_is_the_textbooks(noise_rows):
    """Equal up to rounding, which the textbook's inverses multiply by the condition of its matrices."""
    problem = linear_problem(0, noise_rows)
    found = smooth_linear(*problem)
    means, wide, likelihood = rauch_tung_striebel(*problem)
    np.testing.assert_allclose([each.mean for each in found], means, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(covariances(found), wide, rtol=1e-10, atol=1e-10)
    assert sum(each.log_likelihood for each in found) == pytest.approx(likelihood, rel=1e-10)
    assert found[1].log_likelihood == 0.0  # nothing was seen in that frame


def test_linear_smoother_with_a_singular_prior():
    """Where the prior knows some combinations of states exactly; the noise that it gives makes these states."""
    mean, rows, steps, measurements = linear_problem(1, 2)
    found = smooth_linear(mean, rows[:2], steps, measurements)
    largest, x = max(np.abs(each.mean).max() for each in found), mean + rows[:2].T @ found[0].v
    for each, (f, c, n) in zip(found[:-1], steps, strict=True):
        np.testing.assert_allclose(x, each.mean, atol=1e-10 * largest)
        x = f @ x + c + n.T @ each.noise
    np.testing.assert_allclose(x, found[-1].mean, atol=1e-10 * largest)


def test_results_of_the_first_frame_are_kept():
    """The prior of the second frame in place of the first frame: the same smoothed states from there on."""
    mean, rows, steps, measurements = linear_problem(2, 3)
    whole = smooth_linear(mean, rows, steps, measurements)
    part = smooth_linear(whole[1].prior_mean, whole[1].prior_rows, steps[1:], measurements[1:])
    np.testing.assert_allclose([each.mean for each in part], [each.mean for each in whole[1:]], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(covariances(part), covariances(whole)[1:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part[0].v, whole[1].v, rtol=1e-9, atol=1e-9)


def swing(frames: int = 6, gap: float = 0.06, q0: float = 0.9, seed: int = 0) -> list[Observations]:
    """Two links that swing, their ends seen with 2 mm of noise; one marker of frame 2 and all of frame 3 are hidden."""
    run = hf.simulate(PENDULUM, duration=gap * frames, q0=[q0, 1.5 * q0], t_eval=gap * np.arange(frames))
    places = np.asarray(run.joints)[:, 1:] + 2e-3 * np.random.default_rng(seed).normal(size=(frames, 2, 2))
    places[2, 0], places[3] = np.nan, np.nan
    return [Observations(float(t), each, 2e-3) for t, each in zip(run.t, places, strict=True)]


def interval(observations: list[Observations], density: float = 2.0) -> Interval:
    """All of them in one interval, from a prior that is off."""
    model = RopeFilter(PENDULUM, ARCS, parameters=[EstimatedParameter("friction", 0.5)])
    mean = np.array([0.7, 1.1, 0.5, -0.5, 0.1])
    rows = np.diag([0.3, 0.3, 1.0, 1.0, 0.5])
    nothing = np.zeros((0, 5))
    frames = [InputFrame(seen, seen.seen, 1.0, nothing) for seen in observations]
    fitted = Interval(model.process, model.model, mean, rows, frames[0], np.zeros(2))
    for before, seen in itertools.pairwise(observations):
        assert fitted.append(InputFrame(seen, seen.seen, 1.0, model.process.noise(seen.t - before.t, density)))
    return fitted


def residuals(variables: Array, fitted: Interval) -> Array:
    """What Gauss-Newton squares: start, noises and measurements, by the simulation alone."""
    start, *noises = np.split(variables, np.cumsum([len(each.noise) for each in fitted.frames[:-1]]) + 5)
    x, seen_before, terms = fitted.mean + fitted.rows.T @ start, None, [variables]
    for k, frame in enumerate(fitted.frames):
        if seen_before is not None:
            rope = PENDULUM.replace(friction=PENDULUM.friction * (1.0 + x[4]))
            t_eval = [frame.seen.t - seen_before]
            run = hf.simulate(rope, duration=frame.seen.t - seen_before, q0=x[:2], qd0=x[2:4], tol=1e-9, t_eval=t_eval)
            x = np.concatenate([run.q[-1], run.qd[-1], x[4:]]) + frame.noise.T @ noises[k - 1]
        place = PENDULUM.joints(x[:2], np.zeros(2))[1:]
        terms.append(((frame.seen.places - place)[frame.used] / 2e-3).ravel())
        seen_before = frame.seen.t
    return np.concatenate(terms)


def test_gauss_newton_finds_what_scipy_does():
    """Least squares by another code, over the start and all noises, with derivatives by differences.

    The two integrations differ by 5e-6 m at most, 0.25 % of a marker's deviation.
    """
    fitted = interval(swing())
    fitted.solve(20)
    ours = np.concatenate([fitted.start, *(node.noise for node in fitted.nodes)])
    found = least_squares(residuals, np.zeros(ours.size), args=(fitted,), xtol=1e-10, ftol=1e-12, diff_step=1e-5)
    assert fitted.cost == pytest.approx(2.0 * found.cost, rel=1e-3)
    np.testing.assert_allclose(ours, found.x, atol=0.03)  # of a standard deviation: CLOSE
    covariance = np.linalg.inv(found.jac.T @ found.jac)[:5, :5]
    first = fitted.smoothed[0].rows
    np.testing.assert_allclose(
        np.sqrt(np.diag(first.T @ first)), np.sqrt(np.diag(fitted.rows.T @ covariance @ fitted.rows)), rtol=0.02
    )


def test_the_cost_never_grows():
    """Also far from where the linear step is right: the pendulum goes over the top, the prior is half a turn off."""
    fitted = interval(swing(frames=8, gap=0.12, q0=2.8))
    costs = [fitted.cost]
    for _ in range(12):
        fitted.solve(1)
        costs.append(fitted.cost)
        assert np.isfinite(fitted.x).all()
        assert np.isfinite(fitted.factor).all()
    assert (np.diff(costs) <= 0.0).all()
    assert costs[-1] < 0.1 * costs[0]
    for (before, frame), (node, then) in itertools.pairwise(zip(fitted.nodes, fitted.frames, strict=True)):
        found = fitted.process.predict(before.x, frame.seen.t, then.seen.t)  # each state follows from the one before
        np.testing.assert_allclose(found.x + then.noise.T @ node.noise, node.x, atol=1e-9)


def test_a_long_horizon_is_the_smoother():
    """A moving horizon that never moved, and a smoother over all frames, with the same noise: the same posterior."""
    observations = swing(frames=8)
    horizon = MovingHorizon(PENDULUM, ARCS, frames=20, starts=1)
    whole = smooth(horizon, observations)
    fitted = horizon.horizon
    assert len(fitted.frames) == len(whole.states) == 8
    std = np.sqrt(np.diag(whole.states[-1].covariance))
    gap = np.concatenate([whole.states[-1].q, whole.states[-1].qd]) - fitted.x
    assert (np.abs(gap) < 0.5 * std).all()  # noise levels were learnt meanwhile, so not the same quite


def test_smoothed_states_are_nearer_than_filtered():
    """Through a gap of 0.4 s, too; 90 % regions hold."""
    gap = 0.05
    run = hf.simulate(PENDULUM, duration=4.0, q0=[2.0, 2.5], t_eval=np.arange(0.0, 4.0, gap))
    places = np.asarray(run.joints)[:, 1:] + 2e-3 * np.random.default_rng(1).normal(size=(run.t.size, 2, 2))
    places[50:58] = np.nan
    horizon, ahead = MovingHorizon(PENDULUM, ARCS), []
    observations = [Observations(float(t), each, 2e-3) for t, each in zip(run.t, places, strict=True)]
    tracker = MovingHorizon(PENDULUM, ARCS)
    for seen in observations:
        tracker.update(seen)
        ahead.append(tracker.state.q)
    found = smooth(horizon, observations)
    truth = np.hstack([run.q, run.qd])
    states = np.array([np.concatenate([each.q, each.qd]) for each in found.states])
    online, offline = np.array(ahead) - run.q, states[:, :2] - run.q
    assert np.sqrt((offline[10:] ** 2).mean()) < 0.8 * np.sqrt((online[10:] ** 2).mean())
    nees = [e @ np.linalg.solve(s.covariance, e) for e, s in zip(states - truth, found.states, strict=True)]
    assert np.mean(np.array(nees) < 7.78) > 0.85  # chi square, 4 degrees of freedom; the model is exact
    assert found.places.shape == (run.t.size, 2, 2)
    np.testing.assert_allclose(found.places[50:58], np.asarray(run.joints)[50:58, 1:], atol=5e-3)


def test_the_likelihood_of_all_is_the_filters_where_motion_is_linear(monkeypatch):
    """Small swings, levels of noise known: the same number, so that the noise that is true is ranked best."""
    monkeypatch.setattr(RopeFilter, "_learn", lambda *_: None)
    run = hf.simulate(PENDULUM, duration=0.6, q0=[0.02, 0.02], t_eval=np.arange(0.0, 0.6, 0.02))
    places = np.asarray(run.joints)[:, 1:] + 5e-4 * np.random.default_rng(4).normal(size=(run.t.size, 2, 2))
    known = []
    for std in (2e-4, 5e-4, 2e-3):
        seen = [Observations(float(t), each, std) for t, each in zip(run.t, places, strict=True)]
        one = RopeFilter(PENDULUM, ARCS)
        for each in seen:
            one.update(each)
        known.append(smooth(MovingHorizon(PENDULUM, ARCS, starts=1), seen).log_likelihood)
        assert known[-1] == pytest.approx(one.log_likelihood, abs=1.0)
    assert known[1] > max(known[0], known[2]) + 10.0


@pytest.mark.parametrize("what", ["tip_mass", "touch"])
def test_a_change_does_not_spoil_the_states_before_and_after(what):
    """A mass sticks to the tip, or the tip is pushed for 0.1 s: all is smoothed, and errors are as large as stated."""
    cable, gap, at = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, radius=0.002, friction=2e-4), 0.04, 2.0
    first = hf.simulate(cable, duration=at, q0=np.full(5, 0.8), t_eval=np.arange(0.0, at + 1e-9, gap))
    after = cable.replace(tip_mass=5e-3) if what == "tip_mass" else cable
    kick = pushed_rates(cable, np.asarray(first.q[-1]), 1.0, (0.008, 0.0)) if what == "touch" else np.zeros(5)
    then = np.arange(0.0, 1.6, gap)
    second = hf.simulate(after, duration=1.6, q0=first.q[-1], qd0=first.qd[-1] + kick, t_eval=then)
    q = np.concatenate([first.q, second.q[1:]])
    joints = np.concatenate([first.joints, second.joints[1:]])[:, 1:]
    joints = joints + 1e-3 * np.random.default_rng(2).normal(size=joints.shape)
    tracker = MovingHorizon(cable, np.linspace(0.2, 1.0, 5), starts=1, tests=ChangeTests((what,)))
    told = []

    def observed():
        for k, each in enumerate(joints):
            yield Observations(gap * k, each, std=1e-3)
            told.extend(tracker.changes)

    found = smooth(tracker, observed())
    assert len(told) == 1
    assert told[0].name == what
    if what == "tip_mass":
        value, std = found.values["tip_mass"]
        assert value == pytest.approx(5e-3, abs=4.0 * std)
        assert std < 5e-4
    error = np.array([each.q for each in found.states]) - q
    std = np.sqrt(np.array([np.diag(each.covariance)[:5] for each in found.states]))
    assert np.abs(error[10:] / std[10:]).max() < 6.0
    assert np.sqrt((error[10:] ** 2).mean()) < 7e-3
