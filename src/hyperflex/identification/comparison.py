"""Evidence for models: BIC and held-out prediction, and the recommendation from both."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks, extras, files
from hyperflex.budget import Budget, one_thread
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, Interrupted, InvalidInput
from hyperflex.files import PathLike
from hyperflex.identification.model.parameters import GRAVITY, scales
from hyperflex.identification.options import FitOptions, RecordingSetup
from hyperflex.identification.pipeline import TIME_BUDGET, identify
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import DAMPING, FREE_PROPERTIES, MOST_LINKS, RESISTANCES, Rope, parse_label, recut
from hyperflex.recording import Recording
from hyperflex.status import Status

if TYPE_CHECKING:
    import xarray as xr


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


@dataclass(frozen=True, eq=False)
class FittedModel:
    """One candidate and its evidence.

    Attributes
    ----------
    name, free : str, tuple of str
        Its name, and what was free.
    links, parameters : int
        Numbers of links, and of free parameters that can be known.
    identification : Identification or None
        None where the fit failed.
    reason : str
        Why it failed, or why it cannot be compared; empty if all went well.
    bic : float or None
        Bayesian information criterion; None where other samples were fitted than in the rest.
    fit_rms, held_out_rms : float, rad or m
        Error of the fit, and of the prediction of the part held out (inf: it failed, or nothing was held out).
    whiteness : float
        p-value of the residuals' autocorrelation under white noise.
    """

    name: str
    free: tuple[str, ...]
    links: int
    identification: Identification | None = None
    reason: str = ""
    parameters: int = 0
    bic: float | None = None
    fit_rms: float = float("inf")
    held_out_rms: float = float("inf")
    whiteness: float = float("nan")


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Models of a rope compared by :func:`hyperflex.compare_models`; ``print`` shows the table and why.

    Attributes
    ----------
    models : tuple of FittedModel
        In the order in which they were given, those that failed included.
    preferred, recommendation : str or None, str
        Name of the model that the evidence prefers, None if none could be fitted; and why, in words.
    unit : str
        Of the errors: ``rad`` or ``m``.
    ended : Status or None
        INTERRUPTED or OUT_OF_TIME where not all candidates could be fitted to their end.
    """

    models: tuple[FittedModel, ...]
    preferred: str | None
    recommendation: str
    unit: str
    ended: Status | None = None

    def __getitem__(self, name: str) -> FittedModel:
        for model in self.models:
            if model.name == name:
                return model
        raise KeyError(name)

    @property
    def status(self) -> Status:
        """SUCCESS if all candidates were tried and one is preferred."""
        return self.ended or (Status.FAILED if self.best is None else Status.SUCCESS)

    @property
    def success(self) -> bool:
        """Whether all candidates were tried and one is preferred."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why the comparison failed; empty on success."""
        return "" if self.success else f"{self.status}: {self.recommendation}"

    @property
    def best(self) -> Identification | None:
        """The identification of the preferred model."""
        return None if self.preferred is None else self[self.preferred].identification

    @property
    def dataset(self) -> "xr.Dataset":
        """The table as an ``xarray.Dataset`` over the dimension model; NaN for missing values."""
        extras.require(("xarray",), "xarray", "Datasets")
        import xarray as xr

        columns: dict[str, Any] = {}
        for name, unit, about in (
            ("links", "1", "number of links"),
            ("parameters", "1", "identifiable free parameters"),
            ("bic", "1", "Bayesian information criterion, smaller is better"),
            ("fit_rms", self.unit, "error of the fit"),
            ("held_out_rms", self.unit, "error of predicting the held-out part"),
            ("whiteness", "1", "probability of residuals as autocorrelated as these under white noise"),
        ):
            values = [getattr(model, name) for model in self.models]
            numbers = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
            columns[name] = ("model", numbers, {"units": unit, "long_name": about})
        names = [model.name for model in self.models]
        return xr.Dataset(columns, {"model": names}, {"preferred": self.preferred or ""})

    def summary(self) -> dict[str, Any]:
        """Return the table, the preference and the texts as plain numbers, lists and strings; None for no number."""
        names = ("name", "links", "parameters", "bic", "fit_rms", "held_out_rms", "whiteness", "reason")
        table = [{name: getattr(m, name) for name in (*names, "free")} for m in self.models]
        result: dict[str, Any] = {"success": self.success, "status": self.status, "message": self.message}
        result |= {"preferred": self.preferred, "unit": self.unit}
        return dict(files.plain(result | {"recommendation": self.recommendation, "models": table}))

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def __str__(self) -> str:
        wide = max([5, *(len(model.name) for model in self.models)])
        least = min((m.bic for m in self.models if m.bic is not None), default=0.0)
        head = f"{'model':<{wide}}  links  parameters  BIC over best  fit, m{self.unit}  held out, m{self.unit}  white"
        lines = [f"Models compared ({self.status})", f"  {head}"]
        lines += [f"  {_row(model, wide, least, len(self.unit))}" for model in self.models]
        return "\n".join([*lines, f"  {self.recommendation}"])


def _row(model: FittedModel, wide: int, least: float, unit: int) -> str:
    start = f"{model.name:<{wide}}  {model.links:5d}"
    if model.identification is None:
        return f"{start}  failed: {model.reason}"
    above = "-" if model.bic is None else f"{model.bic - least:.1f}"
    white = f"{'yes' if model.whiteness >= SUPPORT.coloured else 'no'} ({probability(model.whiteness)})"
    held = f"{1e3 * model.held_out_rms:.3f}" if np.isfinite(model.held_out_rms) else "-"
    fit = f"{1e3 * model.fit_rms:.3f}"
    mark = f"  {model.reason}" if model.reason else ""
    return f"{start}  {model.parameters:10d}  {above:>13}  {fit:>{6 + unit}}  {held:>{11 + unit}}  {white}{mark}"


WORSE = 1.001  # ratio of costs: within it fits have reached the same optimum, as far as they go
SLIGHT = 0.1  # of its scale, what a guess has none of at the start
MAX_ADDED = 2  # resistances beside viscous friction in one candidate


@dataclass(frozen=True)
class Candidate:
    """A model to be fitted: a name, a guess and the words of ``free``."""

    name: str
    guess: Rope
    free: tuple[str, ...]

    def nested_in(self, other: "Candidate") -> bool:
        """Whether `other` frees all that is free here, and more."""
        return set(self.free) < set(other.free) and self.guess.n_links == other.guess.n_links

    def starting_guess(self, other: "Candidate", rope: Rope) -> Rope:
        """Return the guess of `other` with the values fitted here, of `rope`; laws keep their guess."""
        labels = [label for word in self.free if (label := parse_label(word)) and label.law in ("", "shared", "inner")]
        names = {label.name for label in labels if FREE_PROPERTIES[label.name].owner in ("link", "rope")} - set(GRAVITY)
        return other.guess.replace(**{name: getattr(rope, name) for name in sorted(names)})


Done = tuple[Candidate, Identification | str]  # a fit, or why it failed


@interruptible(ModelComparison)
@one_thread()
def compare_models(
    recording: Recording,
    rope_guess: Rope,
    models: Mapping[str, object] | None = None,
    *,
    free: Sequence[str] = ("inertia", "friction"),
    links: Sequence[int] = (),
    setup: RecordingSetup | None = None,
    options: FitOptions | None = None,
    time_budget: float | Budget | None = None,
    progress: bool = False,
) -> ModelComparison:
    """Fit several models to one recording and select the one that the evidence prefers.

    Parameters
    ----------
    recording : Recording
        As :func:`hyperflex.identify` takes it.
    rope_guess : Rope
        As for :func:`hyperflex.identify`; in the default models, resistances that are not free are 0.
    models : mapping, optional
        Names to what is free (words as in ``identify``), or to a pair of a guess and what is free. By default the
        viscous rope, alone and with one or two of dry friction, stiffness and air drag beside; and dry friction, air
        drag or both in place of the viscous one.
    free : sequence of str
        What is free in the viscous rope; used where `models` is not given.
    links : sequence of int
        Further numbers of equal links into which the guess is cut, with what is free in the first model. Needs markers.
    setup, options : RecordingSetup, FitOptions, optional
        As for :func:`hyperflex.identify`, the same for all candidates; no intervals are computed.
    time_budget : float or Budget, optional
        Seconds by the clock, without compiling, of which each candidate gets an equal share of what remains; by default
        1800 for each. Out of time, the candidates fitted until then are compared, with ``status`` OUT_OF_TIME.
    progress : bool
        Show a bar over the candidates on standard error.

    Raises
    ------
    InvalidInput
        For candidates that cannot be read, or numbers of links without markers.
    Interrupted
        By Ctrl-C. Its ``partial`` compares the candidates fitted until then; None before any was.

    Notes
    -----
    A candidate is supported by BIC within 6 of the least, and by held-out prediction if it is not worse than the best
    by 2 % and by two standard errors over the held-out stretches (by 10 % where there are fewer than three). The
    simplest that both support is preferred. Where none is, prediction decides, unless the residuals of BIC's choice are
    white. All candidates must be fitted to the same samples; one that is not has no BIC. A model that fits worse than
    one nested in it has ended in a local minimum, and is fitted again from there.
    """
    checks.instance("recording", recording, Recording)
    checks.instance("rope_guess", rope_guess, Rope)
    links = checks.sequence("links", links, "numbers of links")
    if links and recording.kind != "markers":
        raise InvalidInput(
            "numbers of links can be compared only with markers",
            got=recording.kind,
            allowed="a recording of markers",
            fix="Leave links out: the angles of a recording belong to one number of links",
        )
    setup, options = setup or RecordingSetup(), replace(options or FitOptions(), intervals=None)
    if links and setup.arc_lengths is None:
        setup = replace(setup, arc_lengths=np.append(0.0, np.cumsum(rope_guess.length)))
    todo = candidates(rope_guess, free, models, links)
    budget = Budget.of(TIME_BUDGET * len(todo) if time_budget is None else time_budget)
    done: list[Identification | str] = []
    with stoppable() as stop, budget.progress(progress, "comparing", len(todo), "models"):
        for number, each in enumerate(todo):
            budget.check()
            share = budget.share(1.0 / (len(todo) - number))
            fit: Callable[..., Identification] = partial(identify, recording, setup=setup, time_budget=share)
            try:
                found = fit(each.guess, each.free, options=options)
                options = replace(options, window=found.settings["window"])  # the same for all
                simpler = zip(todo, done, strict=False)
                done.append(_refit_from_nested(partial(fit, options=options), each, found, simpler))
            except HyperflexError as failure:
                done.append(str(failure))
            budget.report(number + 1.0)
    if stop.received and all(isinstance(one, str) for one in done):
        raise Interrupted
    late = any(not isinstance(one, str) and one.ended is Status.OUT_OF_TIME for one in done)
    ended = stop.status or (Status.OUT_OF_TIME if late else None)
    return stop.deliver(_compared(todo[: len(done)], done, ended))


def _refit_from_nested(
    fit: Callable[..., Identification], candidate: Candidate, found: Identification, simpler: Iterable[Done]
) -> Identification:
    """Return a fit no worse than those of models nested in it: where one is better, fitted again from there."""
    cost = found.basis.fit.cost
    for other, before in simpler:
        if isinstance(before, str) or not other.nested_in(candidate):
            continue
        if before.residual_t.size == found.residual_t.size and WORSE * before.basis.fit.cost < cost:
            again = fit(other.starting_guess(candidate, before.rope), candidate.free)
            if again.basis.fit.cost < cost:
                found, cost = again, again.basis.fit.cost
    return found


def _compared(todo: Sequence[Candidate], done: Sequence[Identification | str], ended: Status | None) -> ModelComparison:
    fits = [each.basis for each in done if not isinstance(each, str) and each.converged]
    scores = dict(zip(map(id, fits), criteria(fits) if fits else [], strict=True))
    models, evidence, unit = [], [], "rad"
    for each, found in zip(todo, done, strict=True):
        if isinstance(found, str):
            models.append(FittedModel(each.name, each.free, each.guess.n_links, reason=found))
            continue
        model = _fitted_model(each, found, scores.get(id(found.basis)))
        models.append(model)
        unit = found.unit
        unknowns = model.parameters + sum(window.unknowns for window in found.basis.windows)
        evidence.append(Evidence(each.name, unknowns, model.bic, found.held_out, model.whiteness))
    preferred, words = recommend(evidence, unit)
    return ModelComparison(tuple(models), preferred, words, unit, ended)


def _fitted_model(candidate: Candidate, found: Identification, bic: float | None) -> FittedModel:
    reason = "" if bic is not None else "it was fitted to other samples than the rest, so its BIC is not comparable"
    information = found.basis.information
    return FittedModel(
        candidate.name,
        candidate.free,
        candidate.guess.n_links,
        found,
        reason if found.converged else "the fit did not converge",
        information.known.shape[1],
        bic,
        found.residual_rms_all,
        error(found.held_out),
        information.whiteness,
    )


def candidates(
    guess: Rope, free: Sequence[str], models: Mapping[str, object] | None, links: Sequence[int]
) -> list[Candidate]:
    """Return the candidates, made of the arguments of :func:`compare_models`."""
    if models is None:
        result = _resistances(guess, free)
    elif not isinstance(models, Mapping) or not models:
        raise InvalidInput("models contains no candidates", got=models, allowed="a mapping of names to what is free")
    else:
        result = [_own(str(name), guess, value) for name, value in models.items()]
    simplest = result[0]
    for count in links:
        n = checks.count("links", count, most=MOST_LINKS)
        if n != guess.n_links:
            result.append(Candidate(f"{n} links", recut(simplest.guess, n), simplest.free))
    names = [each.name for each in result]
    if len(set(names)) < len(names):
        raise InvalidInput("two candidates have one name", got=names, allowed="each name once")
    return result


def _own(name: str, guess: Rope, value: object) -> Candidate:
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], Rope):
        guess, value = value
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InvalidInput(
            f"candidate {name!r} cannot be used", got=value, allowed="what is free, or a pair (guess, what is free)"
        )
    return Candidate(name, guess, tuple(value))


def _resistances(guess: Rope, free: Sequence[str]) -> list[Candidate]:
    """Return the viscous rope, alone and with one or two resistances added; and what else damps in its place.

    What is not free is 0 in them, but viscous friction that is not in `free`, which all have as given.
    """
    free = checks.sequence("free", free, "names of parameters, such as ['inertia', 'friction']")
    own: dict[str, tuple[str, ...]] = {}
    for word in free:
        label = parse_label(word)
        own.setdefault(label.name if label else "", ())
        own[label.name if label else ""] += (word,)
    viscous, *added = RESISTANCES
    law = ":shared" if ":" in "".join(own.get(viscous.name, ())) else ""
    for each in added:  # started from 0 it may stay there: a joint that never sticks tells little of dry friction
        if each.least and not getattr(guess, each.name).any():
            guess = guess.replace(**{each.name: SLIGHT * scales(guess, each.name)})
    sets = [more for count in range(MAX_ADDED + 1) for more in combinations(added, count)]
    chosen = [(viscous, *more) for more in sets]
    varied = [*added, viscous] if viscous.name in own else added
    if viscous in varied:
        chosen += [those for those in sets if those and all(each.name in DAMPING for each in those)]
    plain = tuple(word for name, words in own.items() for word in words if name not in [each.name for each in varied])
    result = []
    for those in chosen:
        words = [word for each in those if each in varied for word in own.get(each.name, (each.name + law,))]
        absent = {each.name: 0.0 for each in varied if each not in those}
        name = " + ".join(each.field for each in those)
        result.append(Candidate(name, guess.replace(**absent), (*plain, *words)))
    return result
