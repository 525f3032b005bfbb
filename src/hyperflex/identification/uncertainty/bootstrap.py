"""Parametric bootstrap: fits to recordings simulated from a fit."""

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget, one_thread
from hyperflex.checks import Array
from hyperflex.errors import IdentificationError, InvalidInput
from hyperflex.executor import checked_chunks, refuse_lost, run_chunks
from hyperflex.identification.fit import Loss, Window, fit
from hyperflex.identification.model import Parameters
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import LEVEL, Basis, Interval, checked_level
from hyperflex.identification.uncertainty.ratios import ratios
from hyperflex.interruption import interruptible, stoppable
from hyperflex.status import Status


@dataclass(frozen=True, eq=False, repr=False)
class Bootstrap:
    """Fits to simulated recordings.

    Attributes
    ----------
    names : tuple of str
        Of the P parameters, as in ``Identification.parameters``.
    samples : (B, P) array
        Fitted values, SI units.
    ratio_names, ratio_samples : tuple of str, (B, R) array
        The same of the ratios, such as ``J/p1[0]``.
    failed : int
        How many more fits failed.
    ended : Status or None
        INTERRUPTED or OUT_OF_TIME where not all fits were made.
    """

    names: tuple[str, ...]
    samples: Array
    failed: int
    ended: Status | None = None
    ratio_names: tuple[str, ...] = ()
    ratio_samples: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __repr__(self) -> str:
        return f"<{self._head}: {', '.join(self.names)}>"

    def __str__(self) -> str:
        lines = [self._head]
        if len(self.samples) > 1:
            for name in (*self.names, *self.ratio_names):
                values = self._of(name)
                lines.append(f"  {name:<18} {values.mean():.5g} ± {values.std(ddof=1):.2g}, 95 % {self.interval(name)}")
        return "\n".join(lines)

    @property
    def _head(self) -> str:
        end = "" if self.ended is None else f", {self.ended}"
        return f"Bootstrap of {len(self.samples)} fits, {self.failed} more failed{end}"

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
        return "" if self.success else f"{self.status}: {self._head}"

    def interval(self, name: str, level: float = LEVEL) -> Interval:
        """Return the percentile interval of parameter or ratio `name` at a `level`; beside bounds see `profile`.

        It is of noise alone: ``Identification.intervals`` add errors of the model and of the lengths.
        """
        values = self._of(name)
        side = 0.5 * (1.0 - checked_level(level))
        if values.size == 0:
            raise IdentificationError("No fit of the bootstrap converged: there is no interval.")
        low, high = np.quantile(values, [side, 1.0 - side])
        return Interval(float(low), float(high), "bootstrap", level=level)

    def _of(self, name: str) -> Array:
        every = (*self.names, *self.ratio_names)
        if name not in every:
            raise InvalidInput("no such parameter was free", got=name, allowed=", ".join(every))
        which = every.index(name)
        count = len(self.names)
        return self.samples[:, which] if which < count else self.ratio_samples[:, which - count]


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
    plant, fitted = basis.plant, basis.fit
    seen = [plant.predict(fitted.x, w.t, s) for w, s in zip(basis.windows, fitted.states, strict=True)]
    clean = [y for y in seen if y is not None]
    if len(clean) < len(seen):
        raise IdentificationError("The fit cannot be simulated any more: nothing can be drawn from it.")
    executor, size = checked_chunks(executor, chunk_size, 1)
    fits: dict[int, list[Array | None]] = {}
    budget = Budget.of(time_budget)
    with stoppable() as stop, budget.progress(progress, "fitting", count, "simulated recordings"):

        def keep(low: int, some: list[Array | None]) -> None:
            fits[low] = some
            budget.report(float(low + len(some)))
            if len(fits) * size < count:
                budget.check()

        lost = run_chunks(_Draws(basis, clean, seed), range(count), executor, size, keep)
        refuse_lost(lost, "simulated recordings")
    every = [x for low in sorted(fits) for x in fits[low]]
    done = [(plant.parameters.values(x), list(_ratios(plant.parameters, x).values())) for x in every if x is not None]
    failed, names = len(every) - len(done), tuple(_ratios(plant.parameters, fitted.x))
    table = np.array([values for values, _ in done]).reshape(len(done), len(plant.parameters))
    numbers = np.array([ratios for _, ratios in done]).reshape(len(done), len(names))
    return stop.deliver(Bootstrap(plant.parameters.labels, table, failed, stop.status, names, numbers))


def _ratios(parameters: Parameters, x: Array) -> dict[str, float]:
    """Return each link's ratios, but the first moment of link 0 over itself."""
    found = ratios(parameters.rope(parameters.rounded(x)), parameters.names)
    each = {f"{name}[{k}]": float(value) for name, values in found.items() for k, value in enumerate(values)}
    del each["p/p1[0]"]
    return each


def _refitted(basis: Basis, windows: list[Window]) -> Array | None:
    """Return x (P,) of the fit to other windows, from the optimum; None where it fails."""
    try:
        found = fit(basis.plant, windows, basis.fit.x, basis.fit.states, loss=Loss(basis.fit.loss.name))
    except InvalidInput:
        return None
    return found.x if found.converged else None


class _Draws:
    """Draws recordings by their numbers, and fits them; `clean` is what is predicted for each window, (m, C) each."""

    def __init__(self, basis: Basis, clean: list[Array], seed: int) -> None:
        self.basis, self.clean, self.seed, self.noise = basis, clean, seed, _Noise(basis)

    @one_thread()
    def __call__(self, numbers: list[int]) -> list[Array | None]:
        """Return x (P,) of the fit to each recording; None where it fails."""
        rngs = [np.random.default_rng([self.seed, number]) for number in numbers]
        return [_refitted(self.basis, self.noise.add(self.clean, rng)) for rng in rngs]


class _Noise:
    """Draws noise like the residuals."""

    def __init__(self, basis: Basis) -> None:
        self.windows, information = basis.windows, basis.information
        self.scale = float(np.sqrt(information.variance))
        longest = max(window.t.size for window in self.windows)
        lags = np.abs(np.subtract.outer(np.arange(longest), np.arange(longest)))
        memory = information.memory
        self.root = np.linalg.cholesky(memory[:longest][lags]) if memory[1:].any() else None
        self.drawn: Array | None = None
        if basis.fit.loss.name != "squares":
            parts = [r[w.weight.ravel() > 0.0] for r, w in zip(basis.fit.residuals, self.windows, strict=True)]
            residuals = np.concatenate(parts)
            unknowns = sum(w.unknowns for w in self.windows) + len(basis.plant.parameters)
            self.drawn = residuals * np.sqrt(residuals.size / max(1.0, residuals.size - unknowns))

    def add(self, clean: list[Array], random: np.random.Generator) -> list[Window]:
        """Return the windows with noise added to the predictions `clean`, each (m, C)."""
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
