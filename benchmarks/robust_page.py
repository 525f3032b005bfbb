"""The page of benchmarks.robust: stated and observed success, their difference, and the gain of the closed loop."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from hyperflex.planning import SuccessProbability, WindCriteria
from hyperflex.planning.rollouts import MODEL

RESAMPLES, STREAM = 10_000, 4711  # of the bootstrap over targets
AIM, AGREES, APART = 0.9, 0.9, 0.05  # success; targets with 0 inside; stated less observed overall
WAYS = (("nominal", "open"), ("nominal", "closed"), ("robust", "open"), ("robust", "closed"))
Rows = list[dict[str, Any]]


def page(rows: Rows, options: dict[str, Any]) -> str:
    """Return the results as Markdown."""
    goals = (
        f"Goals: {AIM:.0%} overall; the 95 % interval of stated minus observed contains 0 for at least {AGREES:.0%} of "
        f"the targets, and their overall difference is below {100 * APART:.0f} points; closed minus open above 0."
    )
    spread = (
        f"Standard deviations times {options['level']:g}: length 1 %, mass 2 %, joint friction 20 %, friction on "
        "the peg 10 %, motor lag 10 ms, timing 2 ms. Simulated throughout."
    )
    parts = [
        f"# Casting a rope with uncertain parameters: {options['rope']} rope",
        f"{len(rows)} targets of seed {options['seed']}. {spread}",
        definition(),
        "\n".join(overall(rows)),
        " ".join(paired(rows)),
        effort(rows, options),
        goals,
        "\n".join(fine(rows)),
        "\n".join(each(rows)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def definition() -> str:
    """The definition of success."""
    usual = WindCriteria()
    return (
        f"Success: the rope makes {usual.turns:g} turns or more from the arm's tip to its end and keeps them over the "
        f"last {MODEL.last:g} s of the {1.5 + usual.settle:g} s after the arm has stopped, clear of arm and shaft, in "
        "a run with the search's links. Stated and observed success both require this, in separate draws. Whether the "
        f"rope also slips by less than {1e3 * usual.max_slip:g} mm in {usual.watch:g} s is reported as held. An "
        "aborted throw and a target without a throw are failures."
    )


def overall(rows: Rows) -> Iterator[str]:
    """A line for each combination of plan and loop."""
    yield "| plan | loop | targets | stated | observed | 95 % | also held | stated - observed, points | 0 inside |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for plan, loop in WAYS:
        some = [row[plan] for row in rows if row[plan]["throw"] is None or loop in row[plan]]
        if not any(loop in one for one in some):
            continue
        observed = np.array([rate(one, loop) for one in some])
        low, high = interval(observed)
        cells = [plan, loop, str(len(some)), "", percent(observed.mean()), f"{percent(low)} to {percent(high)}"]
        cells += [percent(np.mean([rate(one, loop, "held") for one in some])), "", ""]
        if loop == "open":
            stated = np.array([0.0 if one["stated"] is None else one["stated"][0] / one["stated"][1] for one in some])
            cells[3] = percent(stated.mean())
            cells[-2] = points(stated - observed)
            inside = [agrees(one) for one in some if one["throw"] is not None]
            cells[-1] = f"{sum(inside)} of {len(inside)}"
        yield "| " + " | ".join(cells) + " |"


def paired(rows: Rows) -> Iterator[str]:
    """Differences in the same draws."""
    for plan in ("robust", "nominal"):
        both = [row[plan] for row in rows if "closed" in row[plan]]
        if both:
            gain = np.array([gained(one) for one in both])
            yield (
                f"Closed minus open loop, {plan} plan, in the same draws: {points(gain)} points. Aborted: "
                f"{sum(one['closed']['aborted'] for one in both)} of {sum(len(one['closed']['won']) for one in both)} "
                "throws."
            )
    gain = np.array([rate(row["robust"], "open") - rate(row["nominal"], "open") for row in rows])
    yield f"Robust minus nominal plan, open loop, in the same draws: {points(gain)} points."
    yield "Intervals (95 %) are by bootstrap over targets."


def effort(rows: Rows, options: dict[str, Any]) -> str:
    """Planning times."""
    told = []
    for plan, time_budget in (("robust", options["time_budget"]), ("nominal", options["nominal"])):
        seconds = [row[plan]["seconds"] for row in rows]
        told.append(
            f"{plan} (time budget {time_budget:g} s) median {np.median(seconds):.0f} s, at most {max(seconds):.0f} s"
        )
    return f"Processor time of planning a target, including the final estimate or verification: {'; '.join(told)}."


def fine(rows: Rows) -> Iterator[str]:
    """The bias of coarse runs."""
    pairs = [
        (name, row[plan]["open"][name][: len(row[plan]["fine"][name])], row[plan]["fine"][name])
        for row in rows
        for plan in ("robust", "nominal")
        if "fine" in row[plan]
        for name in ("won", "held")
    ]
    for name in ("won", "held") if pairs else ():
        coarse, finer = (np.concatenate([pair[k] for pair in pairs if pair[0] == name]) for k in (1, 2))
        yield (
            f"- {name} in the same {coarse.size} draws, open loop, both plans: {percent(coarse.mean())} on coarse "
            f"links, {percent(finer.mean())} with 2.5 times the links, refined near the peg, and shorter steps; equal "
            f"in {percent((coarse == finer).mean())} of the draws."
        )


def each(rows: Rows) -> Iterator[str]:
    """A line for each target."""
    head = ("number", "x", "y", "radius", "planned", "s", "stated", "open", "difference, 95 %", "held", "closed")
    head += ("given up", "nominal: planned", "stated", "open", "held", "why not (robust)")
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        one, other = row["robust"], row["nominal"]
        cells = [str(one["number"]), *(f"{one[name]:.3f}" for name in ("x", "y", "radius"))]
        cells += [str(one["planned"]), f"{one['seconds']:.0f}", counts(one["stated"]), won(one, "open")]
        low, high = apart(one) if "open" in one else (0.0, 0.0)
        cells += [f"{100 * low:+.0f} to {100 * high:+.0f}" if "open" in one else "", won(one, "open", "held")]
        cells += [won(one, "closed"), str(one["closed"]["aborted"]) if "closed" in one else ""]
        cells += [str(other["planned"]), counts(other["stated"]), won(other, "open"), won(other, "open", "held")]
        yield "| " + " | ".join([*cells, one["reason"]]) + " |"


def rate(one: dict[str, Any], loop: str, name: str = "won") -> float:
    """Share of the draws; 0 without a throw."""
    return float(np.mean(one[loop][name])) if loop in one else 0.0


def gained(one: dict[str, Any]) -> float:
    """Closed minus open loop, in their common draws."""
    closed = np.array(one["closed"]["won"])
    return float((closed - np.array(one["open"]["won"])[: closed.size]).mean())


def apart(one: dict[str, Any]) -> tuple[float, float]:
    """95 % interval of stated minus observed."""
    return probability_difference(
        SuccessProbability(*one["stated"]), SuccessProbability(sum(one["open"]["won"]), len(one["open"]["won"]))
    )


def probability_difference(one: SuccessProbability, other: SuccessProbability) -> tuple[float, float]:
    """Return the 95 % confidence interval of `one` minus `other`, from independent samples.

    Notes
    -----
    Newcombe (1998), method 10: at each end, the squares of the distances to the ends of both Wilson intervals add up.
    """
    (low, high), (low_other, high_other) = one.interval, other.interval
    p, q = one.estimate, other.estimate
    return p - q - math.hypot(p - low, high_other - q), p - q + math.hypot(high - p, q - low_other)


def agrees(one: dict[str, Any]) -> bool:
    """Whether this interval contains 0."""
    low, high = apart(one)
    return low <= 0.0 <= high


def interval(values: np.ndarray) -> tuple[float, float]:
    """95 % interval of the mean over targets (N,): each resampled with all its draws."""
    random = np.random.default_rng(STREAM)
    means = values[random.integers(values.size, size=(RESAMPLES, values.size))].mean(axis=1)
    tail = 0.5 * (1.0 - 0.95)
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return float(low), float(high)


def points(values: np.ndarray) -> str:
    low, high = interval(values)
    return f"{100 * values.mean():+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"


def percent(value: float) -> str:
    return f"{100 * value:.0f} %"


def counts(stated: list[int] | None) -> str:
    return "" if stated is None else f"{stated[0]}/{stated[1]}"


def won(one: dict[str, Any], loop: str, name: str = "won") -> str:
    return f"{sum(one[loop][name])}/{len(one[loop][name])}" if loop in one else ""
