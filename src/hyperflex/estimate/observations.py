"""Observations of markers, and the model that predicts them from a rope's state."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.errors import InvalidInput
from hyperflex.estimate.parameters import BASE_KINDS, PLANE_KINDS, ParameterStates
from hyperflex.model import Rope, unit_across, unit_along
from hyperflex.sensors import lever_arms
from hyperflex.vision import Camera, check_increasing

UNMEASURED = 1e4  # ratio of standard deviations from which a place is not measured in the direction of the larger one
FAR = 10.0  # lengths of the rope from its first joint: a marker seen farther away is rejected


@dataclass(frozen=True, eq=False)
class Observations:
    """Where markers were seen at one time, each in its place along the rope: the input of an estimator.

    A point whose place along the rope is not known has a covariance that is large in that direction; a direction whose
    standard deviation is UNMEASURED times the other one's does not count as measured.

    Parameters
    ----------
    t : float
        Middle of the exposure, s.
    places : (K, 2) array_like
        Of each marker along the rope; m, or px if there is a camera. NaN: not seen.
    std : float or (K,) array_like, optional
        Standard deviation of each coordinate, same unit.
    rows : (K,) array_like, optional
        When each was read, as a part of the picture's readout: -0.5 in the first row, 0.5 in the last. By default 0.
    covariances : (K, 2, 2) array_like, optional
        In place of `std`: of each place.

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
        places: ArrayLike,
        std: ArrayLike | None = None,
        rows: ArrayLike | None = None,
        *,
        covariances: ArrayLike | None = None,
    ) -> None:
        found = np.array(places, dtype=np.float64)
        if found.ndim != 2 or found.shape[1] != 2:
            raise InvalidInput("places of markers have the wrong shape", got=found.shape, allowed="(K, 2)")
        if np.isinf(found).any():
            raise InvalidInput("places of markers are infinite", got=found, allowed="numbers, or NaN: not seen")
        if (std is None) == (covariances is None):
            raise InvalidInput("an observation needs its uncertainty", allowed="either std or covariances")
        unseen, k = np.isnan(found).any(axis=1), len(found)
        found[unseen] = np.nan
        if covariances is None:
            each = np.broadcast_to(np.asarray(std, dtype=np.float64), (k,))
            if not (each[~unseen] > 0.0).all():
                raise InvalidInput("the std of an observation is not positive", got=std, allowed="> 0, in m or px")
            covariances = each[:, None, None] ** 2 * np.eye(2)
        wide = np.array(np.broadcast_to(np.asarray(covariances, dtype=np.float64), (k, 2, 2)))
        wide[unseen] = np.eye(2)
        if not np.isfinite(wide).all() or not (np.linalg.eigvalsh(wide) > 0.0).all():
            got = covariances if std is None else std
            raise InvalidInput("the uncertainty of an observation is not positive", got=got, allowed="> 0, finite")
        late = np.nan_to_num(np.broadcast_to(0.0 if rows is None else np.asarray(rows, float), (k,)))
        time = checks.number("time of an observation", t, unit="s")
        vars(self).update(t=time, places=found, covariances=wide, rows=late)

    @property
    def seen(self) -> Flags:
        """Which markers were seen (K,)."""
        return ~np.isnan(self.places[:, 0])


@dataclass(frozen=True, eq=False)
class InputFrame:
    """The observations of one frame as an estimator uses them.

    Attributes
    ----------
    seen : Observations
    used : (K,) bool
        Which of its markers are used.
    level : float
        Level of the measurement noise: factor of the standard deviations.
    noise : (r, N) float64
        Rows of the process noise since the frame before; of the first frame none.
    """

    seen: Observations
    used: Flags
    level: float
    noise: Array = field(default_factory=lambda: np.zeros(0))

    @cached_property
    def whitening(self) -> tuple[Array, Flags]:
        """As of :func:`whitening`, of the places used and with the level of the noise."""
        axes, measured = whitening(self.seen.covariances[self.used])
        return axes / self.level, measured

    @cached_property
    def log_determinant(self) -> float:
        """Logarithm of the whitening's determinant, which the likelihood of whitened differences lacks."""
        axes, measured = self.whitening
        return float(np.log(np.linalg.norm(axes[measured], axis=1)).sum())

    def residuals(self, places: Array, slope: Array) -> tuple[Array, Array]:
        """Return whitened differences (m,) from predicted places (K, 2), and whitened derivatives (m, N)."""
        axes, measured = self.whitening
        off = axes @ (self.seen.places[self.used] - places[self.used])[:, :, None]
        return off[measured, 0], (axes @ slope[self.used])[measured]


def whitening(covariances: Array) -> tuple[Array, Flags]:
    """Return matrices (k, 2, 2) whose rows are orthogonal and give differences of places a covariance of 1.

    Also returns which of the rows (k, 2) are of directions that are measured. `covariances` are (k, 2, 2).
    """
    values, vectors = np.linalg.eigh(covariances)
    return vectors.swapaxes(1, 2) / np.sqrt(values)[:, :, None], values < UNMEASURED**2 * values[:, :1]


class MarkerModel:
    """Predicts where a camera sees markers, with exact first derivatives.

    Parameters
    ----------
    rope : Rope
    arc_lengths : (K,) array_like
        How far along the rope each marker is, m from the first joint.
    parameters : ParameterStates
    camera : Camera, optional
        By default places are seen in metres.
    readout : float
        Known time from the first row of a picture to the last, s.
    named : bool
        Whether parameters ``"arc[k]"`` and ``"readout"`` are of these markers; else they have no effect.

    Notes
    -----
    A marker that is read tau before or after the state's time is seen at ``r + tau v + tau^2 a / 2``. The derivatives
    omit those of the last term. The state is that when the picture was taken, so that a delay of the pictures matters
    for the first joint alone: its place at that time follows from the known motion.
    """

    def __init__(
        self,
        rope: Rope,
        arc_lengths: ArrayLike,
        parameters: ParameterStates,
        camera: Camera | None = None,
        readout: float = 0.0,
        named: bool = True,
    ) -> None:
        arcs = checks.array("arc_lengths", arc_lengths, (-1,), unit="m")
        total = rope.total_length
        if not arcs.size or (arcs < 0.0).any() or (arcs > total * (1.0 + 1e-9)).any():
            raise InvalidInput("a marker is not on the rope", got=arcs, allowed=f"0 to {total:g} m, at least one")
        check_increasing(arcs)
        self.arc_lengths, self.parameters, self.camera, self.readout = arcs, parameters, camera, readout
        self._named = named
        self.link, self.arms = lever_arms(rope, arcs)
        arc_names = {f"arc[{marker}]": marker for marker in range(arcs.size)}
        arc_states = [k for k, name in enumerate(parameters.names) if name[:4] == "arc[" and named]
        self._arc_states = {k: arc_names.get(parameters.names[k]) for k in arc_states}
        if None in self._arc_states.values():
            allowed = f"arc[0..{arcs.size - 1}]"
            raise InvalidInput("an arc length is of no marker", got=parameters.names, allowed=allowed)

    @property
    def reads_rows(self) -> bool:
        """Whether rows may be read one after the other."""
        return bool(self.readout) or "readout" in self.parameters.names

    def possible(self, places: Array, base: Array) -> Flags:
        """Return which places (K, 2) may be markers' (K,): in metres, those that are not far away."""
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
            Angular accelerations, rad/s^2; without them, markers move uniformly within a readout.
        """
        n = self.arms.shape[1]
        q, values = x[:n], x[2 * n :]
        at = self.parameters.value
        arms = self.arms * (1.0 + at("length", values)) if len(self.parameters) else self.arms
        for k, marker in self._arc_states.items():
            arms[marker, self.link[marker]] += values[k]
        tau = rows * (self.readout + (at("readout", values) if self._named else 0.0))  # (K,)
        jacobian = np.zeros((len(arms), 2, x.size))
        slope = jacobian[:, :, :n]  # of the places by the angles
        np.multiply(arms, np.cos(q), out=slope[:, 0])
        np.multiply(arms, np.sin(q), out=slope[:, 1])
        places = np.stack([base[0, 0] + slope[:, 1].sum(axis=1), base[0, 1] - slope[:, 0].sum(axis=1)], axis=1)
        if len(self.parameters) or tau.any():
            places = places + self._moved(x, base, (rows, tau), arms, jacobian, qdd)
            places, jacobian = self._in_plane(places, jacobian, values)
        if self.camera is None:
            return places, jacobian
        pixels, by_place = self.camera.linearize(places)
        return pixels, by_place @ jacobian

    def _moved(
        self, x: Array, base: Array, timing: tuple[Array, Array], arms: Array, jacobian: Array, qdd: Array | None
    ) -> Array:
        """Return how far markers are (K, 2), when they are read, from where they would be; complete the derivatives.

        `timing` are rows and delays tau (K,), s.
        """
        n, (rows, tau) = self.arms.shape[1], timing
        q, qd = x[:n], x[n : 2 * n]
        along, across = unit_along(q, 0), unit_across(q, 0)
        slope = jacobian[:, :, :n].copy()
        velocity, bend = np.zeros((2, *slope.shape[:2]))
        if rows.any():
            velocity = base[1] + slope @ qd
            if qdd is not None:
                bend = base[2] + slope @ qdd - arms @ (along * qd * qd).T
            jacobian[:, :, :n] -= (tau[:, None, None] * arms[:, None, :]) * along * qd
            jacobian[:, :, n : 2 * n] = tau[:, None, None] * slope
        for k, name in enumerate(self.parameters.names):
            column, marker = jacobian[:, :, 2 * n + k], self._arc_states.get(k)
            if name == "length":
                column[:] = self.arms @ along.T + tau[:, None] * ((self.arms[:, None, :] * across) @ qd)
            elif name == "delay":
                column[:] = -(base[1] + tau[:, None] * base[2])
            elif name == "readout":
                column[:] = rows[:, None] * (velocity + tau[:, None] * bend)
            elif name in BASE_KINDS:
                column[:, list(BASE_KINDS).index(name)] = 1.0
            elif marker is not None:
                i = self.link[marker]
                column[marker] = along[:, i] + tau[marker] * across[:, i] * qd[i]
        moved = tau[:, None] * velocity + 0.5 * tau[:, None] ** 2 * bend
        return np.asarray(moved + self.parameters.base_offset(x[2 * n :]))

    def _in_plane(self, places: Array, jacobian: Array, values: Array) -> tuple[Array, Array]:
        """Return places in the calibrated plane, by what is estimated of it, and their derivatives."""
        at, names = self.parameters.value, self.parameters.names
        if PLANE_KINDS.keys().isdisjoint(names):
            return places, jacobian
        scale, roll = 1.0 + at("scale", values), at("roll", values)
        rotation = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
        rotated = places @ rotation.T
        derivatives = {
            "scale": rotated,
            "roll": scale * np.stack([-rotated[:, 1], rotated[:, 0]], axis=1),
            "offset_x": np.array([1.0, 0.0]),
            "offset_y": np.array([0.0, 1.0]),
        }
        result, first = scale * (rotation @ jacobian), jacobian.shape[2] - len(names)
        for name in PLANE_KINDS.keys() & set(names):
            result[:, :, first + names.index(name)] = derivatives[name]
        return scale * rotated + [at("offset_x", values), at("offset_y", values)], result


def polyline_angles(rope: Rope, arc_lengths: Array, places: Array, base: Array) -> Array:
    """Return link angles (n,), rad, along the line from the first joint through markers, NaN if not seen."""
    seen = ~np.isnan(places[:, 0])
    arcs, points = np.append(0.0, arc_lengths[seen]), np.concatenate([base[None], places[seen]])
    apart = np.diff(arcs) > 1e-9
    if not apart.any():
        return np.full(rope.n_links, rope.hanging_angle)
    ends, sides = arcs[1:][apart], np.diff(points, axis=0)[apart]
    angles = np.unwrap(np.arctan2(sides[:, 0], -sides[:, 1]))
    return angles[np.minimum(np.searchsorted(ends, rope.link_middles), len(angles) - 1)]
