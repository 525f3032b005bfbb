"""Status codes of rollouts, each with a name and advice for the user."""

from typing import Final

OK: Final = 0
RUNNING: Final = 1  # the step budget of one call is spent; call again
STEP_TOO_SMALL: Final = 2
NOT_FINITE: Final = 3
ENERGY: Final = 4
FRICTION: Final = 5
REACHED: Final = 6  # what was to end the run has happened
LEFT: Final = 7  # no link is near a peg any more, and no joint near its limit: a stepper without them may go on
LIMIT: Final = 8  # a joint has come to its limit, of which the stepper knows no more

NAMES: Final = {
    OK: "ok",
    RUNNING: "running",
    STEP_TOO_SMALL: "step too small",
    NOT_FINITE: "not finite",
    ENERGY: "energy not balanced",
    FRICTION: "dry friction chatters",
    REACHED: "ok",
    LEFT: "ok",
    LIMIT: "joint at its limit",
}

ADVICE: Final = {
    OK: "",
    RUNNING: "",
    STEP_TOO_SMALL: "the tolerance cannot be met. Loosen tol, add joint friction, or look for links whose "
    "mass and inertia are nearly zero beside their neighbours'",
    NOT_FINITE: "the motion left the range of numbers. Check q0, qd0 and the motion for wild values; with "
    "method='rk4' take a smaller step",
    ENERGY: "the energy of the rope changed by more than the motor and friction explain, so the result cannot be "
    "trusted. Tighten tol; with method='rk4' take a smaller step",
    REACHED: "",
    LEFT: "",
    LIMIT: "a joint has come to its limit (max_bend), and what was asked for, derivatives or an event, knows no "
    "impacts. Leave it out, give max_bend = inf, or end the run before",
    FRICTION: "joints stick and come loose again and again without end. Change dry_friction a little, add viscous "
    "friction, or take friction_model='relative': as printed, friction may push a joint the way that it slips",
}
