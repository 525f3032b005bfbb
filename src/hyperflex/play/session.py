"""A rope on an arm, simulated frame by frame by the public functions of the package."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from hyperflex import control
from hyperflex.budget import Budget
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Obstacle, Peg, Rope, Setup
from hyperflex.motion import Motion, arm_moves, hold_arm
from hyperflex.planning import MotorLimits
from hyperflex.play.controls import CROSSING, FIXED, Settings
from hyperflex.simulation import simulate
from hyperflex.status import Status
from hyperflex.trajectory import State, Trajectory
from hyperflex.winding import rope_tension, turns

MOST_MOVES = 120  # in one motion: each frame evaluates all of them
MOST_RECORDED = 120.0  # s of a run that can be kept
FRAME_TIME = 1.0  # s that a frame may take, usually some thousandths
CABLE = Rope.uniform(2.0, 0.125, 50, radius=0.0025, friction=5e-4)  # of Suzuki and Ebihara, shown without a file
_ROPE = {"length", "mass", "links", "friction", "arm_length"}  # settings that need another rope or arm
NUMBERS = ("t", "arm_angle", "pseudo_energy", "x", "scaled_velocity", "tension", "turns", "tip_speed")


class ArmProgram:
    """Moves of an arm that begins at rest.

    Attributes
    ----------
    angles : list of float
        Arm angle at the start and after each move, rad.
    end : float
        End of the last move, s.
    """

    def __init__(self, angle: float, begin: float = 0.0) -> None:
        self.angles, self.end = [angle], begin
        self._timing: list[tuple[float, float, float]] = []  # rest before each move, s, its duration, s, and its ramp

    @property
    def angle(self) -> float:
        """Arm angle after all moves, rad."""
        return self.angles[-1]

    @property
    def count(self) -> int:
        """Number of moves."""
        return len(self._timing)

    @property
    def motion(self) -> Motion:
        """The moves as a motion."""
        return arm_moves(self.angles, *zip(*self._timing, strict=True)) if self._timing else hold_arm(self.angle)

    def move(self, angle: float, start: float, duration: float, ramp: float = 0.5) -> None:
        """Add a move to an `angle`, rad, that starts at a time, s, not before `end`."""
        start = max(start, self.end)
        self._timing.append((start - self.end if self._timing else start, duration, ramp))
        self.angles.append(angle)
        self.end = start + duration

    @property
    def half_turns(self) -> int:
        """Number of half turns, as a rule counts them: even if the arm is at -pi/2, odd at pi/2."""
        return 2 * self.count + (self.angle > 0.0)

    def next_end(self) -> float:
        """Return the end of the next half turn through the bottom, rad; from other angles the arm moves to -pi/2."""
        return 0.5 * math.pi if abs(self.angle + 0.5 * math.pi) < 1e-9 else -0.5 * math.pi


class Recorded(NamedTuple):
    """The motion since the last change, for a new simulation as one run."""

    setup: Setup
    begin: State | None
    duration: float

    def run(self) -> Trajectory:
        """Return the motion as a run with a sample every 10 ms."""
        if not self.duration > 0.0:
            raise InvalidInput("nothing has moved yet", fix="Let it run for a moment")
        return simulate(self.setup, duration=self.duration, state=self.begin)


class Session:
    """A rope on an arm, at an instant.

    Attributes
    ----------
    settings : Settings
    setup : Setup
        The simulated set-up, with the motion up to the last decided move.
    t : float
        Simulated time, s.
    obstacles : tuple of Peg, Wall, Ground
        Obstacles of the last opened set-up, without the target.
    activity : str
        ``"hang"``, ``"swing"``, ``"cast"`` (a planned motion) or ``"file"``.
    """

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.obstacles: tuple[Obstacle, ...] = ()
        self._work = Budget()  # of all simulations: cancelled when the page is closed
        self._motor = MotorLimits()  # whose torque and angles are kept to
        self._like = CABLE, Arm()  # opened rope and arm, which the settings change
        self.activity, self.t, self._begun = "hang", 0.0, 0.0
        self._program: ArmProgram | None = None  # None: the motion is that of a whole set-up
        self._goal: float | None = None  # rad, where the arm must go when it rests
        self._next: float | None = None  # s, when the next half turn begins, once a rule has decided
        self._state: State | None = None
        self._origin: State | None = None
        self._tensions: deque[float] = deque(maxlen=5)  # frames: in contact, the tension of a single step jumps
        self.hang()

    @property
    def rope(self) -> Rope:
        """The current rope."""
        return self.settings.rope(self._like[0])

    @property
    def arm(self) -> Arm:
        """The current arm."""
        return self.settings.arm(self._like[1])

    def hang(self) -> None:
        """Restart: the rope hangs at rest from the arm at its angle."""
        program = ArmProgram(math.radians(self.settings.arm_angle))
        self._begin(Setup(self.rope, program.motion, self.arm, pegs=self._pegs()), "hang", program)

    def swing(self) -> None:
        """Start half turns of the arm, or stop after the current one."""
        if self._program is None:
            self.hang()
        self.activity = "hang" if self.activity == "swing" else "swing"
        self._goal = self._next = None

    @property
    def limits(self) -> MotorLimits:
        """Motor limits: speed and acceleration from the settings, torque and angles from the last opened file."""
        return replace(self.settings.limits, torque=self._motor.torque, angles=self._motor.angles)

    def play(
        self,
        setup: Setup,
        activity: str,
        *,
        skip: float = 0.0,
        limits: MotorLimits | None = None,
        rope: Rope | None = None,
    ) -> None:
        """Start a set-up; its first `skip` seconds are simulated immediately. Its first round peg is the target.

        With the motor's `limits`, if the file has them, and the `rope` as it was before links were cut for this set-up.
        """
        self._begin(setup, activity, None)
        if limits is not None:
            motor = {"motor_speed": limits.speed, "motor_acceleration": limits.acceleration}
            self.settings = replace(self.settings, **motor)
        if activity == "file":
            self._motor, self._like = limits or MotorLimits(), (rope or setup.rope, setup.arm or Arm())
            self.settings = self.settings.of(*self._like)
            self.obstacles = tuple(each for each in setup.pegs if each not in setup.round_pegs[:1])
        if (peg := self._target(setup)) is not None:
            place = {"target_x": peg.x, "target_y": peg.y, "target_radius": peg.radius, "target_friction": peg.mu}
            self.settings = replace(self.settings, **place, target_solid=1)
        if skip > 0.0:
            self._simulate(skip)

    def change(self, values: Mapping[str, object]) -> None:
        """Change settings. After InvalidInput nothing has changed."""
        before, changed = dict(vars(self)), set(values)
        self.settings, self._next = self.settings.changed(values), None
        try:
            if changed & _ROPE:
                swings = self.activity == "swing"
                self.hang()
                self.activity = "swing" if swings else "hang"
            elif any(name.startswith("target_") for name in changed):
                self._move_target()
        except InvalidInput:
            vars(self).update(before)
            raise
        if "arm_angle" in values and self._program is None:
            self.hang()
        elif "arm_angle" in values:
            self.activity, self._goal = "hang", math.radians(self.settings.arm_angle)

    def advance(self, dt: float) -> bytes:
        """Advance by dt, s; return the frame: NUMBERS and places of shaft and joints, m, as float32.

        Raises
        ------
        SimulationError
            If the frame cannot be simulated, or takes longer than FRAME_TIME: a peg was moved within a wound rope.
        """
        if self._program is not None:
            self._decide(self._program, self.t + dt)
        self._simulate(dt, FRAME_TIME)
        if self.t - self._begun > MOST_RECORDED:
            self._record_from_here()
        return self.frame()

    def frame(self) -> bytes:
        """Return the current frame, see :meth:`advance`."""
        run = self._run
        points, arm = run.joints[0], self.setup.arm
        if arm is not None:
            points = np.concatenate([run.base - arm.tip(run.arm_angle) + arm.pivot, points])
        return np.concatenate([self._numbers(run), points.ravel()]).astype("<f4").tobytes()

    def scene(self) -> dict[str, Any]:
        """Return the state of the page in addition to the frames."""
        reach = 1.08 * (float(self.setup.rope.length.sum()) + (self.setup.arm.length if self.setup.arm else 0.0))
        x, y = (0.0, 0.0) if self.setup.arm is None else self.setup.arm.pivot
        return {
            "settings": asdict(self.settings),
            "activity": self.activity,
            "rope": _in_short(self.setup.rope),
            "arm": self.setup.arm is not None,
            "radius": self.setup.rope.radius,
            "view": [x - reach, y - reach, x + reach, y + 0.5 * reach],
            "obstacles": [{**asdict(each), "kind": type(each).__name__.lower()} for each in self.setup.pegs],
            "targets": [] if self._target(self.setup) else [[self.settings.target_x, self.settings.target_y]],
        }

    def cancel(self) -> None:
        """End the present simulation in any thread, and all later ones."""
        self._work.cancel()

    def recorded(self) -> Recorded:
        """Return the motion since the last change, at most MOST_RECORDED s."""
        return Recorded(self.setup, self._origin, self.t - self._begun)

    def _begin(self, setup: Setup, activity: str, program: ArmProgram | None) -> None:
        run = simulate(setup, duration=1e-6, t_eval=[0.0])
        self.setup, self.activity, self._program = setup, activity, program
        self.t, self._begun, self._run = 0.0, 0.0, run
        self._state = self._origin = self._goal = self._next = None
        self._tensions.clear()

    def _simulate(self, dt: float, time_budget: float | None = None) -> None:
        try:
            end = [self.t + dt]
            budget = self._work if time_budget is None else self._work.limit(time_budget)
            self._run = simulate(self.setup, duration=dt, t_eval=end, state=self._state, time_budget=budget)
        except SimulationError as error:
            if error.status != Status.OUT_OF_TIME or time_budget is None:
                raise
            raise SimulationError(
                f"The next frame takes more than {time_budget:g} s of work. "
                "Hang the rope anew, or give it fewer links.",
                status=Status.OUT_OF_TIME,
                time=error.time,
            ) from error
        self._state = self._run.state
        self.t = self._state.t

    def _decide(self, program: ArmProgram, until: float) -> None:
        """Decide the next move of the arm if it starts before a given time."""
        swings = self.activity == "swing"
        goal = program.next_end() if swings else self._goal
        if goal is None or goal == program.angle or (start := max(self.t, self._start(program))) >= until:
            return
        if program.count >= MOST_MOVES:
            program = self._program = ArmProgram(program.angle, program.end)
            self._record_from_here()
        if swings:
            program.move(goal, start, self.settings.t_move)
            self._next = None
        else:
            (duration,), (ramp,) = self.limits.fastest_moves([goal - program.angle])
            program.move(goal, start, float(duration), float(ramp))
        self.setup = self.setup.replace(motion=program.motion)

    def _start(self, program: ArmProgram) -> float:
        """Return the start of the next move, s; inf while the arm moves and a rule cannot decide yet."""
        if self.activity != "swing" or not program.count:
            return program.end
        if self.settings.rule == FIXED:
            return program.end + self.settings.t_rest
        if self._next is None:
            if self._state is None or self.t < program.end:
                return math.inf
            model = control.SwingModel(self.rope, self.arm, self.settings.t_move)
            rule: control.Rule = control.CrossingRule(model)
            if self.settings.rule != CROSSING:
                rule = control.PumpingRule(model, self.rope.total_length + self.arm.length)
            self._next = rule.next_start(RopeState(self.t, self._state.q, self._state.qd), program.half_turns)
        return self._next

    def _pegs(self) -> tuple[Obstacle, ...]:
        return (*((self.settings.target,) if self.settings.target_solid else ()), *self.obstacles)

    def _target(self, setup: Setup) -> Peg | None:
        """Return the first round peg of a set-up that is not an obstacle."""
        return next((each for each in setup.round_pegs if each not in self.obstacles), None)

    def _move_target(self) -> None:
        """Move the peg unless it would overlap the rope. The peg changes its place without pushing the rope."""
        setup = self.setup.replace(pegs=self._pegs())
        state = None if self._state is None else replace(self._state, checkpoint={})
        simulate(setup, duration=1e-6, t_eval=[self.t], state=state)
        self.setup, self._state = setup, state
        self._record_from_here()

    def _record_from_here(self) -> None:
        self._origin, self._begun = self._state, self.t

    def _numbers(self, run: Trajectory) -> list[float]:
        target = self._target(self.setup) or self.settings.target
        c = control.driving_constant(self.settings.t_move, self.settings.t_rest)
        x, v = run.tip[:, 0], run.tip_velocity[:, 0]
        energy = control.pseudo_energy(x, v, float(self.setup.rope.mass.sum()), c)
        self._tensions.append(math.nan if self.setup.torque_driven else float(rope_tension(run)[0, 0]))
        tension = float(np.median(self._tensions))
        speed = float(np.hypot(*run.tip_velocity[0]))
        numbers = [math.degrees(float(run.arm_angle[0])), float(energy[0]), float(x[0]), c * float(v[0]), tension]
        return [self.t, *numbers, float(turns(run, target)[0]), speed]


def _in_short(rope: Rope) -> str:
    """Return a rope in a few words, as in "my cord, 2 m, 125 g, 50 links"."""
    links = f"{rope.n_links} link{'' if rope.n_links == 1 else 's'}"
    words = (rope.name or "rope", f"{rope.total_length:.4g} m", f"{1e3 * rope.total_mass:.4g} g", links)
    return ", ".join(words)
