"""Parametric bootstrap: fits to recordings simulated from a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import fit, one_thread
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.intervals import LEVEL, Interval
from hyperflex.identification.uncertainty.noise import correlations
from hyperflex.simulation.rollouts import progress_bar


@dataclass(frozen=True, eq=False, repr=False)
class Bootstrap:
    """Fits to simulated recordings.

    Attributes
    ----------
    names : tuple of str
        Of the P parameters, as in ``Identification.parameters``.
    samples : (B, P) array
        What each fit found, SI units.
    failed : int
        How many more fits failed.
    interrupted : bool
        Whether Ctrl-C came before all were done.
    """

    names: tuple[str, ...]
    samples: Array
    failed: int
    interrupted: bool

    def __repr__(self) -> str:
        end = ", interrupted" if self.interrupted else ""
        return f"<Bootstrap of {len(self.samples)} fits, {self.failed} more failed{end}: {', '.join(self.names)}>"

    def interval(self, name: str, level: float = LEVEL) -> Interval:
        """Return the interval that leaves out (1 - level) / 2 of the samples of parameter `name` on either side.

        Beside a bound such intervals do not hold the truth as often as `level` says; :func:`profile` does.
        """
        if name not in self.names:
            raise InvalidInput("no such parameter was free", got=name, allowed=", ".join(self.names))
        side = 0.5 * (1.0 - checks.number("level", level, sign="positive"))
        if side <= 0.0:
            raise InvalidInput("level is not a probability", got=level, allowed="between 0 and 1, such as 0.95")
        low, high = np.quantile(self.samples[:, self.names.index(name)], [side, 1.0 - side])
        return Interval(float(low), float(high), "bootstrap", level=level)


@one_thread()
def bootstrap(found: Identification, count: int = 200, *, seed: int = 0, progress: bool = False) -> Bootstrap:
    """Simulate recordings like the one that was fitted, fit each, and return what they find.

    Parameters
    ----------
    found : Identification
        What :func:`identify` gave back, in the same session.
    count : int
        How many recordings.
    seed : int
        Of all draws; draw number b is the same whatever `count` is.
    progress : bool
        Show a bar on standard error.

    Returns
    -------
    Bootstrap
        Of the recordings done so far if Ctrl-C ends it early.

    Raises
    ------
    InvalidInput
        For a result without its fit (read from a file).
    IdentificationError
        When the fit itself cannot be simulated.

    Notes
    -----
    The fitted windows are simulated from the fitted states and parameters, at the same times, with the same gaps.
    Squares: normal noise of the residuals' variance and autoregression is added. Robust losses: residuals are drawn
    with replacement, outliers among them, and taken as white. Each fit starts from the optimum, so that another
    minimum far off is not found. Cost: `count` fits of a few rounds.
    """
    basis = found.basis
    count, seed = checks.count("count", count), checks.count("seed", seed, least=0)
    plant, fitted = basis.plant, basis.fit
    seen = [plant.predict(fitted.x, w.t, s) for w, s in zip(basis.windows, fitted.states, strict=True)]
    clean = [y for y in seen if y is not None]
    if len(clean) < len(seen):
        raise IdentificationError("The fit cannot be simulated any more: nothing can be drawn from it.")
    noise = _Noise(basis)
    samples, failed, interrupted = [], 0, False
    with progress_bar(0.0, float(count), progress, "simulated recordings") as report:
        try:
            for number in range(count):
                windows = noise.add(clean, np.random.default_rng([seed, number]))
                x = _refitted(basis, windows)
                if x is None:
                    failed += 1
                else:
                    samples.append(plant.parameters.values(x))
                if report is not None:
                    report(number + 1.0)
        except KeyboardInterrupt:
            interrupted = True
    table = np.array(samples).reshape(len(samples), len(plant.parameters))
    return Bootstrap(plant.parameters.labels, table, failed, interrupted)


def _refitted(basis: Basis, windows: list[Window]) -> Array | None:
    """Return x (P,) of the fit to other windows, from the optimum; None where it fails."""
    try:
        found = fit(basis.plant, windows, basis.fit.x, basis.fit.states, loss=Loss(basis.fit.loss.name))
    except InvalidInput:
        return None
    if found.interrupted:
        raise KeyboardInterrupt
    return found.x if found.converged else None


class _Noise:
    """Draws noise like the residuals, and adds it to what is seen without."""

    def __init__(self, basis: Basis) -> None:
        self.windows, information = basis.windows, basis.information
        self.scale = float(np.sqrt(information.variance))
        longest = max(window.t.size for window in self.windows)
        lags = np.abs(np.subtract.outer(np.arange(longest), np.arange(longest)))
        self.root = (
            np.linalg.cholesky(correlations(information.terms, longest)[lags]) if information.terms.size else None
        )
        self.drawn: Array | None = None
        if basis.fit.loss.name != "squares":
            parts = [r[w.weight.ravel() > 0.0] for r, w in zip(basis.fit.residuals, self.windows, strict=True)]
            residuals = np.concatenate(parts)
            self.drawn = residuals * np.sqrt(residuals.size / max(1.0, residuals.size - _unknowns(basis)))

    def add(self, clean: list[Array], random: np.random.Generator) -> list[Window]:
        """Return the windows with new values (m, C)."""
        windows = []
        for window, seen in zip(self.windows, clean, strict=True):
            known = window.weight > 0.0
            noise = self._draw(seen.shape, random)
            y = np.where(known, seen + noise / np.where(known, window.weight, 1.0), 0.0)
            windows.append(replace(window, y=y))
        return windows

    def _draw(self, shape: tuple[int, ...], random: np.random.Generator) -> Array:
        if self.drawn is not None:
            return random.choice(self.drawn, shape)
        white = random.standard_normal(shape)
        return self.scale * (white if self.root is None else self.root[: shape[0], : shape[0]] @ white)


def _unknowns(basis: Basis) -> int:
    """Return how many numbers the fit has found: parameters, and states less the rows of their prior."""
    states: int = sum(s.size - w.prior.shape[0] for s, w in zip(basis.fit.states, basis.windows, strict=True))
    return states + len(basis.plant.parameters)
