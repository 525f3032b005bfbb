"""Casting by swinging, open loop (paper section IV): cable, arm and runs, Figs. 9 to 12 as tables, claims C2 to C4."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import PhasePortrait, Spiral, phase_portrait, spiral
from hyperflex.model import Arm, Rope
from hyperflex.motion import arm_swings
from hyperflex.paper.results import Claim, Table
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

Path = Literal["under", "over"]
Friction = Literal["relative", "printed"]
Profile = Literal["bang-bang", "ramp", "minimum-jerk"]
Outcome = Literal["success", "failure"]

T_MOVE = 0.73  # s, the arm's half turn
T_REST: dict[Outcome, float] = {"success": 0.53, "failure": 0.34}  # s; the failure's is inferred from its c
TIME_CONSTANT: dict[Outcome, float] = {"success": 0.40, "failure": 0.34}  # s, c of (10) and (11)
DURATION = 14.0  # s
RATE = 1000  # samples per second: the tip cracks like a whip, and r peaks within a few milliseconds
TOL = 1e-8
TABLE_RATE = 100  # rows per second


@dataclass(frozen=True)
class Reading:
    """One way to read what the paper leaves open.

    The arm turns through the bottom or over the top; friction is that of relative joints with its reaction, or eq. (4)
    as it is printed.
    """

    path: Path
    friction: Friction

    @property
    def title(self) -> str:
        """The reading in words."""
        way = {"under": "through the bottom", "over": "over the top"}[self.path]
        return f"{way}, {'physical' if self.friction == 'relative' else 'printed'} friction"

    @property
    def key(self) -> str:
        """A short name for file columns."""
        return f"{self.path}_{self.friction}"


READINGS = tuple(Reading(path, friction) for path in ("under", "over") for friction in ("relative", "printed"))
OUTCOMES: tuple[Outcome, ...] = ("success", "failure")


def cable(friction: Friction = "relative") -> Rope:
    """Return the paper's cable: 2 m, 0.125 kg, radius 2.5 mm, 50 links, 5e-4 N m s/rad in each joint.

    The inertia is that of the cylinder, 3.372e-7 kg m^2 a link; the printed 3.37e-4 is a slip.
    """
    return Rope.uniform(
        length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4, friction_model=friction, name="paper cable"
    )


def casting_arm() -> Arm:
    """Return the paper's arm, 105 mm; its angle is prescribed."""
    return Arm(length=0.105)


def run(
    reading: Reading,
    t_rest: float,
    *,
    duration: float = DURATION,
    profile: Profile = "bang-bang",
    rate: int = RATE,
    tol: float = TOL,
) -> Trajectory:
    """Simulate the paper's cast: the rope at rest, hanging, the arm at -pi/2 and swinging from t = 0 on.

    `t_rest` is the rest t_c between the arm's half turns, s; they have the given `profile`. `rate`: samples per second.
    """
    motion = arm_swings(t_move=T_MOVE, t_rest=t_rest, profile=profile, path=reading.path)
    t_eval = np.linspace(0.0, duration, round(duration * rate) + 1)
    return simulate(cable(reading.friction), motion, arm=casting_arm(), duration=duration, t_eval=t_eval, tol=tol)


@dataclass(frozen=True, eq=False)
class Cast:
    """The tip and the arm in one cast, with what section IV derives from them."""

    reading: Reading
    outcome: Outcome  # sets the rest t_c and the time constant c
    t: Array  # (T,) s
    tip: Array  # (T, 2) m
    tip_velocity: Array  # (T, 2) m/s
    arm_angle: Array  # (T,) rad

    @property
    def period(self) -> float:
        """The arm's half cycle t_a + t_c, s."""
        return T_MOVE + T_REST[self.outcome]

    @property
    def intervals(self) -> Array:
        """Start and end of each arm motion (m, 2), s."""
        starts = np.arange(0.0, self.t[-1], self.period)
        return np.stack([starts, starts + T_MOVE], axis=1)

    @cached_property
    def spiral(self) -> Spiral:
        """Spiral coordinates of the tip with the paper's c."""
        return spiral(self.t, self.tip[:, 0], self.tip_velocity[:, 0], TIME_CONSTANT[self.outcome])

    @cached_property
    def portrait(self) -> PhasePortrait:
        """The tip's phase portrait, cut where the arm starts and stops."""
        return phase_portrait(self.spiral, self.intervals)

    def reach(self, start: float, end: float) -> float:
        """Return the greatest ``|x|`` of the tip from `start` to `end`, m."""
        within = (self.t >= start) & (self.t <= end)
        return float(np.abs(self.tip[within, 0]).max())


@cache
def cast(reading: Reading, outcome: Outcome, profile: Profile = "bang-bang") -> Cast:
    """Return one of the paper's casts; the same one is simulated only once in a process."""
    result = run(reading, T_REST[outcome], profile=profile)
    return Cast(reading, outcome, result.t, result.tip, result.tip_velocity, result.arm_angle)


def casts() -> dict[tuple[Reading, Outcome], Cast]:
    """Return success and failure in the four readings."""
    return {(reading, outcome): cast(reading, outcome) for reading in READINGS for outcome in OUTCOMES}


def fig9() -> Table:
    """Arm angle against time (Fig. 9)."""
    return _table("fig9", "arm angle", _arms(), "t in s; arm in rad")


def fig10() -> Table:
    """Tip position against time (Fig. 10)."""
    columns = _columns(x=lambda subject: subject.tip[:, 0], y=lambda subject: subject.tip[:, 1])
    return _table("fig10", "tip position", columns, "t in s; x, y in m")


def fig11() -> Table:
    """Spiral coordinates of the tip against time (Fig. 11)."""
    columns = _columns(r=lambda subject: subject.spiral.r, theta=lambda subject: subject.spiral.theta)
    return _table("fig11", "spiral coordinates of the tip", columns | _arms(), "t in s; r in m; theta, arm in rad")


def fig12() -> Table:
    """Phase portrait of the tip (Fig. 12); ``moving`` is 1 while the arm moves and 0 while it rests."""
    columns = _columns(x=lambda subject: subject.spiral.x, cxd=lambda subject: subject.spiral.scaled_velocity)
    for outcome in OUTCOMES:
        subject = cast(READINGS[0], outcome)
        columns[f"moving_{outcome}"] = _thin(subject, (subject.t % subject.period < T_MOVE).astype(np.float64))
    return _table("fig12", "phase portrait of the tip", columns, "t in s; x, cxd (c times the velocity) in m")


def _columns(**measures: Callable[[Cast], Array]) -> dict[str, Array]:
    """Return what is measured of each cast, as columns of a table."""
    return {
        f"{name}_{reading.key}_{outcome}": _thin(subject, measure(subject))
        for (reading, outcome), subject in casts().items()
        for name, measure in measures.items()
    }


def _arms() -> dict[str, Array]:
    """Return the arm angles, which do not depend on the friction, as columns of a table."""
    return {
        f"arm_{reading.path}_{outcome}": _thin(subject, subject.arm_angle)
        for (reading, outcome), subject in casts().items()
        if reading.friction == "relative"
    }


def _table(name: str, title: str, columns: dict[str, Array], units: str) -> Table:
    parameters = "; ".join(
        f"{outcome}: t_a = {T_MOVE} s, t_c = {T_REST[outcome]} s, c = {TIME_CONSTANT[outcome]} s"
        for outcome in OUTCOMES
    )
    time = {"t": _thin(cast(READINGS[0], "success"), cast(READINGS[0], "success").t)}
    notes = {"title": title, "source": "simulated", "units": units, "parameters": parameters}
    return Table(name, title, {**time, **columns}, notes)


def _thin(subject: Cast, values: Array) -> Array:
    step = round(1.0 / (TABLE_RATE * (subject.t[1] - subject.t[0])))
    return values[::step]


def reach_table(subject: Cast) -> Array:
    """Return the greatest ``|x|`` of the tip in each 2 s from the start on, m."""
    return np.array([subject.reach(start, start + 2.0) for start in np.arange(0.0, subject.t[-1] - 1.0, 2.0)])


def success_over_failure(reading: Reading) -> Claim:
    """C2: a rest of 0.53 s pumps the rope up, 0.34 s does not.

    Measured: the greatest ``|x|`` of the tip in 10-14 s, success over failure. Notes how far the failure's reach has
    fallen from its peak ("steps decreasing" in Fig. 11).
    """
    success, failure = cast(reading, "success"), cast(reading, "failure")
    ratio = success.reach(10.0, 14.0) / failure.reach(10.0, 14.0)
    peaks = reach_table(failure)
    note = (
        f"{success.reach(10.0, 14.0):.2f} m against {failure.reach(10.0, 14.0):.2f} m; "
        f"the failure peaks at {peaks.max():.2f} m and ends at {peaks[-1]:.2f} m"
    )
    return Claim("C2", "rest 0.53 s succeeds, 0.34 s fails: ratio of reach in 10-14 s", reading, ratio, 1.6, note)


def straight_phase(reading: Reading) -> Claim:
    """C3: theta(t) of (11) is a straight line for the success; R^2 of the linear fit from 2 s on.

    Notes the failure's R^2 too and whether it would pass: then straightness does not separate a success from a failure.
    """
    straightness, slope, off = straight_fit(cast(reading, "success"))
    failure = straight_fit(cast(reading, "failure"))[0]
    rate = 1.0 / cast(reading, "success").spiral.c
    threshold = 0.995
    tells = "below the threshold" if failure < threshold else "would pass too: this does not tell the two apart"
    note = (
        f"the failure's R^2, for information: {failure:.4f}, {tells}; "
        f"slope {slope:.3f} rad/s, 1/c = {rate:.3f} rad/s; rms off the line {off:.2f} rad"
    )
    return Claim("C3", "theta(t) is straight from 2 s on: R^2", reading, straightness, threshold, note)


def straight_fit(subject: Cast) -> tuple[float, float, float]:
    """Return R^2, slope (rad/s) and rms residual (rad) of the straight line fitted to theta from 2 s on."""
    late = subject.t >= 2.0
    t, theta = subject.t[late], subject.spiral.theta[late]
    slope, offset = np.polyfit(t, theta, 1)
    residual = theta - (slope * t + offset)
    return float(1.0 - residual.var() / theta.var()), float(slope), float(residual.std())


def steady_step_phase(reading: Reading) -> Claim:
    """C4: r rises step-wise, at the same phase of the arm's half cycle each time.

    Measured: the concentration (mean resultant length) of the phases at which dr/dt is greatest, one for each half
    cycle that begins before r has reached 90 % of its greatest value. Where the tip cracks like a whip r shows a spike
    of some milliseconds; that value is therefore taken from the running median of r over one half cycle, while the
    rise itself is taken from r as it is.
    """
    subject = cast(reading, "success")
    rises = rise_phases(subject)
    centre = float(np.angle(np.exp(2j * np.pi * rises).mean()) / (2.0 * np.pi) % 1.0)
    doing = "rests" if centre * subject.period > T_MOVE else "moves"
    listed = ", ".join(f"{phase:.2f}" for phase in rises)
    note = f"mean phase {centre:.2f}, when the arm {doing}; by half cycle: {listed}"
    statement = "r rises fastest at one phase of the arm's half cycle: concentration"
    return Claim("C4", statement, reading, concentration(rises), 0.9, note)


def concentration(phases: Array) -> float:
    """Return the mean resultant length of phases (k,) in [0, 1): 1 if all are the same, near 0 if they are spread."""
    return float(np.abs(np.exp(2j * np.pi * phases).mean()))


def rise_phases(subject: Cast) -> Array:
    """Return the phase in [0, 1) at which r rises fastest in each half cycle until the rope is nearly pumped up."""
    rise = np.gradient(subject.spiral.r, subject.t)
    phases = []
    for start in np.arange(0.0, _pumped_up(subject), subject.period):
        within = np.flatnonzero((subject.t >= start) & (subject.t < start + subject.period))
        phases.append((subject.t[within[np.argmax(rise[within])]] - start) / subject.period)
    return np.array(phases)


def _pumped_up(subject: Cast) -> float:
    """Time at which the running median of r, over one half cycle, reaches 90 % of its greatest value, s."""
    from scipy.ndimage import median_filter

    t = subject.t
    size = 2 * round(0.5 * subject.period / (t[1] - t[0])) + 1
    level = median_filter(subject.spiral.r, size=size, mode="nearest")
    return float(t[np.argmax(level >= 0.9 * level.max())])
