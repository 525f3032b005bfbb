"""Results on identification (section III): Tables I, II, tables behind Figs. 3, 5, 6, and the claims C6 and C7."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification import natural_period, swing_period
from hyperflex.model import Rope
from hyperflex.paper.identification import (
    COUNTS,
    FEW,
    FINER,
    FRICTION,
    INERTIA,
    LENGTH,
    LINK_MASS,
    LINKS,
    NOISE,
    POINTS,
    RATE,
    SEED,
    SMALL,
    SWINGS,
    Swing,
    guess,
    methods,
    motion,
    per_sample,
    record,
    revised,
    true_rope,
    whole_error,
)
from hyperflex.paper.results import Claim, Table

SETTLED = 3  # revisions: "two or three rounds"
DEVIATIONS = 2.0  # standard deviations within which J and eta must lie: 95 % for each
FEWER = 1.15  # E of the fit to 22 samples over that of the fit to all
_FRAMES = 40  # of calculated curves, in each second
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


def residuals(swing: Swing, rope: Rope, start: Array) -> Array:
    """Return the last link's measured less calculated angles (81,), rad, of a run from rest at angles `start` (n,)."""
    recording = record(swing)
    return np.asarray(recording.data[:, -1] - motion(rope, np.append(start, np.zeros(LINKS)), recording.t)[:, -1])


def start_residuals(swing: Swing) -> dict[str, Array]:
    """Return the residuals of the revised rope from the measured and from the optimised initial angles (Fig. 3)."""
    found = revised(swing)
    return {
        "measured": residuals(swing, found.rope, record(swing).data[0]),
        "optimised": residuals(swing, found.rope, found.best.q),
    }


def fig5_curves() -> list[tuple[Array, Array, Array]]:
    """Return the curves with the first guess, from the initial angles that suit it best, and after the revision.

    Each a time (m,), s, the angle of the last link then (m,), rad, and its residuals at the samples (81,), rad.
    """
    found, first = revised(SMALL), revised(SMALL).rounds[0]
    end = record(SMALL).t[-1]
    t = np.linspace(0.0, end, round(end * _FRAMES) + 1)
    guessed = found.rope.replace(inertia=np.full(LINKS, first.inertia), friction=np.full(LINKS, first.friction))
    return [
        (t, motion(rope, np.append(start, np.zeros(LINKS)), t)[:, -1], residuals(SMALL, rope, start))
        for rope, start in ((guessed, first.q), (found.rope, found.best.q))
    ]


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


def settles(swing: Swing) -> Claim:
    """C6: the revision settles within two or three rounds. Measured: revisions that still moved J or eta."""
    found = revised(swing)
    moved = found.converged_after
    steps = ", ".join(f"{1e6 * each.inertia:.3g}" for each in found.rounds)
    frictions = ", ".join(f"{1e3 * each.friction:.3g}" for each in found.rounds)
    note = f"J {steps} e-6 kg m^2; eta {frictions} e-3 N m s/rad; {found.seconds:.1f} s, {found.evaluations} rollouts"
    count = float("inf") if moved is None else float(moved)
    return Claim("C6", "IR settles: revisions that moved J or eta", swing, count, SETTLED, note, "<=")


def finds_the_truth(swing: Swing, seed: int = SEED) -> Claim:
    """C6: J and eta lie within their uncertainty of the truth. Measured: the larger distance in standard deviations."""
    found = revised(swing, seed=seed)
    inertia = abs(found.best.inertia - INERTIA) / found.sd["inertia"]
    friction = abs(found.best.friction - FRICTION) / found.sd["friction"]
    note = (
        f"J = {1e6 * found.best.inertia:.3f} +- {1e6 * found.sd['inertia']:.3f} e-6 kg m^2 (true {1e6 * INERTIA:.3f}), "
        f"eta = {1e3 * found.best.friction:.3f} +- {1e3 * found.sd['friction']:.3f} e-3 N m s/rad "
        f"(true {1e3 * FRICTION:.3f}); J's relative sd is {found.sd['inertia'] / INERTIA:.2f}"
    )
    statement = "J and eta are the true ones: distance in standard deviations"
    return Claim("C6", statement, swing, max(inertia, friction), DEVIATIONS, note, "<=")


def in_order(swing: Swing) -> Claim:
    """C6: the errors are in the order NF > CM > IR. Measured: the smaller of the two ratios."""
    error = {method.name: method.error for method in methods(swing)}
    ratio = min(error["NF"] / error["CM"], error["CM"] / error["IR"])
    note = ", ".join(f"{name} {value:.3g}" for name, value in error.items()) + " rad^2"
    return Claim("C6", "errors NF > CM > IR: smaller ratio of neighbours", swing, ratio, 1.0, note)


def few_samples_do(swing: Swing) -> Claim:
    """C7: 22 of 81 samples suffice. Measured: E over all samples, of the fit to 22 over that of the fit to all."""
    few, full = whole_error(swing, revised(swing, FEW)), whole_error(swing, revised(swing))
    note = f"{few:.4f} against {full:.4f} rad^2 (the paper: 0.046 against 0.040)"
    return Claim("C7", "22 of 81 samples: ratio of errors over all samples", swing, few / full, FEWER, note, "<=")


def identification_claims() -> list[Claim]:
    """Measure C6 and C7 on the small and the wide swing."""
    return [measure(swing) for measure in (settles, finds_the_truth, in_order, few_samples_do) for swing in SWINGS]
