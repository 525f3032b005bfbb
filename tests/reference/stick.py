"""Coulomb's friction by another way than the package's: modes by trying them all, events by scipy's root finder."""

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from tests.reference import dense
from tests.reference.dense import Real

Base = Callable[[float], Real]
STILL = 1e-11  # rad/s; what is slower when modes are decided is at rest


class Event(NamedTuple):
    """At `time` the joint `joint` came to rest (or turned back), or came loose if it was stuck before."""

    time: float
    joint: int
    loose: bool


def lawful(links: Any, q: Real, w: Real, base: Real) -> Real:
    """Modes (n,) of the joints, the only ones among all 3^k of those at rest that Coulomb's law allows."""
    rate = np.diff(w, prepend=base[3])
    resting = np.flatnonzero((np.abs(rate) < STILL) & (links.dry > 0.0))
    grip = np.sign(rate)
    for choice in product([0.0, 1.0, -1.0], repeat=resting.size):
        grip[resting] = choice
        answer = dense.accelerations(links, q, w, base, dtype=float, grip=grip)
        turning = np.diff(answer.alpha, prepend=base[2])
        slack = 1e-9 * np.abs(answer.alpha).max()  # what an event just located leaves over
        stuck = resting[grip[resting] == 0.0]
        slipping = resting[grip[resting] != 0.0]
        if (np.abs(answer.held[stuck]) <= links.dry[stuck] * (1.0 - 1e-10)).all() and (
            grip[slipping] * turning[slipping] >= -slack
        ).all():
            return grip
    raise RuntimeError("no modes obey the law")


def integrate(
    links: Any, base: Base, start: float, end: float, q: Real, w: Real, tol: float = 1e-12
) -> tuple[Real, list[Event]]:
    """State (2 n,) at `end`, and what happened on the way; the base (7,) must be smooth between the two times."""
    n, t, events = len(q), start, []
    y = np.concatenate([q, w])
    while t < end:
        if len(events) > 1000:
            raise RuntimeError(f"joints chatter at {t} s")
        grip = lawful(links, y[:n], y[n:], base(t))

        def rate(t: float, y: Real, grip: Real = grip) -> Real:
            answer = dense.accelerations(links, y[:n], y[n:], base(t), dtype=float, grip=grip)
            return np.concatenate([y[n:], answer.alpha])

        def margin(t: float, y: Real, i: int, grip: Real = grip) -> float:
            if grip[i] == 0.0:
                answer = dense.accelerations(links, y[:n], y[n:], base(t), dtype=float, grip=grip)
                return float(links.dry[i] - abs(answer.held[i]))
            return float(grip[i] * (y[n + i] - (y[n + i - 1] if i else base(t)[3])))

        watched = [i for i in range(n) if links.dry[i] > 0.0]
        marks: list[Any] = [lambda t, y, i=i: margin(t, y, i) for i in watched]
        for mark in marks:
            mark.terminal, mark.direction = True, -1.0
        run = solve_ivp(rate, (t, end), y, "DOP853", events=marks, rtol=tol, atol=tol, max_step=0.01)
        t, y = float(run.t[-1]), run.y[:, -1].copy()
        for i, times in zip(watched, run.t_events, strict=True):
            if times.size:
                events.append(Event(t, i, bool(grip[i] == 0.0)))
                y[n + i] = y[n + i - 1] if i else base(t)[3]
        for i in range(n):
            if grip[i] == 0.0 and links.dry[i] > 0.0:
                y[n + i] = y[n + i - 1] if i else base(t)[3]
    return y, events
