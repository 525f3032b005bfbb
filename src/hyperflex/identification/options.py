"""What a user may say of a recording and of its fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit import LOSSES, LossName
from hyperflex.model import Arm
from hyperflex.motion import Motion
from hyperflex.options import check as check_options
from hyperflex.options import option

How = Literal["auto", "covariance", "profile"]
HOWS: tuple[How, ...] = get_args(How)


@dataclass(frozen=True, eq=False)
class RecordingSetup:
    """Set-up of a recording: motion of the arm, positions of the markers, and measured torque.

    Parameters
    ----------
    motion, arm : Motion, Arm, optional
        Motion of the first joint, in the recording's time; by default it is fixed.
    arc_lengths : (K,) array_like, m, optional
        Distance along the rope of each marker from the first joint; by default markers are at the joints. A marker
        alone needs `origin` as well.
    origin : (2,) array_like, m, optional
        Origin of the motion (the first joint, if it is fixed) in the camera's frame. With `arc_lengths` alone it is
        fitted as ``origin_x`` and ``origin_y``.
    torque : (T,) or (T, k) array_like, optional
        Measured torque of motors, N m, or their current with `torque_constant`; NaN in gaps. It fixes the scale.
        Without a prescribed `motion` the torque is an input: interpolated linearly between the samples (also over
        gaps), it drives the simulation. With one it is an output, fitted as a further channel.
    torque_joints : sequence of int, optional
        Joint of each column of `torque`: 0 is the joint from which the rope hangs, 1 that between the first two links,
        and so on. By default the first k. A motor acts on the link after its joint, and with the opposite sign on the
        link before it.
    torque_constant : float or (k,) array_like
        Torque over the reading: 1 for a torque in N m, the torque constant, N m/A (with the gear), for a current.
    torque_noise : float or (T,) array_like, optional
        Standard deviation of a torque that is fitted, in the unit of `torque`; it is then required, and so is the noise
        of the recording. An input is exact except for its constant.

    Raises
    ------
    InvalidInput
        For an arm without its motion, or a torque of a joint that does not exist.
    """

    motion: Motion | None = None
    arm: Arm | None = None
    arc_lengths: ArrayLike | None = None
    origin: ArrayLike | None = None
    torque: ArrayLike | None = None
    torque_noise: ArrayLike | None = None
    torque_joints: Sequence[int] | None = None
    torque_constant: ArrayLike = 1.0

    def __post_init__(self) -> None:
        if self.arm is not None and self.motion is None:
            fix = "Pass motion=... as well, or omit arm; an arm that a torque drives is the first link of the rope"
            raise InvalidInput("arm is given without its motion", fix=fix)
        if self.torque is None:
            return
        if self.motion is not None and self.arm is None:
            fix = "Pass arm=... as well, or omit motion: the torque then drives the first link"
            raise InvalidInput("torque is given without the arm that it turns", fix=fix)
        columns = self._columns
        if self.motion is not None and (columns > 1 or self.torque_joints is not None):
            fix = "Give that torque alone, or make the arm the first link of the rope and omit motion"
            raise InvalidInput("with a motion the torque is that of the arm's motor", got=f"{columns} columns", fix=fix)
        if self.drives and self.torque_noise is not None:
            allowed = "with a motion and its arm alone; a torque that drives counts as exact"
            fix = "Omit it; say the standard deviation of the torque's scale by FitOptions(torque_std=...)"
            raise InvalidInput("torque_noise is of a torque that is fitted", allowed=allowed, fix=fix)
        joints = [checks.count("torque_joints", each, least=0) for each in self.joints]
        if len(joints) != columns or len(set(joints)) < columns:
            allowed = f"{columns} different joints, one for each column of torque"
            raise InvalidInput("torque_joints do not fit the torque", got=joints, allowed=allowed)
        checks.array("torque_constant", self.torque_constant, (columns,), sign="positive", unit="N m", scalar=True)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joint of each column of the torque."""
        if self.torque_joints is not None:
            return tuple(self.torque_joints)
        return tuple(range(self._columns))

    @property
    def _columns(self) -> int:
        """Number of motors whose torque is given."""
        shape = np.asarray(self.torque, dtype=object).shape
        return int(shape[1]) if len(shape) > 1 else 1

    @property
    def drives(self) -> bool:
        """Whether the torque drives the simulation: no motion is prescribed."""
        return self.torque is not None and self.motion is None


@dataclass(frozen=True)
class FitOptions:
    """How :func:`hyperflex.identify` fits, and how well lengths, times and torques were measured.

    Parameters
    ----------
    window : float, s, optional
        Length of the windows. By default 1.2 periods of a small swing of a straight rod as long as the rope; less
        where links turn fast, more where frames are few. Of up to four links windows are then joined, up to the whole
        recording, as long as errors do not grow exponentially and the fit follows the data.
    train : float, s, optional
        Fit the samples with t < train and predict the rest; ``inf`` fits all. By default the first 80 % is fitted if
        the rest is long enough for a prediction, else all.
    loss : {"squares", "huber", "cauchy"}
        ``huber`` and ``cauchy`` are robust; ``cauchy`` also against gross outliers.
    lead, ahead : float, s
        Held-out part: states are fitted on `lead`, then predicted `ahead`.
    intervals : {"auto", "covariance", "profile", None}
        Method of the 95 % intervals: from standard deviations; by profile likelihood (about six short fits for each
        parameter); ``auto`` profiles where the covariance is skewed, as that of a parameter near 0; None: no intervals.
    length_std : float
        Relative standard deviation of the declared lengths: of one factor on all of them (a ruler, the scale of a
        picture), and of the arm's length. Standard deviations and intervals include its effect as far as the motion
        does not determine the lengths itself; 0: lengths are exact.
    clock_std : float
        The same for the times: of one factor on all of them (a clock, a frame rate). No motion shows lengths and times
        that are wrong together, so standard deviations include that; 0: times are exact.
    torque_std : float
        The same for the torque: of one factor on all samples (a torque constant). Masses, inertias and frictions are
        proportional to it, ratios are not. With ``torque_constant`` among the free parameters it is the standard
        deviation of each motor's constant before the fit. 0: torques are exact.
    """

    window: float | None = option(
        None, "Length of the windows that are fitted one by one", unit="s", sign="positive", infinite=True, shown="auto"
    )
    train: float | None = option(
        None, "Fit the samples before this time; predict the rest. inf fits all", unit="s", infinite=True, shown="80 %"
    )
    loss: LossName = option("squares", "Weight of the residuals: squares; huber or cauchy where there are outliers")
    lead: float = option(0.5, "Time on which the state of a prediction is fitted", unit="s", sign="positive")
    ahead: float = option(1.0, "Time that is predicted without data", unit="s", sign="positive")
    intervals: How | None = option("auto", "Method of the 95 % intervals: auto, covariance, profile or none")
    # What rulers and pictures measure lengths to
    length_std: float = option(
        0.01, "Relative standard deviation of the lengths, which intervals include; 0: exact", sign="nonnegative"
    )
    # Parts of IBM 06 and 16 fit to a gravity of 1.00 +- 0.01, twice this
    clock_std: float = option(
        0.005, "Relative standard deviation of the times, which intervals include; 0: exact", sign="nonnegative"
    )
    # A good calibration of a motor's torque constant, or of a torque sensor on its shaft
    torque_std: float = option(
        0.02, "Relative standard deviation of the torque, which intervals include; 0: exact", sign="nonnegative"
    )

    def __post_init__(self) -> None:
        checks.choice("loss", self.loss, LOSSES)
        if self.intervals is not None:
            checks.choice("intervals", self.intervals, HOWS, also="None (none on the command line)")
        check_options(self, "")

    @property
    def scale_std(self) -> npt.NDArray[np.float64]:
        """Standard deviations (4,) of the logarithms of factors on lengths, gravity, the arm's length and torque.

        A clock that is wrong by a factor multiplies gravity by its inverse square.
        """
        return np.array([self.length_std, 2.0 * self.clock_std, self.length_std, self.torque_std])

    @property
    def gravity_std(self) -> float:
        """Relative standard deviation of gravity, as lengths and times determine it."""
        return float(np.hypot(self.length_std, 2.0 * self.clock_std))
