"""Identification of a drive: lag, limits, friction, inertia and backlash from a recorded test motion."""

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from hyperflex import checks, files
from hyperflex.budget import one_thread
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.hardware.drive_model import DriveModel
from hyperflex.hardware.simulated import SimulatedMotor
from hyperflex.model import MotorLimits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE = "drive"  # of a file with an identified drive
UNITS = {
    "lag": "s",
    "delay": "s",
    "frequency": "rad/s",
    "damping": "",
    "feedforward": "",
    "rate_limit": "rad/s",
    "acceleration_limit": "rad/s^2",
    "backlash": "rad",
    "inertia": "kg m^2",
    "friction": "N m s/rad",
    "dry_friction": "N m",
    "weight_torque": "N m",
}


@dataclass(frozen=True, eq=False)
class DriveRecord:
    """Goals that a drive was sent, and what it replied.

    Attributes
    ----------
    sent, received : (N,) float64
        Times of goal and reply, s, from the first goal on.
    goal, goal_rate : (N,) float64
        Arm angle and rate that were asked for, rad and rad/s.
    angle, torque : (N,) float64
        Arm angle and torque that were reported, rad and N m; NaN where a goal was not answered, or the torque not told.
    """

    sent: Array
    received: Array
    goal: Array
    goal_rate: Array
    angle: Array
    torque: Array

    def __post_init__(self) -> None:
        count = checks.times("times of goals", self.sent, least=100).size
        for name, value in vars(self).copy().items():
            object.__setattr__(self, name, checks.array(f"{name} of a drive's record", value, (count,), gaps=True))
        if np.isfinite(self.angle).sum() < 0.5 * count:
            raise InvalidInput("drive answered fewer than half of the goals", got=int(np.isfinite(self.angle).sum()))

    @property
    def read_at(self) -> Array:
        """Times (N,), s, for which the replies count: the middle between request and reply."""
        return 0.5 * (self.sent + self.received)


@dataclass(frozen=True, eq=False)
class DriveFit:
    """An identified drive.

    Attributes
    ----------
    values : dict of str to float
        By name, SI units: lag (at constant speed, in all, see :class:`DriveModel`), delay, frequency, damping,
        feedforward, rate_limit, acceleration_limit, backlash, and where the drive tells its torque: inertia, friction,
        dry_friction and weight_torque. What the test motion did not show is missing. So is the delay where only the
        lag is known, which is the sum of delay, hold and loop.
    intervals : dict of str to (float, float)
        95 % intervals of the values, if the drive obeys the model: see `doubt`. None of delay, frequency, damping and
        feedforward: other parts explain the same lag about as well.
    reached : (float, float)
        Greatest speed, rad/s, and acceleration, rad/s^2, of the goals: limits that are missing lie above.
    residual : float
        Root mean square of measured less modelled angle, rad.
    model : DriveModel
    record : DriveRecord, optional
        Not in files.
    message : str
        Why it must not be used; empty if it may.
    doubt : str
        What the torques show that the model lacks, cogging or friction that is greater near rest: then intervals are
        too narrow. Empty if they show nothing; a drive that does not tell its torque never does.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    reached: tuple[float, float]
    residual: float
    model: DriveModel
    record: DriveRecord | None = None
    message: str = ""
    doubt: str = ""

    @property
    def success(self) -> bool:
        """Whether the model explains the recording."""
        return not self.message

    @property
    def lag(self) -> float:
        """Lag at constant speed, s."""
        return self.values["lag"]

    @property
    def lag_std(self) -> float:
        """Standard deviation of the lag, s: a quarter of its 95 % interval."""
        low, high = self.intervals["lag"]
        return 0.25 * (high - low)

    def motor_limits(self, limits: MotorLimits) -> MotorLimits:
        """Return limits that the drive keeps: those given, or less where it was found to be slower."""
        speed, rise = (self.intervals.get(name, (math.inf,))[0] for name in ("rate_limit", "acceleration_limit"))
        least = max(speed, 1e-3), max(rise, 1e-3)
        return replace(limits, speed=min(limits.speed, least[0]), acceleration=min(limits.acceleration, least[1]))

    def motor(self, angle: float = 0.0) -> SimulatedMotor:
        """Return a simulated motor with the identified lag, at rest at an angle, rad."""
        return SimulatedMotor(angle, lag=self.lag)

    def describe(self) -> str:
        """Return the lag with its interval as text."""
        low, high = self.intervals["lag"]
        return f"identified lag {1e3 * self.lag:.1f} ms ({1e3 * low:.1f} to {1e3 * high:.1f})"

    def to_toml(self, path: files.PathLike) -> None:
        """Write it to a TOML file, without the record."""
        table = {
            "values": self.values,
            "intervals": {name: list(each) for name, each in self.intervals.items()},
            "reached": list(self.reached),
            "residual": self.residual,
            "message": self.message,
            "doubt": self.doubt,
            "model": asdict(self.model),
        }
        files.write_toml(path, {TABLE: table})

    @classmethod
    def from_toml(cls, path: files.PathLike) -> Self:
        """Read it from a file of :meth:`to_toml`. Raises FileProblem or InvalidInput."""
        table: Any = files.read_toml(path).get(TABLE)
        try:
            return cls(
                {name: float(value) for name, value in table["values"].items()},
                {name: (float(low), float(high)) for name, (low, high) in table["intervals"].items()},
                (float(table["reached"][0]), float(table["reached"][1])),
                float(table["residual"]),
                DriveModel(**{name: float(value) for name, value in table["model"].items()}),
                None,
                str(table["message"]),
                str(table.get("doubt", "")),
            )
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):
            raise InvalidInput(
                f"{path} has no identified drive",
                allowed=f"a table [{TABLE}]",
                fix="Make one with hyperflex motor identify",
            ) from None

    def plot(self) -> "Figure":
        """Return a figure of goals, measured and modelled angle, and their difference; needs the record."""
        from hyperflex.report import drive_figure

        return drive_figure(self)


# Starts and bounds of what is fitted, as in DriveModel, with the lag, s, in place of the delay; offset rad
BOUNDS = {
    "lag": (1e-2, 0.0, 0.5),
    "frequency": (60.0, 2.0, 2000.0),
    "damping": (1.0, 0.05, 20.0),
    "feedforward": (0.5, 0.0, 1.5),
    "dry": (1.0, 0.0, 1e4),
    "viscous": (0.0, 0.0, 1e4),
    "weight": (1.0, -1e4, 1e4),
    "backlash": (2e-3, 0.0, 0.2),
    "rate_limit": (10.0, 0.1, 1e3),
    "slope": (50.0, 1.0, 5e3),
    "acceleration_limit": (300.0, 1.0, 1e5),
    "current_lag": (5e-4, 0.0, 1e-2),
    "offset": (0.0, -0.2, 0.2),
    "inertia": (1e-3, 1e-8, 1e3),
}
MODEL = tuple(each.name for each in fields(DriveModel) if each.name not in ("delay", "hold"))


@one_thread()
def identify_drive(record: DriveRecord) -> DriveFit:
    """Identify a drive from the record of a test motion, by least squares.

    Errors of the angle have a constant part (the encoder's steps) and one that grows with the speed (jitter of the
    time stamps); both are estimated. The covariance is that of Gauss and Newton with the residuals' autocorrelation,
    by the jackknife over blocks of time, and intervals are those of Student's t.

    Raises
    ------
    InvalidInput
        If the arm hardly moved.
    """
    first = _Fit(record, 0.0)
    first.start()
    first.solve(15)
    first.weigh()
    period, rates = float(np.median(np.diff(record.sent))), bool(record.goal_rate.any())
    kinds = [  # of loops: with goals that are held or advanced, whose rates are used or not
        first.variant(hold, part, faster)
        for hold in (period, 0.0)[: 1 + rates]
        for part in (0.0, 1.0)[: 1 + rates]
        for faster in (1.0, 2.0)
    ]
    for each in kinds:
        each.solve(8)
    best = min(kinds, key=lambda each: each.cost)
    best.solve(30)
    best.step = 2.5e-4
    for _ in range(3):
        best.weigh()
        best.solve(30)
    return best.result()


class _Fit:
    """Least squares of a record: `values` by name, of which those in `free` are fitted."""

    def __init__(self, record: DriveRecord, hold: float) -> None:
        self.cost, self.hold, self.step, self.converged = math.inf, hold, 1e-3, False  # step of the model, s
        self.record = record
        self.known = np.isfinite(record.angle)
        if np.ptp(record.angle[self.known]) < 0.05:
            raise InvalidInput("arm barely moved in the test motion", got=float(np.ptp(record.angle[self.known])))
        self.times, self.angles = record.read_at[self.known], record.angle[self.known]
        usual = float(np.mean(self.times - record.sent[self.known]))  # s from sending a goal to its arrival
        self.sent = np.where(self.known, record.read_at - usual, record.sent)  # as if all arrived after that time
        self.torques = record.torque[self.known]
        self.told = bool(np.isfinite(self.torques).all()) and float(np.ptp(self.torques)) > 0.0
        self.values = {name: bound[0] for name, bound in BOUNDS.items()}
        self.sigma, self.sigma_torque, self.late = np.full(self.times.size, 1e-3), np.ones(self.times.size), 0.0
        goal_rate = record.goal_rate
        self.reached = (
            float(np.abs(goal_rate).max()),
            float(np.abs(np.diff(goal_rate) / np.diff(record.sent)).max()),
        )
        steps = np.diff(self.angles[::8]) / np.diff(self.times[::8])
        self.values["rate_limit"] = 1.02 * float(np.abs(steps).max())
        self.values["acceleration_limit"] = 2.0 * self.reached[1]
        self.free: list[str] = []

    def variant(self, hold: float, feedforward: float, faster: float) -> "_Fit":
        """Return the fit of another kind of loop, from the best of a grid around one so much faster.

        There are several minima: a slow loop without a delay moves nearly as a fast one with a delay.
        """
        other = copy(self)
        other.hold = hold
        starts = (
            self.values | {"feedforward": feedforward, "frequency": w * self.values["frequency"], "damping": z}
            for w in faster * np.geomspace(0.6, 1.6, 5)
            for z in np.geomspace(0.5, 2.0, 5) * self.values["damping"]
        )
        other.values = min(starts, key=lambda each: float((other.residuals(each) ** 2).sum()))
        return other

    def model(self, values: Mapping[str, float]) -> DriveModel:
        """Return the model with these values."""
        fast = DriveModel(0.0, **{name: values[name] for name in MODEL}, hold=self.hold)
        return replace(fast, delay=values["lag"] - fast.lag)

    def predicted(self, values: Mapping[str, float]) -> tuple[Array, ...]:
        """Return reported angle, rate, torque and its change (M,) at the times of the replies.

        The torque jumps with each goal that is held, and is the mean expected at times that are not exact: both those
        of the reading and of the goal are off by `late`. Its change is that within the time over which it is the mean.
        """
        goals = self.sent, self.record.goal, self.record.goal_rate
        grid, angle, rate, effort = self.model(values).respond(*goals, self.step)
        wide = max(math.sqrt(6.0) * self.late, float(grid[1] - grid[0]))  # s: half of a uniform distribution
        pushed = values["inertia"] * effort
        area = np.append(0.0, np.cumsum(pushed[1:] * np.diff(grid)))
        means, changes = (
            np.subtract(*(np.interp(self.times + way, grid, each) for way in (wide, -wide))) for each in (area, pushed)
        )
        seen, speed = (np.interp(self.times, grid, each) for each in (angle, rate))
        return seen + values["offset"], speed, means / (2.0 * wide), changes

    def residuals(self, values: Mapping[str, float]) -> Array:
        """Return measured less predicted angles, and torques where they are told, over their deviations."""
        angle, _, torque, _ = self.predicted(values)
        rows = [(self.angles - angle) / self.sigma]
        if self.told:
            rows.append((self.torques - torque) / self.sigma_torque)
        return np.concatenate(rows)

    def start(self) -> None:
        """Choose the best of a grid of loops as the start."""
        starts = (
            self.values | {"lag": lag, "frequency": frequency, "feedforward": part}
            for lag in (5e-3, 1e-2, 2e-2, 4e-2)
            for frequency in (15.0, 30.0, 60.0, 120.0, 240.0)
            for part in (0.0, 0.5, 1.0)
        )
        self.values = min(starts, key=lambda each: float(((self.predicted(each)[0] - self.angles) ** 2).sum()))
        if self.told:
            _, _, torque, _ = self.predicted(self.values | {"inertia": 1.0})
            inertia = float(torque @ self.torques / (torque @ torque))
            self.values["inertia"] = max(inertia, 1e-7)
            self.sigma_torque[:] = max(float(np.std(self.torques - inertia * torque)), 1e-9)

    def jacobian(self, values: Mapping[str, float], names: list[str]) -> Array:
        """Return derivatives of the residuals by the named values (rows, len(names)), by differences."""
        here, columns = self.residuals(values), []
        for name in names:
            step = 1e-3 * max(abs(values[name]), {"lag": 0.01, "offset": 0.01, "backlash": 0.01}.get(name, 0.1))
            step = step if values[name] + step < BOUNDS[name][2] else -step
            columns.append((self.residuals(dict(values) | {name: values[name] + step}) - here) / step)
        return np.stack(columns, axis=1)

    def solve(self, most: int) -> None:
        """Fit what shows in the residuals, with at most so many evaluations."""
        from scipy.optimize import least_squares

        names = ["lag", *MODEL, "offset", *(("inertia",) if self.told else ())]
        if not self.record.goal_rate.any():
            names.remove("feedforward")
        if not self.told:
            names.remove("viscous")  # hardly shows in the angles, beside the damping
        shown = np.abs(self.jacobian(self.values, names)).sum(axis=0) > 0.0
        self.free = [name for name, each in zip(names, shown, strict=True) if each]

        def full(x: Array) -> dict[str, float]:
            return self.values | dict(zip(self.free, x.tolist(), strict=True))

        bounds = np.array([BOUNDS[name][1:] for name in self.free]).T
        first = np.clip([self.values[name] for name in self.free], bounds[0] + 1e-9, bounds[1] - 1e-9)
        found = least_squares(
            lambda x: self.residuals(full(x)),
            first,
            jac=lambda x: self.jacobian(full(x), self.free),
            bounds=bounds,
            x_scale="jac",
            ftol=1e-6,
            xtol=1e-6,
            max_nfev=most,
        )
        self.values, self.cost, self.converged = full(found.x), float(found.cost), found.status > 0

    def _message(self, residual: float) -> str:
        if residual > 0.05 * float(np.ptp(self.angles)):
            return f"the model misses the measured angles by {residual:.3g} rad: is the record of this motion?"
        return "" if self.converged else "the fit has not converged: record another test motion"

    def _doubt(self) -> str:
        """Return what the torques show that the model lacks.

        Cogging: the periodogram of their residuals over the angle has a peak that one of a hundred thousand of white
        noise has. Friction near rest: they are along the motion where it is slow, by three standard deviations.
        """
        if not self.told:
            return ""
        _, speed, torque, _ = self.predicted(self.values)
        moving, orders = np.isfinite(self.sigma_torque), np.arange(1, 121)  # a turn
        away, rate = ((self.torques - torque) / self.sigma_torque)[moving], speed[moving]
        power = np.abs(np.exp(1j * np.outer(orders, self.angles[moving])) @ away) ** 2
        slow = np.sign(rate) * np.exp(-((rate / (0.05 * np.abs(rate).max())) ** 2))
        cogs = power.max() / np.median(power) * math.log(2.0) > math.log(1e5 * orders.size)
        sticks = slow @ away > 3.0 * np.linalg.norm(slow)
        found = [f"cogging, some {orders[power.argmax()]} times a turn"] * bool(cogs)
        found += ["more friction near rest"] * bool(sticks)
        return f"the torques show {' and '.join(found)}: the intervals are too narrow" if found else ""

    def weigh(self) -> None:
        """Estimate the deviation of each reading, which grows with how fast it changes: its time is off by `late`, s.

        Readings at rest do not count: where in its friction, or in a step of the encoder, the arm rests is chance.
        """
        angle, speed, torque, change = self.predicted(self.values)
        resting = np.abs(speed) < 0.01 * np.abs(speed).max()
        self.sigma, self.late = _deviations(self.angles - angle, speed)
        self.sigma[resting] = math.inf
        if self.told:
            self.sigma_torque, _ = _deviations(self.torques - torque, change)
            self.sigma_torque[resting] = math.inf

    def result(self) -> DriveFit:
        """Return the fit with intervals."""
        residuals = self.residuals(self.values)
        jacobian = self.jacobian(self.values, self.free)
        seen = np.abs(jacobian).sum(axis=0) > 0.0
        names = [name for name, each in zip(self.free, seen, strict=True) if each]
        changes = _jackknife(jacobian[:, seen], residuals, self.times)
        values, gradients = self._derived()
        known, intervals = {}, {}
        for name, value in values.items():
            gradient = gradients[name]
            beyond = name in _LIMITS and value > self.reached[_LIMITS.index(name)]  # of what was asked for
            if beyond or not gradient.keys() <= set(names):
                continue
            row = np.array([gradient.get(each, 0.0) for each in names])
            half = _half_width(changes @ row)
            low, high = value - half, value + half
            if name == "delay" and low <= 0.0:  # how the lag is divided was not seen: its sum alone is known
                continue
            known[name] = value
            if name not in ("delay", "frequency", "damping", "feedforward"):
                intervals[name] = max(low, 0.0) if name != "weight_torque" else low, high
        unseen = {name: math.inf for name in _LIMITS if name not in known}
        model = self.model(self.values | unseen)
        angle = self.predicted(self.values)[0]
        residual = float(np.sqrt(np.mean((self.angles - angle) ** 2)))
        told = self._message(residual), self._doubt()
        return DriveFit(known, intervals, self.reached, residual, model, self.record, *told)

    def _derived(self) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Return what a user wants to know, and its derivatives by what was fitted."""
        x = self.values
        w, z, f, j = x["frequency"], x["damping"], x["feedforward"], x["inertia"]
        loop = 2.0 * z * (1.0 - f) / w
        values = {name: x[name] for name in UNITS if name in x}
        gradients = {name: {name: 1.0} for name in values}
        values["delay"] = x["lag"] - 0.5 * self.hold - loop
        gradients["delay"] = {"lag": 1.0, "frequency": loop / w, "damping": -2.0 * (1.0 - f) / w}
        if "feedforward" in self.free:
            gradients["delay"]["feedforward"] = 2.0 * z / w
        else:
            values.pop("feedforward")
        if self.told:
            for name, part in (("friction", "viscous"), ("dry_friction", "dry"), ("weight_torque", "weight")):
                values[name], gradients[name] = j * x[part], {"inertia": x[part], part: j}
        else:
            values.pop("inertia")
        return {name: values[name] for name in UNITS if name in values}, gradients


def _deviations(errors: Array, changes: Array) -> tuple[Array, float]:
    """Return the deviation (M,) of each error, and b: its square is a^2 + b^2 change^2, by least squares."""
    from scipy.optimize import nnls

    squares = np.minimum(errors**2, 20.0 * np.mean(errors**2))  # a gross error is no measure of the usual one
    scale = max(float(np.mean(changes**2)), 1e-300)
    basis = np.stack([np.ones_like(changes), changes**2 / scale], axis=1)
    parts, _ = nnls(basis, squares)
    return np.sqrt(np.maximum(basis @ parts, 1e-4 * squares.mean() + 1e-16)), math.sqrt(parts[1] / scale)


_LIMITS = ("rate_limit", "acceleration_limit")


def _jackknife(jacobian: Array, residuals: Array, times: Array, blocks: int = 40) -> Array:
    """Return changes (blocks, P) of P parameters, the sum of whose squares is their variance.

    Each of the blocks of time is left out once, in one Gauss-Newton step. So residuals may be correlated within a
    block, also those of angle and torque, and may be larger in some moves.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    rows = jacobian / scale
    information = rows.T @ rows
    block = np.tile(np.arange(times.size) * blocks // times.size, residuals.size // times.size)
    changes = []
    for k in range(blocks):
        own = rows[block == k]
        changes.append(np.linalg.lstsq(information - own.T @ own, own.T @ residuals[block == k], rcond=1e-12)[0])
    return np.asarray(math.sqrt((blocks - 1.0) / blocks) * np.array(changes) / scale)


def _half_width(changes: Array) -> float:
    """Return half of the 95 % interval of a value that the blocks change by these (blocks,).

    Student's t has the degrees of freedom of Satterthwaite: few, if a few blocks tell of the value.
    """
    from scipy.special import stdtrit

    squares = changes**2
    if not squares.any():
        return 0.0
    freedom = 3.0 * squares.sum() ** 2 / (squares**2).sum() - 2.0  # 3: of a fourth power of normal numbers
    return float(stdtrit(freedom, 0.975) * math.sqrt(squares.sum()))
