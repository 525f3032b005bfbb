"""Casting by swinging, open loop (paper section IV): cable, arm and runs, Figs. 9 to 12, claims C1 to C4."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from hyperflex.checks import Array, ByName
from hyperflex.control import Spiral, spiral
from hyperflex.dynamics import bias, mass_matrix, partial_linearization, torque_from_input
from hyperflex.model import Arm, Rope
from hyperflex.motion import arm_swings, torque_profile
from hyperflex.paper.part import Claim, Item, Part, Table
from hyperflex.report import BLUE, INK, OUTCOME_COLOUR, Figure, Section, TextTable, legend, new_figure
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

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
WINDOW = 2.5  # s, over which the median of r is taken
STRAIGHT = 0.995  # R^2 from which theta(t) counts as a straight line
REPLAY_ARM = Arm(length=0.105, inertia=1e-3, friction=1e-3)  # the paper names no inertia: values of our own
REPLAY_SPAN = 2.0 * (T_MOVE + T_REST["success"])  # s, one whole swing there and back
TOP = 3.0  # m, whip spikes of r and of the portrait are cut off here so that the steps can be seen
_DASH: dict[Outcome, Any] = {"success": "-", "failure": (0, (4.0, 1.6))}


@dataclass(frozen=True)
class Reading:
    """One reading of an ambiguity of the paper.

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
    """The tip and the arm in one run of a reading, with what section IV derives from them."""

    reading: Reading
    label: str  # in names of columns
    words: str
    run: Trajectory
    starts: Array  # (k,) of the arm's half turns, s
    c: float = TIME_CONSTANT["success"]  # s

    @property
    def t(self) -> Array:
        """Times (T,), s."""
        return self.run.t

    @cached_property
    def spiral(self) -> Spiral:
        """Spiral coordinates of the tip."""
        return spiral(self.t, self.run.tip[:, 0], self.run.tip_velocity[:, 0], self.c)

    @property
    def intervals(self) -> Array:
        """Start and end of each half turn of the arm (k, 2), s."""
        return np.stack([self.starts, self.starts + T_MOVE], axis=1)

    @property
    def moving(self) -> Array:
        """1 while the arm moves and 0 while it rests (T,)."""
        begun = self.starts[np.searchsorted(self.starts, self.t, side="right") - 1]
        return np.where(self.t - begun < T_MOVE, 1.0, 0.0)

    def reach(self, start: float, end: float) -> float:
        """Return the greatest ``|x|`` of the tip from `start` to `end`, m."""
        within = (self.t >= start) & (self.t <= end)
        return float(np.abs(self.spiral.x[within]).max())

    @property
    def reaches(self) -> Array:
        """The greatest ``|x|`` of the tip in each 2 s, m."""
        return np.array([self.reach(start, start + 2.0) for start in np.arange(0.0, self.t[-1] - 1.0, 2.0)])

    @property
    def levels(self) -> Array:
        """Median of r in each `WINDOW`, m: whip spikes of a few milliseconds do not count."""
        edges = np.arange(0.0, self.t[-1] + 0.5 * WINDOW, WINDOW)
        return np.array([np.median(self.spiral.r[(self.t >= a) & (self.t < b)]) for a, b in pairwise(edges)])


@cache
def cast(reading: Reading, outcome: Outcome) -> Cast:
    """Return one of the paper's casts; the same one is simulated only once in a process."""
    rest, inferred = T_REST[outcome], ", inferred" if outcome == "failure" else ""
    words, starts = f"{outcome}{inferred} (rest {rest:.2f} s)", np.arange(0.0, DURATION, T_MOVE + rest)
    return Cast(reading, outcome, words, run(reading, rest), starts, TIME_CONSTANT[outcome])


def casts() -> list[Cast]:
    """Return all the paper's casts."""
    return [cast(reading, outcome) for reading in READINGS for outcome in OUTCOMES]


Measure = Callable[[Cast], Array]
Measures = dict[str, Measure]  # by the names of their columns: key and path of the reading, label of the run
TIP: Measures = {"x_{key}_{label}": lambda each: each.run.tip[:, 0], "y_{key}_{label}": lambda each: each.run.tip[:, 1]}
ARM: Measures = {"arm_{path}_{label}": lambda each: each.run.arm_angle}
RADIUS: Measures = {"r_{key}_{label}": lambda each: each.spiral.r}
SPIRAL: Measures = RADIUS | {"theta_{key}_{label}": lambda each: each.spiral.theta}
PORTRAIT: Measures = {
    "x_{key}_{label}": lambda each: each.spiral.x,
    "cxd_{key}_{label}": lambda each: each.spiral.scaled_velocity,
}


def columns(subjects: Sequence[Cast], *groups: Measures) -> dict[str, Array]:
    """Return the time and each group's measures of all runs as columns, `TABLE_RATE` rows a second."""
    t = subjects[0].t
    found = {"t": t}
    for group in groups:
        for each in subjects:
            names = {"key": each.reading.key, "path": each.reading.path, "label": each.label}
            found |= {name.format(**names): of(each) for name, of in group.items()}
    step = round(1.0 / (TABLE_RATE * (t[1] - t[0])))
    return {name: values[::step] for name, values in found.items()}


def windows_table(subjects: Sequence[Cast], values: Measure, width: float) -> TextTable:
    """Return a value of each run in windows of a `width`, s."""
    rows = tuple((each.reading.title, each.words, *map("{:.2f}".format, values(each))) for each in subjects)
    starts = width * np.arange(len(rows[0]) - 2)
    return TextTable(("reading", "run", *(f"{start:g}-{start + width:g} s" for start in starts)), rows)


def _table(title: str, units: str, *groups: Measures) -> Table:
    rests = (f"{each}: t_a = {T_MOVE} s, t_c = {T_REST[each]} s, c = {TIME_CONSTANT[each]} s" for each in OUTCOMES)
    return Table(columns(casts(), *groups), title=title, units=units, parameters="; ".join(rests))


def _draw_courses(
    title: str, height: float, readings: Sequence[Reading], measures: Measures, finish: Callable[[Any], None]
) -> "Figure":
    """Draw measures of success and failure over time by their labels, in a row for each reading.

    `finish` is called with the axes before the legend is made.
    """
    with new_figure(10.0, height, title) as figure:
        axes = figure.subplots(len(readings), len(measures), sharex=True, sharey="col", squeeze=False)
        for row, reading in zip(axes, readings, strict=True):
            row[0].set_title(reading.title)
            for axis, (label, of) in zip(row, measures.items(), strict=True):
                for outcome in reversed(OUTCOMES):
                    each = cast(reading, outcome)
                    style = {"color": OUTCOME_COLOUR[outcome], "ls": _DASH[outcome]}
                    axis.plot(each.t, of(each), label=each.words, **style)
                axis.set(ylabel=label, xlim=(0.0, DURATION))
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        finish(axes)
        legend(figure, axes[0, 0])
    return figure


def _draw_fig9() -> "Figure":
    angle = {"arm, degrees": lambda each: np.degrees(each.run.arm_angle)}
    ticks = range(-270, 91, 90)
    return _draw_courses(
        "Actuation pattern (Fig. 9)", 4.0, READINGS[::2], angle, lambda axes: axes[0, 0].set_yticks(ticks)
    )


def _draw_fig10() -> "Figure":
    measures = dict(zip(("tip x, m", "tip y, m"), TIP.values(), strict=True))
    return _draw_courses("Tip position, simulated (Fig. 10)", 8.4, READINGS, measures, lambda _: None)


def _draw_fig11() -> "Figure":
    def finish(axes: Any) -> None:
        for axis, reading in zip(axes[:, 0], READINGS, strict=True):
            for start, end in cast(reading, "success").intervals:
                label = "the successful arm moves" if start == 0.0 else ""
                axis.axvspan(start, min(end, DURATION), color=BLUE, alpha=0.08, lw=0, label=label)
            axis.set_ylim(0.0, TOP)
        _note_cut(axes[0, 0].figure, "r", lambda each: each.spiral.r)

    measures = dict(zip(("r, m", "theta, rad"), SPIRAL.values(), strict=True))
    return _draw_courses("Spiral coordinates, simulated (Fig. 11)", 8.4, READINGS, measures, finish)


def _draw_fig12() -> "Figure":
    title = "Phase portrait of the tip, simulated (Fig. 12)"
    with new_figure(11.0, 5.9, title) as figure:
        axes = figure.subplots(len(OUTCOMES), len(READINGS), sharex="row", sharey="row")
        for row, outcome in zip(axes, OUTCOMES, strict=True):
            for axis, reading in zip(row, READINGS, strict=True):
                subject = cast(reading, outcome)
                _draw_portrait(axis, subject, OUTCOME_COLOUR[outcome])
            row[0].set_ylabel(f"{outcome}: c dx/dt, m   (c = {TIME_CONSTANT[outcome]:.2f} s)")
        for axis, reading in zip(axes[0], READINGS, strict=True):
            axis.set_title(reading.title.replace(", ", ",\n"), fontsize=8.5)
        _note_cut(figure, "|c dx/dt|", lambda each: each.spiral.scaled_velocity)
    return figure


def _draw_portrait(axis: Any, subject: Cast, colour: str) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for radius in np.arange(0.5, TOP + 0.1, 0.5):
        axis.plot(radius * np.cos(angle), radius * np.sin(angle), color="#dfe3e9", zorder=0)
    path = np.array([subject.spiral.x, subject.spiral.scaled_velocity])
    for moving, width in ((0.0, 0.6), (1.0, 1.9)):
        axis.plot(*np.where(subject.moving == moving, path, np.nan), color=colour, lw=width, alpha=0.8)
    for times, marker in zip(subject.intervals.T, "ox", strict=True):
        within = times[times <= subject.t[-1]]
        axis.plot(*(np.interp(within, subject.t, each) for each in path), marker, mfc="white", mec=INK)
    axis.set(xlim=(-TOP, TOP), ylim=(-TOP, TOP), aspect="equal", xlabel="x, m")
    axis.grid(False)


def _note_cut(figure: "Figure", name: str, measure: Measure) -> None:
    """State at the foot of a figure the data outside its axes."""
    greatest = max(float(np.abs(measure(each)).max()) for each in casts())
    text = f"{name} is cut off at {TOP:g} m: the tip cracks like a whip, and it spikes to {greatest:.1f} m"
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
    options: ByName = {"arm": REPLAY_ARM, "duration": REPLAY_SPAN, "t_eval": t, "tol": TOL}
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
    grid = np.linspace(0.0, REPLAY_SPAN, round(2000.0 * REPLAY_SPAN) + 1)
    return np.unique(np.round([*grid, *(inside - 1e-7), *inside], 9))


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
    cycle that begins before r has reached 90 % of its greatest value. When the tip cracks like a whip, r has a spike of
    a few milliseconds; that value is therefore taken from the running median of r over one half cycle, while the rise
    itself is taken from r as it is.
    """
    subject = cast(reading, "success")
    rises = rise_phases(subject)
    centre = float(np.angle(np.exp(2j * np.pi * rises).mean()) / (2.0 * np.pi) % 1.0)
    doing = "rests" if centre * subject.starts[1] > T_MOVE else "moves"
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

    t, r, period = subject.t, subject.spiral.r, subject.starts[1]
    level = median_filter(r, size=2 * round(0.5 * period / (t[1] - t[0])) + 1, mode="nearest")
    pumped_up = t[np.argmax(level >= 0.9 * level.max())]
    rise, phases = np.gradient(r, t), []
    for start in subject.starts[subject.starts < pumped_up]:
        within = np.flatnonzero((t >= start) & (t < start + period))
        phases.append((t[within[np.argmax(rise[within])]] - start) / period)
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
    reaches = windows_table(casts(), lambda each: each.reaches, 2.0)
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
            lambda: _table("arm angle", "t in s; arm in rad", ARM),
            _draw_fig9,
            "Arm angle, with either friction. The failing rest of 0.34 s is inferred from the paper's c = 0.34 s.",
        ),
        "fig10": Item(
            lambda: _table("tip position", "t in s; x, y in m", TIP),
            _draw_fig10,
            "Tip position in the four readings.",
        ),
        "fig11": Item(
            lambda: _table("spiral coordinates of the tip", "t in s; r in m; theta, arm in rad", SPIRAL, ARM),
            _draw_fig11,
            "Spiral coordinates of the tip; shaded while the arm of the success moves.",
        ),
        "fig12": Item(
            lambda: _table(
                "phase portrait of the tip",
                "t in s; x, cxd (c times the velocity) in m; moving is 1 while the arm moves and 0 while it rests",
                PORTRAIT,
                {"moving_{label}": lambda each: each.moving},
            ),
            _draw_fig12,
            "Phase portraits of the tip, thick while the arm moves, thin while it rests; circles at the starts of its "
            "motions, crosses at their ends.",
        ),
    },
    measures=dict.fromkeys((linearized, success_over_failure, straight_phase, steady_step_phase), READINGS),
    sections=_sections,
)
