"""A simulation set-up: rope, arm, motion, obstacles, start, and its TOML file."""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import TORQUE, Drive, X, Y
from hyperflex.core.contact.gaps import Pegs
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput, located
from hyperflex.model.arm import Arm
from hyperflex.model.keys import check_tables
from hyperflex.model.obstacles import KINDS, Obstacle, Peg, checked_obstacles, obstacle_tables, obstacles_of, packed
from hyperflex.model.rope import Rope
from hyperflex.motion import Motion, from_spec, hold_arm, to_spec

METHODS = ("extrapolation", "rk4")
_STILL = hold_arm(0.0)
PLAN = "plan"  # table in which a planner keeps what a run does not need
PLANNING = (PLAN, "target", "slot", "limits", "behind")  # tables of a planner, which a run leaves alone
DEFAULT_TOL = 1e-5  # m
DEFAULT_CONTACT_STEP = 2e-4  # s


@dataclass(frozen=True, eq=False, repr=False)
class Setup:
    """What :func:`hyperflex.simulate` runs.

    Parameters
    ----------
    rope : Rope
    motion : Motion, optional
        Prescribed motion of the arm (or of the point that the rope hangs from); by default everything stands still.
    arm : Arm, optional
        None: the rope hangs from a fixed or moving point.
    torque : Motion, optional
        Torque on the arm; then the arm moves as it must, about a pivot that stands still.
    duration : float
        Simulated time, s.
    q0, qd0 : (n,) array_like, optional
        Angles, rad, and rates, rad/s, at the start; by default the rope hangs at rest.
    arm_angle0, arm_rate0 : float
        Start of a torque-driven arm, rad and rad/s.
    tol : float
        Error that a step may make in the position of any joint, m.
    method : {"extrapolation", "rk4"}
    step : float, optional
        Step of ``"rk4"``, s.
    pegs : sequence of Peg, Wall or Ground, optional
        What the rope may touch; for ropes with friction_model="relative".
    contact_step : float
        Longest step with a peg, or with a joint at its limit, s; what closes slower than 1 cm/s, or than 50 m/s^2
        times it, does not bounce.
    tip_force : (2,) array_like
        Constant force on the tip beside gravity, N; only in a set-up with pegs.

    Raises
    ------
    InvalidInput
        If values do not fit each other.
    """

    rope: Rope
    motion: Motion | None = None
    arm: Arm | None = None
    torque: Motion | None = None
    duration: float = 10.0
    q0: Array | None = None
    qd0: Array | None = None
    arm_angle0: float = 0.0
    arm_rate0: float = 0.0
    tol: float = DEFAULT_TOL
    method: str = "extrapolation"
    step: float | None = None
    pegs: tuple[Obstacle, ...] = ()
    contact_step: float = DEFAULT_CONTACT_STEP
    tip_force: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, kind in (("rope", Rope), ("motion", Motion), ("arm", Arm), ("torque", Motion)):
            if getattr(self, name) is not None or name == "rope":
                checks.instance(name, getattr(self, name), kind)
        n = self.rope.n_links
        values: dict[str, Any] = {
            "duration": checks.number("duration", self.duration, sign="positive", unit="s"),
            "tol": checks.number("tol", self.tol, sign="positive", unit="m"),
            "method": checks.choice("method", self.method, METHODS),
            "arm_angle0": checks.number("arm_angle0", self.arm_angle0, unit="rad"),
            "arm_rate0": checks.number("arm_rate0", self.arm_rate0, unit="rad/s"),
        }
        if (self.method == "rk4") != (self.step is not None):
            raise InvalidInput("step belongs to method='rk4'", got=self.step, allowed="a step in s with rk4 alone")
        if self.step is not None:
            values["step"] = checks.number("step", self.step, sign="positive", unit="s")
        for name, unit in (("q0", "rad"), ("qd0", "rad/s")):
            if getattr(self, name) is not None:
                values[name] = checks.array(name, getattr(self, name), (n,), unit=unit)
        if not np.any(values.get("qd0", 0.0)):  # where a run has ended angles may count many turns
            checks.meant("q0", values.get("q0", 0.0), "rad")
        if values["arm_rate0"] == 0.0:
            checks.meant("arm_angle0", self.arm_angle0, "rad")
        values["contact_step"] = checks.number("contact_step", self.contact_step, sign="positive", unit="s")
        x, y = checks.array("tip_force", self.tip_force, (2,), unit="N")
        values |= {"tip_force": (float(x), float(y)), "pegs": checked_obstacles(self.pegs)}
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check_drive()
        self._check_pegs()

    def _check_pegs(self) -> None:
        if not self.pegs and any(self.tip_force):
            raise InvalidInput("tip_force needs a set-up with pegs", got=self.tip_force, fix="Give pegs=[Peg(...)]")
        if not self.touches:
            return
        if self.rope.friction_model != "relative":
            raise InvalidInput(
                "contact and joint limits need joint friction that acts on both links",
                got=self.rope.friction_model,
                allowed="friction_model='relative'",
            )
        if self.method != METHODS[0]:
            raise InvalidInput(
                "contact and joint limits have a stepper of their own",
                got=self.method,
                allowed=f"method={METHODS[0]!r}",
            )

    def _check_drive(self) -> None:
        turning = self.motion is not None and bool((self.motion.coef[:, 0] != 0.0).any())
        if self.motion is not None and bool((self.motion.coef[:, TORQUE] != 0.0).any()):
            raise InvalidInput("motion holds a torque", allowed="torque=... for a torque")
        if self.arm is None and turning:
            raise InvalidInput("motion turns an arm, but there is none", fix="Give arm=Arm(length=...)")
        if self.torque is not None:
            if self.arm is None:
                raise InvalidInput("a torque needs an arm to act on", fix="Give arm=Arm(length=..., inertia=...)")
            if self.motion is not None:
                raise InvalidInput(
                    "the arm cannot both follow a motion and be driven by a torque", fix="Give one of them"
                )
            if self.torque.coef[:, :TORQUE].any():
                raise InvalidInput("torque moves the arm or the pivot", allowed="a torque_profile(t, torque)")

    def __repr__(self) -> str:
        drive = "torque" if self.torque_driven else "motion" if self.motion is not None else "at rest"
        arm = "" if self.arm is None else f"arm of {self.arm.length:g} m, "
        pegs = f", {len(self.pegs)} obstacle{'' if len(self.pegs) == 1 else 's'}" if self.pegs else ""
        return f"Setup({self.rope!r}, {arm}{drive}, {self.duration:g} s{pegs})"

    def replace(self, **changes: Any) -> "Setup":
        """Return a set-up with the fields named in `changes` replaced; raises InvalidInput as Setup does."""
        names = [f.name for f in fields(self)]
        if unknown := set(changes) - set(names):
            raise InvalidInput("unknown field of a set-up", got=sorted(unknown), allowed=", ".join(names))
        return replace(self, **changes)

    @property
    def torque_driven(self) -> bool:
        """Whether the arm is moved by a torque, not by a prescribed motion."""
        return self.torque is not None

    def start(self) -> tuple[Array, Array]:
        """Return angles and rates (n,) at the start; with a torque-driven arm (n + 1,), the arm first."""
        n = self.rope.n_links
        q = np.full(n, self.rope.hanging_angle) if self.q0 is None else self.q0
        qd = np.zeros(n) if self.qd0 is None else self.qd0
        if not self.torque_driven:
            return q, qd
        return np.append(self.arm_angle0, q), np.append(self.arm_rate0, qd)

    def chain(self) -> Chain:
        """Return the chain that the kernels integrate."""
        return self.arm.chain(self.rope) if self.torque_driven and self.arm else self.rope.chain()

    def drive(self) -> Drive:
        """Return the drive of the chain, as the kernels take it."""
        source = self.torque or self.motion or _STILL
        coef = source.coef
        if self.arm is not None and any(self.arm.pivot):
            coef = coef.copy()
            coef[:, X, 0] += self.arm.pivot[0]
            coef[:, Y, 0] += self.arm.pivot[1]
        prescribed = 0.0 if self.arm is None or self.torque_driven else self.arm.length
        limit = math.inf if self.arm is None else self.arm.torque_limit
        return read_only(Drive(source.breaks, coef, source.switch, source.loop, prescribed, limit))

    @property
    def round_pegs(self) -> tuple[Peg, ...]:
        """The round pegs among the obstacles."""
        return tuple(peg for peg in self.pegs if isinstance(peg, Peg))

    @property
    def touches(self) -> bool:
        """Whether there are obstacles or joint limits: they need contact steps."""
        return bool(self.pegs) or self.rope.limited

    @property
    def pegs_turn(self) -> bool:
        """Whether a peg turns on an axle."""
        return any(peg.turns for peg in self.round_pegs)

    def contacts(self) -> Pegs:
        """Return the obstacles as the kernels take them."""
        return packed(self.pegs, self.rope.radius, 1 if self.torque_driven else 0)

    def dumps(self) -> str:
        """Return the set-up as TOML text, from which :meth:`loads` builds an equal one."""
        content: dict[str, Any] = {"duration": self.duration, "tol": self.tol, "method": self.method}
        if self.step is not None:
            content["step"] = self.step
        for name in ("q0", "qd0"):
            value = getattr(self, name)
            if value is not None:
                content[name] = value.tolist()
        content |= {"arm_angle0": self.arm_angle0, "arm_rate0": self.arm_rate0, "rope": self.rope.table()}
        if self.arm is not None:
            content["arm"] = self.arm.table()
        if self.touches:
            content |= {"contact_step": self.contact_step, "tip_force": list(self.tip_force)}
            content |= obstacle_tables(self.pegs)
        for name, motion in (("motion", self.motion), ("torque", self.torque)):
            if motion is not None:
                content[name] = to_spec(motion)
        return files.dumps_toml(content)

    @classmethod
    def loads(cls, text: str, name: str = "the set-up", folder: Path | None = None) -> "Setup":
        """Build a set-up from TOML text; `name` stands for it in messages, files named in it lie in `folder`.

        The tables of a planner, ``[target]``, ``[slot]``, ``[limits]`` and ``[plan]``, are left out.
        """
        content = {key: value for key, value in files.loads_toml(text, name).items() if key not in PLANNING}
        check_tables(name, content, [f.name for f in fields(cls)])
        with located(name, files.toml_words):
            content["rope"] = Rope.from_table(content["rope"])
            if "arm" in content:
                content["arm"] = Arm.from_table(content["arm"])
            content["pegs"] = obstacles_of({kind: content.pop(kind) for kind in KINDS if kind in content})
            for motion in ("motion", "torque"):
                if motion in content:
                    content[motion] = from_spec(content[motion], folder)
            return cls(**content)

    def to_toml(self, path: str | Path) -> None:
        """Write the set-up to the TOML file `path`, wholly or not at all."""
        files.write_text(path, self.dumps())

    @classmethod
    def from_toml(cls, path: str | Path) -> "Setup":
        """Read a set-up from the TOML file `path`; motion files named in it (kind = "file") are looked for beside it.

        Raises
        ------
        FileProblem, InvalidInput
            If the file cannot be read or does not describe a set-up.
        """
        return cls.loads(files.read_text(path, "TOML file"), str(path), Path(path).parent)
