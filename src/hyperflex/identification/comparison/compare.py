"""Comparison of models: candidates fitted to one recording."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from hyperflex import checks
from hyperflex.errors import HyperflexError, Interrupted, InvalidInput
from hyperflex.identification.comparison.evidence import Evidence, criteria, error, recommend
from hyperflex.identification.comparison.result import FittedModel, ModelComparison
from hyperflex.identification.fit.multiple_shooting import one_thread
from hyperflex.identification.model.names import scales
from hyperflex.identification.model.parameters import GRAVITY
from hyperflex.identification.options import FitOptions, RecordingSetup
from hyperflex.identification.pipeline import identify
from hyperflex.identification.result import Identification
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import DAMPING, FREE_PROPERTIES, MOST_LINKS, RESISTANCES, Rope, parse_label, recut
from hyperflex.progress import progress_bar
from hyperflex.recording import Recording

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
    done: list[Identification | str] = []
    with stoppable() as stop, progress_bar(0.0, float(len(todo)), progress, "comparing", "models") as report:
        fit: Callable[..., Identification] = partial(identify, recording, setup=setup, options=options)
        for number, each in enumerate(todo):
            try:
                found = fit(each.guess, each.free)
                fit = partial(fit, options=replace(options, window=found.settings["window"]))  # the same for all
                found = _refit_from_nested(fit, each, found, zip(todo, done, strict=False))
            except HyperflexError as failure:
                done.append(str(failure))
            else:
                done.append(found)
            if report is not None:
                report(number + 1.0)
    if stop.received and all(isinstance(one, str) for one in done):
        raise Interrupted
    return stop.deliver(_compared(todo[: len(done)], done, stop.received))


def _refit_from_nested(
    fit: Callable[..., Identification], candidate: Candidate, found: Identification, simpler: Iterable[Done]
) -> Identification:
    """Return a fit no worse than those of models nested in it: where one is better, fitted again from there."""
    for other, before in simpler:
        if isinstance(before, str) or not other.nested_in(candidate):
            continue
        if before.residual_t.size == found.residual_t.size and WORSE * before.basis.fit.cost < found.basis.fit.cost:
            start = other.starting_guess(candidate, before.rope)
            again = fit(start, candidate.free)
            if again.basis.fit.cost < found.basis.fit.cost:
                found = again
    return found


def _compared(todo: Sequence[Candidate], done: Sequence[Identification | str], stopped: bool) -> ModelComparison:
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
    return ModelComparison(tuple(models), preferred, words, unit, stopped)


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
