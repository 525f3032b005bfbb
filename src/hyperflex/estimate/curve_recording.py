"""The curve of a rope without markers as a recording: each frame's shape alone, as places at some arc lengths."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.observations import InputFrame, Observations
from hyperflex.model import unit_across, unit_along
from hyperflex.sensors import lever_arms


def curve_places(
    estimator: RopeFilter, seen: Sequence[Observations], states: Array, *, count: int = 12, bend: float = 0.5
) -> tuple[Array, Array, Array]:
    """Return where each frame alone shows the rope: arc lengths (M,), places and their errors (T, M, 2), m.

    Places are NaN where the rope is not seen; arc lengths are those of the filter's rope.

    Parameters
    ----------
    estimator : RopeFilter
        Its camera, rope and parameters.
    seen : sequence of T Observations
        Points of the curve, px, each measured across the rope.
    states : (T, N) float64
        Estimates, with the final parameters.
    count : int
        M. More than 12 places hold no more of the waves that a curve of one frame shows.
    bend : float
        Standard deviation of a joint's turn from the estimated one, over sqrt(n links), rad: weak beside a curve.

    Notes
    -----
    A rope does not stretch, so that its curve from the first joint tells the places at all arc lengths. The angles of
    the links that fit the points of a frame best are found by least squares. Unlike smoothed states, these places have
    errors that are independent from frame to frame and hold nothing of the assumed friction, so that `identify` takes
    them as it takes markers. What the curve does not show (bends between two points) is the estimate's.
    """
    model, n = estimator.model, estimator.n_links
    rope, parameters = estimator.process.rope, estimator.parameters
    arcs = rope.total_length * (np.arange(count) + 0.5) / count
    turn = (np.eye(n, k=1) - np.eye(n))[:-1] * np.sqrt(n) / bend
    _, arms = lever_arms(rope, arcs)
    nearest = np.abs(np.subtract.outer(arcs, model.arc_lengths)).argmin(axis=1)
    places, std = np.full((2, len(seen), count, 2), np.nan)
    for k, (frame, state) in enumerate(zip(seen, states, strict=True)):
        x, given = state.copy(), InputFrame(frame, frame.seen, 1.0)
        base, length = estimator.process.base(frame.t, x), 1.0 + parameters.value("length", x[2 * n :])
        for _ in range(3):  # Gauss-Newton steps: the third moves by a millionth of a pixel
            off, slope = given.residuals(*model.predict(x, base, frame.rows))
            rows = np.concatenate([slope[:, :n], turn])
            right = np.concatenate([off, turn @ (state[:n] - x[:n])])
            x[:n] += np.linalg.lstsq(rows, right, rcond=None)[0]
        wide = np.linalg.pinv(rows.T @ rows)
        moves = length * arms[:, None, :] * unit_across(x[:n], 0)
        place = base[0] + parameters.base_offset(x[2 * n :]) + length * arms @ unit_along(x[:n], 0).T
        shown = frame.seen[nearest]
        places[k, shown] = place[shown]
        std[k] = np.sqrt(np.einsum("mcn,nl,mcl->mc", moves, wide, moves))
    return arcs, places, std
