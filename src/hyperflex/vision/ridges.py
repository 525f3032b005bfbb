"""Ridges of a picture, bright, dark or coloured, and the best paths along them from a point."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.vision.video import Image

ORIENTATIONS = 12  # of the filters, equally spaced over half a turn
STEP = 4.0  # px of the working picture, of a path
_WORKING = 1280  # px, the longest side of the working picture
_ALONG, _ACROSS = 4.0, 1.0  # px, standard deviations of a filter
_LEVELS = 5  # of the pyramid: ropes are 1 to 50 px wide in the working picture
_NEIGHBOURHOOD = 64  # px, in which texture is averaged
_TURNS = np.radians([-30.0, -20.0, -11.0, -5.0, 0.0, 5.0, 11.0, 20.0, 30.0])  # in a step
_STIFFNESS = 0.15 / np.radians(10.0) ** 2  # score that a turn of a step costs, over its square
_WALL = 0.5  # evidence of a step from which it counts for a rope, not for a wall
_BEAM = 500  # paths that are followed
_PATIENCE = 12.0  # score that a path may lose before it ends: some 20 steps over a wall
_MEMORY = 0.1  # weight of a step in the mean contrast of a path
_OTHER = 0.4  # weight of a response in other colours than the path's


@dataclass(frozen=True, eq=False)
class Path:
    """A path along ridges.

    Attributes
    ----------
    places : (P, 2) float64
        From its beginning on, px, some `STEP` apart.
    scores : (P,) float64
        Sum of the evidence until there: decimal logarithms of how seldom such a ridge is in the picture, less what a
        wall would give, less the cost of its turns.
    """

    places: Array
    scores: Array


class Ridges:
    """Responses of a picture to oriented ridge filters of all sizes.

    Parameters
    ----------
    image : (height, width, 3) uint8

    Notes
    -----
    A filter is the negative second derivative of a Gaussian across, a Gaussian along. Each response is a vector of three
    channels, whitened by the covariance of all responses of its size, and divided by how much the neighbourhood
    responds (texture). Pictures are made smaller to at most 1280 px first.
    """

    def __init__(self, image: Image) -> None:
        import cv2

        self.shrink = min(1.0, _WORKING / max(image.shape[:2]))
        size = tuple(round(side * self.shrink) for side in image.shape[1::-1])
        level = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        self.size, self._image = size, cv2.GaussianBlur(level, (3, 3), 0)
        self._levels = []
        for _ in range(_LEVELS):
            self._levels.append(_responses(level))
            if min(level.shape[:2]) < 2 * _NEIGHBOURHOOD:
                break
            level = cv2.pyrDown(level)

    def at(
        self, places: Array, directions: Array, sizes: Array | None = None
    ) -> tuple[Array, npt.NDArray[np.intp]]:
        """Return the strongest responses at places in directions, and their sizes.

        Parameters
        ----------
        places : (N, 2) float64
            px of the working picture.
        directions : (N,) float64
            rad.
        sizes : (N,) float64, optional
            Only filters at most twice as large or small count; size k is that of ridges 2^(k + 1) px wide.

        Returns
        -------
        (N, 3) float64
            Responses.
        (N,) int
            Sizes.
        """
        orientation = np.rint(directions / np.pi * ORIENTATIONS).astype(int) % ORIENTATIONS
        best, size, most = np.zeros((len(places), 3)), np.zeros(len(places), np.intp), np.zeros(len(places))
        for k, responses in enumerate(self._levels):
            u, v = np.rint(places.T / 2.0**k).astype(int)
            inside = (u >= 0) & (v >= 0) & (u < responses.shape[2]) & (v < responses.shape[1])
            if sizes is not None:
                inside &= np.abs(sizes - k) <= 1.0
            found = responses[orientation[inside], v[inside], u[inside]].astype(np.float64)
            strength = np.einsum("nc,nc->n", found, found)
            better = strength > most[inside]
            rows = np.flatnonzero(inside)[better]
            best[rows], most[rows], size[rows] = found[better], strength[better], k
        return best, size

    @cached_property
    def _strong(self) -> float:
        """What one in ten places and directions of the picture responds more strongly than."""
        rng, many = np.random.default_rng(0), 40_000
        found = self.at(rng.uniform(0.0, 1.0, (many, 2)) * self.size, rng.uniform(0.0, np.pi, many))[0]
        return float(np.quantile(np.linalg.norm(found, axis=1), 0.9))

    def evidence(self, power: Array) -> Array:
        """Return how many decimal orders a response, squared, is stronger than a wall's; -1 to 3."""
        return np.log10(np.clip(power / self._strong**2, 0.1, 1000.0))

    def _colours(self, places: Array) -> Array:
        """Return the colours (..., 3) of the working picture at places (..., 2), px."""
        u, v = (np.clip(np.rint(places[..., k]).astype(int), 0, self.size[k] - 1) for k in range(2))
        return self._image[v, u].astype(np.float64)

    def paths(self, start: npt.ArrayLike, radius: float, colour: Array | None = None, within: float = 0.0) -> list[Path]:
        """Return paths from a disc, the best first; many differ little.

        Parameters
        ----------
        start : (2,) array_like
            px.
        radius : float
            Of the disc in which they may begin, px.
        colour : (3,) float64, optional
            Of the rope, if it is known. Where a picture has this colour, `within` some levels, it hides no rope and
            shows none: a rope before a thing like it.

        Notes
        -----
        A minimal path in places and directions (Pechaud, Keriven, Peyre 2009), found step by step: of the paths that
        arrive in the same cell of both, the best is kept, and of all the best 500. A path does not run along itself.
        """
        grid = np.arange(-radius, radius + 1.0, 3.0 / self.shrink)
        disc = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        disc = disc[np.hypot(*disc.T) <= radius]
        turns = np.linspace(-np.pi, np.pi, 2 * ORIENTATIONS, endpoint=False)
        place = np.repeat((np.asarray(start, float) + disc) * self.shrink, turns.size, axis=0)
        direction, score = np.tile(turns, len(disc)), np.repeat(-0.5 * np.hypot(*disc.T) / max(radius, 1.0), turns.size)
        history = place[:, None]
        scores = score[:, None]
        mean = np.zeros((len(place), 4))
        ended: list[Path] = []
        for step in range(int(4 * max(self.size) / STEP)):
            heading = direction[:, None] + _TURNS
            ahead = place[:, None] + STEP * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            middle = direction[:, None] + 0.5 * _TURNS
            where, sizes = 0.5 * (place[:, None] + ahead), None if step < 5 else np.repeat(mean[:, 3], _TURNS.size)
            found, size = self.at(where.reshape(-1, 2), middle.ravel(), sizes)
            seen = np.column_stack([found, size]).reshape(*heading.shape, 4)
            usual = mean[:, :3] / np.maximum(np.linalg.norm(mean[:, :3], axis=1, keepdims=True), 1e-9)
            like = np.maximum(np.einsum("nkc,nc->nk", seen[:, :, :3], usual), 0.0)
            power = np.square(seen[:, :, :3]).sum(axis=2)
            known = mean[:, :3].any(axis=1, keepdims=True)
            same = like**2 + _OTHER**2 * np.maximum(power - like**2, 0.0)
            gained = self.evidence(np.where(known, same, power)) - _WALL
            if colour is not None:
                alike = np.linalg.norm(self._colours(where) - colour, axis=2) < within
                gained[alike] = np.maximum(gained[alike], 0.0)
            gained -= _STIFFNESS * _TURNS**2
            total = score[:, None] + gained
            outside = ((ahead < 0.0) | (ahead > np.array(self.size) - 1.0)).any(axis=2)
            total[outside] = -np.inf
            row, turn = _best_of_cells(ahead, heading, total)
            own = history[row]
            kept = _apart(own, ahead[row, turn], heading[row, turn])
            peak = np.maximum.accumulate(scores, axis=1)[:, -1]
            kept &= total[row, turn] > peak[row] - _PATIENCE
            left = np.ones(len(place), bool)
            left[row[kept]] = False
            ended += [Path(history[k] / self.shrink, scores[k]) for k in np.flatnonzero(left)]
            row, turn = row[kept], turn[kept]
            if not row.size:
                break
            place, direction, score = ahead[row, turn], heading[row, turn], total[row, turn]
            history = np.concatenate([history[row], place[:, None]], axis=1)
            scores = np.concatenate([scores[row], score[:, None]], axis=1)
            rate = max(_MEMORY, 1.0 / (step + 1)) * (gained[row, turn, None] > 0.0 if step else 1.0)
            mean = mean[row] + rate * (seen[row, turn] - mean[row])
        ended += [Path(line / self.shrink, each) for line, each in zip(history, scores, strict=True)]
        cut = [Path(p.places[: k + 1], p.scores[: k + 1]) for p in ended for k in [int(np.argmax(p.scores))]]
        return sorted(cut, key=lambda path: -path.scores[-1])


def _responses(level: npt.NDArray[np.float32]) -> npt.NDArray[np.float16]:
    """Return the responses (ORIENTATIONS, h, w, 3) of a picture (h, w, 3), whitened, relative to the neighbourhood's."""
    import cv2

    half = int(np.ceil(3.0 * _ALONG))
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    found = np.empty((ORIENTATIONS, *level.shape), np.float32)
    for k, angle in enumerate(np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS):
        along, across = (
            (np.cos(angle) * u + np.sin(angle) * v) / _ALONG,
            (np.cos(angle) * v - np.sin(angle) * u) / _ACROSS,
        )
        kernel = (1.0 - across**2) * np.exp(-0.5 * (along**2 + across**2))
        kernel -= kernel.mean()
        found[k] = cv2.filter2D(level, cv2.CV_32F, kernel / np.abs(kernel).sum(), borderType=cv2.BORDER_REFLECT)
    some = found[:, ::4, ::4].reshape(-1, 3).astype(np.float64)
    size = np.linalg.norm(some, axis=1)
    some = some[size <= np.quantile(size, 0.9)]
    values, vectors = np.linalg.eigh(some.T @ some / len(some) + 0.01 * np.eye(3))
    found = found @ (vectors / np.sqrt(values)).astype(np.float32)
    texture = np.sqrt(np.einsum("khwc,khwc->khw", found, found)).mean(axis=0)
    texture = cv2.blur(texture, (_NEIGHBOURHOOD + 1, _NEIGHBOURHOOD + 1))
    return np.asarray(found / np.maximum(texture / np.median(texture), 0.5)[:, :, None], np.float16)


def _best_of_cells(ahead: Array, heading: Array, total: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return rows and columns of the best candidates, one in each cell of places and directions."""
    order = np.argsort(-total, axis=None, kind="stable")
    order = order[np.isfinite(total.ravel()[order])]
    row, turn = np.divmod(order, total.shape[1])
    cells = np.rint(ahead[row, turn] / 2.0).astype(np.int64)
    angle = np.rint(heading[row, turn] / np.pi * ORIENTATIONS).astype(np.int64) % (2 * ORIENTATIONS)
    key = (cells[:, 0] * 65536 + cells[:, 1]) * 64 + angle
    first = np.sort(np.unique(key, return_index=True)[1])[:_BEAM]
    return row[first], turn[first]


def _apart(history: Array, place: Array, heading: Array) -> npt.NDArray[np.bool_]:
    """Return which paths (N, P, 2) do not run along themselves at their new places (N, 2), in their directions (N,)."""
    early = history[:, :-6]
    if early.shape[1] < 2:
        return np.ones(len(place), bool)
    near = np.linalg.norm(early[:, 1:] - place[:, None], axis=2) < STEP
    along = np.diff(early, axis=1) @ np.array([1.0, 1.0j])
    parallel = np.abs(np.cos(np.angle(along) - heading[:, None])) > np.cos(np.radians(40.0))
    return np.asarray(~(near & parallel).any(axis=1))
