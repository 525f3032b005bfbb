"""The paper's online estimator (section III D, Fig. 7), and trackers without dynamics to compare it with."""

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory
from hyperflex.vision import Camera, Gate, Image, MarkerDetector

WINDOW = 0.1  # m, around its prediction in which a marker is looked for: half of what the markers are apart
SAMPLES = 4  # of a prediction until the next frame
TOL = 1e-5  # m, of the simulation: far below what a camera sees


@dataclass(frozen=True, eq=False)
class Capture:
    """Which markers were found in a frame.

    Attributes
    ----------
    places : (K, 2) float64
        In the swing plane, m; NaN: not found.
    seconds : float
        It took, the paper's T_v.
    """

    places: Array
    seconds: float

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """Which were found (K,)."""
        return ~np.isnan(self.places[:, 0])


def capture(image: Image, detector: MarkerDetector, camera: Camera, predicted: Array) -> Capture:
    """Look for markers in windows around where they are predicted (K, 2), m: the nearest blob, and none for two."""
    start = time.perf_counter()
    pixels, slopes = camera.linearize(predicted)
    reach = WINDOW * np.linalg.norm(slopes, ord=2, axis=(1, 2))
    gates = [Gate(centre, (each / 3.0) ** 2 * np.eye(2)) for centre, each in zip(pixels, reach, strict=True)]
    seen = camera.locate(detector.find(image, gates).places)
    places = np.full(predicted.shape, np.nan)
    apart = np.linalg.norm(seen[None] - predicted[:, None], axis=2)
    while apart.size and apart.min() < WINDOW:
        k, j = np.unravel_index(apart.argmin(), apart.shape)
        places[k] = seen[j]
        apart[k], apart[:, j] = np.inf, np.inf
    return Capture(places, time.perf_counter() - start)


class NearestBlob:
    """Takes the blob that is nearest to where a marker was last; knows no motion at all."""

    def __init__(self, t: float, places: Array) -> None:
        self.t, self.places, self.velocity = t, places, np.zeros_like(places)

    def predict(self, t: float) -> Array:
        """Return where the markers are expected (K, 2), m, at a time, s."""
        return self.places

    def correct(self, t: float, seen: Array) -> None:
        """Take what was found (K, 2), m, at a time, s; NaN: not found, and the prediction is taken."""
        self.places = np.where(np.isnan(seen), self.predict(t), seen)
        self.t = t


class ConstantVelocity(NearestBlob):
    """Lets each marker go on as it went from the last frame but one to the last."""

    def predict(self, t: float) -> Array:
        """Return where the markers are expected (K, 2), m, at a time, s."""
        return self.places + (t - self.t) * self.velocity

    def correct(self, t: float, seen: Array) -> None:
        """Take what was found (K, 2), m, at a time, s; NaN: not found, and the prediction is taken."""
        before, dt = self.places, t - self.t
        super().correct(t, seen)
        self.velocity = (self.places - before) / dt


class OnlineEstimator:
    """The estimator of the paper's Fig. 7: simulate ahead, look there, take the prediction where that fails, correct.

    Parameters
    ----------
    rope : Rope
        Which hangs from the origin.
    arc_lengths : (K,) array_like
        Of the markers, m.
    t : float
        Time of the first frame, s.
    places : (K, 2) float64
        Of all markers in it, m. Rates are not known yet and count as zero.

    Attributes
    ----------
    t : float
        Of the last frame, s.
    q, qd : (n,) float64
        Link angles, rad, and rates, rad/s, then.
    ahead : Trajectory or None
        The last prediction: continuous angles, rates and accelerations, its times counted from the frame before.
    seconds : float
        It took to compute; over the time simulated, the paper's alpha.

    Notes
    -----
    How markers correct the state, the paper leaves open. Here all links between two markers turn by the same angle, so
    that the chord between them points to where the next one was seen (or predicted, where that failed), and their rates
    change by that angle over t_sim.
    """

    def __init__(self, rope: Rope, arc_lengths: npt.ArrayLike, t: float, places: Array) -> None:
        self.rope, self.arc_lengths = rope, np.asarray(arc_lengths, dtype=np.float64)
        ends = np.cumsum(rope.length)
        self._link = np.minimum(np.searchsorted(ends, self.arc_lengths - 1e-9), rope.n_links - 1)
        self._rest = self.arc_lengths - (ends - rope.length)[self._link]
        self._part = np.searchsorted(self.arc_lengths, ends - 0.5 * rope.length)  # which marker follows each link
        self.t, self.qd = t, np.zeros(rope.n_links)
        self.q = self._turned(np.full(rope.n_links, rope.hanging_angle), places)
        self.ahead: Trajectory | None = None
        self.seconds = 0.0

    def predict(self, t: float) -> Array:
        """Simulate ahead to a time, s, and return where the markers are expected then (K, 2), m."""
        start = time.perf_counter()
        times = np.linspace(0.0, t - self.t, SAMPLES + 1)
        self.ahead = simulate(self.rope, duration=times[-1], q0=self.q, qd0=self.qd, t_eval=times, tol=TOL)
        self.seconds = time.perf_counter() - start
        return self.places(np.asarray(self.ahead.q[-1]))

    def correct(self, t: float, seen: Array) -> None:
        """Take what was found (K, 2), m, at the time, s, of the prediction; NaN: not found, the prediction is taken.

        Raises
        ------
        InvalidInput
            If nothing was predicted.
        """
        if self.ahead is None:
            raise InvalidInput("nothing was predicted yet", fix="Call predict first")
        q, qd = np.asarray(self.ahead.q[-1]), np.asarray(self.ahead.qd[-1])
        self.q = self._turned(q, np.where(np.isnan(seen), self.places(q), seen))
        self.qd = qd + (self.q - q) / (t - self.t)
        self.t = t

    def places(self, q: Array) -> Array:
        """Return the places (K, 2), m, of the markers for link angles (n,), rad."""
        joints = self.rope.joints(q, np.zeros(2))
        along = np.stack([np.sin(q), -np.cos(q)], axis=1)
        return np.asarray(joints[self._link] + self._rest[:, None] * along[self._link])

    def _turned(self, q: Array, places: Array) -> Array:
        """Return angles whose chords between markers point to these places, one after the other."""
        q, before = q.copy(), np.zeros(2)
        for k, place in enumerate(places):
            have, want = self.places(q)[k] - before, place - before
            turn = np.arctan2(have[0] * want[1] - have[1] * want[0], have @ want)
            q[self._part == k] += turn
            before = self.places(q)[k]
        return q
