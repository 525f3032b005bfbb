"""Whether a run keeps its tolerance: against a tighter run, and a Runge-Kutta run if that is cheap, within a horizon.

`tol` is the allowed error of one step in the position of any joint, and in its velocity times some milliseconds; for
steps below :data:`SHARE` in proportion. The growth of such an error is measured with two perturbed runs: one in the
angles, one in the rates, each as large as `tol` allows. If all errors had the same direction, they would add up to::

    error(t) <= K tol (1 + t / SHARE) max(1, growth(t))

which is the bound of a run, as long as the right side, and the distance of the perturbed runs, are small compared with
the rope (:data:`SMALL`): this is the horizon. A run with a larger error is wrong without a warning. K = 3, because the
error of one step was up to 2.6 times its estimate, and because two random perturbations miss the fastest growth. The
runs that a run is compared with need not last longer than that: they are a :data:`SHORTEST` part of it at first, and
twice as long each time, until the horizon lies in them. A run of the same rope that ends at an event has to end in time
(``event_times``). Most errors do not add up in this way: :data:`USUAL` counts the runs that stay below ``USUAL tol
max(1, growth)``.
"""

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.errors import SimulationError
from hyperflex.model import Setup
from hyperflex.simulation import runge_kutta_limit, simulate
from hyperflex.trajectory import Trajectory
from tests.reference.event_times import NONE, timing

Real = npt.NDArray[np.float64]

K = 3.0  # see above
USUAL = 30.0
SHARE = 0.02  # s, as in hyperflex.core.integrate.rollout
SMALL = 0.02  # of the rope's length
TIGHTER = 100.0
SAMPLES = 101
SHORTEST = 1 / 16  # of the duration
EFFORT = 3e6  # links times steps that a Runge-Kutta run may cost


class Verdict(NamedTuple):
    """What became of a run. Errors are the largest inside the horizon."""

    outcome: str  # "accurate", "wrong", "failed" (with a reason) or "unchecked" (a tighter run failed)
    reason: str
    promise: float  # error in units of what is promised; "accurate" up to 1
    factor: float  # error in units of tol max(1, growth)
    error: float  # m
    growth: float
    horizon: float  # s
    checked: bool  # whether Runge and Kutta's errors are among them, too
    energy: float  # greatest error of the energy account over the greatest kinetic energy
    event: str  # name of the event whose time was checked, if any
    late: float  # s, error of that time
    lateness: float  # the same in units of what is promised
    seconds: float  # processor time of the run


class OutOfPatience(Exception):
    """Raised by a signal where a run, or its checks, take too long."""

    status = "too slow"


def judge(setup: Setup, seed: int = 0) -> Verdict:
    """Run a set-up and say whether it kept its tolerance."""
    t = np.linspace(0.0, setup.duration, SAMPLES)
    begin = time.process_time()
    try:
        run = simulate(setup, t_eval=t)
    except (SimulationError, OutOfPatience) as error:
        return _unjudged("failed", error.status, time.process_time() - begin)
    seconds = time.process_time() - begin
    try:
        return _checked(setup, run, t, seconds, seed)
    except (SimulationError, OutOfPatience) as error:
        return _unjudged("unchecked", error.status, seconds)


def _checked(setup: Setup, run: Trajectory, t: Real, seconds: float, seed: int) -> Verdict:
    """Judge a run that ended well; raises where the runs that it is compared with do not."""
    tight, truth, growth, promised = _horizon(setup, t, seed)
    kept = promised.size
    error = distance(run, truth)[:kept]
    check = runge_kutta(replace(setup, duration=tight.duration), t[:kept])
    own = np.full(kept, np.inf) if check is None else distance(*check)
    checked = bool((own <= promised).all())
    if check is not None and checked:  # of the fourth order: half the step leaves a sixteenth; allow a quarter
        error = np.maximum(error, distance(run, check[0]) - 0.25 * own)
    event = timing(setup, tight, truth, promised, float(t[kept - 1]), seed)
    good, in_time = (error <= promised).all(), not event.promise > 1.0
    return Verdict(
        "accurate" if good and in_time else "wrong",
        "" if in_time else "time of the event",
        float((error / promised).max()),
        float((error / (setup.tol * growth)).max()),
        float(error.max()),
        float(growth.max()),
        float(t[kept - 1]),
        checked,
        float(np.abs(run.energy_error).max() / max(run.kinetic_energy.max(), 1e-300)),
        *event,
        seconds,
    )


def _horizon(setup: Setup, t: Real, seed: int) -> tuple[Setup, Trajectory, Real, Real]:
    """The tighter set-up as far as it is run, its run, and growth and promise (T,) up to the horizon."""
    small = SMALL * setup.rope.total_length
    part = SHORTEST
    while True:
        upto = t[: 1 + round(part * (t.size - 1))]
        tight = replace(setup, tol=setup.tol / TIGHTER, duration=float(upto[-1]))
        truth = simulate(tight, t_eval=upto)
        beside = nudges(setup, np.random.default_rng(seed))
        nudged = [simulate(replace(tight, **nudge), t_eval=upto) for nudge in beside]
        apart = np.max([distance(one, truth) for one in nudged], axis=0)
        growth = np.maximum(1.0, growth_along_the_way(apart, setup.tol))
        promised = K * setup.tol * growth * (1.0 + upto / SHARE)
        inside = np.logical_and.accumulate((apart < small) & (promised < small))
        inside[0] = True
        if part == 1.0 or not inside[-1]:
            kept = int(inside.sum())
            return tight, truth, growth[:kept], promised[:kept]
        part = min(1.0, 2.0 * part)


def _unjudged(outcome: str, reason: str, seconds: float) -> Verdict:
    none = float("nan")
    return Verdict(outcome, reason, none, none, none, none, none, False, none, *NONE, seconds)


def drift(setup: Setup) -> float:
    """Largest angle, rad, by which a joint of a rope that should stick has turned by the end."""
    run = simulate(setup, t_eval=[setup.duration])
    turned = run.q[-1] - setup.start()[0]
    return float(np.abs(np.diff(turned, prepend=0.0)).max())


def distance(run: Trajectory, other: Trajectory) -> Real:
    """Largest distance (T,) of any joint in one run from the same joint in the other, m, as long as both last."""
    last = min(run.t.size, other.t.size)
    return np.asarray(np.linalg.norm(run.joints[:last] - other.joints[:last], axis=2).max(axis=1))


def nudges(setup: Setup, rng: np.random.Generator) -> list[dict[str, Real]]:
    """Perturbed starts of the set-up: every angle, every rate, by the error that `tol` allows in a step."""
    rope = setup.rope
    n = rope.n_links
    q = np.full(n, rope.hanging_angle) if setup.q0 is None else setup.q0
    qd = np.zeros(n) if setup.qd0 is None else setup.qd0
    across = np.stack([np.cos(q), np.sin(q)], axis=1)
    changes = []
    for size in (setup.tol, setup.tol / SHARE):
        change = rng.normal(0.0, 1.0, n)
        moved = np.linalg.norm(np.cumsum((rope.length * change)[:, None] * across, axis=0), axis=1).max()
        changes.append(size / moved * change)
    return [{"q0": q + changes[0], "qd0": qd}, {"q0": q, "qd0": qd + changes[1]}]


def growth_along_the_way(apart: Real, tol: float) -> Real:
    """Growth factor (T,) at each time of an error of `tol` made at any earlier time.

    A nudge of `tol` at the start that is `apart` by then tells of later errors as well, as long as it has not sunk
    into the errors of the runs themselves, some hundredths of `tol`: what was less than a tenth counts as a tenth.
    """
    least = np.minimum.accumulate(np.clip(apart, 0.1 * tol, tol))
    return np.asarray(apart / least)


def runge_kutta(setup: Setup, t: Real) -> tuple[Trajectory, Trajectory] | None:
    """Runs by the classical method with a step and with twice that step, or None where they would cost too much."""
    chain = setup.chain()
    fastest = float(np.abs(setup.start()[1]).max())
    step = min(0.2 * runge_kutta_limit(chain), 5e-4, 2e-3 / max(1.0, 0.1 * fastest))
    if setup.duration / step * chain.length.size > EFFORT:
        return None
    try:
        fine, coarse = (simulate(replace(setup, step=h), t_eval=t) for h in (step, 2.0 * step))
    except SimulationError:
        return None
    return fine, coarse
