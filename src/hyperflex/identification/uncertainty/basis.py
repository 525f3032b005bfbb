"""A fit with its model, windows and information, and fits of some of its windows with one thing more free."""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hyperflex.budget import Budget
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit import Fit, Window, fit
from hyperflex.identification.model import Plant, extended
from hyperflex.identification.uncertainty.covariance import (
    LEVEL,
    Information,
    Interval,
    estimate_covariance,
    freedom_with,
    interval,
    sensitivities,
    window_models,
)
from hyperflex.identification.uncertainty.noise import Piece


@dataclass(frozen=True)
class RefitOptions:
    """How far a refit goes: for time."""

    # windows, spread over the recording, and rounds at most
    windows: int = 12
    rounds: int = 40
    # gain of a round, as a part of the cost, that ends a refit: far less than gains that differ
    enough: float = 1e-3


REFIT = RefitOptions()


@dataclass(frozen=True, eq=False)
class Basis:
    """A fit, its model and windows, and their information about the parameters.

    usual: time, s, over which windows and parts of longer ones are compared with each other.
    """

    plant: Plant
    windows: list[Window]
    fit: Fit
    information: Information
    usual: float = np.inf
    _refits: dict[str, "Basis | None"] = field(default_factory=dict, init=False)

    @property
    def part(self) -> "Basis":
        """The fit in some of its windows, spread over the recording."""
        every, found = -(-len(self.windows) // REFIT.windows), self.fit
        some = Fit(found.x, found.states[::every], found.residuals[::every], found.loss)
        return replace(self, windows=self.windows[::every], fit=some)

    def refit(self, name: str = "", *, covariance: bool = False) -> "Basis | None":
        """Return a fit of some windows with `name` free as well, made once; None where none converges.

        Its information is that of this fit unless its own `covariance` is required.
        """
        if not name and self.fit.converged and len(self.windows) <= REFIT.windows:
            return self
        if name not in self._refits:
            self._refits[name] = None
            some = self.refit() if name else self.part
            if some is not None:
                plant, x, _ = extended(some.plant, some.fit.x, [name] * bool(name))
                with suppress(InvalidInput):
                    again = partial(fit, plant, some.windows, x, some.fit.states, loss=some.fit.loss)
                    self._refits[name] = replace(some, plant=plant, fit=again(rounds=REFIT.rounds, enough=REFIT.enough))
        found = self._refits[name]
        if covariance and found is not None and found.information is self.information:
            own = estimate_covariance(found.plant, found.windows, found.fit)
            found = self._refits[name] = replace(found, information=own)
        return found

    def pieces(self, budget: Budget) -> list[Piece]:
        """Return the windows' residuals, with all directions that the fit absorbs, the 2n of the state first."""
        mean = sensitivities(self.windows, self.fit)[1]
        models = window_models(self.plant, self.windows, self.fit, mean, budget)
        return [each.piece(self.information.root) for each in models]

    def intervals(self, level: float = LEVEL) -> dict[str, Interval]:
        """Return intervals of all free parameters by label, from their standard deviations, within bounds."""
        information = self.information
        stds = information.deviations(np.ones(information.x.size))
        freedom = freedom_with(information.freedom, stds, information.declared.model_spread(np.eye(information.x.size)))
        each = zip(self.plant.parameters.all, information.x, stds, freedom, strict=True)
        return {p.label: interval(float(x), std, more, p.least, level, p.value) for p, x, std, more in each}
