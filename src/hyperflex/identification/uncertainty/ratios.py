"""Ratios over the first moment p1, which a motion without known forces determines, and their standard deviations."""

from collections.abc import Collection

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.model import Parameter, Parameters, lumped
from hyperflex.identification.uncertainty.covariance import Information
from hyperflex.model import RESISTANCES, Rope


def ratios(rope: Rope, free: Collection[str] = ()) -> dict[str, Array]:
    """Return the ratios over p1 = p of link 0 that are identifiable without known forces, each (n,).

    ``J/p1`` (m), ``p/p1``, ``c/p1`` (m/s), and of the other resistances those that the rope has or that are `free`:
    ``tau_d/p1`` and ``k/p1`` (m/s^2), ``d/p1`` (1/m^3).
    """
    p, inertia = lumped(rope)
    resistances = {each.symbol: getattr(rope, each.name) for each in RESISTANCES}
    shown = {each.symbol for each in RESISTANCES if each.name in free or each.symbol == "c"}
    resistances = {name: value for name, value in resistances.items() if name in shown or value.any()}
    return {f"{name}/p1": value / p[0] for name, value in {"J": inertia, "p": p, **resistances}.items()}


def ratio_gradients(parameters: Parameters, x: Array) -> dict[str, Array]:
    """Return the derivatives (n, P) of each ratio by x (P,)."""
    every = tuple(each.name for each in RESISTANCES)
    names = ratios(parameters.rope(x), parameters.names)
    step = 1e-6
    columns = []
    for k in range(x.size):
        up, down = x.copy(), x.copy()
        up[k] += step
        down[k] = max(x[k] - step, parameters.lower[k])
        above, below = (ratios(parameters.rope(end), every) for end in (up, down))
        columns.append({name: (above[name] - below[name]) / (up[k] - down[k]) for name in names})
    return {name: np.stack([c[name] for c in columns], axis=1) for name in names}


def ratio_spread(parameters: Parameters, information: Information, *, model: bool = False) -> dict[str, Array]:
    """Return standard deviations (n,) of each ratio by the delta method; inf where it cannot be known.

    With `model` only the part that errors of the model, lengths and clock have. Ratios of what was held have none.
    """
    every = tuple(range(parameters.guess.n_links))
    stretched = Parameter("length", every, "length:factor", 1.0, 1.0, "factor")
    gradients = ratio_gradients(Parameters(parameters.guess, [*parameters.all, stretched]), np.append(information.x, 0))
    spread = information.model_spread if model else information.spread
    return {
        name: spread(each[:, :-1], np.where(each[:, :-1].any(axis=1), each[:, -1], 0.0))
        for name, each in gradients.items()
    }
