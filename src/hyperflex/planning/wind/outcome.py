"""A throw run as exactly as the library can: wound or not, held or not, and why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import checks, winding
from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL, Peg
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory
from hyperflex.winding import Winding

WOUND = 1.25  # turns, from the arm's tip to the rope's end
SETTLING = 1.0  # s after the last move before the watch begins
WATCH = 2.0  # s, for which the rope must hold
SLIP = 5e-3  # m, by which it may slip meanwhile
SAMPLE_TIME = 0.01  # s
BOUNCE = 0.3  # s, off the peg that do not end a stay on it
CALM = 0.1  # s, over which forces are means where a grip is judged: single steps jerk


@dataclass(frozen=True, eq=False)
class Cast:
    """What became of a throw in a verified (simulated) run.

    Attributes
    ----------
    wound, held : bool
        Turned WOUND times or more about the peg; slipped by less than SLIP in WATCH seconds from SETTLING after the
        arm stopped; and bears the pull that a plan asked for, if it did.
    turns : float
        Signed turns from the arm's tip to the rope's end at the end of the run, positive counterclockwise.
    slipped : float
        Greatest way of the rope on the peg in the watch, m; NaN or infinite where it is not, or has left it.
    grip : float
        Greatest pull of the arm's side in the watch over what Capstan's rule lets the rope bear: below 1 with
        something in hand. NaN where the rope is not on the peg.
    strike : float
        When the rope comes to the peg for its longest stay, s, breaks of BOUNCE left out; NaN if it never touches it.
    touch : float
        When it first touches the peg, s: before `strike` where it grazes it and comes off again.
    contact : float
        Angle about the peg from the first to the last link that lies on it at the end of the run, rad, >= 0.
    bend : float
        Sharpest bend between neighbouring links, rad: with more than pi the rope is folded through itself, which a
        simulation without contact of the rope with itself allows and a real rope does not.
    torque : float
        Greatest torque that the arm's motion asks of the motor for the rope, N m.
    reason : str
        Why it failed; empty if it did not.
    run : Trajectory or None
        The run; None where it failed.
    """

    wound: bool
    held: bool
    turns: float
    slipped: float
    grip: float
    strike: float
    touch: float
    contact: float
    bend: float
    torque: float
    reason: str
    run: Trajectory | None

    @property
    def success(self) -> bool:
        """Wound and held."""
        return self.wound and self.held and not self.reason

    @property
    def folded(self) -> bool:
        """Whether the rope is folded through itself somewhere on the way."""
        return self.bend > np.pi


def verify(
    thrower: Thrower,
    peg: Peg,
    motion: Motion,
    *,
    tol: float = DEFAULT_TOL,
    contact_step: float = DEFAULT_CONTACT_STEP,
    watch: float = WATCH,
    patience: float | None = None,
) -> Cast:
    """Run a motion from rest beside a peg on the refined rope and see whether it winds and holds.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    motion : Motion
        That ends; the arm stays where it is then.
    tol, contact_step : float
        As for :func:`hyperflex.simulate`, m and s.
    watch : float
        How long the rope must hold, s, from SETTLING after the arm has stopped; a rope that has unwound by then has not
        held.
    patience : float, optional
        Processor time that the run may take, s; one that takes more has failed.
    """
    watch = checks.number("watch", watch, sign="positive", unit="s")
    stop = float(motion.breaks[-1])
    duration = stop + SETTLING + watch
    t: Array = np.arange(0.0, duration + 1e-9, SAMPLE_TIME)
    t[-1] = min(t[-1], duration)
    try:
        run = simulate(
            thrower.rope,
            motion,
            arm=thrower.arm,
            duration=duration,
            pegs=[peg],
            tol=tol,
            contact_step=contact_step,
            t_eval=t,
            patience=patience,
        )
    except SimulationError as error:
        nothing = dict.fromkeys(("slipped", "grip", "strike", "touch", "contact", "bend", "torque"), float("nan"))
        reason = f"the simulation failed ({error.status})"
        return Cast(wound=False, held=False, turns=0.0, **nothing, reason=reason, run=None)
    return judge(thrower, peg, run, stop)


def judge(thrower: Thrower, peg: Peg, run: Trajectory, stop: float) -> Cast:
    """Say what became of a throw whose arm stopped at `stop`, s."""
    wound = winding.wound(run, peg)
    watched = run.t >= stop + SETTLING
    turns = wound.turns[watched]
    sense = np.sign(turns[-1])
    way = winding.slip(run, peg, since=stop + SETTLING)[watched]
    on = bool(np.isfinite(way).all())
    slipped, grip = float(np.abs(way).max()), gripped(wound, watched, peg) if on else float("nan")
    enough = bool((sense * turns >= WOUND).all())
    held = on and slipped < SLIP
    touched = np.isfinite(wound.before)
    torque = float(np.abs(run.motor_torque).max())
    reason = ""
    if not touched.any():
        reason = "the rope does not touch the peg"
    elif not enough:
        least, most = max(0.0, float((sense * turns).min())), float(np.abs(wound.turns).max())
        reason = f"it winds {least:.2f} turns ({most:.2f} at most), and {WOUND:g} are asked"
    elif not held:
        reason = "the rope leaves the peg" if not on else f"it slips by {1e3 * slipped:.1f} mm, {1e3 * SLIP:g} allowed"
    elif torque > thrower.limits.torque:
        reason = f"it asks {torque:.3g} N m of a motor that gives {thrower.limits.torque:.3g}"
    return Cast(
        wound=enough,
        held=held,
        turns=float(turns[-1]),
        slipped=slipped,
        grip=grip,
        strike=_longest_stay(run.t, touched),
        touch=float(run.t[touched.argmax()]) if touched.any() else float("nan"),
        contact=abs(float(wound.arc[-1])),
        bend=float(np.abs(np.diff(run.q, axis=1)).max(initial=0.0)),
        torque=torque,
        reason=reason,
        run=run,
    )


def _longest_stay(t: Array, touched: npt.NDArray[np.bool_]) -> float:
    """When the longest stay on the peg begins, s; NaN where there is none. Breaks of BOUNCE do not end it."""
    there = t[touched]
    if not there.size:
        return float("nan")
    apart = np.flatnonzero(np.diff(there) > BOUNCE)
    begins, ends = there[np.append(0, apart + 1)], there[np.append(apart, there.size - 1)]
    return float(begins[(ends - begins).argmax()])


def gripped(wound: Winding, watched: npt.NDArray[np.bool_], peg: Peg) -> float:
    """Return the greatest part of what it can bear that a wound rope is pulled with, means over CALM."""
    count = max(1, round(CALM / SAMPLE_TIME))
    before, after = (
        np.convolve(force[watched], np.full(count, 1.0 / count), mode="valid") for force in (wound.before, wound.after)
    )
    arc = np.abs(wound.arc[watched]).min()
    return float((before / np.maximum(after * np.exp(peg.mu * arc), 1e-12)).max())
