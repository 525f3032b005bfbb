"""Runs along the frozen steps of another, also with dry friction, and the differences that they give."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.chain.drive import Segment, base_size, base_state, segment
from hyperflex.core.chain.lanes import COLUMNS, load, rows, set_slip
from hyperflex.core.integrate import steps as steppers
from hyperflex.core.integrate.rollout import JOINT, LENGTH, MODES
from hyperflex.core.integrate.steps import new_substeps
from hyperflex.core.stiction import STICTION
from hyperflex.simulation.rollouts import TABLES, Rollout, rollout_limits
from hyperflex.simulation.sensitivity import ParameterDirections, forward_derivatives, parameter_directions
from tests.reference import dense

# an eighth-order difference: its truncation is far below the rounding, which is some 1e-15 over the spacing
STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


def run_of(it: hf.Setup, ways: ParameterDirections | None = None) -> Rollout:
    chain = ways.with_faint_terms(it.chain()) if ways else it.chain()
    limits = rollout_limits(it, chain, it.duration)
    run = Rollout(it, np.zeros(1), chain=chain, limits=limits, logged=True)
    run.complete()
    return run


class Frozen:
    """The steps of a run taken again by another set-up: each as long, unless a switch, an event or the end cuts it."""

    def __init__(self, run: Rollout, it: hf.Setup) -> None:
        self.chain, self.drive, self.run, n = it.chain(), it.drive(), run, it.chain().length.size
        self.links = dense.Links(*self.chain[:-1], reaction=len(self.chain.reaction) - 1.0)
        self.lanes, self.tip = rows(COLUMNS, n)
        load(COLUMNS, self.chain, self.lanes, self.tip)
        self.stop = run.limits.stop
        self.t, self.y, self.n = 0.0, np.concatenate([*it.start(), np.zeros(2)]), n

    def base(self, part: Segment, t: float) -> Array:
        base = np.empty(base_size(self.drive))
        base_state(self.drive, part, t, base)
        return base

    def step(self, part: Segment, order: int, length: float, grip: Array) -> Array:
        n, out = self.n, np.empty(2 * self.n + 2)
        scratch = (
            np.empty((steppers.ERRORS, 2 * n + 2)),
            new_substeps(n)[0],
            self.lanes,
            self.tip,
            np.zeros((base_size(self.drive), len(COLUMNS))),
            np.empty(6 * n),
        )
        steppers.extrapolate(
            self.chain, self.drive, part, TABLES[order - TABLES[0].order], self.t, length, self.y, out, *scratch
        )
        before, after = self.base(part, self.t), self.base(part, self.t + length)
        for i in np.flatnonzero(grip == 0.0):
            out[n + i] = out[n + i - 1] if i else after[3]
            out[i] = self.y[i] + ((out[i - 1] - self.y[i - 1]) if i else after[4] - before[4])
        return out

    def margin(self, part: Segment, order: int, length: float, grip: Array, joint: int) -> float:
        n, out, base = self.n, self.step(part, order, length, grip), self.base(part, self.t + length)
        if grip[joint]:
            return float(out[n + joint] - (out[n + joint - 1] if joint else base[3]))
        torque = np.zeros(max(1, base.size - 9))
        torque[0] = base_state(self.drive, part, self.t + length, base)
        torque[: base.size - 9] += base[9:]
        held = dense.accelerations(self.links, out[:n], out[n : 2 * n], base[:7], torque=torque, grip=grip).held[joint]
        return float((abs(held) - self.links.dry[joint]) / self.links.dry[joint])

    def until(self, part: Segment, order: int, length: float, grip: Array, joint: int) -> float:
        """Length at which the margin of a joint is zero, the one nearest to `length`."""

        def margin(h: float) -> float:
            return self.margin(part, order, h, grip, joint)

        wide = 1e-5 * length
        while margin(length - wide) * margin(length + wide) > 0.0:
            wide *= 2.0
        return float(brentq(margin, length - wide, length + wide, xtol=1e-17, rtol=1e-15))

    def log(self) -> Array:
        """The log of the run with this set-up's lengths of steps."""
        steps, old = self.run.log.copy(), 0.0
        for row in steps:
            length, end, order, grip = row[0], row[1], int(row[2]), row[MODES:]
            part, before = segment(self.drive, self.t), segment(self.run.drive, old)
            cut = end >= before.end or end >= self.stop
            if cut:
                length = (part.end if end >= before.end else self.stop) - self.t
            if not grip.size:  # no joint sticks, so that only switches cut steps
                row[LENGTH], row[1] = length, self.t + length
                self.t, old = row[1], end
                continue
            set_slip(COLUMNS, self.lanes, grip)
            joint = int(row[JOINT])
            if not cut and joint >= 0 and length >= STICTION.quick:  # else it sticks and slips by rounding
                length = self.until(part, order, length, grip, joint)
            self.y = self.step(part, order, length, grip)
            self.t, old = self.t + length, end
            base = self.base(part, self.t)
            for i in range(self.n):
                if grip[i] == 0.0 or i == joint:
                    self.y[self.n + i] = self.y[self.n + i - 1] if i else base[3]
            row[LENGTH], row[1] = length, self.t
        return steps


def times_of(run: Rollout) -> Array:
    """Output times far from ends of steps, which differences must not carry across them."""
    times = np.linspace(0.03, run.limits.stop, 60)
    near = np.abs(times[:, None] - run.log[:, 1]).min(axis=1)
    return np.append(0.0, times[near > 2.5e-3])


def check(make: Callable[[float], hf.Setup], wrt: Any, size: float) -> Rollout:
    """Compare with differences of a spacing of `size`; 1e-7 of the greatest, which is the rounding of differences."""
    it = make(0.0)
    ways = parameter_directions(it, wrt)
    run, n = run_of(it, ways), it.chain().length.size
    times = times_of(run)
    _, dy = forward_derivatives(run, ways, it.start(), times)

    def followed(x: float) -> Array:
        other, moved = copy.copy(run), make(x)
        other.chain, other.drive = moved.chain(), moved.drive()
        other.log = Frozen(run, moved).log()
        return forward_derivatives(other, ways, moved.start(), times)[0][:, : 2 * n]

    want = np.zeros((times.size, 2 * n))
    for k, weight in STENCIL.items():
        want += weight * (followed(k * size) - followed(-k * size)) / size
    for part in (slice(0, n), slice(n, 2 * n)):
        np.testing.assert_allclose(dy[:, part, 0], want[:, part], rtol=0.0, atol=1e-7 * np.abs(want[:, part]).max())
    return run
