"""Observations of markers, and the model that predicts them from a rope's state."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.parameters import ParameterStates
from hyperflex.model import Rope
from hyperflex.sensors import lever_arms
from hyperflex.vision import Camera, check_increasing

FAR = 10.0  # lengths of the rope from its first joint, beyond which a place is no marker's
ADJUSTMENTS = frozenset({"scale", "roll", "offset_x", "offset_y"})  # parameters of the plane's place in the picture


@dataclass(frozen=True, eq=False)
class Observations:
    """Where markers were seen at one time, each in its place along the rope: what an estimator takes.

    What a detector finds in a picture, in no order, is another class: :class:`hyperflex.vision.Observations`.

    Parameters
    ----------
    t : float
        Middle of the exposure, s.
    places : (K, 2) array_like
        Of each marker along the rope; m, or px where there is a camera. NaN: not seen.
    std : float or (K,) array_like, optional
        Standard deviation of each coordinate, same unit.
    covariances : (K, 2, 2) array_like, optional
        In place of `std`: of each place.
    rows : (K,) array_like, optional
        When each was read, as a part of the picture's readout: -0.5 in the first row, 0.5 in the last. By default 0.

    Raises
    ------
    InvalidInput
        If shapes differ, or a standard deviation is not positive.
    """

    t: float
    places: Array
    covariances: Array
    rows: Array

    def __init__(
        self,
        t: float,
        places: npt.ArrayLike,
        std: npt.ArrayLike | None = None,
        rows: npt.ArrayLike | None = None,
        *,
        covariances: npt.ArrayLike | None = None,
    ) -> None:
        found = np.array(places, dtype=np.float64)
        if found.ndim != 2 or found.shape[1] != 2:
            raise InvalidInput("places of markers have the wrong shape", got=found.shape, allowed="(K, 2)")
        found[np.isnan(found).any(axis=1)] = np.nan
        if np.isinf(found).any():
            raise InvalidInput("places of markers are infinite", got=found, allowed="numbers, or NaN: not seen")
        if (std is None) == (covariances is None):
            raise InvalidInput("an observation needs its uncertainty", allowed="either std or covariances")
        seen, k = ~np.isnan(found[:, 0]), len(found)
        wide = np.zeros((k, 2, 2))
        if covariances is None:
            each = np.broadcast_to(np.asarray(std, dtype=np.float64), (k,))
            if not (each[seen] > 0.0).all():
                raise InvalidInput("the std of an observation is not positive", got=std, allowed="> 0, in m or px")
            wide[:] = each[:, None, None] ** 2 * np.eye(2)
        else:
            wide[:] = covariances
        wide[~seen] = np.eye(2)
        if not np.isfinite(wide).all() or not _positive(wide):
            got = std if covariances is None else covariances
            raise InvalidInput("the uncertainty of an observation is not positive", got=got, allowed="> 0, finite")
        late = np.zeros(k) if rows is None else np.nan_to_num(np.broadcast_to(np.asarray(rows, float), (k,)))
        values = {"t": checks.number("time of an observation", t, unit="s"), "places": found, "covariances": wide}
        for name, value in {**values, "rows": late.copy()}.items():
            object.__setattr__(self, name, value)

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Which markers were seen (K,)."""
        return ~np.isnan(self.places[:, 0])


def _positive(wide: Array) -> bool:
    """Whether symmetric matrices (K, 2, 2) are positive definite."""
    determinant = wide[:, 0, 0] * wide[:, 1, 1] - wide[:, 0, 1] * wide[:, 1, 0]
    return bool((wide[:, 0, 0] > 0.0).all() and (determinant > 0.0).all())


class MarkerModel:
    """Predicts where a camera sees markers, with exact first derivatives.

    Parameters
    ----------
    rope : Rope
    arc_lengths : (K,) array_like
        How far along the rope each marker sits, m from the first joint.
    parameters : ParameterStates
    camera : Camera, optional
        By default places are seen in metres.
    readout : float
        Known time from the first row of a picture to the last, s.

    Notes
    -----
    A marker that is read tau before or after the state's time is seen at ``r + tau v + tau^2 a / 2``. The derivatives
    leave out those of the last term. The state is as it was when the picture was taken, so that a delay of the pictures
    counts for the first joint alone: that was where it is known to have been then.
    """

    def __init__(
        self,
        rope: Rope,
        arc_lengths: npt.ArrayLike,
        parameters: ParameterStates,
        camera: Camera | None = None,
        readout: float = 0.0,
    ) -> None:
        arcs = checks.array("arc_lengths", arc_lengths, (-1,), unit="m")
        total = float(rope.length.sum())
        if not arcs.size or (arcs < 0.0).any() or (arcs > total * (1.0 + 1e-9)).any():
            raise InvalidInput("a marker is not on the rope", got=arcs, allowed=f"0 to {total:g} m, at least one")
        check_increasing(arcs)
        self.arc_lengths, self.parameters, self.camera, self.readout = arcs, parameters, camera, readout
        self.link, self.arms = lever_arms(rope, arcs)
        self._arc_states = {k: int(name[4:-1]) for k, name in enumerate(parameters.names) if name.startswith("arc[")}
        if any(marker >= arcs.size for marker in self._arc_states.values()):
            raise InvalidInput(
                "an arc length is of no marker", got=parameters.names, allowed=f"arc[0..{arcs.size - 1}]"
            )

    @property
    def reads_rows(self) -> bool:
        """Whether rows are read one after the other, as far as is known."""
        return bool(self.readout) or "readout" in self.parameters.names

    def places(self, x: Array, base: Array) -> Array:
        """Return where the markers are in the rope's plane (K, 2), m; arguments as of :meth:`predict`."""
        q = x[: self.arms.shape[1]]
        return np.asarray(base[0] + np.stack([self.arms @ np.sin(q), -(self.arms @ np.cos(q))], axis=1))

    def possible(self, places: Array, base: Array) -> npt.NDArray[np.bool_]:
        """Return which places (K, 2) may be markers' (K,): of those in metres the ones that are not far off."""
        if self.camera is not None:
            return np.ones(len(places), dtype=bool)
        return np.asarray(np.hypot(*(places - base[0]).T) < FAR * self.parameters.rope.total_length)

    def predict(self, x: Array, base: Array, rows: Array, qdd: Array | None = None) -> tuple[Array, Array]:
        """Return where the markers are seen (K, 2), and the derivatives (K, 2, 2 n + P) with respect to x.

        Parameters
        ----------
        x : (2 n + P,) float64
            Angles, rad, rates, rad/s, and parameters.
        base : (3, 2) float64
            Place, velocity and acceleration of the first joint when the picture was taken, m, m/s, m/s^2.
        rows : (K,) float64
            As in :class:`Observations`.
        qdd : (n,) float64, optional
            Angular accelerations, rad/s^2; where they are left out, markers move uniformly within a readout.
        """
        n = self.arms.shape[1]
        q, values = x[:n], x[2 * n :]
        at = self.parameters.value
        readout = self.readout + at("readout", values)
        sin, cos = np.sin(q), np.cos(q)
        arms = self.arms * (1.0 + at("length", values)) if len(self.parameters) else self.arms
        for k, marker in self._arc_states.items():
            arms[marker, self.link[marker]] += values[k]
        tau = rows * readout  # (K,)
        jacobian = np.zeros((len(arms), 2, 2 * n + len(self.parameters)))
        slope = jacobian[:, :, :n]  # of the places by the angles
        np.multiply(arms, cos, out=slope[:, 0])
        np.multiply(arms, sin, out=slope[:, 1])
        places = np.stack([base[0, 0] + slope[:, 1].sum(axis=1), base[0, 1] - slope[:, 0].sum(axis=1)], axis=1)
        if len(self.parameters) or tau.any():
            places = self._moved(x, base, rows, tau, arms, places, jacobian, qdd)
        return self._seen(places, jacobian, values)

    def _moved(
        self,
        x: Array,
        base: Array,
        rows: Array,
        tau: Array,
        arms: Array,
        place: Array,
        jacobian: Array,
        qdd: Array | None,
    ) -> Array:
        """Return places (K, 2) a time `tau` (K,) later, and complete the derivatives by rates and parameters."""
        n = self.arms.shape[1]
        q, qd = x[:n], x[n : 2 * n]
        along, across = np.stack([np.sin(q), -np.cos(q)]), np.stack([np.cos(q), np.sin(q)])
        velocity, bend, late = np.zeros_like(place), np.zeros_like(place), bool(rows.any())
        if late:
            slope = jacobian[:, :, :n].copy()
            velocity = base[1] + slope @ qd
            if qdd is not None:
                bend = base[2] + slope @ qdd - arms @ (along * qd * qd).T
            jacobian[:, :, :n] -= (tau[:, None, None] * arms[:, None, :]) * along * qd
            jacobian[:, :, n : 2 * n] = tau[:, None, None] * slope
        now = velocity + tau[:, None] * bend
        for k, name in enumerate(self.parameters.names):
            column = jacobian[:, :, 2 * n + k]
            if name == "length":
                column[:] = self.arms @ along.T
                if late:
                    column += tau[:, None] * ((self.arms[:, None, :] * across) @ qd)
            elif name == "delay":
                column[:] = -(base[1] + tau[:, None] * base[2])
            elif name == "readout":
                column[:] = rows[:, None] * now
            elif k in self._arc_states:
                marker = self._arc_states[k]
                i = self.link[marker]
                column[marker] = along[:, i] + tau[marker] * across[:, i] * qd[i]
        return np.asarray(place + tau[:, None] * velocity + 0.5 * tau[:, None] ** 2 * bend) if late else place

    def _seen(self, places: Array, jacobian: Array, values: Array) -> tuple[Array, Array]:
        """Turn places in the rope's plane and their derivatives into what the camera shows."""
        names = self.parameters.names
        shown, moved = (places, jacobian) if ADJUSTMENTS.isdisjoint(names) else self._adjusted(places, jacobian, values)
        if self.camera is None:
            return shown, moved
        pixels, by_place = self.camera.place_slopes(shown)
        return pixels, by_place @ moved

    def _adjusted(self, places: Array, jacobian: Array, values: Array) -> tuple[Array, Array]:
        """Turn, stretch and shift places and their derivatives as the estimated parameters of the plane say."""
        at, names, first = self.parameters.value, self.parameters.names, jacobian.shape[2] - len(self.parameters)
        scale, roll = 1.0 + at("scale", values), at("roll", values)
        turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
        turned = places @ turn.T
        shown = scale * turned + np.array([at("offset_x", values), at("offset_y", values)])
        moved = scale * (turn @ jacobian)
        changes = {
            "scale": turned,
            "roll": scale * np.stack([-turned[:, 1], turned[:, 0]], axis=1),
            "offset_x": np.array([1.0, 0.0]),
            "offset_y": np.array([0.0, 1.0]),
        }
        for name, change in changes.items():
            if name in names:
                moved[:, :, first + names.index(name)] = change
        return shown, moved


def polyline_angles(rope: Rope, arc_lengths: Array, places: Array, base: Array) -> Array:
    """Return link angles (n,), rad, along the line from the first joint through markers, NaN where not seen."""
    seen = ~np.isnan(places[:, 0])
    arcs = np.concatenate([[0.0], arc_lengths[seen]])
    points = np.concatenate([base[None], places[seen]])
    order = np.argsort(arcs, kind="stable")
    arcs, points = arcs[order], points[order]
    apart = np.diff(arcs) > 1e-9
    ends, sides = arcs[1:][apart], np.diff(points, axis=0)[apart]
    if not len(sides):
        return np.full(rope.n_links, rope.hanging_angle)
    angles = np.unwrap(np.arctan2(sides[:, 0], -sides[:, 1]))
    middle = np.cumsum(rope.length) - 0.5 * rope.length
    return np.asarray(angles[np.minimum(np.searchsorted(ends, middle), len(angles) - 1)])
