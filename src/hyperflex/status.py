"""Status of a result: one enumeration for all results, and the meaning of `success` and `message`."""

from enum import StrEnum


class Status(StrEnum):
    """Status at the end of work.

    A result has `status`, `success` (whether the status is SUCCESS) and `message`: the reason of a failure, and what to
    do; empty on success.
    """

    SUCCESS = "success"  # what was required has been achieved
    FAILED = "failed"  # the work is complete, and what was required has not been achieved
    INFEASIBLE = "infeasible"  # a necessary condition is not met: no attempt was made
    OUT_OF_TIME = "out of time"
    INTERRUPTED = "interrupted"
    STEP_TOO_SMALL = "step too small"
    NOT_FINITE = "not finite"
    ENERGY_NOT_BALANCED = "energy not balanced"
    FRICTION_CHATTERS = "dry friction chatters"
    JOINT_AT_LIMIT = "joint at its limit"
    WORKER_LOST = "worker lost"  # each worker process that ran it died
