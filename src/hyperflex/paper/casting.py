"""Casting by swinging, open loop (paper section IV): cable, arm and runs, Figs. 9 to 12, claims C1 to C4."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import PhasePortrait, Spiral, phase_portrait, spiral
from hyperflex.dynamics import bias, mass_matrix, partial_linearization, torque_from_input
from hyperflex.model import Arm, Rope
from hyperflex.motion import arm_swings, torque_profile
from hyperflex.paper.part import Claim, Item, Part, Table
from hyperflex.report import BLUE, GREY, INK, OUTCOME_COLOUR, Section, TextTable, legend, new_figure
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Path = Literal["under", "over"]
Friction = Literal["relative", "printed"]
Outcome = Literal["success", "failure"]

T_MOVE = 0.73  # s, the arm's half turn
T_REST: dict[Outcome, float] = {"success": 0.53, "failure": 0.34}  # s; the failure's is inferred from its c
TIME_CONSTANT: dict[Outcome, float] = {"success": 0.40, "failure": 0.34}  # s, c of (10) and (11)
DURATION = 14.0  # s
RATE = 1000  # samples per second: the tip cracks like a whip, and r peaks within a few milliseconds
TOL = 1e-8
TABLE_RATE = 100  # rows per second
STRAIGHT = 0.995  # R^2 from which theta(t) counts as a straight line
REPLAY_ARM = Arm(length=0.105, inertia=1e-3, friction=1e-3)  # the paper names no inertia: values of our own
REPLAY_SPAN = 2.0 * (T_MOVE + T_REST["success"])  # s, one whole swing there and back
REPLAY_RATE = 2000  # torque samples per second
_BEFORE = 1e-7  # s, the torque is also sampled this long before each of its jumps
_TOP = 3.0  # m, whip spikes of r and of the portrait are cut off here so that the steps can be seen
_DASH: dict[Outcome, Any] = {"success": "-", "failure": (0, (4.0, 1.6))}


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


def run(reading: Reading, t_rest: float, *, tol: float = TOL) -> Trajectory:
    """Simulate the paper's cast: the rope at rest, hanging, the arm at -pi/2 and swinging from t = 0 on.

    `t_rest` is the rest t_c between the arm's half turns, s.
    """
    motion = arm_swings(t_move=T_MOVE, t_rest=t_rest, path=reading.path)
    t_eval = np.linspace(0.0, DURATION, round(DURATION * RATE) + 1)
    return simulate(cable(reading.friction), motion, arm=casting_arm(), duration=DURATION, t_eval=t_eval, tol=tol)


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

    @property
    def portrait(self) -> PhasePortrait:
        """The tip's phase portrait, cut where the arm starts and stops."""
        return phase_portrait(self.spiral, self.intervals)

    def reach(self, start: float, end: float) -> float:
        """Return the greatest ``|x|`` of the tip from `start` to `end`, m."""
        within = (self.t >= start) & (self.t <= end)
        return float(np.abs(self.tip[within, 0]).max())

    @property
    def reaches(self) -> Array:
        """The greatest ``|x|`` of the tip in each 2 s, m."""
        return np.array([self.reach(start, start + 2.0) for start in np.arange(0.0, self.t[-1] - 1.0, 2.0)])


@cache
def cast(reading: Reading, outcome: Outcome) -> Cast:
    """Return one of the paper's casts; the same one is simulated only once in a process."""
    result = run(reading, T_REST[outcome])
    return Cast(reading, outcome, result.t, result.tip, result.tip_velocity, result.arm_angle)


Measure = Callable[[Cast], Array]
TIP: dict[str, Measure] = {"x": lambda subject: subject.tip[:, 0], "y": lambda subject: subject.tip[:, 1]}
SPIRAL: dict[str, Measure] = {"r": lambda subject: subject.spiral.r, "theta": lambda subject: subject.spiral.theta}
PORTRAIT: dict[str, Measure] = {
    "x": lambda subject: subject.spiral.x,
    "cxd": lambda subject: subject.spiral.scaled_velocity,
}


def _table(
    title: str, units: str, measures: Mapping[str, Measure], *, arms: bool = False, moving: bool = False
) -> Table:
    """Return measures of every cast, and the arm's angle, which is the same with either friction, or when it moves."""
    every = [cast(reading, outcome) for reading in READINGS for outcome in OUTCOMES]
    columns = {"t": every[0].t}
    columns |= {
        f"{name}_{each.reading.key}_{each.outcome}": of(each) for each in every for name, of in measures.items()
    }
    if arms:
        columns |= {
            f"arm_{each.reading.path}_{each.outcome}": each.arm_angle
            for each in every
            if each.reading.friction == "relative"
        }
    if moving:
        columns |= {
            f"moving_{each.outcome}": np.where(each.t % each.period < T_MOVE, 1.0, 0.0)
            for each in every[: len(OUTCOMES)]
        }
    rests = (f"{each}: t_a = {T_MOVE} s, t_c = {T_REST[each]} s, c = {TIME_CONSTANT[each]} s" for each in OUTCOMES)
    notes = {"title": title, "source": "simulated", "units": units, "parameters": "; ".join(rests)}
    return Table({name: values[:: RATE // TABLE_RATE] for name, values in columns.items()}, notes)


def _draw_fig9() -> "Figure":
    with new_figure(8.0, 3.6, "Actuation pattern (Fig. 9)") as figure:
        axes = figure.subplots(2, 1, sharex=True)
        ways = ((READINGS[0], "through the bottom", (-90, 0, 90)), (READINGS[2], "over the top", (-270, -180, -90)))
        for axis, (reading, title, ticks) in zip(axes, ways, strict=True):
            _draw_course(axis, reading, lambda subject: np.degrees(subject.arm_angle))
            axis.set(title=title, ylabel="arm, degrees", yticks=ticks)
        axes[-1].set_xlabel("time, s")
        legend(figure, axes[0])
    return figure


def _draw_courses(figure: "Figure", measures: Mapping[str, Measure], labels: tuple[str, str]) -> Any:
    """Draw two measures of success and failure over time, in a row for each reading; return the axes."""
    axes = figure.subplots(len(READINGS), 2, sharex=True, sharey="col")
    for row, reading in zip(axes, READINGS, strict=True):
        for axis, measure, label in zip(row, measures.values(), labels, strict=True):
            _draw_course(axis, reading, measure)
            axis.set_ylabel(label)
        row[0].set_title(reading.title)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    return axes


def _draw_course(axis: Any, reading: Reading, measure: Measure) -> None:
    for outcome in reversed(OUTCOMES):
        subject, inferred = cast(reading, outcome), ", inferred" if outcome == "failure" else ""
        style = {"color": OUTCOME_COLOUR[outcome], "ls": _DASH[outcome], "lw": 1.3}
        axis.plot(subject.t, measure(subject), label=f"{outcome}{inferred} (rest {T_REST[outcome]:.2f} s)", **style)
        axis.set_xlim(subject.t[0], subject.t[-1])


def _draw_fig10() -> "Figure":
    with new_figure(10.0, 8.4, "Tip position, simulated (Fig. 10)") as figure:
        legend(figure, _draw_courses(figure, TIP, ("tip x, m", "tip y, m"))[0, 0])
    return figure


def _draw_fig11() -> "Figure":
    with new_figure(10.0, 8.4, "Spiral coordinates, simulated (Fig. 11)") as figure:
        axes = _draw_courses(figure, SPIRAL, ("r, m", "theta, rad"))
        for axis, reading in zip(axes[:, 0], READINGS, strict=True):
            success = cast(reading, "success")
            for start, end in success.intervals:
                label = "the successful arm moves" if start == 0.0 else None
                axis.axvspan(start, min(end, success.t[-1]), color=BLUE, alpha=0.08, lw=0, label=label)
            swing = (success.arm_angle - success.arm_angle.min()) / np.ptp(success.arm_angle)
            axis.plot(success.t, 0.35 * swing - 0.45, color=GREY, lw=0.8)
            axis.set_ylim(-0.55, _TOP)
        legend(figure, axes[0, 0])
        _note_cut(figure, "r", SPIRAL["r"])
    return figure


def _draw_fig12() -> "Figure":
    title = "Phase portrait of the tip, simulated (Fig. 12)"
    with new_figure(11.0, 5.9, title) as figure:
        axes = figure.subplots(len(OUTCOMES), len(READINGS), sharex="row", sharey="row")
        for row, outcome in zip(axes, OUTCOMES, strict=True):
            for axis, reading in zip(row, READINGS, strict=True):
                _draw_portrait(axis, cast(reading, outcome).portrait, OUTCOME_COLOUR[outcome])
            row[0].set_ylabel(f"{outcome}: c dx/dt, m   (c = {TIME_CONSTANT[outcome]:.2f} s)")
        for axis, reading in zip(axes[0], READINGS, strict=True):
            axis.set_title(reading.title.replace(", ", ",\n"), fontsize=8.5)
        _note_cut(figure, "|c dx/dt|", PORTRAIT["cxd"])
    return figure


def _draw_portrait(axis: Any, portrait: PhasePortrait, colour: str) -> None:
    from matplotlib.collections import LineCollection

    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for radius in np.arange(0.5, _TOP + 0.1, 0.5):
        axis.plot(radius * np.cos(angle), radius * np.sin(angle), color="#dfe3e9", lw=0.7, zorder=0)
    axis.add_collection(LineCollection(portrait.resting, colors=colour, linewidths=0.6, alpha=0.8))
    axis.add_collection(LineCollection(portrait.moving, colors=colour, linewidths=1.9, alpha=0.75))
    axis.plot(*portrait.starts.T, "o", ms=4.0, mfc="white", mec=INK, mew=0.9)
    axis.plot(*portrait.ends.T, "x", ms=4.5, mec=INK, mew=1.1)
    axis.set(xlim=(-_TOP, _TOP), ylim=(-_TOP, _TOP), aspect="equal", xlabel="x, m")
    axis.grid(False)


def _note_cut(figure: "Figure", name: str, measure: Measure) -> None:
    """Say at the foot of a figure what its axes leave out."""
    greatest = max(float(np.abs(measure(cast(reading, each))).max()) for reading in READINGS for each in OUTCOMES)
    text = f"{name} is cut off at {_TOP:g} m: the tip cracks like a whip, and it spikes to {greatest:.1f} m"
    figure.supxlabel(f"Note: {text}; the CSV file is not cut off.", x=0.01, ha="left", fontsize=8.0, color=INK)


@cache
def replay(reading: Reading) -> tuple[float, float]:
    """Recover the motor torque of one swing by (3) and drive the arm with it.

    Returns
    -------
    acceleration_error : float
        Greatest difference between the input u and the arm's acceleration under the recovered torque, by a dense solve
        of (1), over the greatest u.
    tip_error : float
        Greatest distance between the tips under the prescribed motion and under the torque, open loop, m.
    """
    rope = cable(reading.friction)
    motion = arm_swings(T_MOVE, T_REST["success"], path=reading.path)
    t = _sample_times(motion.switches(0.0, REPLAY_SPAN))
    options: dict[str, Any] = {"arm": REPLAY_ARM, "duration": REPLAY_SPAN, "t_eval": t, "tol": TOL}
    led = simulate(rope, motion, **options)
    u, torque, errors = motion.acceleration(t), np.empty_like(t), []
    for k, (q, qd, angle, rate) in enumerate(zip(led.q, led.qd, led.arm_angle, led.arm_rate, strict=True)):
        torque[k] = torque_from_input(partial_linearization(rope, REPLAY_ARM, q, qd, angle, rate), u[k])
        if k % 100 == 0:  # the dense solve is slow; a few dozen instants of the swing tell as much
            load = -bias(rope, q, qd, arm=REPLAY_ARM, arm_angle=angle, arm_rate=rate)
            load[0] += torque[k]
            inertia = mass_matrix(rope, q, arm=REPLAY_ARM, arm_angle=angle)
            errors.append(abs(np.linalg.solve(inertia, load)[0] - u[k]))
    driven = simulate(rope, torque=torque_profile(t, torque), arm_angle0=led.arm_angle[0], **options)
    distance = np.linalg.norm(driven.tip - led.tip, axis=1)
    return float(max(errors) / np.abs(u).max()), float(distance.max())


def _sample_times(switches: Array) -> Array:
    """Return a grid over the span with each switch and an instant just before it."""
    inside = switches[(switches > 0.0) & (switches < REPLAY_SPAN)]
    grid = np.linspace(0.0, REPLAY_SPAN, round(REPLAY_SPAN * REPLAY_RATE) + 1)
    return np.unique(np.round([*grid, *(inside - _BEFORE), *inside], 9))


def linearized(reading: Reading) -> Claim:
    """C1: with u from (3) the arm's acceleration equals u, and the torque recovered from u reproduces the motion."""
    error, distance = replay(reading)
    note = f"the recovered torque, replayed open loop for one swing, leads the tip back within {1e3 * distance:.2g} mm"
    statement = "u of (3) is the arm's acceleration: relative error"
    return Claim("C1", statement, reading, error, 1e-9, note, "<=")


def success_over_failure(reading: Reading) -> Claim:
    """C2: a rest of 0.53 s pumps the rope up, 0.34 s does not.

    Measured: the greatest ``|x|`` of the tip in 10-14 s, success over failure. Notes how far the failure's reach has
    fallen from its peak ("steps decreasing" in Fig. 11).
    """
    failure = cast(reading, "failure")
    high, low = cast(reading, "success").reach(10.0, 14.0), failure.reach(10.0, 14.0)
    peaks = failure.reaches
    note = f"{high:.2f} m against {low:.2f} m; the failure peaks at {peaks.max():.2f} m and ends at {peaks[-1]:.2f} m"
    return Claim("C2", "rest 0.53 s succeeds, 0.34 s fails: ratio of reach in 10-14 s", reading, high / low, 1.6, note)


def straight_phase(reading: Reading) -> Claim:
    """C3: theta(t) of (11) is a straight line for the success; R^2 of the linear fit from 2 s on.

    Notes the failure's R^2 too and whether it would pass: then straightness does not separate a success from a failure.
    """
    straightness, slope, off = straight_fit(cast(reading, "success"))
    failure = straight_fit(cast(reading, "failure"))[0]
    tells = "below the threshold" if failure < STRAIGHT else "would pass too: this does not tell the two apart"
    note = (
        f"the failure's R^2, for information: {failure:.4f}, {tells}; slope {slope:.3f} rad/s, "
        f"1/c = {1.0 / TIME_CONSTANT['success']:.3f} rad/s; rms off the line {off:.2f} rad"
    )
    return Claim("C3", "theta(t) is straight from 2 s on: R^2", reading, straightness, STRAIGHT, note)


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
    from scipy.ndimage import median_filter

    t, r = subject.t, subject.spiral.r
    level = median_filter(r, size=2 * round(0.5 * subject.period / (t[1] - t[0])) + 1, mode="nearest")
    pumped_up = t[np.argmax(level >= 0.9 * level.max())]
    rise, phases = np.gradient(r, t), []
    for start in np.arange(0.0, pumped_up, subject.period):
        within = np.flatnonzero((t >= start) & (t < start + subject.period))
        phases.append((t[within[np.argmax(rise[within])]] - start) / subject.period)
    return np.array(phases)


def _sections() -> list[Section]:
    rope, arm = cable(), casting_arm()
    setup = (
        f"Cable: {rope.total_length:g} m, {rope.total_mass:g} kg, radius {1e3 * rope.radius:g} mm, {rope.n_links} "
        f"rigid links, joint friction {rope.friction[0]:g} N m s/rad, inertia of the cylinder {rope.inertia[0]:.4g} "
        f"kg m^2 a link (the printed 3.37e-4 is a slip). Arm: {1e3 * arm.length:g} mm, half a turn in {T_MOVE:g} s "
        f"with bang-bang acceleration, then a rest of {T_REST['success']:.2f} s (success) or {T_REST['failure']:.2f} s "
        "(failure). The rope starts hanging at rest, the arm at -90 degrees."
    )
    rows = tuple(
        (
            reading.title,
            f"{each} (rest {T_REST[each]:.2f} s)",
            *(f"{reach:.2f}" for reach in cast(reading, each).reaches),
        )
        for reading in READINGS
        for each in OUTCOMES
    )
    windows = tuple(f"{2 * k}-{2 * k + 2} s" for k in range(len(rows[0]) - 2))
    reaches = TextTable(("reading", "cast", *windows), rows)
    return [
        Section("Reach of the tip", text=("Greatest |x| of the tip in each 2 s, m.",), table=reaches),
        Section("Set-up", text=(setup,)),
    ]


PART = Part(
    title="Casting a rope by swinging",
    lead=(
        "Casting by swinging, open loop: section IV of Suzuki and Ebihara, Casting Control for Hyper-Flexible "
        "Manipulation (ICRA 2007), simulated with the paper's own cable in the four readings that the paper leaves "
        "open."
    ),
    message="simulating the casts",
    items={
        "fig9": Item(
            lambda: _table("arm angle", "t in s; arm in rad", {}, arms=True),
            _draw_fig9,
            "Arm angle. The failing rest of 0.34 s is inferred from the paper's c = 0.34 s.",
        ),
        "fig10": Item(
            lambda: _table("tip position", "t in s; x, y in m", TIP),
            _draw_fig10,
            "Tip position in the four readings.",
        ),
        "fig11": Item(
            lambda: _table("spiral coordinates of the tip", "t in s; r in m; theta, arm in rad", SPIRAL, arms=True),
            _draw_fig11,
            "Spiral coordinates of the tip; shaded while the arm of the success moves (line below).",
        ),
        "fig12": Item(
            lambda: _table(
                "phase portrait of the tip",
                "t in s; x, cxd (c times the velocity) in m; moving is 1 while the arm moves and 0 while it rests",
                PORTRAIT,
                moving=True,
            ),
            _draw_fig12,
            "Phase portraits of the tip, thick while the arm moves, thin while it rests; circles at the starts of its "
            "motions, crosses at their ends.",
        ),
    },
    measures=dict.fromkeys((linearized, success_over_failure, straight_phase, steady_step_phase), READINGS),
    sections=_sections,
)
