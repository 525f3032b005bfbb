"""Test of whether links are too long for the rope that was recorded."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.held import FEW_LINKS, LINKS
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest, fit_with, part_of, within
from hyperflex.identification.fit import Window, fit
from hyperflex.identification.model import Plant
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.model import Rope
from hyperflex.sensors import Angles

UNSURE, ELSE = 0.25, 2.0  # of the pattern's amplitude (1: finer links): its least deviation, and that of other causes
PIECES = 4  # that each link is cut into: errors go with a link's length squared, so that a 16th of them is left


def link_test(basis: Basis, others: Sequence[ScoreTest] = ()) -> tuple[ScoreTest, ...]:
    """Return the test of a rope's links, or nothing where they cannot be cut, or where few leave no more than noise.

    Links of a rope of many have to be alike; few may each have values of their own, with their mass in their middle. If
    one of the `others` explains much, what it leaves is tested: a fit with it free as well.

    Notes
    -----
    Indirect inference: the rope as fitted, its links cut into PIECES, is simulated, and the fit repeated on what the
    same sensor would see of that. The parameters' change is the error that too long links make; the residuals are its
    pattern. How much of it the residuals hold is 1 of the finer rope and 0 of a chain that has just these links; see
    :func:`_probability`.
    """
    name = next((each.name for each in others if each.masks), "")
    richer = fit_with(basis, name)
    if richer is not None:
        return tuple(within(each, basis.fit.x.size, [name]) for each in link_test(richer))
    plant, x, some = basis.plant, basis.fit.x, part_of(basis)
    n, parameters = plant.parameters.guess.n_links, plant.parameters.all
    few, own = n <= FEW_LINKS, any(0 < len(p.links) < n for p in parameters if p.kind.owner == "link")
    if n == 1 or plant.motor is not None or (basis.information.whiteness >= CHANCE if few else own):
        return ()
    loss, states = some.fit.loss, some.fit.states
    try:
        finer = plant.cut(x, PIECES)
        seen = [_seen(plant.parameters.rope(x), finer, *each) for each in zip(some.windows, states, strict=True)]
        again = fit(plant, seen, x, states, loss=loss, rounds=TESTING.rounds)
    except InvalidInput:  # links that are not uniform, or that cannot be simulated
        return ()
    pairs = list(zip(some.fit.residuals, again.residuals, strict=True))
    before = sum(loss.cost(residual) for residual, _ in pairs)
    gained = before - sum(loss.cost(residual - pattern) for residual, pattern in pairs)
    shift = again.x - x
    std, now, then = np.sqrt(np.diag(basis.information.covariance)), *map(plant.parameters.values, (x, again.x))
    parts = np.abs(np.divide(then - now, now, out=np.zeros(x.size), where=now > 0.0))
    test = ScoreTest(
        LINKS,
        max(gained, 0.0) / before if before > 0.0 else 0.0,
        np.array([float(n * PIECES)]),
        shift=shift,
        excess_gain=_probability(basis, pairs),
        ratio_sensitivity=float(np.max(parts, where=np.abs(shift) > 2.0 * std, initial=0.0)),
    )
    return (test,)


def _probability(basis: Basis, pairs: list[tuple[Array, Array]]) -> float:
    """Return the probability of the finer rope, by windows' residuals and patterns [((m C,), (m C,)), ..].

    The amplitude of the pattern is fitted to the residuals; its standard deviation follows from the noise, and from how
    the windows scatter. Where residuals are not white it is UNSURE at least, and the amplitude may come from anything
    else that was left out as well, which makes it as large as ELSE.
    """
    dots, sizes = np.array([(pattern @ residual, pattern @ pattern) for residual, pattern in pairs]).T
    total = float(sizes.sum())
    if total <= 0.0:
        return 0.0
    amplitude, count = float(dots.sum()) / total, len(pairs)
    variance = basis.information.variance * basis.information.correlation / total
    if count > 1:
        scatter = float(((dots - amplitude * sizes) ** 2).sum()) / total**2 * count / (count - 1.0)
        variance = max(variance, scatter)
    white = basis.information.whiteness >= CHANCE
    std = float(np.sqrt(variance if white else variance + UNSURE**2))
    logs = -0.5 * (np.array([amplitude - 1.0, amplitude]) / max(std, 1e-12)) ** 2  # of finer links, and of these
    if not white:
        logs = np.append(logs, -0.5 * (amplitude / ELSE) ** 2 + np.log(std / ELSE))
    weights = np.exp(logs - logs.max())
    return float(weights[0] / weights.sum())


def _seen(rope: Rope, finer: Plant, window: Window, state: Array) -> Window:
    """Return a window with what the sensor sees of the finer rope from a smooth shape like `state` (2n,)."""
    from scipy.interpolate import make_interp_spline

    n, fine = rope.n_links, finer.parameters.guess
    places, old = (np.cumsum(each.length) - 0.5 * each.length for each in (fine, rope))
    # along the rope, straight lines continue beyond the ends
    start = make_interp_spline(old, state.reshape(2, n).T, k=1)(places).T.ravel()
    y = finer.predict(np.zeros(0), window.t, start)
    if y is None:
        raise InvalidInput("the finer rope cannot be simulated")
    if isinstance(finer.sensor, Angles):
        y = _chords(y.reshape(y.shape[0], n, PIECES), fine.length.reshape(n, PIECES))
    return replace(window, y=np.where(window.weight > 0.0, y, 0.0))


def _chords(q: Array, length: Array) -> Array:
    """Return the directions (m, n) of the chords of links cut into pieces (m, n, p), rad."""
    mean = np.mean(q, axis=2)
    off = q - mean[:, :, None]
    across, along = (length * np.sin(off)).sum(axis=2), (length * np.cos(off)).sum(axis=2)
    return np.asarray(mean + np.arctan2(across, along))
