"""The impact of a whip on a small peg at its target: impulse and energy from a run with contact."""

from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.model import DEFAULT_CONTACT_STEP, Peg
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.whip.tip_target import TipTarget
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

IMPACT_RADIUS = 0.01  # m, of the peg
IMPACT_TIME, WINDOW = 0.05, 0.15  # s: duration of an impact; before and after it
SUDDEN = 0.01  # fraction of the lost energy above which a sample's loss is that of a collision


@dataclass(frozen=True)
class Impact:
    """Impact of a whip on a small fixed peg whose surface is at the target.

    Attributes
    ----------
    t : float
        Time of the first touch, s; NaN if the rope does not touch the peg, and then the rest is 0.
    impulse : float
        Impulse on the peg in IMPACT_TIME seconds, N s.
    impulse_along : float
        Its component in the asked direction, N s.
    energy : float
        Energy lost in the impact, J.
    link : int
        First link in contact, counted from the motor; -1 if none is.
    """

    t: float
    impulse: float
    impulse_along: float
    energy: float
    link: int


def simulate_impact(
    cast_setup: CastSetup,
    target: TipTarget,
    motion: Motion,
    near: float,
    *,
    radius: float = IMPACT_RADIUS,
    mu: float = 0.3,
) -> Impact:
    """Simulate a motion beside a small fixed peg at the target and measure the impact, expected at time `near`, s.

    The peg (`radius`, m, friction coefficient `mu`) lies behind the target in the asked direction, so that the tip
    touches it where it passes the target. Raises SimulationError if the run fails.
    """
    radius = checks.number("radius", radius, sign="positive", unit="m")
    way = np.array([np.cos(target.direction), np.sin(target.direction)])
    x, y = target.point + (radius + cast_setup.rope.radius) * way
    step = 0.5 * DEFAULT_CONTACT_STEP
    begin = max(step, near - WINDOW)
    t = np.append(0.0, begin + step * np.arange(np.ceil((near - begin + WINDOW + IMPACT_TIME) / step)))
    peg = Peg(float(x), float(y), radius, mu)
    run = simulate(
        cast_setup.rope, motion, arm=cast_setup.arm, duration=float(t[-1]), t_eval=t, pegs=[peg], refine=False
    )
    loss = np.asarray(run.contact_loss)
    force = -np.asarray(run.contact_force)  # on the peg
    touched = (loss > loss[1]) | (np.abs(force).sum(axis=(1, 2)) > 0.0)
    touched[:2] = False
    if not touched.any():
        return Impact(float("nan"), 0.0, 0.0, 0.0, -1)
    first = int(touched.argmax())
    last = min(first + round(IMPACT_TIME / step), t.size - 1)
    energy = float(loss[last] - loss[first - 1])
    total = step * force[first : last + 1].sum(axis=(0, 1))
    for k in range(first, last + 1):
        if loss[k] - loss[k - 1] > SUDDEN * energy:
            total = total - collision_impulse(run, peg, k)
    link = _touching(run, peg, first)[0]
    return Impact(float(run.t[first]), float(np.hypot(*total)), float(total @ way), energy, link)


def collision_impulse(run: Trajectory, peg: Peg, k: int) -> Array:
    """Impulse (2,), N s, of a collision on the rope between samples k - 1 and k; finite forces are neglected.

    From the jump of the generalised momenta: an impulse P at distance s along link c changes that of link i by l_i t_i
    P before c, by s t_c P at c and not beyond, with t_i across link i.
    """
    length = run.setup.rope.length
    link, along = _touching(run, peg, k)
    lever = np.where(np.arange(length.size) < link, length, 0.0)
    lever[link] = along
    across = np.stack([np.cos(run.q[k]), np.sin(run.q[k])], axis=-1)
    jump = momenta(run, k) - momenta(run, k - 1)
    return np.asarray(np.linalg.lstsq(lever[:, None] * across, jump, rcond=None)[0])


def momenta(run: Trajectory, k: int) -> Array:
    """Generalised momenta (n,) of the links' angles at sample k, N m s."""
    rope = run.setup.rope
    across = np.stack([np.cos(run.q[k]), np.sin(run.q[k])], axis=-1)
    spin = run.qd[k][:, None] * across
    ends = run.base_velocity[k] + np.cumsum(rope.length[:, None] * spin, axis=0)
    centres = ends + (rope.com - rope.length)[:, None] * spin
    carried = rope.mass[:, None] * centres
    beyond = carried.sum(axis=0) + rope.tip_mass * ends[-1] - np.cumsum(carried, axis=0)
    own = rope.com[:, None] * carried + rope.length[:, None] * beyond
    return np.asarray((own * across).sum(axis=1) + rope.inertia * run.qd[k])


def _touching(run: Trajectory, peg: Peg, k: int) -> tuple[int, float]:
    """Return the link nearest to a peg at sample k, and how far along it the nearest point is, m."""
    length, q = run.setup.rope.length, run.q[k]
    out = np.array([peg.x, peg.y]) - run.joints[k, :-1]
    along = np.clip(out[:, 0] * np.sin(q) - out[:, 1] * np.cos(q), 0.0, length)
    gap = np.hypot(out[:, 0] - along * np.sin(q), out[:, 1] + along * np.cos(q))
    link = int(gap.argmin())
    return link, float(along[link])
