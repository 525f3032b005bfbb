"""A simulation set-up: rope, arm, motion, obstacles, start, and its TOML file."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, files, options
from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import ANGLE, TORQUE, Drive, X, Y
from hyperflex.core.contact.gaps import Pegs
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput, located
from hyperflex.model.arm import Arm
from hyperflex.model.obstacles import (
    KINDS,
    Obstacle,
    Peg,
    checked_obstacles,
    obstacle_tables,
    obstacles_of,
    packed,
    rows_of,
)
from hyperflex.model.refine import COARSE, FINE, cuts
from hyperflex.model.rope import Rope, table_keys
from hyperflex.motion import Motion, from_spec, hold_arm, motion_keys, to_spec, torque_profile
from hyperflex.options import option

_STILL = hold_arm(0.0)
PLAN = "plan"  # table of data that only a planner uses
PLANNING = (PLAN, "target", "slot", "limits", "behind")  # tables of a planner, which a run ignores
DEFAULT_TOL = 1e-5  # m
DEFAULT_CONTACT_STEP = 2e-4  # s
Control = Callable[[float, float, float, Array, Array], float]


class SetupFields(TypedDict, total=False):
    """Fields of a :class:`Setup` that functions such as :func:`hyperflex.simulate` take as keywords."""

    arm: Arm | None
    torque: Motion | float | Control | None
    control_rate: float | None
    duration: float | None
    q0: ArrayLike | None
    qd0: ArrayLike | None
    arm_angle0: float | None
    arm_rate0: float | None
    tol: float | None
    step: float | None
    pegs: Sequence[Obstacle]
    contact_step: float | None
    tip_force: ArrayLike | None


@dataclass(frozen=True, eq=False, repr=False)
class Setup:
    """The complete input of :func:`hyperflex.simulate`.

    Parameters
    ----------
    rope : Rope
    motion : Motion, optional
        Prescribed motion of the arm, or of the point from which the rope hangs (``moving_pivot``); by default both are
        at rest.
    arm : Arm, optional
        The arm; without one the rope hangs from the point itself.
    torque : Motion, float or callable, optional
        Drives the arm by a torque, N m: a ``torque_profile``, a constant, or ``torque(t, arm_angle, arm_rate, q, qd)``,
        which becomes `control`. Without an arm it acts on the first link. A ``torque_profile`` with several columns
        also has motors in the further joints.
    duration : float
        Simulated time, s.
    q0, qd0 : (n,) array_like, optional
        Absolute link angles, rad, and rates, rad/s, at the start; by default the rope hangs at rest.
    arm_angle0, arm_rate0 : float
        Start of a torque-driven arm, rad and rad/s.
    tol : float
        Allowed error of the position of any joint in one step, m. The error at the tip after some seconds of casting is
        of the order of ten times as much (docs/models.md). In contact with pegs the bound of the energy error is
        proportional to it: at the default a millionth per second of the energy scale; 1e-3 suits a search.
    step : float, optional
        Fixed step of the classical Runge-Kutta method, s, as a check of the linearly implicit extrapolation with error
        control, which is the default. A step beyond its stability limit, which holds for a hanging rope, is refused.
    pegs : sequence of Peg, Wall or Ground, optional
        Obstacles that the rope can touch and wind round; for ropes with friction_model="relative".
    contact_step : float
        Longest step with a peg or with a joint at its limit, s. Contacts that close slower than 1 cm/s, or than
        50 m/s^2 times this, do not bounce.
    tip_force : (2,) array_like
        Constant force on the tip in addition to gravity, N; only in a set-up with pegs.
    control : callable, optional
        Function that returns the motor torque; it is called at the `control_rate`, and the torque is constant in
        between. Such a set-up cannot be written to a file; the set-up of its trajectory has the applied torques.
    control_rate : float, optional
        Rate at which `control` is called, Hz.

    Raises
    ------
    InvalidInput
        If values do not fit each other.
    """

    rope: Rope
    motion: Motion | None = None
    arm: Arm | None = None
    torque: Motion | None = None
    duration: float = option(10.0, "simulated time", unit="s", sign="positive")
    q0: Array | None = None
    qd0: Array | None = None
    arm_angle0: float = option(0.0, "angle of a torque-driven arm at the start", unit="rad")
    arm_rate0: float = option(0.0, "rate of a torque-driven arm at the start", unit="rad/s")
    tol: float = option(DEFAULT_TOL, "error of a step in the position of any joint", unit="m", sign="positive")
    step: float | None = option(
        None, "fixed step of Runge-Kutta, as a check of the extrapolation", unit="s", sign="positive", shown="none"
    )
    pegs: tuple[Obstacle, ...] = ()
    contact_step: float = option(DEFAULT_CONTACT_STEP, "longest step in contact", unit="s", sign="positive")
    tip_force: tuple[float, float] = (0.0, 0.0)
    control: Control | None = None
    control_rate: float | None = option(None, "rate at which the control is called", unit="Hz", sign="positive")

    def __post_init__(self) -> None:
        values: dict[str, Any] = {"pegs": checked_obstacles(self.pegs)}
        torque: object = self.torque
        if callable(torque):
            values["control"], torque = torque, 0.0
        if torque is not None and not isinstance(torque, Motion):
            # a constant torque ends after 1e6 s
            values["torque"] = torque_profile([0.0, 1e6], [checks.number("torque", torque, unit="N m")] * 2)
        values["tip_force"] = tuple(checks.array("tip_force", self.tip_force, (2,), unit="N").tolist())
        for name, unit in (("q0", "rad"), ("qd0", "rad/s")):
            if getattr(self, name) is not None:
                n = checks.instance("rope", self.rope, Rope).n_links
                values[name] = checks.array(name, getattr(self, name), (n,), unit=unit, scalar=True)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        options.check(self, "")
        for name, kind in (("rope", Rope), ("motion", Motion), ("arm", Arm), ("torque", Motion)):
            if getattr(self, name) is not None or name == "rope":
                checks.instance(name, getattr(self, name), kind)
        if (self.control is None) != (self.control_rate is None):
            got, allowed = self.control_rate, "both, or neither"
            raise InvalidInput("control_rate belongs to a torque callback", got=got, allowed=allowed)
        if self.qd0 is None or not self.qd0.any():  # the angles of a moving rope may include many turns
            checks.meant("q0", 0.0 if self.q0 is None else self.q0, "rad")
        if self.arm_rate0 == 0.0:
            checks.meant("arm_angle0", self.arm_angle0, "rad")
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
        if self.torque is not None and self.torque.joints > 1:
            raise InvalidInput(
                "contact and joint limits know the motor of the first joint alone",
                got=f"torques of {self.torque.joints} joints",
                allowed="one column, or a set-up without pegs and joint limits",
            )
        if self.step is not None:
            raise InvalidInput(
                "contact and joint limits have a stepper of their own", got=self.step, fix="Leave the step out"
            )

    def _check_drive(self) -> None:
        turning = self.motion is not None and bool(self.motion.coef[:, ANGLE].any())
        if self.motion is not None and bool(self.motion.coef[:, TORQUE].any()):
            raise InvalidInput("motion holds a torque", allowed="torque=... for a torque")
        if self.arm is None and turning:
            raise InvalidInput("motion turns an arm, but there is none", fix="Give arm=Arm(length=...)")
        if self.torque is not None:
            if self.arm is None and self.control is not None:
                raise InvalidInput(
                    "a torque callback needs an arm to act on", fix="Give arm=Arm(length=..., inertia=...)"
                )
            if self.motion is not None:
                raise InvalidInput(
                    "the arm cannot both follow a motion and be driven by a torque", fix="Give one of them"
                )
            if self.torque.coef[:, :TORQUE].any():
                raise InvalidInput("torque moves the arm or the pivot", allowed="a torque_profile(t, torque)")
            joints = self.rope.n_links + (self.arm is not None)
            if self.torque.joints > joints:
                raise InvalidInput(
                    "torque has more columns than there are joints", got=self.torque.joints, allowed=f"at most {joints}"
                )

    def __repr__(self) -> str:
        drive = "torque" if self.torque is not None else "motion" if self.motion is not None else "at rest"
        arm = "" if self.arm is None else f"arm of {self.arm.length:g} m, "
        pegs = f", {len(self.pegs)} obstacle{'' if len(self.pegs) == 1 else 's'}" if self.pegs else ""
        return f"Setup({self.rope!r}, {arm}{drive}, {self.duration:g} s{pegs})"

    def replace(self, **changes: Any) -> "Setup":
        """Return a set-up with the fields named in `changes` replaced; raises InvalidInput as Setup does."""
        checks.keys("a set-up", changes, [each.name for each in fields(self)])
        return replace(self, **changes)

    @property
    def torque_driven(self) -> bool:
        """Whether the arm is moved by a torque, not by a prescribed motion."""
        return self.torque is not None and self.arm is not None

    def start(self) -> tuple[Array, Array]:
        """Return angles and rates (n,) at the start; with a torque-driven arm (n + 1,), the arm first."""
        n = self.rope.n_links
        q = np.full(n, self.rope.hanging_angle) if self.q0 is None else self.q0
        qd = np.zeros(n) if self.qd0 is None else self.qd0
        if not self.torque_driven:
            return q, qd
        return np.append(self.arm_angle0, q), np.append(self.arm_rate0, qd)

    def first_joint(self, t: Array) -> Array:
        """Return the positions (T, 2), m, of the chain's first joint at times t (T,), s."""
        motion = self.motion or _STILL
        place: Array = motion.point(t)
        if self.arm is None:
            return place
        return place + (self.arm.pivot if self.torque_driven else self.arm.tip(motion.angle(t)))

    def chain(self) -> Chain:
        """Return the chain that the kernels integrate."""
        return self.arm.chain(self.rope) if self.torque_driven and self.arm else self.rope.chain()

    def drive(self) -> Drive:
        """Return the kernels' drive of the chain."""
        source = self.torque or self.motion or _STILL
        coef = source.coef
        if self.arm is not None and any(self.arm.pivot):
            coef = coef.copy()
            coef[:, [X, Y], 0] += self.arm.pivot
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

    def contacts(self) -> Pegs:
        """Return the kernels' arrays of obstacles."""
        return packed(self.pegs, self.rope.radius, 1 if self.torque_driven else 0)

    def dumps(self) -> str:
        """Return the set-up as TOML text, from which :meth:`loads` builds an equal one."""
        if self.control is not None:
            fix = "Write the set-up of its trajectory, which has the torques"
            raise InvalidInput("a set-up with a torque callback cannot be written", fix=fix)
        numbers = [each.name for each in options.options_of(Setup) if self.touches or each.name != "contact_step"]
        content = {name: getattr(self, name) for name in numbers if getattr(self, name) is not None}
        content |= {name: getattr(self, name).tolist() for name in ("q0", "qd0") if getattr(self, name) is not None}
        if self.touches:
            content["tip_force"] = list(self.tip_force)
        tables = {"rope": self.rope.table(), **obstacle_tables(self.pegs)}
        if self.arm is not None:
            tables["arm"] = self.arm.table()
        tables |= {name: to_spec(getattr(self, name)) for name in ("motion", "torque") if getattr(self, name)}
        return files.dumps_toml({**content, **tables})

    @classmethod
    def loads(cls, text: str, name: str = "the set-up", folder: Path | None = None) -> "Setup":
        """Build a set-up from TOML text. `name` is its name in messages; paths of files in it are relative to `folder`.

        The tables of a planner, ``[target]``, ``[slot]``, ``[limits]`` and ``[plan]``, are ignored.
        """
        content = {key: value for key, value in files.loads_toml(text, name).items() if key not in PLANNING}
        check_tables(name, content)
        with located(name, files.toml_words):
            content["rope"] = Rope.from_table(content["rope"])
            if "arm" in content:
                content["arm"] = Arm.from_table(content["arm"])
            content["pegs"] = obstacles_of({kind: content.pop(kind, []) for kind in KINDS})
            for motion in ("motion", "torque"):
                if motion in content:
                    content[motion] = from_spec(content[motion], folder)
            return cls(**content)

    def to_toml(self, path: str | Path) -> None:
        """Write the set-up to the TOML file `path`, wholly or not at all."""
        files.write_text(path, self.dumps())

    @classmethod
    def from_toml(cls, path: str | Path) -> "Setup":
        """Read a set-up from the TOML file `path`; motion files (kind = "file") are relative to its folder.

        Raises
        ------
        FileProblem, InvalidInput
            If the file cannot be read or does not describe a set-up.
        """
        text = files.read_text(path, "TOML file")
        setup = cls.loads(text, str(path), Path(path).parent)
        if f"\n[{PLAN}]" not in text:  # with a divided rope and a clear arm
            warn_of_pegs(str(path), setup)
        return setup


def warn_of_pegs(name: str, setup: Setup) -> None:
    """Warn of pegs for which the links of a rope are too long, or through which its arm can rotate."""
    rope, arm = setup.rope, setup.arm
    for peg in setup.round_pegs:
        axis, where = (
            peg.radius + rope.radius,
            f"the peg at ({peg.x:.4g}, {peg.y:.4g}) m (radius {1e3 * peg.radius:.3g} mm)",
        )
        long = rope.length[cuts(rope, (peg,), arm=arm, ratio=COARSE) > 1]
        if long.size:
            text = f"{name}: links of {1e3 * long.max():.3g} mm near {where} hold less than a smooth rope. "
            warnings.warn(f"{text}Give links of up to {1e3 * FINE * axis:.2g} mm.", stacklevel=3)
        if arm is not None and math.dist(arm.pivot, peg.point) < arm.length + peg.radius:
            warnings.warn(f"{name}: the arm can turn through {where}, which only the rope touches.", stacklevel=3)


def check_tables(name: str, content: Mapping[str, Any], more: Sequence[str] = ()) -> None:
    """Refuse unknown tables and keys of the file `name`, and state where a misplaced one belongs.

    `more` are known tables in addition to those of a set-up.
    """
    known: dict[str, Sequence[str]] = {"rope": table_keys(), "arm": [each.name for each in fields(Arm)]}
    known |= {table: [each.name for each in fields(kind)] for table, kind in KINDS.items()}
    for table in ("motion", "torque"):
        spec = content.get(table)
        known[table] = motion_keys(spec.get("kind") if isinstance(spec, Mapping) else None)
    top = [each.name for each in fields(Setup) if each.name not in (*known, "control", "control_rate")]
    places = {f"in the table [{table}]": keys for table, keys in known.items()}
    places["at the top, above all tables"] = top
    checks.keys(name, content, (*known, *top, *more), needed=("rope",), elsewhere=places)
    for table in filter(content.__contains__, known):
        for row in rows_of(content[table]) if table in KINDS else [content[table]]:
            if not isinstance(row, Mapping):
                raise InvalidInput(f"{name}: {table} is not a table", got=row, allowed=f"[{table}]")
            checks.keys(f"{name}, table [{table}]", row, known[table], elsewhere=places)
