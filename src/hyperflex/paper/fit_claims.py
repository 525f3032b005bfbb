"""The paper's claims on identification (section III), each measured against a threshold on its twin."""

from __future__ import annotations

from hyperflex.paper.casting_claims import Claim
from hyperflex.paper.identification import FEW, FRICTION, INERTIA, SEED, SWINGS, Swing, methods, revised, whole_error

SETTLED = 3  # revisions: "two or three rounds"
DEVIATIONS = 2.0  # standard deviations within which J and eta must lie: 95 % for each
FEWER = 1.15  # E of the fit to 22 samples over that of the fit to all


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
