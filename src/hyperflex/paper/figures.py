"""The numbers behind the paper's Figs. 9 to 12, one table a figure, for every reading and both outcomes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.paper.casting import OUTCOMES, READINGS, T_MOVE, T_REST, TIME_CONSTANT, Cast, Outcome, Reading, cast

TABLE_RATE = 100  # rows per second


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length with what a reader of the file must know.

    Attributes
    ----------
    name : str
        "fig10" and the like; the stem of file names.
    title : str
        What it shows.
    columns : dict of str to (T,) float64
        Values by column name.
    notes : dict of str to str
        Units, source and parameters.
    """

    name: str
    title: str
    columns: dict[str, Array]
    notes: dict[str, str]


def casts() -> dict[tuple[Reading, Outcome], Cast]:
    """Return success and failure in the four readings."""
    return {(reading, outcome): cast(reading, outcome) for reading in READINGS for outcome in OUTCOMES}


def fig9() -> Table:
    """Arm angle against time (Fig. 9)."""
    columns = {}
    for (reading, outcome), subject in _one_friction():
        columns[f"arm_{reading.path}_{outcome}"] = _thin(subject, subject.arm_angle)
    return _table("fig9", "arm angle", columns, "t in s; arm in rad")


def fig10() -> Table:
    """Tip position against time (Fig. 10)."""
    columns = {}
    for (reading, outcome), subject in casts().items():
        for axis, name in enumerate("xy"):
            columns[f"{name}_{reading.key}_{outcome}"] = _thin(subject, subject.tip[:, axis])
    return _table("fig10", "tip position", columns, "t in s; x, y in m")


def fig11() -> Table:
    """Spiral coordinates of the tip against time (Fig. 11)."""
    columns = {}
    for (reading, outcome), subject in casts().items():
        columns[f"r_{reading.key}_{outcome}"] = _thin(subject, subject.spiral.r)
        columns[f"theta_{reading.key}_{outcome}"] = _thin(subject, subject.spiral.theta)
    for (reading, outcome), subject in _one_friction():
        columns[f"arm_{reading.path}_{outcome}"] = _thin(subject, subject.arm_angle)
    return _table("fig11", "spiral coordinates of the tip", columns, "t in s; r in m; theta, arm in rad")


def fig12() -> Table:
    """Phase portrait of the tip (Fig. 12); ``moving`` is 1 while the arm moves and 0 while it rests."""
    columns = {}
    for (reading, outcome), subject in casts().items():
        columns[f"x_{reading.key}_{outcome}"] = _thin(subject, subject.spiral.x)
        columns[f"cxd_{reading.key}_{outcome}"] = _thin(subject, subject.spiral.scaled_velocity)
    for outcome in OUTCOMES:
        subject = cast(READINGS[0], outcome)
        moves = (subject.t % subject.period < T_MOVE).astype(np.float64)
        columns[f"moving_{outcome}"] = _thin(subject, moves)
    return _table("fig12", "phase portrait of the tip", columns, "t in s; x, cxd (c times the velocity) in m")


def _one_friction() -> Iterator[tuple[tuple[Reading, Outcome], Cast]]:
    """Yield the casts of the physical friction only, for what does not depend on it."""
    yield from ((key, subject) for key, subject in casts().items() if key[0].friction == "relative")


def _table(name: str, title: str, columns: dict[str, Array], units: str) -> Table:
    parameters = "; ".join(
        f"{outcome}: t_a = {T_MOVE} s, t_c = {T_REST[outcome]} s, c = {TIME_CONSTANT[outcome]} s"
        for outcome in OUTCOMES
    )
    time = {"t": _thin(cast(READINGS[0], "success"), cast(READINGS[0], "success").t)}
    notes = {"title": title, "source": "simulated", "units": units, "parameters": parameters}
    return Table(name, title, {**time, **columns}, notes)


def _thin(subject: Cast, values: Array) -> Array:
    step = round(1.0 / (TABLE_RATE * (subject.t[1] - subject.t[0])))
    return values[::step]
