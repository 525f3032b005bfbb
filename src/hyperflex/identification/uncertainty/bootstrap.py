"""Parametric bootstrap: fits to recordings simulated from a fit."""

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import toeplitz

from hyperflex import checks
from hyperflex.budget import Budget, one_thread
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.executor import checked_chunks, refuse_lost, run_chunks
from hyperflex.identification.fit import Loss, Window, fit
from hyperflex.identification.model import Parameters
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import LEVEL, Basis, Interval, checked_level, ratios
from hyperflex.identification.uncertainty.noise import NOISE, ar_coefficients, partial_correlations
from hyperflex.interruption import interruptible, stoppable
from hyperflex.status import Status


@dataclass(frozen=True, eq=False, repr=False)
class Bootstrap:
    """Fits to simulated recordings.

    Attributes
    ----------
    names : tuple of str
        Of the parameters, as in ``Identification.parameters``, and then of the ratios, such as ``J/p1[0]``.
    samples : (B, P) array
        Their fitted values, SI units.
    failed : int
        How many more fits failed.
    ended : Status or None
        INTERRUPTED or OUT_OF_TIME where not all fits were made.
    """

    names: tuple[str, ...]
    samples: Array
    failed: int
    ended: Status | None = None

    def __repr__(self) -> str:
        end = "" if self.ended is None else f", {self.ended}"
        return f"<Bootstrap of {len(self.samples)} fits, {self.failed} more failed{end}>"

    def __str__(self) -> str:
        lines = [repr(self).strip("<>")]
        if len(self.samples) > 1:
            for name, values in zip(self.names, self.samples.T, strict=True):
                lines.append(f"  {name:<18} {values.mean():.5g} ± {values.std(ddof=1):.2g}, 95 % {self.interval(name)}")
        return "\n".join(lines)

    @property
    def status(self) -> Status:
        """SUCCESS if all fits were tried, and at least one converged."""
        return self.ended or (Status.SUCCESS if len(self.samples) else Status.FAILED)

    @property
    def success(self) -> bool:
        """Whether all fits were tried, and at least one converged."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why it is no success; empty on success."""
        return "" if self.success else f"{self.status}: {repr(self).strip('<>')}"

    def interval(self, name: str, level: float = LEVEL) -> Interval:
        """Return the percentile interval of parameter or ratio `name` at a `level`; near bounds see `profile`.

        It is of noise alone: ``Identification.intervals`` add errors of the model and of the lengths.
        """
        if name not in self.names:
            raise InvalidInput("no such parameter was free", got=name, allowed=", ".join(self.names))
        side = 0.5 * (1.0 - checked_level(level))
        if len(self.samples) == 0:
            raise IdentificationError("No fit of the bootstrap converged: there is no interval.")
        low, high = np.quantile(self.samples[:, self.names.index(name)], [side, 1.0 - side])
        return Interval(float(low), float(high), "bootstrap", level=level)


@interruptible(Bootstrap)
@one_thread()
def bootstrap(
    found: Identification,
    count: int = 200,
    *,
    seed: int = 0,
    executor: Executor | None = None,
    chunk_size: int | None = None,
    time_budget: float | Budget | None = None,
    progress: bool = False,
) -> Bootstrap:
    """Simulate recordings like the one that was fitted, and fit each (parametric bootstrap).

    Parameters
    ----------
    found : Identification
        Of :func:`identify`, in the same session.
    count : int
        Number of recordings.
    seed : int
        Of all draws; draw number b is the same whatever `count` is.
    executor : concurrent.futures.Executor, optional
        Where the fits are made: processes, or other machines (``docs/how-to/many-machines.md``). Results do not depend
        on it.
    chunk_size : int, optional
        Fits of a chunk; by default one.
    time_budget : float or Budget, optional
        Seconds by the clock, without compiling, checked after each chunk; no limit by default. Out of time, the result
        holds the fits until then, with ``status`` OUT_OF_TIME.
    progress : bool
        Show a bar on standard error.

    Raises
    ------
    InvalidInput
        For a result without its fit (read from a file).
    IdentificationError
        When the fit itself cannot be simulated.
    WorkerLost
        If fits kill the workers of the executor.
    Interrupted
        By Ctrl-C. Its ``partial`` holds the fits until then.

    Notes
    -----
    The fitted windows are simulated from the fitted states and parameters, at the same times, with the same gaps.
    Squares: normal noise of the residuals' variance and autoregression is added. Robust losses: residuals are drawn
    with replacement and taken as white. Errors of the model and of the lengths (``Identification.model_std``) are in no
    draw. Each fit starts from the optimum, so other minima are not found. Cost: `count`
    fits of a few rounds.
    """
    basis = found.basis
    count, seed = checks.count("count", count), checks.count("seed", seed, least=0)
    draws = Draws(basis, seed)
    executor, size = checked_chunks(executor, chunk_size, 1)
    fits: dict[int, list[Array | None]] = {}
    budget = Budget.of(time_budget)
    with stoppable() as stop, budget.progress(progress, "fitting", count, "simulated recordings"):

        def keep(low: int, some: list[Array | None]) -> None:
            fits[low] = some
            budget.report(float(low + len(some)))
            if len(fits) * size < count:
                budget.check()

        lost = run_chunks(draws, range(count), executor, size, keep)
        refuse_lost(lost, "simulated recordings")
    every = [x for low in sorted(fits) for x in fits[low]]
    done = [list(_values(basis.plant.parameters, x).values()) for x in every if x is not None]
    names = tuple(_values(basis.plant.parameters, basis.fit.x))
    table = np.reshape(done, (len(done), len(names)))
    return stop.deliver(Bootstrap(names, table, len(every) - len(done), stop.status))


def _values(parameters: Parameters, x: Array) -> dict[str, float]:
    """Return the parameters and each link's ratios by label, but the first moment of link 0 over itself."""
    found = ratios(parameters.rope(parameters.rounded(x)), parameters.names)
    each = {f"{name}[{k}]": float(value) for name, values in found.items() for k, value in enumerate(values)}
    del each["p/p1[0]"]
    return dict(zip(parameters.labels, parameters.values(x).tolist(), strict=True)) | each


class Draws:
    """Draws recordings like the fitted one by their numbers, and fits them."""

    def __init__(self, basis: Basis, seed: int) -> None:
        self.basis, self.seed, windows, information = basis, seed, basis.windows, basis.information
        seen = [w.predicted(basis.plant, basis.fit.x, s) for w, s in zip(windows, basis.fit.states, strict=True)]
        self.clean = [y for y in seen if y is not None]
        if len(self.clean) < len(seen):
            raise IdentificationError("The fit cannot be simulated any more: nothing can be drawn from it.")
        self.scale, memory = float(np.sqrt(information.variance)), information.memory
        parts = partial_correlations(memory[: NOISE.most_terms + 1])
        self.filter = np.append(1.0, -ar_coefficients(parts))
        self.innovation = float(np.sqrt(np.prod(1.0 - parts**2)))
        self.root = np.linalg.cholesky(toeplitz(memory[: NOISE.most_terms]))  # of the first values
        known = [r[w.weight.ravel() > 0.0] for r, w in zip(basis.fit.residuals, windows, strict=True)]
        residuals = np.concatenate(known)
        unknowns = sum(w.unknowns for w in windows) + len(basis.plant.parameters)
        self.residuals = residuals * np.sqrt(residuals.size / max(1.0, residuals.size - unknowns))

    @one_thread()
    def __call__(self, numbers: list[int]) -> list[Array | None]:
        """Return x (P,) of the fit to each recording; None where it fails."""
        return [self._refitted(self.windows(np.random.default_rng([self.seed, number]))) for number in numbers]

    def windows(self, random: np.random.Generator) -> list[Window]:
        """Return the windows with noise like the residuals added to what is predicted."""
        windows = []
        for window, seen in zip(self.basis.windows, self.clean, strict=True):
            known = window.weight > 0.0
            if self.basis.fit.loss.name != "squares":
                noise = random.choice(self.residuals, seen.shape)
            else:
                noise = self.scale * self.coloured(random.standard_normal(seen.shape))
            y = np.where(known, seen + noise / np.where(known, window.weight, 1.0), 0.0)
            windows.append(replace(window, y=y))
        return windows

    def coloured(self, white: Array) -> Array:
        """Return noise of variance 1 (m, C), stationary from the first value on, made of white noise (m, C)."""
        from scipy.signal import lfilter

        first = self.root[: len(white), : len(white)] @ white[: len(self.root)]
        driving = np.concatenate([lfilter(self.filter, [1.0], first, axis=0), self.innovation * white[len(first) :]])
        return np.asarray(lfilter([1.0], self.filter, driving, axis=0))

    def _refitted(self, windows: list[Window]) -> Array | None:
        """Return x (P,) of the fit to other windows, from the optimum; None where it fails."""
        plant, fitted = self.basis.plant, self.basis.fit
        try:
            found = fit(plant, windows, fitted.x, fitted.states, loss=Loss(fitted.loss.name))
        except InvalidInput:
            return None
        return found.x if found.converged else None
