"""Where a moving rope is at any time: its link angles between samples, and motion off the plane by choice."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import unit_along
from hyperflex.trajectory import Trajectory

OffPlane = Callable[[Array, Array], Array]  # times (m,), arc lengths (P,) -> (m, P), m


class RopeMotion:
    """Places along a rope whose link angles are known at sample times.

    Parameters
    ----------
    t : (T,) array_like
        Times, s, T >= 2.
    q, qd : (T, n) array_like
        Absolute link angles, rad, and rates, rad/s.
    length : (n,) array_like
        Of the links, m.
    base, base_velocity : (T, 2) array_like or None
        Of the first joint, m and m/s; None: it rests at the origin.
    off_plane : callable, optional
        Of times (m,), s, and arc lengths (P,), m, to how far off the plane (m, P) that is, m, towards the viewer.
        The rope is made that much longer, which is of second order.

    Notes
    -----
    Cubic Hermite interpolation between samples: error (step)^4 / 384 of the fourth derivative. Before the first and
    after the last sample it stands still.
    """

    def __init__(
        self,
        t: ArrayLike,
        q: ArrayLike,
        qd: ArrayLike,
        length: ArrayLike,
        base: ArrayLike | None = None,
        base_velocity: ArrayLike | None = None,
        off_plane: OffPlane | None = None,
    ) -> None:
        from scipy.interpolate import CubicHermiteSpline

        self.t = checks.times("t", t, least=2)
        self.length = checks.array("length", length, (-1,), sign="positive", unit="m")
        if (base is None) != (base_velocity is None):
            raise InvalidInput("one of base and base_velocity is missing", fix="Give both or none")
        still = np.zeros((self.t.size, 2))
        base, velocity = (still, still) if base is None else (base, base_velocity)
        links, joint = (self.t.size, self.length.size), still.shape
        values = [checks.array("q", q, links, unit="rad"), checks.array("base", base, joint, unit="m")]
        rates = [checks.array("qd", qd, links, unit="rad/s"), checks.array("base_velocity", velocity, joint)]
        self._values = CubicHermiteSpline(self.t, np.hstack(values), np.hstack(rates))
        self.off_plane = off_plane

    @classmethod
    def from_trajectory(cls, trajectory: Trajectory, off_plane: OffPlane | None = None) -> "RopeMotion":
        """Return the motion of a simulated rope, and of its arm's tip; see the class for `off_plane`."""
        run = trajectory
        return cls(run.t, run.q, run.qd, run.rope.length, run.base, run.base_velocity, off_plane)

    @property
    def joint_arc_lengths(self) -> Array:
        """Arc lengths (n + 1,) of the joints, the tip last, m."""
        return np.concatenate([[0.0], np.cumsum(self.length)])

    def places(self, t: ArrayLike, arc_lengths: ArrayLike) -> Array:
        """Return places (m, P, 3), m: x, y and off the plane, at times (m,), s, of points (P,), m along the rope.

        Points beyond the tip lie on the last link's line.
        """
        times, arcs = np.atleast_1d(np.asarray(t, float)), np.asarray(arc_lengths, float)
        q, base = np.split(self._values(np.clip(times, self.t[0], self.t[-1])), [-2], axis=1)
        along = unit_along(q)  # (m, n, 2)
        joints = base[:, None] + np.pad(np.cumsum(self.length[:, None] * along, axis=1), ((0, 0), (1, 0), (0, 0)))
        ends = self.joint_arc_lengths
        link = np.clip(np.searchsorted(ends, arcs, side="right") - 1, 0, self.length.size - 1)
        result = np.zeros((times.size, arcs.size, 3))
        result[:, :, :2] = joints[:, link] + (arcs - ends[link])[:, None] * along[:, link]
        if self.off_plane is not None:
            result[:, :, 2] = self.off_plane(times, arcs)
        return result
