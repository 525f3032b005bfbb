"""Status of a result: one enumeration for all of them, and what `success` and `message` mean."""

from enum import StrEnum


class Status(StrEnum):
    """How a piece of work ended.

    A result has `status`, `success` (whether the status is SUCCESS) and `message`: why it is no success, and what to
    do; empty on success.
    """

    SUCCESS = "success"  # what was required has been achieved
    FAILED = "failed"  # the work is complete, and what was required has not been achieved
    INFEASIBLE = "infeasible"  # a necessary condition is not met: nothing was tried
    OUT_OF_TIME = "out of time"
    INTERRUPTED = "interrupted"
    STEP_TOO_SMALL = "step too small"
    NOT_FINITE = "not finite"
    ENERGY_NOT_BALANCED = "energy not balanced"
    FRICTION_CHATTERS = "dry friction chatters"
    JOINT_AT_LIMIT = "joint at its limit"
    WORKER_LOST = "worker lost"  # each worker process that ran it died
