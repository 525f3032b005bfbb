"""Status codes of rollouts, each with a name and advice for the user."""

from typing import Final

# RUNNING: the step budget of one call is spent; call again. REACHED: the event that ends the run has happened. LEFT: no
# link is near a peg and no joint near its limit, so a stepper without them may continue. LIMIT: a joint has reached its
# limit, which this stepper cannot handle
OK, RUNNING, STEP_TOO_SMALL, NOT_FINITE, ENERGY, FRICTION, REACHED, LEFT, LIMIT = range(9)

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
    STEP_TOO_SMALL: "the tolerance cannot be met. Loosen tol, add joint friction, or check for links whose "
    "mass and inertia are nearly zero compared with their neighbours'",
    NOT_FINITE: "the motion left the range of numbers. Check q0, qd0 and the motion for wild values, "
    "or take a smaller step",
    ENERGY: "the energy of the rope changed by more than the motor and friction explain, so the result cannot be "
    "trusted. Tighten tol, or take a smaller step",
    REACHED: "",
    LEFT: "",
    LIMIT: "a joint has reached its limit (max_bend), but derivatives and events do not support impacts. "
    "Omit them, set max_bend = inf, or end the run before",
    FRICTION: "joints stick and slip in endless alternation. Change dry_friction a little, add viscous "
    "friction, or take friction_model='relative': as printed, friction may push a joint the way that it slips",
}
