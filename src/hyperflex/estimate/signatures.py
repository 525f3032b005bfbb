"""What changes do to a filter's state, and what they would leave in its innovations."""

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.estimate import square_root as sr


class Signatures:
    """What changes do to the state, and the sums of what they would leave in the innovations.

    Parameters
    ----------
    size : int
        Of the state, N.
    places, axes : int
        At how many places a change is possible, and along how many axes: P and a. What w changes of different moments
        have in common is summed for each place alone.

    Attributes
    ----------
    states : (N, w P a) float64
        Errors of the state, per unit of each change: moment by moment, in these place by place.
    information : (P, w a, w a), score : (P, w a) float64
    """

    def __init__(self, size: int, places: int = 1, axes: int = 1) -> None:
        self._places, self._axes = places, axes
        self.states, self.information, self.score = np.zeros((size, 0)), np.zeros((places, 0, 0)), np.zeros((places, 0))

    def predict(self, transition: Array) -> None:
        """Carry the errors on."""
        self.states = transition @ self.states

    def add(self, columns: Array) -> None:
        """Add changes (N, P a) that begin."""
        before, now = self.score.shape[1], self.score.shape[1] + self._axes
        information, score = np.zeros((self._places, now, now)), np.zeros((self._places, now))
        information[:, :before, :before], score[:, :before] = self.information, self.score
        self.states, self.information, self.score = np.concatenate([self.states, columns], axis=1), information, score

    def keep(self, good: npt.NDArray[np.bool_]) -> None:
        """Keep the changes of some moments (w,)."""
        if not good.all():
            own = np.flatnonzero(np.repeat(good, self._axes))
            self.states = self.states[:, np.repeat(good, self._places * self._axes)]
            self.information, self.score = self.information[:, own[:, None], own], self.score[:, own]

    def update(self, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> None:
        """Take in an innovation, and correct the errors as the filter does its own."""
        seen = jacobian @ self.states
        count, shape = self.score.shape[1], (self.score.shape[1] // self._axes, self._places, self._axes, len(seen))
        by_moment = sr.solved(upper, seen, transposed=True).T.reshape(shape)
        left = by_moment.swapaxes(0, 1).reshape(self._places, count, len(seen))
        self.score = self.score + left @ whitened
        self.information = self.information + left @ left.transpose(0, 2, 1)
        self.states = self.states - gain @ seen
