"""The paper's online estimator (section III D, Fig. 7), and trackers without dynamics to compare it with."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex.checks import Array
from hyperflex.model import Rope
from hyperflex.sensors import Markers
from hyperflex.simulation import simulate
from hyperflex.vision import Camera, Gate, Image, MarkerDetector

WINDOW = 0.1  # m, around its prediction in which a marker is looked for: half of what the markers are apart
SAMPLES = 4  # of a prediction until the next frame


def capture(image: Image, detector: MarkerDetector, camera: Camera, predicted: Array) -> Array:
    """Return the markers found (K, 2), m, near their predicted places (K, 2), m: each the nearest blob; NaN: none.

    A blob within the windows of two markers counts for the nearer one.
    """
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
    return places


class Ahead(NamedTuple):
    """A prediction from the last frame to a time."""

    places: Array  # (K, 2) m, of the markers in the end
    tip: Array  # (SAMPLES + 1, 2) m, from the frame on
    velocity: Array  # (2,) m/s, of the tip at the frame
    rates: Array | float  # (n,) rad/s, of the links at the frame; NaN: not known


class BlobTracker:
    """Expects each marker, the last one on the tip, where it was, or, if `moving`, where it goes; knows no rope."""

    def __init__(self, t: float, places: Array, *, moving: bool) -> None:
        self.t, self.places, self.moving, self.velocity = t, places, moving, np.zeros_like(places)

    def predict(self, t: float) -> Ahead:
        """Predict to a time, s."""
        times, velocity = np.linspace(0.0, t - self.t, SAMPLES + 1), self.velocity[-1]
        tip = self.places[-1] + np.outer(times, velocity)
        return Ahead(self.places + (t - self.t) * self.velocity, tip, velocity, np.nan)

    def correct(self, t: float, seen: Array) -> None:
        """Take markers (K, 2), m, found at the time, s, of the prediction; NaN: not found, the prediction is taken."""
        places = np.where(np.isnan(seen), self.predict(t).places, seen)
        if self.moving:
            self.velocity = (places - self.places) / (t - self.t)
        self.t, self.places = t, places


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

    Notes
    -----
    How markers correct the state, the paper leaves open. Here all links between two markers turn by the same angle, so
    that the chord between them points to where the next one was seen (or predicted, where that failed), and their rates
    change by that angle over t_sim.
    """

    def __init__(self, rope: Rope, arc_lengths: ArrayLike, t: float, places: Array) -> None:
        self.rope, self._markers = rope, Markers(arc_lengths)
        self._part = np.searchsorted(self._markers.arc_lengths, rope.link_middles)  # which marker follows each link
        self.t, self.qd = t, np.zeros(rope.n_links)
        self.q = self._turned(np.full(rope.n_links, rope.hanging_angle), places)
        self._ahead = (self.q, self.qd)  # at the end of the last prediction

    def predict(self, t: float) -> Ahead:
        """Predict to a time, s."""
        times = np.linspace(0.0, t - self.t, SAMPLES + 1)
        run = simulate(self.rope, duration=times[-1], q0=self.q, qd0=self.qd, t_eval=times)
        self._ahead = (run.q[-1], run.qd[-1])
        return Ahead(self._places(run.q[-1]), run.tip, run.tip_velocity[0], self.qd)

    def correct(self, t: float, seen: Array) -> None:
        """Take markers (K, 2), m, found at the time, s, of the prediction; NaN: not found, the prediction is taken."""
        q, qd = self._ahead
        self.q = self._turned(q, np.where(np.isnan(seen), self._places(q), seen))
        self.qd = qd + (self.q - q) / (t - self.t)
        self.t = t

    def _places(self, q: Array) -> Array:
        """Return the places (K, 2), m, of the markers for link angles (n,), rad."""
        return self._markers.predict(self.rope, q[None], np.zeros((1, 2))).reshape(-1, 2)

    def _turned(self, q: Array, places: Array) -> Array:
        """Return angles whose chords between markers point to these places, one after the other."""
        q, before = q.copy(), np.zeros(2)
        for k, place in enumerate(places):
            have, want = self._places(q)[k] - before, place - before
            q[self._part == k] += np.arctan2(have[0] * want[1] - have[1] * want[0], have @ want)
            before = self._places(q)[k]
        return q
