"""The sweep in SIMD lanes: LANES chains side by side, each taking its own linearly implicit Euler step.

A single rollout puts the columns of its extrapolation table into the lanes; a batch can put whole rollouts there. All
lane data lie in one flat array of n + 2 rows: row 0 is the parent (arm or wall), rows 1..n are the links, row n + 1 is
what hangs beyond the tip. A row holds SLOTS quantities of LANES numbers each.

LLVM turns the inner loops over lanes into packed instructions only where it can prove that no two accesses of a loop
overlap. So each loop touches one slice of three neighbouring rows, at offsets that are constants: UP + slot + j for the
parent, AT + slot + j for the link itself, DOWN + slot + j for the link beyond. ``vdivpd`` in the assembly of
:func:`sweep` shows that it worked (tests/core/test_lanes.py looks).
"""

from __future__ import annotations

import math

from hyperflex.core.chain import link_step, sincos
from hyperflex.core.jit import kernel

LANES = 4

# parameters of a link
LENGTH, MA, INERTIA, MASS, VISCOUS, STIFFNESS, REST, DRY = (LANES * k for k in range(8))
# state; dry friction torque and its slope; sine, cosine; (r, ex, ey, kappa) / D for the way back; step
Q, W, TORQUE, SLOPE, SIN, COS, RD, EX, EY, KD, STEP = (LANES * k for k in range(8, 19))
# on the way to the motor: the answer at the motor-side joint
AXX, AXY, AYX, AYY, FX, FY, BX, BY, UX, UY, S, BETA = (LANES * k for k in range(19, 31))
# on the way back: acceleration of the far joint (less gravity), and of the link
PX, PY, ALPHA = (LANES * k for k in range(31, 34))
# friction work, summed up from the tip; of the lane as a whole, in row 0: torque on link 0, work put in
DISSIPATED, EXTERNAL, WORK = (LANES * k for k in range(34, 37))
ROW = 37 * LANES
UP, AT, DOWN = 0, ROW, 2 * ROW


@kernel
def load(chain, lanes):  # type: ignore[no-untyped-def]
    """Copy the parameters of one chain into every lane of ``lanes`` ((n + 2) ROW,)."""
    n = chain.length.size
    for i in range(n):
        ma = chain.mass[i] * chain.com[i]
        row = lanes[(i + 1) * ROW : (i + 2) * ROW]
        for j in range(LANES):
            row[LENGTH + j] = chain.length[i]
            row[MA + j] = ma
            row[INERTIA + j] = chain.inertia[i] + ma * chain.com[i]
            row[MASS + j] = chain.mass[i]
            row[VISCOUS + j] = chain.viscous[i]
            row[STIFFNESS + j] = chain.stiffness[i]
            row[REST + j] = chain.rest[i]
            row[DRY + j] = chain.dry[i]
    tip = lanes[(n + 1) * ROW : (n + 2) * ROW]
    tip[:] = 0.0
    for j in range(LANES):
        tip[AXX + j] = chain.tip_mass
        tip[AYY + j] = chain.tip_mass


@kernel
def dry_friction(lanes, dry_rate):  # type: ignore[no-untyped-def]
    """Smoothed Coulomb torque of every joint (TORQUE) and its slope (SLOPE); without it both stay zero."""
    n = lanes.size // ROW - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW : (i + 1) * ROW]
        for j in range(LANES):
            u = math.tanh((row[AT + W + j] - row[UP + W + j]) / dry_rate)
            row[AT + TORQUE + j] = -row[AT + DRY + j] * u
            row[AT + SLOPE + j] = row[AT + DRY + j] / dry_rate * (1.0 - u * u)


@kernel
def sweep(lanes, reaction):  # type: ignore[no-untyped-def]
    """From tip to motor: the answer of the chain at each joint (M.8)-(M.13), and the friction work of the step.

    One large loop body on purpose: LLVM unrolls small loops over so few lanes before it looks for packed instructions.
    """
    n = lanes.size // ROW - 2
    for k in range(n):
        i = n - k
        first = 1.0 if i == 1 else 0.0  # link 0 bears the external torque
        row = lanes[(i - 1) * ROW : (i + 2) * ROW]
        for j in range(LANES):
            h = row[DOWN + STEP + j]
            stiffness = row[AT + STIFFNESS + j]
            w = row[AT + W + j]
            rate = w - row[UP + W + j]
            spring = -stiffness * (row[AT + Q + j] - row[UP + Q + j] - row[AT + REST + j] + h * rate)
            friction = row[AT + TORQUE + j] - row[AT + VISCOUS + j] * rate
            kappa = h * (row[AT + VISCOUS + j] + row[AT + SLOPE + j])
            sin, cos = sincos(row[AT + Q + j])
            soft = h * h * stiffness
            at, back = link_step(
                (row[AT + LENGTH + j], row[AT + MA + j], row[AT + INERTIA + j], row[AT + MASS + j]),
                (
                    friction + spring + first * row[UP + EXTERNAL + j],
                    reaction * friction + spring,
                    kappa + soft,
                    reaction * kappa + soft,
                ),
                sin,
                cos,
                w * w,
                (
                    row[DOWN + AXX + j],
                    row[DOWN + AXY + j],
                    row[DOWN + AYX + j],
                    row[DOWN + AYY + j],
                    row[DOWN + FX + j],
                    row[DOWN + FY + j],
                    row[DOWN + BX + j],
                    row[DOWN + BY + j],
                    row[DOWN + UX + j],
                    row[DOWN + UY + j],
                    row[DOWN + S + j],
                    row[DOWN + BETA + j],
                ),
            )
            row[AT + AXX + j], row[AT + AXY + j], row[AT + AYX + j], row[AT + AYY + j] = at[0], at[1], at[2], at[3]
            row[AT + FX + j], row[AT + FY + j], row[AT + BX + j], row[AT + BY + j] = at[4], at[5], at[6], at[7]
            row[AT + UX + j], row[AT + UY + j], row[AT + S + j], row[AT + BETA + j] = at[8], at[9], at[10], at[11]
            row[AT + RD + j], row[AT + EX + j], row[AT + EY + j], row[AT + KD + j] = back
            row[AT + STEP + j] = h
            row[AT + SIN + j] = sin
            row[AT + COS + j] = cos
            lost = h * friction * (w - reaction * row[UP + W + j])
            row[AT + DISSIPATED + j] = row[DOWN + DISSIPATED + j] - lost


@kernel
def advance(lanes):  # type: ignore[no-untyped-def]
    """From motor to tip: accelerations, then w + h alpha and q + h w of the Euler step."""
    n = lanes.size // ROW - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW : (i + 1) * ROW]
        for j in range(LANES):
            px = row[UP + PX + j]
            py = row[UP + PY + j]
            w = row[AT + W + j]
            length = row[AT + LENGTH + j]
            sin = row[AT + SIN + j]
            cos = row[AT + COS + j]
            alpha = (
                row[AT + RD + j]
                - row[AT + EX + j] * px
                - row[AT + EY + j] * py
                + row[AT + KD + j] * row[UP + ALPHA + j]
            )
            row[AT + ALPHA + j] = alpha
            row[AT + PX + j] = px + length * (cos * alpha - sin * w * w)
            row[AT + PY + j] = py + length * (sin * alpha + cos * w * w)
            w += row[AT + STEP + j] * alpha
            row[AT + W + j] = w
            row[AT + Q + j] += row[AT + STEP + j] * w


@kernel
def euler(chain, lanes, base, has_dry):  # type: ignore[no-untyped-def]
    """One linearly implicit Euler step in every lane, each of its own length.

    Parameters
    ----------
    chain : Chain, for what all lanes share (gravity, friction reading)
    lanes : ((n + 2) ROW,), advanced in place. EXTERNAL (N m) is read from row 0, STEP (s) from the last row;
        WORK and DISSIPATED of row 0 grow
    base : (LANES, 9) motion of the first joint at the beginning of each lane's step, as ``drive.base_state`` writes it
    has_dry : bool, whether any joint has dry friction
    """
    top = lanes[:ROW]
    for j in range(LANES):
        top[W + j] = base[j, 3]
        top[Q + j] = base[j, 4]
    if has_dry:
        dry_friction(lanes, chain.dry_rate)
    sweep(lanes, chain.reaction)
    row = lanes[ROW : 2 * ROW]
    for j in range(LANES):
        px = base[j, 0] - chain.gx
        py = base[j, 1] - chain.gy
        up = base[j, 2]
        fx = row[AXX + j] * px + row[AXY + j] * py + row[FX + j] * up + row[BX + j]
        fy = row[AYX + j] * px + row[AYY + j] * py + row[FY + j] * up + row[BY + j]
        moment = row[UX + j] * px + row[UY + j] * py + row[S + j] * up + row[BETA + j]
        power = fx * base[j, 5] + fy * base[j, 6] + moment * base[j, 3] + top[EXTERNAL + j] * row[W + j]
        top[WORK + j] += row[STEP + j] * power
        top[DISSIPATED + j] += row[DISSIPATED + j]
        top[PX + j] = px
        top[PY + j] = py
        top[ALPHA + j] = up
    advance(lanes)
