"""The result of a rollout: labelled arrays, energies, the set-up that made them and the state to go on from."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hyperflex import checks, extras, files
from hyperflex.checks import Array, ByName
from hyperflex.errors import InvalidInput
from hyperflex.files import NetCDF, Variable
from hyperflex.model import Rope, Setup
from hyperflex.status import Status

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["State", "Trajectory", "interpolated", "read_trajectory", "swept"]
FORMAT = "hyperflex trajectory 1"
PARTED = 0.01  # of the rope's length: two runs that differ by more show different motions

# field of Trajectory and variable of the dataset: (dimensions after time, units, long name)
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "q": (("link",), "rad", "absolute link angle, 0 = hanging, positive towards +x"),
    "qd": (("link",), "rad/s", "link rate"),
    "qdd": (("link",), "rad/s^2", "link acceleration"),
    "base": (("axis",), "m", "position of the first joint"),
    "base_velocity": (("axis",), "m/s", "velocity of the first joint"),
    "arm_angle": ((), "rad", "angle of the arm (or of the wall that the rope hangs from)"),
    "arm_rate": ((), "rad/s", "rate of the arm"),
    "kinetic_energy": ((), "J", "kinetic energy"),
    "potential_energy": ((), "J", "potential energy: gravity and joint stiffness"),
    "dissipated_energy": ((), "J", "energy lost to friction and air since the start of the run"),
    "motor_work": (
        (),
        "J",
        "work done on the rope (and on a torque-driven arm) since the start of the run",
    ),
    "motor_torque": ((), "N m", "torque of the motor"),
}
OPTIONAL: dict[str, tuple[tuple[str, ...], str, str]] = {
    "contact_force": (("link", "axis"), "N", "force of the pegs on the link, mean over the step at the sample"),
    "contact_loss": ((), "J", "energy lost to contact since the start of the run, part of dissipated_energy"),
    "peg_angle": (("peg",), "rad", "angle by which a round peg has turned, positive counterclockwise"),
    "peg_rate": (("peg",), "rad/s", "rate of a round peg"),
    "limit": (("joint", "axis"), "m", "positions of the joints in the limit of many links, the tip last"),
    "limit_error": ((), "m", "greatest distance by which a joint may be off the limit"),
}
DERIVED: dict[str, tuple[tuple[str, ...], str, str]] = {
    "joints": (("joint", "axis"), "m", "positions of the joints, the tip last"),
    "tip": (("axis",), "m", "position of the tip"),
    "tip_velocity": (("axis",), "m/s", "velocity of the tip"),
}
# field of State: (dimensions, units)
STATE: dict[str, tuple[tuple[str, ...], str]] = {
    "t": ((), "s"),
    "q": (("link",), "rad"),
    "qd": (("link",), "rad/s"),
    "step": ((), "s"),
    "work": ((), "J"),
    "dissipated": ((), "J"),
    "peg_angle": (("peg",), "rad"),
    "peg_rate": (("peg",), "rad/s"),
    "arm_angle": ((), "rad"),
    "arm_rate": ((), "rad/s"),
}
CHECKPOINT = "checkpoint_"  # before the names of the integrator's own variables
_AXES = "x to the right, y upwards"
OWN_ATTRIBUTES = ("format", "source", "hyperflex_version", "status", "message", "setup", "event", "event_time")


@dataclass(frozen=True, eq=False)
class State:
    """All data that are needed to continue a run without interruption.

    Parameters
    ----------
    t : float
        Time, s.
    q, qd : (n,) float64
        Absolute link angles, rad, and rates, rad/s.
    step : float
        Size of the next integration step, s (0 where the integrator has yet to choose one).
    work, dissipated : float
        Motor work and friction loss since the start of the run, J.
    checkpoint : dict of str to float or array
        Other data of the integrator, by name; a NetCDF file preserves numbers and arrays bit for bit.
    peg_angle, peg_rate : (P,) float64 or None
        Angles, rad, and rates, rad/s, of the round pegs in the order of the set-up; 0 of fixed ones. None: all 0.
    arm_angle, arm_rate : float or None
        Angle and rate of the arm, rad and rad/s. A prescribed motion determines them; None: as in the set-up.
    """

    t: float
    q: Array
    qd: Array
    step: float = 0.0
    work: float = 0.0
    dissipated: float = 0.0
    checkpoint: ByName = field(default_factory=dict)
    peg_angle: Array | None = None
    peg_rate: Array | None = None
    arm_angle: float | None = None
    arm_rate: float | None = None

    def variables(self) -> dict[str, Variable]:
        """Return the state as variables of a file, the checkpoint's with a prefix."""
        found = {}
        for name, (dims, unit) in STATE.items():
            if (value := getattr(self, name)) is not None:
                found[name] = Variable(dims, value, {"units": unit})
        for name, value in self.checkpoint.items():
            found[CHECKPOINT + name] = Variable(tuple(f"{name}_{axis}" for axis in range(np.ndim(value))), value)
        return found


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """A simulated motion (made by :func:`hyperflex.simulate`, or read by :func:`read_trajectory`).

    Parameters
    ----------
    t : (T,) float64
        Time, s.
    q, qd, qdd : (T, n) float64
        Absolute link angles, rad; rates, rad/s; accelerations, rad/s^2.
    base, base_velocity : (T, 2) float64
        Position, m, and velocity, m/s, of the first joint.
    arm_angle, arm_rate : (T,) float64
        The arm, rad and rad/s.
    kinetic_energy, potential_energy : (T,) float64
        Energies of the rope (and of an actuated arm, and of pegs that turn), J.
    dissipated_energy, motor_work : (T,) float64
        Friction loss and motor work since the start of the run, J.
    motor_torque : (T,) float64
        Torque of the motor, N m.
    setup : Setup
        The simulated set-up.
    state : State
        End of the run; pass it to :func:`hyperflex.simulate` to continue.
    start : State
        Where it began.
    status : Status
        How the run ended.
    message : str
        Why the run failed, and what to try; empty on success.
    attrs : dict
        Facts about the run (method, tolerance, ...): strings and numbers.
    event : (str, float) or None
        Name and time, s, of the event that ended the run (``simulate(..., until=...)``); None if none did.
    contact_force : (T, n, 2) float64 or None
        Force of the pegs on each link, N, mean over the step at the sample; None without pegs.
    contact_loss : (T,) float64 or None
        Part of `dissipated_energy` that was lost to contact, J; None without pegs.
    peg_angle, peg_rate : (T, P) float64 or None
        Angle, rad, and rate, rad/s, of each round peg of the set-up, in order, positive counterclockwise; 0 of fixed
        ones. None if no peg turns.
    limit : (T, n + 1, 2) float64 or None
        Positions of the joints, the tip last, in the limit of many short links, m; only with ``extrapolate=True``.
    limit_error : (T,) float64 or None
        Error bar of that limit at the worst joint, m.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    base: Array
    base_velocity: Array
    arm_angle: Array
    arm_rate: Array
    kinetic_energy: Array
    potential_energy: Array
    dissipated_energy: Array
    motor_work: Array
    motor_torque: Array
    setup: Setup
    state: State
    start: State
    status: Status = Status.SUCCESS
    message: str = ""
    attrs: ByName = field(default_factory=dict)
    event: tuple[str, float] | None = None
    contact_force: Array | None = None
    contact_loss: Array | None = None
    peg_angle: Array | None = None
    peg_rate: Array | None = None
    limit: Array | None = None
    limit_error: Array | None = None

    def __post_init__(self) -> None:
        sizes = {
            "link": self.setup.rope.n_links,
            "joint": self.setup.rope.n_links + 1,
            "axis": 2,
            "peg": len(self.setup.round_pegs),
        }
        for name, (dims, *_) in {"t": ((), "", ""), **VARIABLES, **self.optional()}.items():
            view = np.asarray(getattr(self, name), dtype=np.float64).view()
            shape = (self.t.size, *(sizes[dim] for dim in dims))
            if view.shape != shape:
                raise InvalidInput(f"trajectory {name} has the wrong shape", got=view.shape, allowed=f"shape {shape}")
            view.setflags(write=False)
            object.__setattr__(self, name, view)

    def optional(self) -> dict[str, tuple[tuple[str, ...], str, str]]:
        """Return those of the optional variables that this run has: name, (dimensions after time, units, long name)."""
        return {name: what for name, what in OPTIONAL.items() if getattr(self, name) is not None}

    def __repr__(self) -> str:
        span = f" from {self.t[0]:g} to {self.t[-1]:g} s" if self.t.size else ""
        return f"Trajectory({self.q.shape[1]} links, {self.t.size} samples{span}, {self.status})"

    def __str__(self) -> str:
        """Return what ``repr`` shows, and when the run stops being predictable, for which it is simulated again."""
        return ": ".join(each for each in (repr(self), self.warning()) if each)

    @property
    def success(self) -> bool:
        """Whether the run came to its end, or to the event that it was to end at."""
        return self.status is Status.SUCCESS

    @property
    def rope(self) -> Rope:
        """The rope as it was simulated, with the links that pegs need."""
        return self.setup.rope

    @cached_property
    def joints(self) -> Array:
        """Joint positions (T, n+1, 2), m; the last one is the tip."""
        return _read_only(self.rope.joints(self.q, self.base))

    @property
    def tip(self) -> Array:
        """Tip position (T, 2), m."""
        return self.joints[:, -1]

    @cached_property
    def tip_velocity(self) -> Array:
        """Tip velocity (T, 2), m/s."""
        return _read_only(self.rope.joint_velocities(self.q, self.qd, self.base_velocity)[:, -1].copy())

    @property
    def energy_error(self) -> Array:
        """Error of the energy balance (T,), J: E - E[0] - motor work + dissipation, zero in an exact run."""
        energy = self.kinetic_energy + self.potential_energy
        gained = self.motor_work - self.dissipated_energy
        return energy - energy[:1] - (gained - gained[:1])

    @cached_property
    def error_estimate(self) -> Array:
        """Estimated error (T,), m: distance of the worst joint from a run with a tenth of the tolerance.

        The second run is made when this is read; it takes about as long as the first. Steps that no tolerance controls
        are halved in it (in contact, and a fixed step). NaN from where it fails, or would take half an hour. Of a
        set-up with a `control` both runs apply the recorded torques. Errors of the model, the number of links among
        them, are not included.
        """
        from hyperflex.simulation import tighter_run

        found = np.full(self.t.size, np.nan)
        if self.t.size:
            other = tighter_run(self).joints
            apart = np.linalg.norm(self.joints[: len(other)] - other, axis=2)
            found[: len(other)] = apart.max(axis=1)
        return _read_only(found)

    def agrees_until(self, allowed: float | None = None) -> float:
        """Return the last time, s, up to which :attr:`error_estimate` stays below `allowed`, m; inf: to the end.

        By default `allowed` is PARTED of the rope's length.
        """
        beyond = ~(self.error_estimate <= self._limit(allowed))
        if not beyond.any():
            return math.inf
        first = int(beyond.argmax())
        return float(self.t[first - 1]) if first else self.start.t

    @property
    def predictable_until(self) -> float:
        """Time, s, until which inputs and tolerance determine the run; inf if they do until its end.

        After it a run with a tenth of the tolerance differs by more than PARTED of the rope's length: compare energies
        and statistics, not positions. Computed when first read, see :attr:`error_estimate`.
        """
        return self.agrees_until()

    def warning(self, allowed: float | None = None) -> str:
        """Return a sentence on when the error exceeds `allowed`, m (:meth:`agrees_until`); empty if it never does."""
        if (until := self.agrees_until(allowed)) == math.inf:
            return ""
        failed = np.isnan(self.error_estimate[self.t > until][0])
        fate = "fails or takes too long" if failed else f"is more than {1e3 * self._limit(allowed):.3g} mm off"
        return f"not predictable after {until:.4g} s, where a run with a tenth of the tolerance {fate}"

    def _limit(self, allowed: float | None) -> float:
        default = PARTED * self.rope.total_length
        return checks.positive("allowed", default if allowed is None else allowed, "m")

    @cached_property
    def dataset(self) -> "xr.Dataset":
        """The whole run as an ``xarray.Dataset`` with units, long names and the set-up in its attributes."""
        made: xr.Dataset = extras.load("xarray", "xarray", "Datasets").Dataset(
            self.variables(), attrs=self.attributes()
        )
        return made

    def variables(self) -> dict[str, Variable]:
        """Return the samples as variables of a dataset or a file, with the coordinates ``time`` and ``axis``."""
        found = {
            "time": Variable(("time",), self.t, {"units": "s", "long_name": "time"}),
            "axis": Variable(("axis",), np.array(["x", "y"], dtype=object), {"long_name": _AXES}),
        }
        for name, (dims, units, long_name) in {**VARIABLES, **self.optional(), **DERIVED}.items():
            found[name] = Variable(("time", *dims), getattr(self, name), {"units": units, "long_name": long_name})
        return found

    def attributes(self) -> ByName:
        """What the dataset and the file say about the run as a whole, the set-up as TOML text included."""
        from hyperflex import __version__

        found = {key: value for key, value in self.attrs.items() if value is not None}
        found |= {"format": FORMAT, "source": "simulated", "hyperflex_version": __version__}
        found |= {"status": str(self.status), "message": self.message, "setup": self.setup.dumps()}
        return found if self.event is None else found | {"event": self.event[0], "event_time": self.event[1]}

    def to_netcdf(self, path: str | Path) -> None:
        """Write the run, its set-up and its final state to the NetCDF file `path`, usually ``.nc``.

        An existing file is replaced only once the new one is complete. FileProblem if the folder cannot be written to
        or is full; nothing has changed then.
        """
        ends = {name: state.variables() for name, state in (("start", self.start), ("state", self.state))}
        files.write_netcdf(path, NetCDF(self.variables(), self.attributes(), ends))

    def to_csv(self, path: str | Path) -> None:
        """Write the samples to the CSV file `path`, a row each, whole or not at all, in SI units.

        The columns are time ``t``, arm_angle, arm_rate, link angles (th1, th2, ..) and rates (w1, w2, ..), joints
        (x0, y0, .., the tip last), energies, motor_work and motor_torque.
        """
        n, columns = self.q.shape[1], {"t": self.t, "arm_angle": self.arm_angle, "arm_rate": self.arm_rate}
        columns |= {
            f"{name}{k + 1}": values[:, k] for name, values in (("th", self.q), ("w", self.qd)) for k in range(n)
        }
        columns |= {f"{axis}{k}": self.joints[:, k, j] for k in range(n + 1) for j, axis in enumerate("xy")}
        columns |= {name: getattr(self, name) for name, (_, unit, _) in VARIABLES.items() if unit in ("J", "N m")}
        notes = {"source": "simulated", "contents": "s, rad, rad/s, m, J and N m; angles: 0 hangs down; y upwards"}
        files.write_table(path, list(columns), np.column_stack(list(columns.values())), notes=notes)

    def plot(
        self,
        kind: Literal["strobe", "course"] = "strobe",
        *,
        start: float | None = None,
        end: float | None = None,
        title: str = "",
        ax: "Axes | None" = None,
    ) -> "Figure":
        """Draw the run: return a Matplotlib figure.

        Parameters
        ----------
        kind : {"strobe", "course"}
            Many instants in one picture; or arm, speed of the tip, energies and torque over time.
        start, end : float, optional
            Time to show, s; by default the last sweep of the rope in a strobe, and all of a course.
        title : str
        ax : matplotlib.axes.Axes, optional
            Axes for the strobe, in place of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
            Its method ``savefig`` writes it to a file; a notebook shows it. It is not registered with pyplot, so it
            needs no screen and no closing: for a window, pass axes of pyplot.

        Raises
        ------
        InvalidInput
            If the kind is unknown, the times are not in the run, or a course is to be drawn into one axes.

        Examples
        --------
        >>> import matplotlib.pyplot as plt
        >>> import hyperflex as hf
        >>> rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=10, friction=1e-3)
        >>> _, (left, right) = plt.subplots(1, 2)
        >>> for ax, angle in ((left, 0.3), (right, 1.2)):
        ...     figure = hf.simulate(rope, duration=1.0, q0=angle).plot(ax=ax)
        >>> plt.close(figure)
        """
        from hyperflex.report import run_figure

        return run_figure(self, kind, start=start, end=end, title=title, ax=ax)

    def animate(self, path: str | Path, **options: Any) -> None:
        """Write a film of the run to `path`, whose suffix, .gif or .mp4, says the kind.

        `options` are those of :func:`hyperflex.report.animate`: start, end, frame_rate, speed, width, title, ...
        """
        from hyperflex.report import animate

        animate(self, path, **options)

    def to_html(self, path: str | Path, **options: Any) -> None:
        """Write a page to `path` that plays the run in any browser, without a network: scrub it, slow it down.

        `options` are those of :func:`hyperflex.report.player_html`: start, end, frame_rate, speed, title, ...
        """
        from hyperflex.report import write_player

        write_player(self, path, **options)

    def _repr_html_(self) -> str:
        from hyperflex.report import run_html

        return run_html(self)


def swept(away: Array) -> Array:
    """Return the signed angle (..., n), rad, that each link subtends at the origin of `away` (..., n + 1, 2)."""
    a, b = away[..., :-1, :], away[..., 1:, :]
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.asarray(np.arctan2(cross, (a * b).sum(axis=-1)))


def interpolated(t: Array, value: Array, rate: Array, times: Array) -> Array:
    """Return values (K, ...) at `times` (K,), s, by cubic Hermite interpolation of samples and rates (T, ...)."""
    k = np.clip(t.searchsorted(times, side="right") - 1, 0, t.size - 2)
    wide = [slice(None), *(value.ndim - 1) * [None]]
    span, part = (each[tuple(wide)] for each in (t[k + 1] - t[k], (times - t[k]) / (t[k + 1] - t[k])))
    rest = 1.0 - part
    return rest**2 * ((1.0 + 2.0 * part) * value[k] + part * span * rate[k]) + part**2 * (
        (1.0 + 2.0 * rest) * value[k + 1] - rest * span * rate[k + 1]
    )


def _read_only(value: Array) -> Array:
    value.setflags(write=False)
    return value


_NEEDED = ("t", "q", "qd", "step", "work", "dissipated")  # of a state


def read_trajectory(path: str | Path) -> Trajectory:
    """Read a run that :meth:`Trajectory.to_netcdf` wrote.

    Parameters
    ----------
    path : str or Path
        The NetCDF file.

    Returns
    -------
    Trajectory

    Raises
    ------
    FileProblem
        There is no such file, or it is cut off or damaged.
    InvalidInput
        It is no NetCDF-4 file, or not a hyperflex trajectory.
    """
    content = files.read_netcdf(path)
    attributes, main = content.attributes, content.variables
    start, state = (content.groups.get(name, {}) for name in ("start", "state"))
    if attributes.get("format") != FORMAT:
        raise InvalidInput(
            f"{path} is not a hyperflex trajectory",
            got=attributes.get("format", "no attribute 'format'"),
            allowed=f"a file written by Trajectory.to_netcdf (format {FORMAT!r})",
            fix="Measured data are read by hyperflex.read_recording",
        )
    missing = [name for name in ("time", *VARIABLES) if name not in main]
    missing += [f"start/{name}" for name in _NEEDED if name not in start]
    missing += [f"state/{name}" for name in _NEEDED if name not in state]
    missing += [f"attribute {name!r}" for name in ("setup", "status") if name not in attributes]
    if missing:
        raise InvalidInput(f"{path} lacks parts of a trajectory", got=missing, fix="Simulate it again")
    return Trajectory(
        t=main["time"].numbers("time"),
        setup=Setup.loads(str(attributes["setup"]), f"the set-up in {path}"),
        state=_state(state),
        start=_state(start),
        status=Status(checks.choice(f"status in {path}", str(attributes["status"]), list(Status))),
        message=str(attributes.get("message", "")),
        event=(str(attributes["event"]), float(attributes["event_time"])) if "event" in attributes else None,
        attrs={key: value for key, value in attributes.items() if key not in OWN_ATTRIBUTES},
        **{name: main[name].numbers(name) for name in (*VARIABLES, *OPTIONAL) if name in main},
    )


def _state(variables: Mapping[str, Variable]) -> State:
    plain: ByName = {name: each.values for name, each in variables.items()}
    plain |= {name: variables[name].numbers(name) for name in STATE if name in variables}
    plain = {name: value.item() if np.ndim(value) == 0 else value for name, value in plain.items()}
    kept = {name.removeprefix(CHECKPOINT): value for name, value in plain.items() if name.startswith(CHECKPOINT)}
    return State(**{name: plain[name] for name in STATE if name in plain}, checkpoint=kept)
