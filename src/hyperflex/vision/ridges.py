"""Ridges of a picture, bright, dark or coloured, and the best paths along them from a point."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex.checks import Array, Flags, Integers
from hyperflex.vision.video import Image

ORIENTATIONS = 12  # of the filters, equally spaced over half a turn
STEP = 4.0  # px of the working picture, of a path
_NEIGHBOURHOOD = 64  # px, in which texture is averaged; so the pyramid has five levels: ropes are 1 to 50 px wide
_TURNS = np.radians([-30.0, -20.0, -11.0, -5.0, 0.0, 5.0, 11.0, 20.0, 30.0])  # in a step
_STIFFNESS, _JERK = (
    0.1 / np.radians(10.0) ** 2,
    0.3 / np.radians(10.0) ** 2,
)  # score for a turn, and its change, squared
_WALL = 0.5  # evidence of a step from which it counts for a rope, not for a wall
CLICKED = 6.0  # px that a click may be off
SHADOW = 0.65  # most of a rope's contrast that its shadow has
BLUR = 14  # px to both sides of a rope, which blur may reach


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

    @property
    def seen(self) -> Array:
        """The places, without those between which nothing is seen: the path is taken to go straight there."""
        gains = np.diff(self.scores) > 0.0
        return np.asarray(self.places[np.append(True, gains) | np.append(gains, True)])


class Mixture:
    """What mixtures of a rope and its wall look like.

    Parameters
    ----------
    image : (height, width, 3) uint8
    bgr : (3,) float64
        Colour of the rope.
    width : float
        Of the rope, px.

    Notes
    -----
    The wall is the median of a square three times as wide as the rope and twice as wide as it is when it is blurred.
    """

    def __init__(self, image: Image, bgr: Array, width: float) -> None:
        import cv2

        side = 2 * round(1.5 * width) + 4 * BLUR + 1
        wall = cv2.medianBlur(image, side).astype(np.float32)
        off, contrast = cv2.GaussianBlur(image, (3, 3), 0) - wall, bgr.astype(np.float32) - wall
        self._size = np.maximum(np.linalg.norm(contrast, axis=2), 1.0)
        share = np.clip(np.einsum("hwc,hwc->hw", off, contrast) / self._size**2, 0.0, 1.2)
        self._residual = np.linalg.norm(off - share[:, :, None] * contrast, axis=2)
        self._share = cv2.dilate(share, np.ones((3, 3), np.uint8))
        self._covers = [share]
        while min(share.shape) >= 2 * _NEIGHBOURHOOD:
            share = cv2.pyrDown(share)
            self._covers.append(share)
        self._covers = [cv2.GaussianBlur(each, (0, 0), np.sqrt(2.0 / 3.0)) for each in self._covers]  # level k: 2^k px
        self._contrast = float(np.median(self._size))
        self._usual = 0.2 * self._contrast
        self.width, self._known = width, np.zeros(image.shape[:2], np.uint8)

    def _at(self, places: Array) -> tuple[Integers, Integers]:
        u, v = (np.clip(np.rint(places[:, k]).astype(int), 0, self._share.shape[1 - k] - 1) for k in range(2))
        return v, u

    def learn(self, curve: Array) -> None:
        """Learn from the middle of a rope (P, 2), px, how much its own texture deviates."""
        where = self._at(curve)
        self._contrast = float(np.median(self._size[where]))
        self._usual = max(0.1 * self._contrast, float(np.median(self._residual[where])))

    def leave_out(self, curve: Array, apart: float) -> None:
        """Leave out a rope along a curve (P, 2), px, and `apart` px beside it: it tells nothing of another one."""
        import cv2

        cv2.polylines(self._known, [np.rint(curve).astype(np.int32)], False, 1, 2 * round(apart) + 1)

    def share(self, places: Array) -> Array:
        """Return how much of the rope is seen at places (N, 2), px, (N,), 0 to 1.2."""
        return np.asarray(self._share[self._at(places)])

    def _cover(self, places: Array, widths: Array) -> Array:
        """Return how much of a rope is seen across ridges (N,), as a part of what there is if blur makes it so wide."""
        from scipy.special import erf

        level = np.clip(np.rint(np.log2(widths)).astype(int) - 1, 0, len(self._covers) - 1)
        wide, result = np.maximum(widths, self.width), np.zeros(len(places))
        for k, cover in enumerate(self._covers):
            own = level == k
            u, v = (np.clip(np.rint(places[own, i] / 2.0**k).astype(int), 0, cover.shape[1 - i] - 1) for i in range(2))
            result[own] = cover[v, u]
        return np.asarray(result * wide / (self.width * erf(wide / (np.sqrt(8.0) * 2.0**level))))

    def weigh(self, places: Array, widths: Array, edges: Flags, evidence: Array) -> Array:
        """Return the evidence (N,) that a ridge at places (N, 2), px, some px wide, is this rope, from that it is one.

        Another colour than a mixture's tells against it; so does nothing of its colour, unless the wall is like it;
        and so does less or more of it than of a rope that blur makes so wide: a shadow, a wide thing.
        """
        where = self._at(places)
        evidence = evidence - 2.0 * np.abs(np.log10(np.clip(self._cover(places, widths), 0.1, 10.0)))
        doubt = np.clip(0.25 * ((self._residual[where] / self._usual) ** 2 - 2.0), 0.0, 3.0)
        evidence = np.where(self._share[where] < 0.1, np.minimum(evidence, -_WALL), evidence) - doubt
        alike = (self._size[where] < 0.4 * self._contrast) | (edges & (self._share[where] > SHADOW))
        return np.where(self._known[where] > 0, 0.0, np.where(alike, np.maximum(evidence, -0.2 * _WALL), evidence))


class Ridges:
    """Responses of a picture to oriented ridge filters of all sizes.

    Parameters
    ----------
    image : (height, width, 3) uint8

    Notes
    -----
    A filter is the negative second derivative of a Gaussian, summed over four places along the ridge. A response is a
    vector of three channels, whitened by the covariance of all responses of its size, and divided by how much the
    neighbourhood responds (texture). Pictures are made smaller first.
    """

    WORKING = 1280  # px, longest side of the working picture
    BEAM = 250  # paths that are followed
    PATIENCE = 12.0  # score that a path may lose before it ends: some 20 steps over a wall
    GROWTH = 0.5  # score that another size than the path's costs, in powers of two, squared
    OTHER = 0.4  # weight of a response in other colours than the path's

    def __init__(self, image: Image) -> None:
        import cv2

        self.shrink = min(1.0, self.WORKING / max(image.shape[:2]))
        size = tuple(round(side * self.shrink) for side in image.shape[1::-1])
        level = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        self.size = size
        self._levels = [_responses(level)]
        while min(level.shape[:2]) >= 2 * _NEIGHBOURHOOD:
            level = cv2.pyrDown(level)
            self._levels.append(_responses(level))

    def at(self, places: Array, directions: Array, sizes: Array | None = None) -> tuple[Array, Integers]:
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
        for k, (responses, texture, _) in enumerate(self._levels):
            u, v = np.rint(places.T / 2.0**k).astype(int)
            inside = (u >= 0) & (v >= 0) & (u < responses.shape[2]) & (v < responses.shape[1])
            if sizes is not None:
                inside &= np.abs(sizes - k) <= 1.0
            u, v = u[inside], v[inside]
            found = responses[orientation[inside], v, u].astype(np.float64) / texture[v, u, None]
            strength = np.einsum("nc,nc->n", found, found)
            better = strength > most[inside]
            rows = np.flatnonzero(inside)[better]
            best[rows], most[rows], size[rows] = found[better], strength[better], k
        return best, size

    def edges(self, places: Array, directions: Array, sizes: Integers) -> Flags:
        """Return where ridges (N,), as of :meth:`at`, are only edges: a rope stands out from what is on both sides."""
        normals, result = np.stack([-np.sin(directions), np.cos(directions)], axis=1), np.zeros(len(places), bool)
        for k, (_, _, colours) in enumerate(self._levels):
            own, last = sizes == k, np.array(colours.shape[1::-1]) - 1
            lines = places[own] / 2.0**k + 3.0 * np.array([-1.0, 0.0, 1.0])[:, None, None] * normals[own]
            u, v = np.clip(np.rint(lines), 0, last).astype(int).transpose(2, 0, 1)
            left, middle, right = colours[v, u].astype(np.float64)
            off = np.einsum("snc,nc->sn", middle - [left, right], 2.0 * middle - left - right)
            clear = off.max(axis=0) > 3.0**2  # else it may be the wall's texture
            result[own] = clear & (off.min(axis=0) < (1.0 - SHADOW) * off.max(axis=0))
        return result

    @cached_property
    def _strong(self) -> float:
        """What one in ten places and directions of the picture responds more strongly than."""
        rng, many = np.random.default_rng(0), 40_000
        found = self.at(rng.uniform(0.0, 1.0, (many, 2)) * self.size, rng.uniform(0.0, np.pi, many))[0]
        return float(np.quantile(np.linalg.norm(found, axis=1), 0.9))

    def evidence(self, power: Array) -> Array:
        """Return how many decimal orders a response, squared, is stronger than a wall's; -1 to 2.25.

        Of more than 1.5, only 0.3 times the rest counts: a stronger ridge is hardly likelier a rope.
        """
        orders = np.log10(np.clip(power / self._strong**2, 0.1, 1e4))
        return orders - 0.7 * np.maximum(orders - 1.5, 0.0)

    def paths(self, start: ArrayLike, rope: Mixture | None = None, longest: float = np.inf) -> list[Path]:
        """Return paths from a disc about a click, the best first; many differ little.

        Parameters
        ----------
        start : (2,) array_like
            The click, px.
        rope : Mixture, optional
            What is followed; by default a path is to keep its own contrast.
        longest : float
            That a path may be, px.

        Notes
        -----
        A minimal path in places and directions (Pechaud, Keriven, Peyre 2009), found step by step: of the paths that
        arrive in the same cell of both, the best is kept, and of all the best. A path does not run along itself.
        """
        grid = np.arange(-CLICKED, CLICKED + 1.0, 3.0 / self.shrink)
        disc = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        disc = disc[np.hypot(*disc.T) <= CLICKED]
        turns = np.linspace(-np.pi, np.pi, 2 * ORIENTATIONS, endpoint=False)
        place = np.repeat((np.asarray(start, float) + disc) * self.shrink, turns.size, axis=0)
        direction, score = np.tile(turns, len(disc)), np.repeat(-0.5 * np.hypot(*disc.T) / CLICKED, turns.size)
        history, scores, peak = (place @ [1.0, 1.0j]).astype(np.complex64)[:, None], score[:, None], score
        mean, bend = np.zeros((len(place), 4)), np.zeros(len(place))
        ended: list[Path] = []
        for step in range(int(min(2 * max(self.size), longest * self.shrink) / STEP)):
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
            same = like**2 + self.OTHER**2 * np.maximum(power - like**2, 0.0)
            gained = self.evidence(np.where(known, same, power)) - _WALL
            gained -= self.GROWTH * (seen[:, :, 3] - mean[:, None, 3]) ** 2 * (step >= 5)
            edges = self.edges(where.reshape(-1, 2), middle.ravel(), size)
            gained = np.where(edges.reshape(gained.shape), np.minimum(gained, -0.2 * _WALL), gained)
            if rope is not None:
                places, widths = (where / self.shrink).reshape(-1, 2), 2.0 ** (size + 1) / self.shrink
                gained = rope.weigh(places, widths, edges, gained.ravel()).reshape(gained.shape)
            gained -= _STIFFNESS * _TURNS**2 + _JERK * (_TURNS - bend[:, None]) ** 2
            total = score[:, None] + gained
            outside = ((ahead < 0.0) | (ahead > np.array(self.size) - 1.0)).any(axis=2)
            total[outside | (total < peak[:, None] - self.PATIENCE)] = -np.inf
            done = np.isneginf(total).all(axis=1)
            ended += self._cut(history[done], scores[done])
            row, turn = _best_of_cells(ahead, heading, seen[:, :, 3], total, self.BEAM)
            beside = STEP + BLUR + 2.0 ** (mean[row, 3] + 1.0)  # else it may return along the rope's shadow
            kept = _apart(history[row], ahead[row, turn], heading[row, turn], beside)
            row, turn = row[kept], turn[kept]
            if not row.size:
                break
            place, direction, score, bend = ahead[row, turn], heading[row, turn], total[row, turn], _TURNS[turn]
            peak = np.maximum(peak[row], score)
            history = np.column_stack([history[row], (place @ [1.0, 1.0j]).astype(np.complex64)])
            scores = np.column_stack([scores[row], score])
            rate = 1.0 / min(step + 1, 10) * (gained[row, turn, None] > 0.0 if step else 1.0)
            mean = mean[row] + rate * (seen[row, turn] - mean[row])
        else:
            ended += self._cut(history, scores)
        return sorted(ended, key=lambda path: -path.scores[-1])

    def _cut(self, history: npt.NDArray[np.complex64], scores: Array) -> list[Path]:
        """Return paths (N, P) of the working picture, each up to its best score (N, P)."""
        ends = np.argmax(scores, axis=1) + 1
        lines = np.stack([history.real, history.imag], axis=-1).astype(np.float64) / self.shrink
        return [Path(line[:end], each[:end]) for line, each, end in zip(lines, scores, ends.tolist(), strict=True)]


def _responses(
    level: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float16], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the whitened responses (ORIENTATIONS, h, w, 3) of a picture (h, w, 3), how textured it is (h, w), and it.

    The picture is smoothed and whitened as the responses are; usual places 3 px apart differ by 1.
    """
    import cv2

    reaches, margin = (2, 4), 8  # px: a filter's places along the ridge are 2 and 6 px to both sides
    padded = cv2.copyMakeBorder(level, *(margin,) * 4, cv2.BORDER_REFLECT)
    x = np.arange(-4.0, 5.0)
    smooth = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    xx, xy, yy = (
        cv2.sepFilter2D(padded, cv2.CV_32F, smooth * across, smooth * down)
        for across, down in ((1.0 - x**2, x**0), (-x, x), (x**0, 1.0 - x**2))
    )
    some = np.concatenate([each[::4, ::4].reshape(-1, 3) for each in (xx, yy)]).astype(np.float64)
    size = np.linalg.norm(some, axis=1)
    some = some[size <= np.quantile(size, 0.9)]
    values, vectors = np.linalg.eigh(some.T @ some / len(some) + 0.01 * np.eye(3))
    whiten = (vectors / np.sqrt(values)).T.astype(np.float32)
    xx, xy, yy = (cv2.transform(each, whiten) for each in (xx, xy, yy))
    found, texture = np.empty((ORIENTATIONS, *level.shape), np.float16), np.zeros(level.shape[:2], np.float32)
    for k, angle in enumerate(np.arange(ORIENTATIONS) * np.pi / ORIENTATIONS):
        c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        one = s * s * xx - 2.0 * s * c * xy + c * c * yy
        for reach in reaches:
            du, dv = round(reach * float(c)), round(reach * float(s))
            both = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
            both[reach + dv, reach + du] = both[reach - dv, reach - du] = 1.0
            one = cv2.filter2D(one, cv2.CV_32F, both)
        one = one[margin:-margin, margin:-margin]
        found[k] = one
        texture += np.sqrt(np.einsum("hwc,hwc->hw", one, one))
    texture = cv2.blur(texture, (_NEIGHBOURHOOD + 1, _NEIGHBOURHOOD + 1))
    colours = cv2.transform(cv2.GaussianBlur(level, (0, 0), 1.0), whiten)
    usual = np.median(np.linalg.norm(colours[::4, 3::4] - colours[::4, :-3:4], axis=2))
    colours /= np.maximum(usual, 1e-9)  # of a picture of one colour
    return found, np.maximum(texture, 0.5 * np.median(texture)) / ORIENTATIONS, colours


def _best_of_cells(ahead: Array, heading: Array, size: Array, total: Array, most: int) -> tuple[Integers, Integers]:
    """Return rows and columns of the best candidates, `most`, one in each cell of places, sizes and directions.

    A cell is as large as its filter sees: else the many places on a wide thing crowd out a thin rope.
    """
    order = np.argsort(-total, axis=None, kind="stable")
    order = order[np.isfinite(total.ravel()[order])]
    row, turn = np.divmod(order, total.shape[1])
    level = size[row, turn].astype(np.int64)
    cells = np.rint(ahead[row, turn] / 2.0 ** (level[:, None] + 1)).astype(np.int64)
    angle = np.rint(heading[row, turn] / np.pi * ORIENTATIONS).astype(np.int64) % (2 * ORIENTATIONS)
    key = ((cells[:, 0] * 65536 + cells[:, 1]) * 64 + angle) * 8 + level
    first = np.sort(np.unique(key, return_index=True)[1])[:most]
    return row[first], turn[first]


def _apart(history: npt.NDArray[np.complex64], place: Array, heading: Array, reach: Array) -> Flags:
    """Return which paths (N, P) do not run beside themselves, within `reach`, at new places (N, 2), directions (N,)."""
    early = np.arange(1, history.shape[1]) < history.shape[1] - 0.5 * reach[:, None]  # before a turn
    near = np.abs(history[:, 1:] - (place @ [1.0, 1.0j])[:, None]) < reach[:, None]
    row, column = np.nonzero(early & near)
    along = np.angle(history[row, column + 1] - history[row, column])
    parallel = np.abs(np.cos(along - heading[row])) > np.cos(np.radians(40.0))
    result = np.ones(len(place), bool)
    result[row[parallel]] = False
    return result
