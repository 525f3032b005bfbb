"""Pinocchio: its articulated-body algorithm (ABA), which has no integrator, in two integrators written here.

One is classical Runge-Kutta at its stability limit. The other is hyperflex's method: ABA adds an armature to the
diagonal of the mass matrix in relative angles, and an armature of step times friction makes friction implicit. The
comparison separates the effects of method and kernel.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin
from cast import Cast, Contestant, Stretch

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.integrate.steps import scheme
from hyperflex.simulation.rollouts import runge_kutta_limit

NAME = "Pinocchio"
ARM = (
    "no joint at all: the rope hangs in the frame of the arm's end, whose acceleration is taken off gravity, and the "
    "first joint's torque knows the arm's rate; exact, and one joint cheaper than an arm"
)
DRIVE = "none, its acceleration in gravity"
WORLD = pin.Convention.WORLD  # a sixth quicker than LOCAL, which is the default
ORDER = 7
LARGEST = 200  # links: Pinocchio's Data holds tensors of n^3 numbers, several gigabytes beyond this
STAGES = 4  # of Runge-Kutta
BLOCK = 4400  # states handed to Pinocchio's own loop at once

Step = Callable[[Array, Array, float, int], tuple[Array, Array]]


def model(rope: hf.Rope) -> pin.Model:
    """Return a chain of hinges about z that hangs along -y from a fixed point."""
    built, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for i in range(rope.n_links):
        parent = built.addJoint(parent, pin.JointModelRZ(), place, f"joint{i}")
        com = np.array([0.0, -float(rope.com[i]), 0.0])
        inertia = float(rope.inertia[i]) * np.eye(3)
        built.appendBodyToJoint(parent, pin.Inertia(float(rope.mass[i]), com, inertia), pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([0.0, -float(rope.length[i]), 0.0]))
    built.gravity = pin.Motion(np.array([*rope.gravity, 0.0]), np.zeros(3))
    return built


class Rig:
    """A model with all that its integrators share; relative angles q (n,), of which the first is absolute."""

    def __init__(self, cast: Cast) -> None:
        self.cast = cast
        self.model = model(cast.rope)
        self.data = self.model.createData()
        self.friction = np.array(cast.rope.friction)
        self.none = np.zeros(cast.rope.n_links)

    def frames(self, part: Stretch, t: Array) -> tuple[Array, Array]:
        """Gravity (T, 3) in the frame of the arm's end, m/s^2, and the arm's rate (T,), rad/s."""
        acceleration, rate = self.cast.base(t, part.acceleration)
        gravity = np.zeros((t.size, 3))
        gravity[:, :2] = np.array(self.cast.rope.gravity) - acceleration
        return gravity, rate

    def acceleration(self, q: Array, v: Array, gravity: Array, drag: float) -> Array:
        """One ABA; `drag` is the torque on the first joint that the arm's motion adds, N m."""
        self.model.gravity.linear = gravity
        torque = -self.friction * v
        torque[0] += drag
        return pin.aba(self.model, self.data, q, v, torque, WORLD)

    def run(self, longest: float, prepare: Callable[[Stretch, Array, float], Step]) -> Array:
        """Return the tip (T, 2) with equal steps of at most `longest`, s, between switches."""
        q, v = self.none.copy(), self.none.copy()
        tips = []
        for part in self.cast.stretches():
            count = math.ceil((part.end - part.start) / longest - 1e-9)
            h = (part.end - part.start) / count
            step = prepare(part, part.start + h * np.arange(count), h)
            for k in range(count):
                q, v = step(q, v, h, k)
            if part.output:
                tips.append(self.cast.tip(part.end, np.cumsum(q)))
        return np.array(tips)

    def runge_kutta(self, part: Stretch, starts: Array, h: float) -> Step:
        """Classical Runge-Kutta; the arm's motion is computed for all steps at once."""
        g0, r0 = self.frames(part, starts)
        g1, r1 = self.frames(part, starts + 0.5 * h)
        g2, r2 = self.frames(part, starts + h)
        drag = self.friction[0]

        def step(q: Array, v: Array, h: float, k: int) -> tuple[Array, Array]:
            half = 0.5 * h
            a1 = self.acceleration(q, v, g0[k], drag * r0[k])
            v2 = v + half * a1
            a2 = self.acceleration(q + half * v, v2, g1[k], drag * r1[k])
            v3 = v + half * a2
            a3 = self.acceleration(q + half * v2, v3, g1[k], drag * r1[k])
            v4 = v + h * a3
            a4 = self.acceleration(q + h * v3, v4, g2[k], drag * r2[k])
            return q + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)

        return step

    def extrapolation(self, part: Stretch, starts: Array, h: float) -> Step:
        """Linearly implicit Euler over 1..ORDER substeps, extrapolated (hyperflex's method, with a fixed step)."""
        weights = scheme(ORDER).best
        offsets = np.concatenate([h / j * np.arange(j) for j in range(1, ORDER + 1)])
        gravity, rate = self.frames(part, (starts[:, None] + offsets).ravel())

        def step(q: Array, v: Array, h: float, k: int) -> tuple[Array, Array]:
            at = k * offsets.size
            q_new, v_new = q.copy(), v.copy()
            for j in range(1, ORDER + 1):
                short = h / j
                self.model.armature = short * self.friction
                qj, vj = q, v
                for _ in range(j):
                    drag = self.friction[0] * (rate[at] + short * part.acceleration)
                    vj = vj + short * self.acceleration(qj, vj, gravity[at], drag)
                    qj = qj + short * vj
                    at += 1
                q_new += weights[j] * (qj - q)
                v_new += weights[j] * (vj - v)
            return q_new, v_new

        return step


class Loop:
    """Pinocchio's own loop over states (its parallel ABA on one thread): no Python between two of them."""

    def __init__(self, built: pin.Model, q: Array, v: Array, torque: Array, count: int) -> None:
        self.pool = pin.ModelPool(built, 1)
        self.states = [np.asfortranarray(np.tile(x[:, None], count)) for x in (q, v, torque)]
        self.result = np.zeros((q.size, count), order="F")

    def run(self) -> Array:
        """Accelerations (n, count) of all states, rad/s^2."""
        pin.abaInParallel(1, self.pool, *self.states, self.result)
        return self.result


def contestants(cast: Cast, quick: bool) -> Iterator[Contestant]:
    """Runge-Kutta at its stability limit, and its ABAs alone; the extrapolated method with several steps."""
    rig, edge = Rig(cast), 0.99 * runge_kutta_limit(cast.rope.chain())
    setting = f"dt {edge:.3g} s"
    yield Contestant(NAME, "RK4 on ABA", setting, lambda: rig.run(edge, rig.runge_kutta))
    if quick:
        return
    bent = np.linspace(-0.1, 0.1, cast.rope.n_links)
    loop, tip = Loop(rig.model, bent, bent, bent, BLOCK), rig.run(edge, rig.runge_kutta)
    blocks = round(STAGES * cast.duration / edge / BLOCK)

    def alone() -> Array:
        for _ in range(blocks):
            loop.run()
        return tip

    yield Contestant(NAME, "RK4's ABAs alone", setting, alone)
    implicit = Rig(cast)
    for longest in (0.05, 0.03, 0.02):
        setting = f"order {ORDER}, fixed step {longest:g} s"
        yield Contestant(
            f"{NAME}, our method",
            "extrapolation on ABA",
            setting,
            lambda s=longest: implicit.run(s, implicit.extrapolation),
        )
