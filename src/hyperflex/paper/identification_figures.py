"""The numbers behind the paper's Tables I and II and Figs. 3, 5 and 6, one table each, for all swings of the twin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import natural_period, swing_period
from hyperflex.paper.figures import Table
from hyperflex.paper.identification import (
    COUNTS,
    FINER,
    FRICTION,
    INERTIA,
    LENGTH,
    LINK_MASS,
    LINKS,
    NOISE,
    POINTS,
    RATE,
    SMALL,
    SWINGS,
    guess,
    methods,
    motion,
    per_sample,
    record,
    revised,
    true_rope,
    whole_error,
)

METHODS = ("NF", "CM", "IR", "IR(theta_0)")
DRAWN = (*SWINGS, *FINER)
CURVES = (*SWINGS, FINER[0])  # of Fig. 6


def table1() -> Table:
    """J, eta and E in each round of the revision (Table I), one row a round, for every swing."""
    rows = [
        (
            swing.angle,
            swing.links,
            number,
            each.inertia,
            each.friction,
            each.error,
            per_sample(each.error),
            each.evaluations,
        )
        for swing in DRAWN
        for number, each in enumerate(revised(swing).rounds)
    ]
    names = ("angle", "data_links", "revision", "inertia", "friction", "error", "error_per_sample", "rollouts")
    return _table("table1", "change of J, eta and E", _columns(names, rows))


def table2() -> Table:
    """J, eta and E of NF, CM and IR (Table II); ``method`` counts them in that order."""
    rows = [
        (swing.angle, swing.links, k, each.rope.inertia[0], each.rope.friction[0], each.error, per_sample(each.error))
        for swing in DRAWN
        for k, each in enumerate(methods(swing))
    ]
    names = ("angle", "data_links", "method", "inertia", "friction", "error", "error_per_sample")
    table = _table("table2", "comparison of NF, CM and IR", _columns(names, rows))
    table.notes["methods"] = "; ".join(f"{k}: {name}" for k, name in enumerate(METHODS))
    table.notes["periods"] = periods_text()
    return table


def fig3() -> Table:
    """Measured and optimised initial angles (Fig. 3), one row a link."""
    columns = {"link": np.arange(1.0, LINKS + 1.0)}
    for swing in SWINGS:
        columns[f"measured_{swing.key}"] = np.array(record(swing).data[0])
        columns[f"optimised_{swing.key}"] = revised(swing).best.q
        columns[f"true_{swing.key}"] = np.full(LINKS, swing.angle)
    return _table("fig3", "measured and optimised initial angles", columns)


def fig5() -> Table:
    """Measured and calculated angles against time (Fig. 5), of every link of the small swing."""
    recording, found = record(SMALL), revised(SMALL)
    calculated = motion(found.rope, np.append(found.best.q, found.best.qd), recording.t)
    columns = {"t": np.array(recording.t)}
    for k in range(LINKS):
        columns[f"measured_{k + 1}"] = np.array(recording.data[:, k])
        columns[f"calculated_{k + 1}"] = calculated[:, k]
    return _table("fig5", "measured and calculated angles", columns)


def fig6() -> Table:
    """E over all samples against the number of samples that the revision used (Fig. 6)."""
    columns = {"samples": np.array(COUNTS, dtype=np.float64)}
    for swing in CURVES:
        made = [revised(swing, count) for count in COUNTS]
        columns[f"error_{swing.key}"] = np.array([whole_error(swing, each) for each in made])
        columns[f"inertia_{swing.key}"] = np.array([each.best.inertia for each in made])
        columns[f"friction_{swing.key}"] = np.array([each.best.friction for each in made])
    return _table("fig6", "identification error against samples used", columns)


def periods_text() -> str:
    """Return T_nat in words: measured on each swing, and computed for the models; the paper's is 1.61 s."""
    seen = "; ".join(f"{swing.title}: {swing_period(record(swing)):.3f} s" for swing in DRAWN)
    models = ", ".join(f"{links} links {natural_period(true_rope(links)):.3f} s" for links in (LINKS, FINER[0].links))
    return f"measured, {seen}; small swings computed, {models}; the paper's 1.61 s"


def _columns(names: tuple[str, ...], rows: Sequence[tuple[float, ...]]) -> dict[str, Array]:
    return dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))


def _table(name: str, title: str, columns: dict[str, Array]) -> Table:
    notes = {
        "title": title,
        "source": "simulated",
        "units": "SI, angles and E in rad and rad^2; error_per_sample is sqrt(E / 81) in 0.01 rad",
        "parameters": (
            f"L = {LENGTH} m, {LINK_MASS} kg a link, J = {INERTIA} kg m^2, eta = {FRICTION} N m s/rad (length and mass "
            f"inferred), first guess J = {guess().inertia[0]:.3g}, eta = {guess().friction[0]:.3g}; {POINTS} samples "
            f"at {RATE} Hz, noise {NOISE} rad rms"
        ),
    }
    return Table(name, title, columns, notes)
