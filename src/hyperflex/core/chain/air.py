"""Air drag of a link, quadratic in its normal velocity (M.29)-(M.32).

Drag c, kg/m^2, gives the force per length -c |v| v against the velocity v across a link, which is u at its motor-side
joint and u + w l at its far joint. With S = |u| + |u + w l| and xi = (2 u + w l) / S the integrals do not depend on
whether v changes its sign on the link, and have no cancellation at small w.
"""

from hyperflex.core.jit import inlined, non_allocating

TINY = 1e-140  # m/s, negligible against any speed; its square does not underflow


@inlined
def link_drag(drag, length, across, turn):  # type: ignore[no-untyped-def]
    """Resistance of one link, (M.30).

    Parameters
    ----------
    drag, length : kg/m^2, m
    across, turn : velocity across the link at its motor-side joint, and its change up to the far joint, m/s

    Returns
    -------
    force, moment : against the velocity, N, and about the motor-side joint, N m
    """
    far = across + turn
    near_size, far_size = abs(across), abs(far)
    speed = near_size + far_size
    xi = (across + far) / (speed + TINY)
    zeta = 0.25 - 0.25 * xi * xi
    mean = xi * (speed * speed - near_size * far_size) * (1.0 / 3.0)
    lean = turn * speed * (1.0 - 2.0 * zeta * (1.0 + zeta)) * (1.0 / 6.0)
    force = drag * length * mean
    return force, 0.5 * length * (force + drag * length * lean)


@inlined
def drag_slopes(drag, length, across, turn):  # type: ignore[no-untyped-def]
    """Twice the integral of drag |v| along the link, times 1, s and s^2 (s from its motor-side joint), (M.31).

    The derivatives of force and moment by the velocity at the motor-side joint and by the link's rate are
    (first, second) and (second, third).
    """
    far = across + turn
    speed = abs(across) + abs(far)
    xi = (across + far) / (speed + TINY)
    zeta = 0.25 - 0.25 * xi * xi
    size = speed * (0.5 - zeta)
    lean = xi * turn * (1.0 + 2.0 * zeta) * (1.0 / 6.0)
    spread = speed * (1.0 - 2.0 * zeta * (1.0 - 2.0 * zeta)) * (1.0 / 6.0)
    first = 2.0 * drag * length * size
    second = length * (0.5 * first + drag * length * lean)
    return first, second, length * (second - 0.5 * drag * length * length * (size - spread))


@non_allocating
def air_loads(chain, w, base, work, at, stride):  # type: ignore[no-untyped-def]
    """Torque of the air on each link, including the drag of the chain beyond it, (M.32); O(n).

    Parameters
    ----------
    chain : Chain
    w : (n,) rates, rad/s
    base : (7,) as in ``accelerations``
    work : (6 n,) sines and cosines of the angles, as ``sines`` leaves them from 4 n on; the torques are written to
        ``work[at + stride i]``, N m

    Returns
    -------
    fx, fy, power : force of the air on the whole chain, N, and the power that it takes, W
    """
    n = w.size
    fx = fy = power = 0.0
    airy = False
    for i in range(n):
        work[at + stride * i] = 0.0
        airy |= chain.drag[i] > 0.0
    if not airy:
        return fx, fy, power
    vx, vy = base[5], base[6]
    for i in range(n):
        turn = chain.length[i] * w[i]
        vx += turn * work[5 * n + i]
        vy += turn * work[4 * n + i]
    for way in range(n):
        i = n - 1 - way
        length, sin, cos = chain.length[i], work[4 * n + i], work[5 * n + i]
        turn = length * w[i]
        vx -= turn * cos
        vy -= turn * sin
        across = vx * cos + vy * sin
        force, moment = link_drag(chain.drag[i], length, across, turn)
        work[at + stride * i] = length * (cos * fx + sin * fy) - moment
        fx -= force * cos
        fy -= force * sin
        power += force * across + moment * w[i]
    return fx, fy, power
