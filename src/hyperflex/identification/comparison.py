"""Models of a rope compared: BIC and held-out prediction, and the recommendation from both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from hyperflex import checks, files
from hyperflex.budget import DEFAULT_TIME, Budget, one_thread
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, Interrupted, InvalidInput
from hyperflex.identification.findings import Kind
from hyperflex.identification.fit import Loss
from hyperflex.identification.model import scales
from hyperflex.identification.options import FitOptions, RecordingSetup
from hyperflex.identification.pipeline import identify
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.ranking import Ranking
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.noise import CHANCE
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import DAMPING, MOST_LINKS, RESISTANCES, Rope, parse_label, with_links
from hyperflex.recording import Recording
from hyperflex.status import Status

STRONG = 6.0  # difference of BIC from which evidence is strong (Kass and Raftery 1995, doi:10.2307/2291091)
CLEAR = 2.0  # standard errors by which a prediction must be worse on the mean to count as worse
FEW = 3  # predicted stretches, fewer have no standard error to speak of
MATTERS = 1.02  # ratio of rms errors below which a difference is too small to matter
EQUALLY_GOOD = 1.1  # ratio of rms errors within which predictions are as good as each other, where there are few
SLIGHT = 0.1  # of its scale, what a guess has none of at the start
COLUMNS = "links", "parameters", "bic", "fit_rms", "held_out_rms", "whiteness"  # of the table
MAX_ADDED = 2  # resistances beside viscous friction in one candidate


@dataclass(frozen=True, eq=False)
class FittedModel:
    """One candidate and its evidence.

    Attributes
    ----------
    name, guess, free : str, Rope, tuple of str
        Its name, what it was fitted from, and what was free.
    identification : Identification or None
        None where the fit failed.
    reason : str
        Why it failed, or why it cannot be compared; empty if all went well.
    parameters : int
        Number of free parameters that can be known.
    unknowns : float
        Identifiable parameters and states; a model with fewer is simpler.
    bic : float or None
        Bayesian information criterion; None where other samples were fitted than in the rest.
    fit_rms : float, rad or m
        Error of the fit.
    held_out : HeldOut or None
        Prediction of the part held out.
    whiteness : float
        p-value of the residuals' autocorrelation under white noise.
    """

    name: str
    guess: Rope
    free: tuple[str, ...]
    identification: Identification | None = None
    reason: str = ""
    parameters: int = 0
    unknowns: float = 0.0
    bic: float | None = None
    fit_rms: float = float("inf")
    held_out: HeldOut | None = None
    whiteness: float = float("nan")

    @property
    def links(self) -> int:
        """Number of links."""
        return self.guess.n_links

    @property
    def held_out_rms(self) -> float:
        """Prediction error over channels and stretches, rad or m; inf without a prediction, and where one failed."""
        return float("inf") if self.held_out is None else float(np.sqrt(_squares(self.held_out).mean()))


def criteria(fits: Sequence[Basis]) -> list[float | None]:
    """Return the BIC of each fit; None where it fits other samples than the one with the most.

    N ln(s^2) + sum of ln N over the identifiable parameters (Schwarz 1978, doi:10.1214/aos/1176344136), s^2 the mean
    weighted square. A window's initial state counts ln of that window's own number of values. Values count as N / tau,
    tau the shortest integrated autocorrelation time among the candidates. With a robust loss the squares are what the
    loss makes of them, over the least scale among the candidates.
    """
    times = [np.concatenate([window.t for window in one.windows]) for one in fits]
    most = int(np.argmax([t.size for t in times]))
    tau = min(one.information.correlation for one in fits)
    name, scale = fits[0].fit.loss.name, min(one.fit.loss.scaled(one.fit.residuals).scale for one in fits)
    return [
        _criterion(one, tau, Loss(name, scale))
        if np.array_equal(t, times[most]) and one.windows[0].y.shape[1] == fits[most].windows[0].y.shape[1]
        else None
        for one, t in zip(fits, times, strict=True)
    ]


def _criterion(one: Basis, tau: float, loss: Loss) -> float:
    values = np.array([window.values for window in one.windows])
    count = float(values.sum()) / tau
    cost = sum(loss.cost(residual) for residual in one.fit.residuals)
    misfit = count * float(np.log(cost / values.sum())) if loss.name == "squares" else cost / (tau * loss.scale**2)
    states = np.array([window.unknowns for window in one.windows])
    of_states = float((states * np.log(np.maximum(values / tau, 1.0))).sum())
    return float(misfit + one.information.known.shape[1] * np.log(count) + of_states)


def predicts_as_well(one: HeldOut | None, best: HeldOut | None) -> bool:
    """Whether `one` does not predict clearly worse than `best`: by 2 %, and by two standard errors over stretches."""
    if one is None or best is None:
        return False
    mine, other = _squares(one), _squares(best)
    if not np.isfinite(mine).all():
        return False
    ratio, gap = float(np.sqrt(mine.mean() / other.mean())), mine - other
    if mine.size < FEW or mine.size != other.size:
        return ratio <= EQUALLY_GOOD
    return bool(ratio <= MATTERS or gap.mean() <= CLEAR * gap.std(ddof=1) / np.sqrt(gap.size))


def _squares(held_out: HeldOut) -> Array:
    """Return the mean square of each stretch (W,)."""
    return np.asarray(np.nanmean(held_out.window_rms**2, axis=1))


def recommend(models: Sequence[FittedModel]) -> tuple[str | None, str]:
    """Return the preferred model and why, in words; the simplest one where evidence does not decide."""
    bic = {each.name: each.bic for each in models if each.bic is not None}
    known = sorted((each for each in models if each.name in bic), key=lambda each: each.unknowns)
    if not known:
        return None, "No candidate could be fitted."
    likely = [each for each in known if bic[each.name] - min(bic.values()) < STRONG]
    nearest = min(known, key=lambda each: each.held_out_rms)
    good = [each for each in known if predicts_as_well(each.held_out, nearest.held_out)]
    both = [each for each in likely if each in good or not good]
    chosen = both[0] if both else likely[0] if likely[0].whiteness >= CHANCE else good[0]
    if len(known) == 1:
        words = f"Only {chosen.name} could be fitted: there is no comparison."
    elif not good:
        words = f"{chosen.name} is preferred by BIC{_also(likely)}; there is no held-out prediction."
    elif both:
        words = f"{chosen.name} is preferred by BIC{_also(likely)} and by held-out prediction{_also(good)}."
    else:
        words = (
            f"BIC prefers {likely[0].name}, whose residuals are {'' if chosen in likely else 'not '}white noise as it "
            f"requires; prediction prefers {good[0].name}. {chosen.name} is preferred; a longer recording would decide."
        )
    if chosen.whiteness < CHANCE:
        words += f" But its residuals are not white noise (p = {chosen.whiteness:.2g}): all candidates omit an effect."
    return chosen.name, words


def _also(alike: Sequence[FittedModel]) -> str:
    """Return that others are as good, of which the simplest is taken."""
    others = ", ".join(each.name for each in alike[1:])
    return f" (others are not clearly worse: {others})" if others else ""


@dataclass(frozen=True, eq=False)
class ModelComparison(Ranking):
    """Models of a rope compared by :func:`hyperflex.compare_models`; ``print`` shows the table and why.

    Attributes
    ----------
    models : tuple of FittedModel
        In the order in which they were given, those that failed included.
    preferred, recommendation : str or None, str
        Name of the model that the evidence prefers, None if none could be fitted; and the reason as text.
    unit : str
        Of the errors: ``rad`` or ``m``.
    ended : Status or None
        INTERRUPTED or OUT_OF_TIME if not all fits were completed.
    """

    models: tuple[FittedModel, ...]
    preferred: str | None
    recommendation: str
    unit: str
    ended: Status | None = None

    def __getitem__(self, name: str) -> FittedModel:
        return {model.name: model for model in self.models}[name]

    @property
    def best(self) -> Identification | None:
        """The identification of the preferred model."""
        return None if self.preferred is None else self[self.preferred].identification

    def summary(self) -> dict[str, Any]:
        """Return the table, the preference and the texts as plain numbers, lists and strings; None for no number."""
        table = [{name: getattr(m, name) for name in ("name", "free", *COLUMNS, "reason")} for m in self.models]
        about = {"preferred": self.preferred, "unit": self.unit, "models": table}
        return dict(files.plain(super().summary() | about))

    def __str__(self) -> str:
        least = min((m.bic for m in self.models if m.bic is not None), default=0.0)
        head = "model", "links", "parameters", "BIC over best", f"fit, m{self.unit}", f"held out, m{self.unit}", "white"
        rows: list[tuple[Sequence[str], str]] = [(head, "")]
        for model in self.models:
            cells, failed = [model.name, str(model.links)], model.identification is None
            if not failed:
                numbers = (
                    None if model.bic is None else model.bic - least,
                    1e3 * model.fit_rms,
                    1e3 * model.held_out_rms,
                )
                shown = (
                    "-" if each is None or not np.isfinite(each) else f"{each:.{digits}f}"
                    for each, digits in zip(numbers, (1, 3, 3), strict=True)
                )
                white = f"{'yes' if model.whiteness >= CHANCE else 'no'} (p = {model.whiteness:.2g})"
                cells += [str(model.parameters), *shown, "-" if np.isnan(model.whiteness) else white]
            rows.append((cells, f"failed: {model.reason}" if failed else model.reason))
        return self._text("Models compared", rows)


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
        For each name the free parameters (as in ``identify``), or a pair of a guess and its free parameters. By default
        the viscous rope, alone and with one or two of dry friction, stiffness and air drag; and dry friction, air drag
        or both instead of viscous friction.
    free : sequence of str
        Free parameters of the viscous rope; used if `models` is not given.
    links : sequence of int
        Further numbers of equal links into which the guess is divided, with the free parameters of the first model.
        Needs markers.
    setup, options : RecordingSetup, FitOptions, optional
        As for :func:`hyperflex.identify`, the same for all candidates; no intervals are computed.
    time_budget : float or Budget, optional
        Wall-clock time, s, without compiling; each candidate gets an equal share of the remainder. By default 1800 for
        each. If the time runs out, the candidates fitted until then are compared, with ``status`` OUT_OF_TIME.
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
    BIC supports a candidate within 6 of the least. Held-out prediction supports one that is not worse than the best by
    2 % and by two standard errors over the held-out stretches (by 10 % if there are fewer than three). The simplest
    candidate that both support is preferred. If there is none, prediction decides, unless the residuals of BIC's choice
    are white. All candidates must be fitted to the same samples; one that is not has no BIC.
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
    setup = checks.instance("setup", RecordingSetup() if setup is None else setup, RecordingSetup)
    options = checks.instance("options", FitOptions() if options is None else options, FitOptions)
    options = replace(options, intervals=None)
    if links and setup.arc_lengths is None:
        setup = replace(setup, arc_lengths=np.append(0.0, rope_guess.link_ends))
    todo = candidates(rope_guess, free, models, links)
    budget = Budget.of(DEFAULT_TIME * len(todo) if time_budget is None else time_budget)
    done: list[FittedModel] = []
    with stoppable() as stop, budget.progress(progress, "comparing", len(todo), "models"):
        for number, each in enumerate(todo):
            budget.check()
            share = budget.share(1.0 / (len(todo) - number))
            try:
                found = identify(recording, each.guess, each.free, setup=setup, options=options, time_budget=share)
                if found.converged:  # in windows of the usual length, not in shorter ones that come first
                    options = replace(options, window=found.settings["window"])  # the same for all
                done.append(replace(each, identification=found))
            except HyperflexError as failure:
                done.append(replace(each, reason=str(failure)))
            budget.report(number + 1.0)
    fits = [one.identification for one in done if one.identification is not None]
    if stop.received and not fits:
        raise Interrupted
    late = any(one.ended is Status.OUT_OF_TIME for one in fits)
    bases = [one.basis for one in fits if one.converged and not one.has(Kind.NOT_ESTIMATED)]
    scores = dict(zip(map(id, bases), criteria(bases) if bases else [], strict=True))
    fitted = tuple(_with_evidence(one, scores) for one in done)
    unit = fits[-1].unit if fits else "rad"
    ended = stop.status or (Status.OUT_OF_TIME if late else None)
    return stop.deliver(ModelComparison(fitted, *recommend(fitted), unit, ended))


def _with_evidence(model: FittedModel, scores: Mapping[int, float | None]) -> FittedModel:
    found = model.identification
    if found is None:
        return model
    model = replace(model, fit_rms=found.residual_rms_all, held_out=found.held_out)
    if found.has(Kind.NOT_ESTIMATED):
        return replace(model, reason="it ended before its standard deviations were found")
    bic, information = scores.get(id(found.basis)), found.basis.information
    reason = "" if bic is not None else "it was fitted to other samples than the rest, so its BIC is not comparable"
    parameters = information.known.shape[1]
    return replace(
        model,
        reason=reason if found.converged else "the fit did not converge",
        parameters=parameters,
        unknowns=parameters + sum(window.unknowns for window in found.basis.windows),
        bic=bic,
        whiteness=information.whiteness,
    )


def candidates(
    guess: Rope, free: Sequence[str], models: Mapping[str, object] | None, links: Sequence[int]
) -> list[FittedModel]:
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
            result.append(FittedModel(f"{n} links", with_links(simplest.guess, n), simplest.free))
    names = [each.name for each in result]
    if len(set(names)) < len(names):
        raise InvalidInput("two candidates have one name", got=names, allowed="each name once")
    return result


def _own(name: str, guess: Rope, value: object) -> FittedModel:
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], Rope):
        guess, value = value
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InvalidInput(
            f"candidate {name!r} cannot be used", got=value, allowed="what is free, or a pair (guess, what is free)"
        )
    return FittedModel(name, guess, tuple(value))


def _resistances(guess: Rope, free: Sequence[str]) -> list[FittedModel]:
    """Return the viscous rope, alone and with one or two resistances added; and what else damps in its place.

    What is not free is 0 in them, but viscous friction that is not in `free`, which all have as given.
    """
    own: dict[str, tuple[str, ...]] = {}
    for word in checks.sequence("free", free, "names of parameters, such as ['inertia', 'friction']"):
        label = parse_label(word)
        name = label.name if label else ""
        own[name] = (*own.get(name, ()), word)
    viscous, *added = RESISTANCES
    law = ":shared" if ":" in "".join(own.get(viscous.name, ())) else ""
    for each in added:  # started from 0 it may stay there: a joint that never sticks tells little of dry friction
        if each.least and not getattr(guess, each.name).any():
            guess = guess.replace(**{each.name: SLIGHT * scales(guess, each.name, getattr(guess, each.name))})
    varied = [*added, viscous] if viscous.name in own else added
    every = [those for count in range(1, MAX_ADDED + 2) for those in combinations(RESISTANCES, count)]
    chosen = [those for those in every if viscous in those]
    if viscous in varied:
        chosen += [those for those in every if viscous not in those and all(each.name in DAMPING for each in those)]
    names = [each.name for each in varied]
    plain = tuple(word for name, words in own.items() for word in words if name not in names)
    result = []
    for those in chosen:
        words = [word for each in those if each in varied for word in own.get(each.name, (each.name + law,))]
        absent = {each.name: 0.0 for each in varied if each not in those}
        name = " + ".join(each.field for each in those)
        result.append(FittedModel(name, guess.replace(**absent), (*plain, *words)))
    return result
