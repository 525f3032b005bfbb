"""Evidence for models: BIC and held-out prediction, and the recommendation from both."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.uncertainty.covariance import Basis


@dataclass(frozen=True)
class EvidenceOptions:
    """When evidence prefers a model."""

    # difference of BIC from which evidence is strong (Kass and Raftery 1995, doi:10.2307/2291091)
    strong: float = 6.0
    # probabilities below it are not told apart
    tiny: float = 1e-09
    # probability below which residuals are no white noise
    coloured: float = 0.01
    # standard errors by which a prediction must be worse on the mean to count as worse
    clear: float = 2.0
    # predicted stretches, fewer have no standard error to speak of
    few: int = 3
    # ratio of rms errors below which a difference is too small to matter
    matters: float = 1.02
    # ratio of rms errors within which predictions are as good as each other, where there are few
    alike: float = 1.1


SUPPORT = EvidenceOptions()


@dataclass(frozen=True)
class Evidence:
    """Evidence for a model. A model with fewer `unknowns` is simpler; None if it cannot be compared."""

    name: str
    unknowns: float
    bic: float | None
    held_out: HeldOut | None
    whiteness: float


def criteria(fits: Sequence[Basis]) -> list[float | None]:
    """Return the BIC of each fit; None where it fits other samples than the one with the most.

    N ln(s^2) + sum of ln N over the identifiable parameters (Schwarz 1978, doi:10.1214/aos/1176344136), s^2 the mean
    weighted square. A window's initial state counts ln of that window's own number of values. Values count as N / tau,
    tau the shortest integrated autocorrelation time among the candidates. With a robust loss the squares are what the
    loss makes of them, over the least scale among the candidates.
    """
    sizes = [np.concatenate([window.t for window in one.windows]) for one in fits]
    whole = max(sizes, key=lambda t: t.size)
    width = fits[int(np.argmax([t.size for t in sizes]))].windows[0].y.shape[1]
    tau = min(one.information.correlation for one in fits)
    scale = min(one.fit.loss.scaled(one.fit.residuals).scale for one in fits)
    result: list[float | None] = []
    for one, t in zip(fits, sizes, strict=True):
        same = np.array_equal(t, whole) and one.windows[0].y.shape[1] == width
        result.append(_criterion(one, tau, scale) if same else None)
    return result


def _criterion(one: Basis, tau: float, scale: float) -> float:
    values = np.array([window.values for window in one.windows])
    count = float(values.sum()) / tau
    cost = sum(one.fit.loss.scaled([]).cost(residual) for residual in one.fit.residuals)
    if one.fit.loss.name == "squares":
        misfit = count * float(np.log(cost / values.sum()))
    else:
        misfit = cost / (tau * scale**2)
    states = np.array([window.unknowns for window in one.windows])
    known = one.information.known.shape[1]
    of_states = float((states * np.log(np.maximum(values / tau, 1.0))).sum())
    return float(misfit + known * np.log(count) + of_states)


def why_alike(one: HeldOut | None, best: HeldOut | None) -> str:
    """Return why `one` does not predict clearly worse than `best`; "" if it does."""
    if one is None or best is None or not np.isfinite(_squares(one)).all():
        return ""
    mine, other = _squares(one), _squares(best)
    if mine.size < SUPPORT.few or mine.size != other.size:
        near = np.sqrt(mine.mean()) <= SUPPORT.alike * np.sqrt(other.mean())
        few = (
            f"with so little held-out data a difference below {100.0 * (SUPPORT.alike - 1.0):.0f} % is not significant"
        )
        return few if near else ""
    if mine.mean() <= SUPPORT.matters**2 * other.mean():
        return f"a difference below {100.0 * (SUPPORT.matters - 1.0):.0f} % is irrelevant"
    gap = mine - other
    if gap.mean() > SUPPORT.clear * gap.std(ddof=1) / np.sqrt(gap.size):
        return ""
    chance = f"over the {mine.size} predicted stretches the difference is not significant"
    return f"{chance} (less than {SUPPORT.clear:g} standard errors)"


def error(held_out: HeldOut | None) -> float:
    """Return the rms prediction error over channels and stretches, rad or m; inf without a prediction."""
    return float("inf") if held_out is None else float(np.sqrt(_squares(held_out).mean()))


def _squares(held_out: HeldOut) -> Array:
    """Return the mean square of each stretch (W,)."""
    return np.asarray(np.nanmean(held_out.window_rms**2, axis=1))


def recommend(all_of_them: Sequence[Evidence], unit: str) -> tuple[str | None, str]:
    """Return the preferred model and why, in words; the simplest one where evidence does not decide."""
    known = [each for each in all_of_them if each.bic is not None]
    if not known:
        return None, "No candidate could be fitted."
    if len(known) == 1:
        return known[0].name, f"Only {known[0].name} could be fitted: there is no comparison."
    least = min(known, key=lambda each: each.bic or 0.0)
    likely = [each for each in known if _bic(each) - _bic(least) < SUPPORT.strong]
    predicted = [each for each in known if np.isfinite(error(each.held_out))]
    first = min(likely, key=lambda each: each.unknowns)
    if not predicted:
        alone = "There is no held-out prediction, so only fits were compared."
        return first.name, f"{_by_bic(first, known)} {alone}{_hue(first)}"
    nearest = min(predicted, key=lambda each: error(each.held_out))
    alike = {each.name: why_alike(each.held_out, nearest.held_out) for each in predicted}
    good = [each for each in predicted if alike[each.name]]
    both = [each for each in likely if each in good]
    if both:
        chosen = min(both, key=lambda each: each.unknowns)
        also = "best of all."
        if chosen is not nearest:
            also = f"not clearly worse than {nearest.name} ({_error(nearest, unit)}): {alike[chosen.name]}."
        return chosen.name, f"{_by_bic(chosen, known)} Prediction error {_error(chosen, unit)}, {also}{_hue(chosen)}"
    simple = min(good, key=lambda each: each.unknowns)
    chosen = simple if first.whiteness < SUPPORT.coloured else first
    why = "are not white noise, which BIC requires" if chosen is simple else "are white noise, as BIC requires"
    return chosen.name, (
        f"BIC and prediction disagree: BIC prefers {first.name}, held-out prediction prefers {simple.name} "
        f"({_error(simple, unit)} against {_error(first, unit)}). The residuals of {first.name} {why}, "
        f"so {chosen.name} is preferred; a longer recording would decide.{_hue(chosen)}"
    )


def _bic(each: Evidence) -> float:
    return float("inf") if each.bic is None else each.bic


def _by_bic(chosen: Evidence, known: Sequence[Evidence]) -> str:
    rest = min(_bic(each) for each in known if each is not chosen)
    ahead = rest - _bic(chosen)
    next_one = next(each for each in known if each is not chosen and _bic(each) == rest)
    if ahead >= SUPPORT.strong:
        return f"{chosen.name}: BIC is lower by {ahead:.0f} than that of the next, {next_one.name}."
    what = "lower" if ahead >= 0.0 else "higher"
    weak = f"{chosen.name}: BIC is {what} than that of {next_one.name} by only {abs(ahead):.1f}: no strong evidence"
    return f"{weak}." if ahead >= 0.0 else f"{weak}, and it is the simpler of the two."


def probability(value: float) -> str:
    """Return a p-value as text."""
    return f"p = {value:.2g}" if value >= SUPPORT.tiny else f"p < {SUPPORT.tiny:.0e}"


def _hue(chosen: Evidence) -> str:
    """Return a warning if the residuals of the preferred model are more than noise."""
    if chosen.whiteness >= SUPPORT.coloured:
        return ""
    return f" But its residuals are not white noise ({probability(chosen.whiteness)}): all candidates omit an effect."


def _error(each: Evidence, unit: str) -> str:
    return f"{1e3 * error(each.held_out):.3g} m{unit}"
