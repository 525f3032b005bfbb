"""Faults that the residuals of a fit show: a channel whose zero moves or is off, or that is late; smoothed samples.

To add one, yield its pattern from `_patterns`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.model import Mask
from hyperflex.identification.uncertainty.covariance import MASSES, Basis, ratio_gradients, ratio_spread, ratios
from hyperflex.identification.uncertainty.noise import CHANCE, Piece, whiteness
from hyperflex.recording import UNIT, Recording
from hyperflex.sensors import Angles


@dataclass(frozen=True)
class ChannelTestLimits:
    """Which faults of a channel are tested."""

    # samples before and after a step: what fewer ones show is an outlier
    side: int = 20
    # part of a pattern's squares that the fit leaves: of less, errors of the linear model decide
    left: float = 1e-3
    # times the rms of what remains: smaller steps look like slow errors of the model
    visible: float = 1.0


CHANNEL_TEST = ChannelTestLimits()


class _Pattern(NamedTuple):
    """What a fault of size 1 makes of the weighted values of each window [(m, C), ..]; at `steps` it may begin."""

    kind: Kind
    channel: int
    windows: list[Array]
    steps: Mask


class _Explained(NamedTuple):
    """A fault that may explain residuals: its size, from sample `at` on, and how much of their squares it takes."""

    pattern: _Pattern
    at: int
    size: float
    squares: float

    @property
    def possible(self) -> bool:
        """Whether it explains anything; no sensor sees ahead."""
        return self.squares > 0.0 and (self.size > 0.0 or self.pattern.kind not in (Kind.LINK_LATE, Kind.SMOOTHED))

    @property
    def windows(self) -> list[Array]:
        """What it makes of the weighted residuals of each window [(m, C), ..]."""
        begins = np.cumsum([0, *(len(each) for each in self.pattern.windows)])
        every = zip(self.pattern.windows, begins[:-1], strict=True)
        return [np.where((begin + np.arange(len(w)) >= self.at)[:, None], -self.size * w, 0.0) for w, begin in every]

    @property
    def rms(self) -> float:
        """The root of the mean square of what it makes of the residuals that it changes."""
        values = np.concatenate([each[each != 0.0] for each in self.windows])
        return float(np.sqrt(np.mean(values**2)))


def channel_faults(basis: Basis, recording: Recording, tests: Sequence[ScoreTest], budget: Budget) -> list[Finding]:
    """Return the fault of one channel, or the smoothing of all, that explains the residuals of a fit, or nothing.

    Notes
    -----
    Generalised likelihood ratio test (Willsky and Jones 1976, doi:10.1109/TAC.1976.1101146): the residuals are compared
    with the pattern of each fault from each sample on, less what states and parameters of the fit absorb. The greatest
    gain is chance in CHANCE of all recordings at most, by Bonferroni's bound over all faults and samples. Errors of the
    model seem to be such a fault as well, but last and change slowly: a fault has to be larger than what it leaves, to
    leave white noise or take most of the squares, and to explain more than any of the other `tests`.
    """
    from scipy.special import fdtrc

    own, pieces = 2 * basis.plant.parameters.guess.n_links, basis.pieces(budget)
    pieces, patterns = _orthogonal(pieces, own), list(_patterns(basis, recording))
    found = [each for pattern in patterns if (each := _explained(pieces, pattern, own)).possible]
    total = sum(float((piece.residual**2).sum()) for piece in pieces)
    freedom = sum(float(piece.seen.sum()) - piece.basis.shape[2] for piece in pieces) - 1.0
    # of the markers of one link, which show the same, the one that hangs
    best = max(reversed(found), key=lambda each: each.squares, default=None)
    if best is None or freedom < 1.0 or best.squares >= total:
        return []
    gain, left = best.squares / total, (total - best.squares) / freedom
    chance = sum(int(each.steps.sum()) for each in patterns) * fdtrc(1.0, freedom, best.squares / left)
    # springs, which the guess has not, explain about as much as smoothing does
    more = -TESTING.equal if best.pattern.kind is Kind.SMOOTHED else TESTING.equal
    others = max((each.gain for each in tests), default=0.0)
    if chance > CHANCE or best.rms < CHANNEL_TEST.visible * np.sqrt(left) or gain <= others + more:
        return []
    every = list(zip(pieces, best.windows, strict=True))
    without = _orthogonal([replace(piece, residual=piece.residual - made * piece.seen) for piece, made in every], own)
    if gain <= TESTING.explains and whiteness(without) < CHANCE:
        return []
    absorbed = np.sum([np.einsum("mc,mck->k", made, piece.basis) for piece, made in every], axis=0)[own:]
    severity = Severity.WRONG if _matters(basis, basis.information.root @ absorbed, left) else Severity.DOUBT
    return [_finding(best, severity, gain, recording, np.concatenate([window.t for window in basis.windows]))]


def _matters(basis: Basis, step: Array, variance: float) -> bool:
    """Whether a step of x (P,) moves a ratio by more than is negligible and residuals of this variance may move it."""
    information, parameters = basis.information, basis.plant.parameters
    share = variance / max(information.variance * information.correlation, 1e-300)
    gradients, known = ratio_gradients(parameters, information.x), ratios(parameters.rope(information.x))
    for name, std in ratio_spread(parameters, information).items():
        if name in MASSES:
            moved = np.abs(gradients[name] @ step)
            if (moved > np.maximum(TESTING.covered * np.sqrt(share) * std, TESTING.moves * np.abs(known[name]))).any():
                return True
    return False


def _orthogonal(pieces: Sequence[Piece], own: int) -> list[Piece]:
    """Return residuals less what the fit absorbs: the first `own` directions are of each window alone."""
    along = [np.einsum("mc,mck->k", piece.residual, piece.basis) for piece in pieces]
    common = np.sum([each[own:] for each in along], axis=0)
    every = zip(pieces, along, strict=True)
    return [replace(p, residual=p.residual - p.basis @ np.append(each[:own], common)) for p, each in every]


def _patterns(basis: Basis, recording: Recording) -> Iterator[_Pattern]:
    """Yield all faults: a zero of each channel that moves or is off, links whose samples are late, and smoothing."""
    every = list(zip(basis.windows, basis.fit.states, strict=True))
    seen = [basis.plant.predict(basis.fit.x, window.t, state) for window, state in every]  # also in gaps
    fitted = [window.y if each is None else each for each, (window, _) in zip(seen, every, strict=True)]
    steps = np.zeros(sum(len(seen) for seen in fitted), dtype=np.bool_)
    always = np.arange(steps.size) == 0
    steps[CHANNEL_TEST.side : -CHANNEL_TEST.side] = True
    shifts = [_shifts(basis, recording, seen) for seen in fitted]
    rates = [np.gradient(seen, window.t, axis=0) for seen, window in zip(fitted, basis.windows, strict=True)]
    for channel in range(recording.data.shape[1]):
        moved = [shift[channel] * window.weight for shift, window in zip(shifts, basis.windows, strict=True)]
        yield _Pattern(Kind.JUMP, channel, moved, steps)
        if recording.kind == "angles" and recording.n_links > 1:
            yield _Pattern(Kind.LINK_ZERO, channel, moved, always)
            late = [-rate * each for rate, each in zip(rates, moved, strict=True)]
            yield _Pattern(Kind.LINK_LATE, channel, late, always)
    # a mean over times of variance 2 s about each instant adds s times the second derivative
    bent = [
        np.gradient(rate, window.t, axis=0) * window.weight for rate, window in zip(rates, basis.windows, strict=True)
    ]
    yield _Pattern(Kind.SMOOTHED, 0, bent, always)


def _shifts(basis: Basis, recording: Recording, fitted: Array) -> Array:
    """Return by how much the fitted channels (m, C) change per unit of each recorded one (J, m, C).

    A marker at a joint turns the links on either side of it. It does so by the fitted angles: measured ones have the
    noise that the residuals have.
    """
    count, (m, channels) = recording.data.shape[1], fitted.shape
    if not isinstance(basis.plant.sensor, Angles) or recording.kind == "angles":
        return np.broadcast_to(np.eye(count, channels)[:, None, :], (count, m, channels))
    found = np.zeros((count // 2, 2, m, channels))
    for link, length in enumerate(recording.link_lengths()):
        turned = np.array([np.cos(fitted[:, link]), np.sin(fitted[:, link])]) / length
        found[link + 1, :, :, link] = turned
        found[link, :, :, link] = -turned
    return found.reshape(count, m, channels)


def _explained(pieces: Sequence[Piece], pattern: _Pattern, own: int) -> _Explained:
    """Return from which of its steps on a pattern explains most: sums from each sample to the end of all windows."""
    columns = 2 + np.arange(own)  # of what the state of a window absorbs
    dots, sizes, whole = list[Array](), list[Array](), list[Array]()
    later, absorbed = np.zeros(2 + pieces[0].basis.shape[2]), 0.0
    for piece, shape in zip(reversed(pieces), reversed(pattern.windows), strict=True):
        products = np.stack([piece.residual * shape, shape**2]).sum(axis=2)
        acts = shape.any(axis=0)  # one channel or two, as a rule
        each = np.column_stack([*products, np.einsum("mc,mck->mk", shape[:, acts], piece.basis[:, acts])])
        table = later + np.cumsum(each[::-1], axis=0)[::-1]
        dots.append(table[:, 0])
        sizes.append(table[:, 1] - absorbed - (table[:, 2:] ** 2).sum(axis=1))
        whole.append(table[:, 1])
        later = table[0].copy()
        absorbed += float((later[columns] ** 2).sum())
        later[columns] = 0.0
    dot, size, full = (np.concatenate(each[::-1]) for each in (dots, sizes, whole))
    seen = pattern.steps & (size > CHANNEL_TEST.left * full)
    squares = np.divide(dot**2, size, out=np.zeros_like(dot), where=seen)
    at = int(np.argmax(squares))
    return _Explained(pattern, at, -float(dot[at] / size[at]) if seen[at] else 0.0, float(squares[at]))


def _finding(found: _Explained, severity: Severity, gain: float, recording: Recording, t: Array) -> Finding:
    kind, channel, *_ = found.pattern
    if kind is Kind.JUMP:
        values = {"channel": recording.channel(channel), "size": found.size, "unit": UNIT[recording.kind]}
        values |= {"time": float(t[found.at])}
    elif kind is Kind.SMOOTHED:
        values = {"width": float(np.sqrt(24.0 * found.size))}  # of a moving mean
    else:
        values = {"link": channel, {Kind.LINK_ZERO: "angle", Kind.LINK_LATE: "delay"}[kind]: found.size}
    return Finding(kind, severity, values, gain)
