"""Test of a rope's links: whether a rope of shorter ones explains the residuals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.declarations.held import FEW_LINKS, LINKS
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest, within
from hyperflex.identification.fit import Window, averaged, fit
from hyperflex.identification.model import Plant
from hyperflex.identification.uncertainty.covariance import REFIT, Basis
from hyperflex.model import Rope
from hyperflex.sensors import Angles

UNSURE, ELSE = 0.25, 2.0  # of the pattern's amplitude (1: finer links): its least deviation, and that of other causes
PIECES = 4  # that each link is cut into: errors go with a link's length squared, so that a 16th of them is left


def link_test(basis: Basis, others: Sequence[ScoreTest] = ()) -> tuple[ScoreTest, ...]:
    """Return the test of a rope's links, or nothing where they cannot be cut, or where few leave no more than noise.

    Links of a rope of many have to be alike; few may each have values of their own, with their mass in their middle. If
    one of the `others` explains much that longer links do not, what it leaves is tested: a fit with it free as well.

    Notes
    -----
    Indirect inference: the rope as fitted, its links cut into PIECES, is simulated, and the fit repeated on what the
    same sensor would see of that. The parameters' change is the error that too long links make; the residuals are its
    pattern. How much of it the residuals hold is 1 of the finer rope and 0 of a chain that has just these links; see
    :func:`_probability`. Of the `others` those are explained by the links that a fit to the finer rope shows as well,
    with half of their gain at least.
    """
    if basis.plant.parameters.guess.n_links == 1:
        return ()
    found = _link_test(basis, others)
    explained = {name for each in found for name in each.explains}
    masking = next((each.name for each in others if each.masks and each.name not in explained), "")
    richer = basis.refit(masking, covariance=True) if masking else None
    if richer is None:
        return found
    return tuple(within(each, basis.fit.x.size, [masking]) for each in _link_test(richer))


def _link_test(basis: Basis, others: Sequence[ScoreTest] = ()) -> tuple[ScoreTest, ...]:
    """Return the test of a rope's links, with what it explains of the `others`."""
    plant, x, some = basis.plant, basis.fit.x, basis.part
    n, parameters, loss, states = plant.parameters.guess.n_links, plant.parameters.all, some.fit.loss, some.fit.states
    own = any(0 < len(p.links) < n for p in parameters if p.kind.owner == "link")
    if plant.constants is not None or (basis.information.white if n <= FEW_LINKS else own):
        return ()
    try:
        finer = plant.cut(x, PIECES)
        seen = [_seen(plant.parameters.rope(x), finer, *each) for each in zip(some.windows, states, strict=True)]
        again = fit(plant, seen, x, states, loss=loss, rounds=REFIT.rounds)
    except InvalidInput:  # links that are not uniform, or that cannot be simulated
        return ()
    pairs = list(zip(some.fit.residuals, again.residuals, strict=True))
    before, after = (sum(map(loss.cost, each)) for each in (some.fit.residuals, [r - pattern for r, pattern in pairs]))
    shift, std = again.x - x, np.sqrt(np.diag(basis.information.covariance))
    now, then = map(plant.parameters.values, (x, again.x))
    parts = np.abs(np.divide(then - now, now, out=np.zeros(x.size), where=now > 0.0))
    probability, of_finer = _probability(basis, pairs), replace(some, windows=seen, fit=again)
    shown = [each for each in others if each.refitted and probability > TESTING.likely]
    refits = [(each, of_finer.refit(each.name)) for each in shown]
    test = ScoreTest(
        LINKS,
        max(before - after, 0.0) / before if before > 0.0 else 0.0,
        np.array([float(n * PIECES)]),
        shift=shift,
        excess_gain=probability,
        ratio_sensitivity=float(np.max(parts, where=np.abs(shift) > 2.0 * std, initial=0.0)),
        explains=tuple(
            each.name
            for each, after in refits
            if after is not None and again.cost - after.fit.cost > TESTING.seeming * each.gain * again.cost
        ),
    )
    return (test,)


def _probability(basis: Basis, pairs: list[tuple[Array, Array]]) -> float:
    """Return the probability of the finer rope, by windows' residuals and patterns [((m C,), (m C,)), ..].

    The amplitude of the pattern is fitted to the residuals; its standard deviation follows from the noise, and from how
    the windows scatter. Where residuals are not white it is UNSURE at least, and the amplitude may come from anything
    else that the model omits, which makes it as large as ELSE.
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
    from scipy.special import softmax

    white = basis.information.white
    std = max(float(np.sqrt(variance + UNSURE**2 * (not white))), 1e-12)
    # of the pattern's amplitude if the rope has finer links, has just these, or the model omits something else
    means, stds = np.array([1.0, 0.0, 0.0]), np.array([std, std, ELSE])
    logs = -0.5 * ((amplitude - means) / stds) ** 2 - np.log(stds)
    return float(softmax(logs[: 2 if white else 3])[0])


def _seen(rope: Rope, finer: Plant, window: Window, state: Array) -> Window:
    """Return a window with what the sensor sees of the finer rope from a smooth shape like `state` (2n,)."""
    from scipy.interpolate import make_interp_spline

    n, fine = rope.n_links, finer.parameters.guess
    places, old = fine.link_middles, rope.link_middles
    # along the rope, straight lines continue beyond the ends
    start = make_interp_spline(old, state.reshape(2, n).T, k=1)(places).T.ravel()
    y = finer.predict(np.zeros(0), window.t, start)
    if y is None:
        raise InvalidInput("the finer rope cannot be simulated")
    if isinstance(finer.sensor, Angles):
        y = _chords(y.reshape(y.shape[0], n, PIECES), fine.length.reshape(n, PIECES))
    return replace(window, y=np.where(window.weight > 0.0, averaged(y, window.t, window.spread), 0.0))


def _chords(q: Array, length: Array) -> Array:
    """Return the directions (m, n) of the chords of links cut into pieces (m, n, p), rad."""
    mean = np.mean(q, axis=2)
    off = q - mean[:, :, None]
    across, along = (length * np.sin(off)).sum(axis=2), (length * np.cos(off)).sum(axis=2)
    return np.asarray(mean + np.arctan2(across, along))
