"""State, bounds and workspace of a rollout."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.integrate.end_conditions import Until
from hyperflex.core.integrate.event_search import Search, new_search
from hyperflex.core.integrate.steps import extrapolate, runge_kutta
from hyperflex.core.integrate.substeps import new_substeps
from hyperflex.core.jit import kernel, non_allocating
from hyperflex.core.stiction.constraint_torques import StictionWorkspace, new_stiction_workspace


class Limits(NamedTuple):
    """Bounds of a rollout."""

    stop: float  # s, run until here
    tol: float  # m, error allowed in the position of any joint, of a step and of SHARE seconds
    lever: Array  # (n,) m, how far a link's angle moves mass: the larger of its length and its radius of gyration
    reach: float  # m, length of the chain
    fall: float  # J, weight times length, and what may stick: the scale of the chain's energy at rest
    fixed: float  # s, fixed Runge-Kutta step; 0.0: extrapolation with error control
    least: int  # order of the extrapolation, also the first
    most: int
    budget: int  # steps of one call, so that callers can show progress and be interrupted
    until: Until  # what ends the run before


class Progress(NamedTuple):
    """State of a rollout; all arrays are changed in place."""

    y: Array  # (2 n + 2,) angles, rates, work put in, energy dissipated
    mark: Array  # (2 n + 2,) the state before the first step that was cut short to end at `stop`
    slip: Array  # (n,) modes of the joints, as in ``articulated_body.accelerations``
    mark_slip: Array
    clock: Array  # (CLOCK,) see the names below; the mark's time is -inf while no step has been cut
    log: Array  # (m, 3) or (m, 4 + n) with stiction: of the first m steps that succeed, see below


# A row of the log: length of the step, s, its end, s, and order; with stiction also the joint whose change of mode
# ended it, -1 where none did, and the joints' modes meanwhile
LENGTH, END, DEGREE, JOINT, MODES = range(5)
# AFTER: first step that succeeded after the last switch, where the motion is least smooth; tried first at the next one
# RESTARTED: 1.0 from a switch (or an event) until a step has succeeded behind it
# LAST, SIZE: length and error of the last step that succeeded since the last switch; LAST is 0.0 where there is none
# UNDECIDED: 1.0 where the modes of the joints are to be decided anew
# CHATTER: events in a row that ended very short steps
# ORDER: of the extrapolation, for the next step; taken into the limits
# MARK: where these nine stand again as they were at the mark
# PENDING: margin of what is to end the run at the end of the last step, 0.0 where it is not watched
T, STEP, AFTER, RESTARTED, LAST, SIZE, UNDECIDED, CHATTER, ORDER, MARK = range(10)
INDEX, TAKEN, REJECTED, PENDING, CLOCK = range(2 * MARK, 2 * MARK + 5)


@non_allocating
def restart(clock):  # type: ignore[no-untyped-def]
    """Note that the motion switches here: the next step is no longer than what succeeded after the last switch."""
    clock[STEP] = min(clock[STEP], clock[AFTER])
    clock[RESTARTED] = 1.0
    clock[LAST] = 0.0
    clock[UNDECIDED] = 1.0


@non_allocating
def save_mark(progress):  # type: ignore[no-untyped-def]
    """Save the state from which an uninterrupted run would go on, unless one is saved already."""
    clock = progress.clock
    if clock[MARK] == -np.inf:
        assign(progress.mark, progress.y)
        assign(progress.mark_slip, progress.slip)
        assign(clock[MARK : 2 * MARK], clock[:MARK])


class Workspace(NamedTuple):
    """Working arrays of a run."""

    out: Array  # (2 n + 2,) state after the step
    errors: Array  # (2, 2 n + 2), as in steps.extrapolate
    ys: Array  # (3, 2 n + 2) states at the beginning, middle and end of a step, and their derivatives
    dys: Array
    stage: Array  # (3, 2 n + 2)
    base: Array  # (9, lanes)
    lanes: Array  # ((n + 2) ROW lanes,)
    tip: Array  # (ROW lanes,)
    stiction: StictionWorkspace
    search: Search
    before: Array  # (9,) motion of the first joint at the beginning of a step, and at another time
    after: Array
    between: Array
    alpha: Array  # (n,) accelerations at the beginning of a step
    locked: Array  # (n + 1,) or, where a joint has limits, (2 n + 1,), as in event_search.assess_step
    power: Array  # (3,) of stuck joints, see constraint_torques.stuck_loss
    kept: Array  # (MOST_SUBSTEPS, 2 n + 2) substeps of a step in which there are outputs, and their weights
    weight: Array


@kernel
def new_workspace(chain):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, its parameters loaded into the lanes."""
    n = chain.length.size
    m = 2 * n + 1 if chain.max_bend.min() < np.inf else n + 1
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    kept, weight = new_substeps(n)
    return Workspace(
        np.empty(2 * n + 2),
        np.zeros((2, 2 * n + 2)),
        np.empty((3, 2 * n + 2)),
        np.empty((3, 2 * n + 2)),
        np.empty((3, 2 * n + 2)),
        np.zeros((9, len(ln.COLUMNS))),
        lanes,
        tip,
        new_stiction_workspace(n),
        new_search(m),
        np.empty(9),
        np.empty(9),
        np.empty(9),
        np.empty(n),
        np.zeros(m),
        np.zeros(3),
        kept,
        weight,
    )


@non_allocating
def advance(chain, drive, part, table, fixed, t, step, y, slip, out, kept, workspace):  # type: ignore[no-untyped-def]
    """Take one step of the chosen integrator from y at t to `out`; the lanes of `workspace` know `slip`.

    `kept` is as in ``steps.extrapolate``.
    """
    work, lanes, tip = workspace.stiction.work, workspace.lanes, workspace.tip
    if fixed > 0.0:
        runge_kutta(chain, drive, part, t, step, y, slip, out, workspace.stage, work)
    else:
        base = workspace.base
        extrapolate(chain, drive, part, table, t, step, y, out, workspace.errors, kept, lanes, tip, base, work)
