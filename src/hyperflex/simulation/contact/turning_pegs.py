"""Pegs that turn: their start, coasting in free flight, and output."""

from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Setup, round_places
from hyperflex.trajectory import State

SHOWN = ("peg_angle", "peg_rate")  # of a State, and of a Trajectory


def starting_spin(setup: Setup, state: State | None) -> Array:
    """Return angles, rad, and rates, rad/s, of all obstacles at the start (2, m): 0 unless a state says otherwise."""
    places = round_places(setup.pegs)
    spin = np.zeros((2, setup.contacts().reach.size))
    for row, name in enumerate(SHOWN):
        given = None if state is None else getattr(state, name)
        if given is None:
            continue
        values = checks.array(f"state {name}", given, (len(places),), unit=("rad", "rad/s")[row])
        fixed = [k for k, place in enumerate(places) if values[k] != 0.0 and np.isinf(setup.contacts().inertia[place])]
        if fixed:
            raise InvalidInput(
                f"state {name} turns a fixed peg",
                got=float(values[fixed[0]]),
                allowed="0",
                fix="Give the peg an inertia",
            )
        spin[row, places] = values
    return spin


def coast(setup: Setup, spin: Array, spans: Array) -> tuple[Array, Array]:
    """Return what pegs that nothing touches do: exponential decay of their rates, exactly.

    `spin` (2, m) are angles, rad, and rates, rad/s, before; the answer (k, 2, m) is for the times since then, `spans`
    (k,), s, and comes with the energy (k,) that the axles took meanwhile, J.
    """
    pegs = setup.contacts()
    turns = np.isfinite(pegs.inertia)
    inertia = np.where(turns, pegs.inertia, 1.0)
    x = spans[:, None] * pegs.bearing / inertia
    mean = np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
    spins = np.empty((spans.size, *spin.shape))
    spins[:, 0] = spin[0] + spans[:, None] * mean * spin[1]
    spins[:, 1] = np.exp(-x) * spin[1]
    return spins, np.asarray((-0.5 * np.expm1(-2.0 * x) * np.where(turns, inertia * spin[1] ** 2, 0.0)).sum(axis=1))


def spin_energy(setup: Setup, rates: Array) -> Array:
    """Return the kinetic energy (...,), J, of pegs with rates (..., m), rad/s; what is fixed has none."""
    if not setup.pegs_turn:
        return np.zeros(rates.shape[:-1])
    inertia = setup.contacts().inertia
    turns = np.isfinite(inertia)
    return np.asarray(0.5 * (inertia[turns] * rates[..., turns] ** 2).sum(axis=-1))


def shown(setup: Setup, spin: Array | None) -> dict[str, Any]:
    """Return angles and rates (..., P) of the round pegs by name, from all obstacles (..., 2, m); {} if none turns."""
    if spin is None or not setup.pegs_turn:
        return {}
    turning = np.where(np.isfinite(setup.contacts().inertia), spin, 0.0)[..., round_places(setup.pegs)]
    return {name: turning[..., row, :].copy() for row, name in enumerate(SHOWN)}
