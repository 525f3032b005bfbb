"""The paper's arm, derived independently: bang-bang swings between -pi/2 and pi/2, as intervals of constant
acceleration."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import DOP853

from tests.reference import dense, stick
from tests.reference.dense import Links, Real


class Stretch(NamedTuple):
    """From time `start` to `end` the arm turns with constant acceleration from `angle` and `rate`."""

    start: float
    end: float
    angle: float
    rate: float
    acceleration: float

    def at(self, t: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration of the arm at time t."""
        s = t - self.start
        angle = self.angle + s * (self.rate + s * self.acceleration / 2)
        return angle, self.rate + s * self.acceleration, self.acceleration

    def base(self, t: float, arm_length: float) -> Real:
        """The first joint's motion (7,) as the chain takes it: the tip of an arm on a fixed pivot at the origin."""
        angle, rate, alpha = self.at(t)
        along, across = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
        push = arm_length * (alpha * across - rate**2 * along)
        return np.array([*push, alpha, rate, angle, *(arm_length * rate * across)])


def bang_bang_swings(t_move: float, t_rest: float, until: float, *, over: bool = False) -> Iterator[Stretch]:
    """Stretches from 0 to `until`: half of each move speeds up, half slows down; then a rest; then back."""
    t, angle, turn = 0.0, -np.pi / 2, -np.pi if over else np.pi
    half, push = t_move / 2, 4 * turn / t_move**2
    while True:
        middle, stop, end = t + half, t + t_move, t + t_move + t_rest
        for stretch in (
            Stretch(t, middle, angle, 0.0, push),
            Stretch(middle, stop, angle + turn / 2, push * half, -push),
            Stretch(stop, end, angle + turn, 0.0, 0.0),
        ):
            if stretch.end >= until:
                yield stretch._replace(end=until)
                return
            yield stretch
        t, angle, turn, push = end, angle + turn, -turn, -push


Rate = Callable[[float, Real], Real]


def integrate(rate: Rate, y: Real, start: float, end: float, rtol: float, atol: float) -> Real:
    """Dormand and Prince's eighth-order method from `start` to `end`, where `rate` must be smooth."""
    solver = DOP853(rate, start, y, end, rtol=rtol, atol=atol)
    while solver.status == "running":
        solver.step()
    if solver.status != "finished":
        raise RuntimeError(f"the reference failed at {solver.t} s")
    return np.asarray(solver.y)


def cast(links: Links, arm_length: float, stretches: list[Stretch], q: Real, w: Real, tol: float = 1e-12) -> Real:
    """Angles and rates (m, 2 n) at the ends of the stretches of a chain on a prescribed arm, by dense algebra."""
    n = len(q)
    state, states = np.concatenate([q, w]), []
    for stretch in stretches:
        if np.any(links.dry > 0.0):

            def base(t: float, stretch: Stretch = stretch) -> Real:
                return stretch.base(t, arm_length)

            state, _ = stick.integrate(links, base, stretch.start, stretch.end, state[:n], state[n:], tol)
            states.append(state)
            continue

        def rate(t: float, y: Real, stretch: Stretch = stretch) -> Real:
            base = stretch.base(t, arm_length)
            return np.concatenate([y[n:], dense.accelerations(links, y[:n], y[n:], base, dtype=float).alpha])

        state = integrate(rate, state, stretch.start, stretch.end, tol, tol)
        states.append(state)
    return np.array(states)


def still(duration: float) -> list[Stretch]:
    """An arm that hangs down and does not move."""
    return [Stretch(0.0, duration, 0.0, 0.0, 0.0)]


def links_of(rope: Any) -> Links:
    """The reference's parameters of a rope of the package."""
    return Links(
        *(np.array(getattr(rope, name)) for name in ("length", "mass", "com", "inertia", "friction", "dry_friction")),
        stiffness=np.array(rope.stiffness),
        rest=np.array(rope.rest_angle),
        drag=np.array(rope.drag),
        max_bend=np.array(rope.max_bend),
        tip_mass=rope.tip_mass,
        gx=float(rope.gravity[0]),
        gy=float(rope.gravity[1]),
        reaction={"relative": 1.0, "printed": 0.0}[rope.friction_model],
    )
