"""Findings of score tests: what was declared or held, and does not fit, or cannot be tested."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.identification.declarations.held import CLOCK, DRIFT, LINKS, SCALES, as_free
from hyperflex.identification.declarations.score_tests import TESTING, ScoreTest
from hyperflex.identification.findings import Finding, Kind, Severity


@dataclass(frozen=True)
class FindingLimits:
    """Limits from which tests are reported."""

    # standard deviation of gravity's factor: any ruler measures lengths better
    untested: float = 0.05
    # relative, of lengths: a ruler that is read with care errs by less
    short: float = 0.004
    # standard deviations: more than noise makes of 99.7 % of what is right
    certain: float = 3.0
    # condition number of information that determines nothing
    singular: float = 10000000000.0
    # probability: more likely than not
    likely: float = 0.5


REPORTED = FindingLimits()


def first_misdeclared(tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what was declared or held, does not fit and matters, and explains most; None where all fits."""
    return next((each for each in tests if each.significant and each.matters), None)


def explaining(tests: Sequence[ScoreTest]) -> ScoreTest | None:
    """Return what explains most of a fit that is poor, though its ratios are not known well enough to move beyond."""
    reported = [each for each in tests if each.significant and each.quantity.reported]
    causes = [each for each in (*_causes(tests), *reported) if each.gain > TESTING.explains]
    return max(causes, key=lambda each: each.gain, default=None)


def score_findings(tests: Sequence[ScoreTest], *, odd: bool, known: bool, wrong: bool) -> list[Finding]:
    """Return the findings of tests of a fit that is `odd`, or that determines no ratio (not `known`).

    What explains such a fit is wrong; `wrong`: something else is known to be, and causes are doubts.
    """
    found = _of_links(tests, odd=odd)
    first, cause = first_misdeclared(tests), None
    if first is not None:
        cause = next((each for each in _causes(tests) if each.gain > first.gain + TESTING.equal), None)
        found.append(finding(first, Severity.WRONG, tests))
    elif (odd or not known) and not wrong and not any(each.severity is Severity.WRONG for each in found):
        cause = explaining(tests)
    if cause is not None:
        found.append(finding(cause, Severity.WRONG))
    found += [finding(each, Severity.DOUBT) for each in tests if each is not cause and _doubtful(each, first)]
    return [*found, *_lengths(tests), *_untested(tests)]


def finding(test: ScoreTest, severity: Severity, tests: Sequence[ScoreTest] = ()) -> Finding:
    """Return a test as a finding, with which others of `tests` explain as much."""
    alike = [each for each in tests if each.significant and each is not test and each.gain > test.gain - TESTING.equal]
    others = {"freed_with": as_free(test.freed_with), "alike": [_label(each) for each in alike]}
    values = test.quantity.values(test.name, test.values) | {"moved": test.moved}
    return Finding(test.quantity.kind, severity, values | others, test.gain)


def _label(test: ScoreTest) -> str:
    """Return what a test is about, and its value."""
    name = f"'{test.name}'" if test.quantity.kind in (Kind.HELD, Kind.RESISTANCE) else str(test.quantity.kind)
    values = test.quantity.values(test.name, test.values).values()
    return next((f"{name} ({each:.3g})" for each in values if isinstance(each, float)), name)


def _causes(tests: Sequence[ScoreTest]) -> list[ScoreTest]:
    """Return what is held and surely does not fit, though ratios move by no more than noise may, or not at all."""
    certain = (each for each in tests if each.significant and each.excess_gain > TESTING.sure and not each.matters)
    return [each for each in certain if each.law or (each.covered and each.quantity.of_rope)]


def _doubtful(test: ScoreTest, first: ScoreTest | None) -> bool:
    """Whether something seems off, but moves ratios by little, or something else may explain it."""
    if test.name == DRIFT:
        return test.refitted and not (test.significant and test.matters) and (first is None or first.gain <= test.gain)
    if test.name in (LINKS, SCALES) or (test.significant and test.matters):
        return False
    if test.suspected or test.covered:
        return not test.freed_with
    alike = first is not None and abs(test.gain - first.gain) < TESTING.equal
    explains = test.law and test.gain > TESTING.explains and not alike
    return test.significant and (test.slight or test.uneven or test.quantity.reported or explains)


def _of_links(tests: Sequence[ScoreTest], *, odd: bool) -> list[Finding]:
    """Return that links are too long: the cause of an `odd` fit, or a doubt; nothing where another cause is better."""
    links = next((each for each in tests if each.name == LINKS), None)
    if links is None or links.excess_gain < REPORTED.likely or links.gain <= TESTING.equal:
        return []
    better = {other.name for other in tests if other.significant and other.gain > links.gain + TESTING.equal}
    if not better <= set(links.freed_with):
        return []
    along = {"freed_with": as_free(links.freed_with)}
    values = along | {"probability": links.excess_gain, "moved": links.ratio_sensitivity}
    cause = odd and links.gain >= max(TESTING.explains, *(other.gain for other in tests))
    found = Finding(Kind.LINKS_TOO_LONG, Severity.WRONG if cause else Severity.DOUBT, values, links.gain)
    return [found] * (cause or links.ratio_sensitivity > 0.0)


def _lengths(tests: Sequence[ScoreTest]) -> list[Finding]:
    """Return that lengths seem off where a drive makes the motion depend on them, and no clock seems off."""
    scales = next((each for each in tests if each.name == SCALES and each.values.size > 2), None)
    if scales is None or any(each.significant and each.name == CLOCK for each in tests):
        return []
    known = scales.information[:2, :2]  # of links' lengths and of gravity, the arm being as long as declared
    if np.linalg.cond(known) > REPORTED.singular:
        return []
    score = scales.information[:2] @ np.log(np.clip(scales.values, 1e-9, 1e9))
    off, std = abs(float(np.linalg.solve(known, score)[0])), float(np.sqrt(np.linalg.inv(known)[0, 0]))
    seen = off >= max(REPORTED.short, REPORTED.certain * std)
    return [Finding(Kind.LENGTHS, Severity.DOUBT, {"off": off})] * seen


def _untested(tests: Sequence[ScoreTest]) -> list[Finding]:
    """Return that this motion cannot show a wrong clock or wrong lengths, where it cannot."""
    scale = next((each for each in tests if each.name == CLOCK), None)
    return [Finding(Kind.UNTESTED)] if scale is not None and scale.std > REPORTED.untested else []
