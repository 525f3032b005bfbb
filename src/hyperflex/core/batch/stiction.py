"""Dry friction in the lanes of a batch: each lane settles its joints and shortens its own steps (see ``stick``)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.batch.members import (
    AFTER,
    BASE,
    CHATTER,
    EXTERNAL,
    FRESH,
    LAST,
    ORIGIN,
    RETRY,
    SINCE,
    STEP,
    TIME,
    UNSETTLED,
    WANTED,
    base_motion,
    chain_of,
)
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import PRINTED, Array, sincos
from hyperflex.core.integrate.event_search import AGAIN, EVENT, TRIES, Search, begin, judge
from hyperflex.core.jit import kernel
from hyperflex.core.stiction.constraint_torques import (
    QUICK,
    Bench,
    bench,
    come_to_rest,
    hold,
    margins,
    middle,
    stuck_loss,
    stuck_power,
    widened,
)
from hyperflex.core.stiction.slip_modes import settled


class Watch(NamedTuple):
    """What is kept for each of k lanes between the attempts of a step, and working arrays."""

    span: Array  # (k, 4) and so on as in events.Search
    low: Array  # (k, 2, n + 1)
    high: Array
    here: Array
    middle: Array
    alpha: Array  # (k, n) accelerations at the beginning of the step
    power: Array  # (k, 3) of stuck joints
    grip: Array  # (k, n)
    locked: Array  # (k, n + 1) as in events.judge
    start: Array  # (k, 2 n + 2) angles and rates at the beginning of the step, the last two not used
    out: Array  # (k, 2 n + 2) and at its end
    before: Array  # (k, 9) motion of the first joint, less gravity, at the beginning of the step
    after: Array  # (9,) at another time
    bench: Bench


@kernel
def new_watch(n):  # type: ignore[no-untyped-def]
    """Arrays for chains of n links in all lanes."""
    k = len(ln.MEMBERS)
    span, still = np.zeros((k, 4)), np.full((4, k, 2, n + 1), np.inf)
    some = np.zeros((2, k, 2 * n + 2))
    return Watch(
        span,
        still[0],
        still[1],
        still[2],
        still[3],
        np.zeros((k, n)),
        np.zeros((k, 3)),
        np.ones((k, n)),
        np.zeros((k, n + 1)),
        some[0],
        some[1],
        np.zeros((k, 9)),
        np.zeros(9),
        bench(n),
    )


@kernel
def unloaded(members, terms, m):  # type: ignore[no-untyped-def]
    """Chain of member m without gravity, which the base's acceleration holds in a batch."""
    return chain_of(members, terms, m, 0.0, 0.0)


@kernel
def base_at(path, j, since, base):  # type: ignore[no-untyped-def]
    """Motion of lane j's first joint, less gravity, to ``base`` (9,), `since` its piece began; returns the torque."""
    k = len(ln.MEMBERS)
    path[SINCE * k + j] = since
    base_motion(ln.MEMBERS, path)
    for s in range(9):
        base[s] = path[(BASE + s) * k + j]
    return path[EXTERNAL * k + j]


@kernel
def settle_lane(members, terms, m, lanes, path, j, lane, watch):  # type: ignore[no-untyped-def]
    """Decide how the joints of member m in lane j slip or stick where it stands; False if they chatter."""
    k, n = len(ln.MEMBERS), members.links.shape[2]
    start, grip, base = watch.start[j], watch.grip[j], watch.before[j]
    for i in range(n):
        start[i] = lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j]
        start[n + i] = lanes[((i + 1) * ln.ROW + ln.W_START) * k + j]
    torque = base_at(path, j, lane[TIME] - lane[ORIGIN], base)
    chain, before = unloaded(members, terms, m), watch.out[j, :n]
    rates = start[n : 2 * n]
    good, chatter = settled(chain, start[:n], rates, base[:7], torque, lane[CHATTER], grip, before, watch.bench)
    lane[CHATTER] = chatter
    for i in range(n):
        lanes[((i + 1) * ln.ROW + ln.GRIP) * k + j] = grip[i]
        lanes[((i + 1) * ln.ROW + ln.W_START) * k + j] = rates[i]
        watch.locked[j, i] = 1.0 - grip[i] * grip[i]
    lane[UNSETTLED] = 0.0
    return good


@kernel
def look(members, terms, m, lanes, path, j, lane, watch):  # type: ignore[no-untyped-def]
    """Judge the step of lane j, of the length WANTED: a verdict of ``events.judge``; with AGAIN, WANTED is shorter."""
    k, n = len(ln.MEMBERS), members.links.shape[2]
    chain, tools = unloaded(members, terms, m), watch.bench
    start, out, grip, before, after = watch.start[j], watch.out[j], watch.grip[j], watch.before[j], watch.after
    search = Search(watch.span[j], watch.low[j], watch.high[j], watch.here[j], watch.middle[j])
    since, step, widen = lane[TIME] - lane[ORIGIN], lane[WANTED], widened(lane[CHATTER], n)
    until = (lane[TIME] + step) - lane[ORIGIN]  # as the next step will reckon it
    if lane[RETRY] == 0.0:
        for i in range(n):
            start[i] = lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j]
            start[n + i] = lanes[((i + 1) * ln.ROW + ln.W_START) * k + j]
        torque = base_at(path, j, since, before)
        margins(chain, start[:n], start[n : 2 * n], grip, before[:7], torque, widen, tools, search.low)
        assign(watch.alpha[j], tools.alpha)
        watch.power[j, 0] = stuck_power(chain, start[n : 2 * n], grip, tools.load)
        begin(search)
    for i in range(n):
        row = lanes[(i + 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        out[i] = row[ln.Q_START * k + j] + row[ln.Q_SUM * k + j]
        out[n + i] = row[ln.W_START * k + j] + row[ln.W_SUM * k + j]
    torque = base_at(path, j, until, after)
    hold(chain, grip, start, before, out, after)
    margins(chain, out[:n], out[n : 2 * n], grip, after[:7], torque, widen, tools, search.here)
    watch.power[j, 2] = stuck_power(chain, out[n : 2 * n], grip, tools.load)
    if search.span[TRIES] == 0.0 or (len(chain.bears) == len(PRINTED) and not grip.all()):
        middle(step, start[:n], start[n : 2 * n], watch.alpha[j], out, tools)
        torque = base_at(path, j, since + 0.5 * step, after)
        margins(chain, tools.state[:n], tools.state[n:], grip, after[:7], torque, widen, tools, tools.margin)
        assign_rows(search.middle[:, :n], tools.margin)
        watch.power[j, 1] = stuck_power(chain, tools.state[n:], grip, tools.load)
        base_at(path, j, until, after)
    verdict, length = judge(watch.locked[j], search, step)
    if verdict == EVENT:
        come_to_rest(chain, grip, search.here, out, after)
    lane[RETRY] = 1.0 if verdict == AGAIN else 0.0
    lane[WANTED] = length
    return verdict


@kernel
def conclude(lanes, n, j, lane, energy, step, event, watch):  # type: ignore[no-untyped-def]
    """Make the judged end of lane j's step, of the length `step`, the start of its next one."""
    k = len(ln.MEMBERS)
    for i in range(n):
        lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j] = watch.out[j, i]
        lanes[((i + 1) * ln.ROW + ln.W_START) * k + j] = watch.out[j, n + i]
        sin, cos = sincos(watch.out[j, i])
        lanes[((i + 1) * ln.ROW + ln.SIN_START) * k + j] = sin
        lanes[((i + 1) * ln.ROW + ln.COS_START) * k + j] = cos
    power = watch.power[j]
    energy[j, 1] += stuck_loss(power, step, 1.0)
    power[:] = 0.0
    if event:
        lane[STEP] = min(lane[STEP], lane[AFTER])
        lane[FRESH] = lane[UNSETTLED] = 1.0
        lane[LAST] = 0.0
    if event and step < QUICK:
        lane[CHATTER] += 1.0
    elif step >= QUICK:
        lane[CHATTER] = 0.0
