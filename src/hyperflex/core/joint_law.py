"""Joint law: friction and spring torque, their linearization, derivatives and power.

Used alike by kernels, lanes, derivatives, contact and numpy.

A joint is (viscous, dry, stiffness, rest): N m s/rad, N m, N m/rad, rad. Its torque at the relative angle phi and rate
omega, slipping in the sense chi (1, -1, or 0 where it is stuck), is the sum of friction and spring (M.6)::

    F = -viscous omega - dry chi,        G = -stiffness (phi - rest)

``reaction_factor`` is sigma of (M.7), the part of the friction that acts on the parent: 1.0, or 0.0 as the paper
prints it. All functions take numbers or numpy arrays. The law is taken to be linear in angle and rate: the implicit
step and its tangent use the slopes of ``jacobian``. One that is not needs them at the joint's state.
"""

import math

from hyperflex.core.jit import inlined


@inlined
def friction(joint, rate, slip):  # type: ignore[no-untyped-def]
    """Friction torque F of a joint at a relative rate, rad/s, in the sense `slip`; N m."""
    viscous, dry, _, _ = joint
    return -viscous * rate - dry * slip


@inlined
def spring(joint, angle):  # type: ignore[no-untyped-def]
    """Torque G of a joint's stiffness at a relative angle, rad; N m."""
    _, _, stiffness, rest = joint
    return -stiffness * (angle - rest)


@inlined
def spring_energy(joint, angle):  # type: ignore[no-untyped-def]
    """Energy that a joint's stiffness stores at a relative angle, rad; J."""
    _, _, stiffness, rest = joint
    bend = angle - rest
    return 0.5 * stiffness * bend * bend


@inlined
def power(joint, reaction_factor, w, up, slip):  # type: ignore[no-untyped-def]
    """Power that friction takes from a link that turns at w and from its parent that turns at `up`, rad/s; W."""
    return -friction(joint, w - up, slip) * (w - reaction_factor * up)


@inlined
def regularized(joint, rate, tolerance):  # type: ignore[no-untyped-def]
    """Joint with viscous friction in place of dry, alike at a relative rate much above `tolerance`, both rad/s.

    Under a torque of x times ``dry``, x < 1, it creeps at `tolerance` times x / sqrt(1 - x^2). An implicit Euler step
    with the coefficient of its beginning is stable for any length (lagged diffusivity, as in image denoising: Vogel and
    Oman 1996, doi:10.1137/0917016), but friction is then too large where a joint turns faster at its end; error control
    keeps steps short there.
    """
    viscous, dry, stiffness, rest = joint
    return viscous + dry / math.sqrt(rate * rate + tolerance * tolerance), 0.0 * dry, stiffness, rest


@inlined
def jacobian(joint, reaction_factor, by_rate, by_angle):  # type: ignore[no-untyped-def]
    """What joint torque falls by, on the link and on its parent, where rate and angle grow by these; N m.

    An implicit joint (M.13) takes its torque at the end of a step h, where an acceleration of 1 rad/s^2 has made the
    rate larger by h and the angle by h^2: ``jacobian(joint, reaction_factor, h, h * h)`` are
    kappa and kappa'.
    """
    viscous, _, stiffness, _ = joint
    return by_rate * viscous + by_angle * stiffness, reaction_factor * (by_rate * viscous) + by_angle * stiffness


@inlined
def torques(joint, reaction_factor, angle, rate, slip, h):  # type: ignore[no-untyped-def]
    """T on the link, T_back on its parent, N m, and kappa, kappa_back, kg m^2, as ``link_step`` takes them (M.13).

    `angle`, rad, and `rate`, rad/s, are relative; h > 0 makes the joint implicit over a step of so many seconds.
    """
    own = friction(joint, rate, slip)
    bent = spring(joint, angle + h * rate)
    kappa, kappa_back = jacobian(joint, reaction_factor, h, h * h)
    return own + bent, reaction_factor * own + bent, kappa, kappa_back


@inlined
def variation(joint, seed, reaction_factor, bend, rate, change, slip, h, stretch):  # type: ignore[no-untyped-def]
    """Change of the torques on link and parent (N m) by changes of the joint and of an implicit step's length, (M.22).

    Parameters
    ----------
    seed : changes of (viscous, dry, stiffness, rest)
    bend : angle against rest at the end of the step, rad
    rate, change : rate at its beginning, rad/s, and relative acceleration, rad/s^2
    h, stretch : s, length of the step and its relative change
    """
    viscous, dry, stiffness, rest = seed
    stiff, _, soft, _ = joint
    own = -dry * slip - viscous * (rate + h * change) - stretch * h * stiff * change
    bent = -stiffness * bend + soft * rest - stretch * h * soft * (rate + 2.0 * h * change)
    return own + bent, reaction_factor * own + bent
