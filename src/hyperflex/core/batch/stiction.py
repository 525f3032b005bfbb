"""Dry friction in the lanes of a batch: modes, events and shortened steps of each lane."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.batch.members import (
    AFTER,
    BASE,
    CHATTER,
    EXTERNAL,
    LAST,
    NEXT_STEP,
    ORIGIN,
    RESTARTED,
    RETRY,
    SINCE,
    STEP,
    TIME,
    UNDECIDED,
    base_motion,
    chain_of,
)
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import ONE_SIDED, Array, sincos, sticks_often
from hyperflex.core.integrate.event_search import AGAIN, EVENT, TRIES, Search, allow_lateness, assess_step, begin_search
from hyperflex.core.jit import inlined, kernel, non_allocating
from hyperflex.core.stiction.constraint_torques import (
    QUICK,
    StictionWorkspace,
    margins,
    midpoint_state,
    new_stiction_workspace,
    project_stuck,
    stop_joints,
    stuck_loss,
    stuck_power,
    tolerance_factor,
)
from hyperflex.core.stiction.slip_modes import decide_modes


class LaneStiction(NamedTuple):
    """What is kept for each of k lanes between the attempts of a step, and working arrays."""

    span: Array  # (k, 4) and so on as in event_search.Search
    low: Array  # (k, 2, n + 1)
    high: Array
    here: Array
    middle: Array
    late: Array  # (k, n + 1)
    alpha: Array  # (k, n) accelerations at the beginning of the step
    power: Array  # (k, 3) of stuck joints
    slip: Array  # (k, n)
    locked: Array  # (k, n + 1) as in event_search.assess_step
    start: Array  # (k, 2 n + 2) angles and rates at the beginning of the step, the last two not used
    out: Array  # (k, 2 n + 2) and at its end
    before: Array  # (k, 9) motion of the first joint, less gravity, at the beginning of the step
    after: Array  # (9,) at another time
    workspace: StictionWorkspace


@kernel
def new_lane_stiction(n):  # type: ignore[no-untyped-def]
    """Arrays for chains of n links in all lanes."""
    k = len(ln.MEMBERS)
    span, still = np.zeros((k, 4)), np.full((4, k, 2, n + 1), np.inf)
    some = np.zeros((2, k, 2 * n + 2))
    return LaneStiction(
        span,
        still[0],
        still[1],
        still[2],
        still[3],
        np.zeros((k, n + 1)),
        np.zeros((k, n)),
        np.zeros((k, 3)),
        np.ones((k, n)),
        np.zeros((k, n + 1)),
        some[0],
        some[1],
        np.zeros((k, 9)),
        np.zeros(9),
        new_stiction_workspace(n),
    )


@inlined
def chain_without_gravity(members, terms, m):  # type: ignore[no-untyped-def]
    """Chain of member m without gravity, which the base's acceleration holds in a batch."""
    return chain_of(members, terms, m, 0.0, 0.0)


@non_allocating
def base_at(path, j, since, base):  # type: ignore[no-untyped-def]
    """Motion of lane j's first joint, less gravity, to ``base`` (9,), `since` its piece began; returns the torque."""
    k = len(ln.MEMBERS)
    path[SINCE * k + j] = since
    base_motion(ln.MEMBERS, path)
    for s in range(9):
        base[s] = path[(BASE + s) * k + j]
    return path[EXTERNAL * k + j]


@non_allocating
def decide_lane_modes(members, terms, m, lanes, path, j, lane, friction):  # type: ignore[no-untyped-def]
    """Decide how the joints of member m in lane j slip or stick where it stands; False if they chatter."""
    k, n = len(ln.MEMBERS), members.links.shape[2]
    start, slip, base = friction.start[j], friction.slip[j], friction.before[j]
    for i in range(n):
        start[i] = lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j]
        start[n + i] = lanes[((i + 1) * ln.ROW + ln.W_START) * k + j]
    torque = base_at(path, j, lane[TIME] - lane[ORIGIN], base)
    chain, before = chain_without_gravity(members, terms, m), friction.out[j, :n]
    rates = start[n : 2 * n]
    tools = friction.workspace
    good, chatter = decide_modes(chain, start[:n], rates, base[:7], torque, lane[CHATTER], slip, before, tools)
    lane[CHATTER] = chatter
    for i in range(n):
        lanes[((i + 1) * ln.ROW + ln.SLIP) * k + j] = slip[i]
        lanes[((i + 1) * ln.ROW + ln.W_START) * k + j] = rates[i]
        friction.locked[j, i] = 1.0 - slip[i] * slip[i]
    lane[UNDECIDED] = 0.0
    return good


@non_allocating
def assess_lane(members, terms, m, lanes, path, j, lane, friction):  # type: ignore[no-untyped-def]
    """Assess the step of lane j as ``event_search.assess_step`` does; with AGAIN, NEXT_STEP is shorter."""
    k, n = len(ln.MEMBERS), members.links.shape[2]
    chain, tools = chain_without_gravity(members, terms, m), friction.workspace
    start, out, slip = friction.start[j], friction.out[j], friction.slip[j]
    before, after = friction.before[j], friction.after
    search = Search(
        friction.span[j], friction.low[j], friction.high[j], friction.here[j], friction.middle[j], friction.late[j]
    )
    since, step, widen = lane[TIME] - lane[ORIGIN], lane[NEXT_STEP], tolerance_factor(lane[CHATTER], n)
    until = (lane[TIME] + step) - lane[ORIGIN]  # as the next step will reckon it
    if lane[RETRY] == 0.0:
        for i in range(n):
            start[i] = lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j]
            start[n + i] = lanes[((i + 1) * ln.ROW + ln.W_START) * k + j]
        torque = base_at(path, j, since, before)
        margins(chain, start[:n], start[n : 2 * n], slip, before[:7], torque, widen, tools, search.low)
        assign(friction.alpha[j], tools.alpha)
        friction.power[j, 0] = stuck_power(chain, start[n : 2 * n], slip, tools.load)
        begin_search(search)
        friction.late[j] = 0.0
        if sticks_often(chain):
            allow_lateness(search, friction.locked[j], chain, terms.tol, step)
    for i in range(n):
        row = lanes[(i + 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        out[i] = row[ln.Q_START * k + j] + row[ln.Q_SUM * k + j]
        out[n + i] = row[ln.W_START * k + j] + row[ln.W_SUM * k + j]
    torque = base_at(path, j, until, after)
    project_stuck(chain, slip, start, before, out, after)
    margins(chain, out[:n], out[n : 2 * n], slip, after[:7], torque, widen, tools, search.here)
    friction.power[j, 2] = stuck_power(chain, out[n : 2 * n], slip, tools.load)
    if search.span[TRIES] == 0.0 or (len(chain.reaction) == len(ONE_SIDED) and not slip.all()):
        midpoint_state(step, start[:n], start[n : 2 * n], friction.alpha[j], out, tools)
        torque = base_at(path, j, since + 0.5 * step, after)
        margins(chain, tools.state[:n], tools.state[n:], slip, after[:7], torque, widen, tools, tools.margin)
        assign_rows(search.middle[:, :n], tools.margin)
        friction.power[j, 1] = stuck_power(chain, tools.state[n:], slip, tools.load)
        base_at(path, j, until, after)
    verdict, length = assess_step(friction.locked[j], search, step)
    if verdict == EVENT:
        stop_joints(chain, slip, search.here, out, after)
    lane[RETRY] = 1.0 if verdict == AGAIN else 0.0
    lane[NEXT_STEP] = length
    return verdict


@non_allocating
def finish_lane(lanes, n, j, lane, energy, step, event, friction):  # type: ignore[no-untyped-def]
    """Make the end of lane j's step, of the length `step`, the start of its next one."""
    k = len(ln.MEMBERS)
    for i in range(n):
        lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j] = friction.out[j, i]
        lanes[((i + 1) * ln.ROW + ln.W_START) * k + j] = friction.out[j, n + i]
        sin, cos = sincos(friction.out[j, i])
        lanes[((i + 1) * ln.ROW + ln.SIN_START) * k + j] = sin
        lanes[((i + 1) * ln.ROW + ln.COS_START) * k + j] = cos
    power = friction.power[j]
    energy[j, 1] += stuck_loss(power, step, 1.0)
    power[:] = 0.0
    if event:
        lane[STEP] = min(lane[STEP], lane[AFTER])
        lane[RESTARTED] = lane[UNDECIDED] = 1.0
        lane[LAST] = 0.0
    if event and step < QUICK:
        lane[CHATTER] += 1.0
    elif step >= QUICK:
        lane[CHATTER] = 0.0
