"""Consistency of parts of a real recording: each part is fitted separately, and the estimates are compared.

python -m benchmarks.windows --data FOLDER            eight parts of each recording; to benchmarks/results/
python -m benchmarks.windows --data FOLDER --out -    nothing is written

If the stated standard deviations are right, estimates of parts scatter accordingly about their weighted mean:
chi-squared over its degrees of freedom is about 1, and 95 % of the differences of two parts are within 1.96 times the
root of the sum of squares of both deviations. Two 95 % intervals overlap far more often (99.4 % of the pairs), so this
is reported but is not a criterion. Errors of lengths and of the clock are common to all parts and would reduce these
statistics: they use deviations without these errors, and chi-squared with the stated deviations is reported as well.
The deviation due to noise alone is also reported; the rest is the model error estimated by the fit.

The exit code is 1 if, for a usable ratio, chi-squared per degree exceeds 1.5 or fewer than 90 % of the pairs agree, or
if more than a quarter of a recording's parts are refused ("do not use"). Pairs with a refused part are reported as
well. A friction that fails is accepted if all parts report it as a model error; its size is reported.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import machine

import hyperflex as hf
from hyperflex import files
from hyperflex.identification import Kind
from hyperflex.identification import text as text_of
from hyperflex.identification.findings import percent
from hyperflex.identification.uncertainty.covariance import ratio_spread

RESULTS = Path(__file__).parent / "results"
BAND = 1.96  # standard deviations on either side that contain 95 %
MOST, LEAST = 1.5, 0.9  # chi-squared per degree of freedom, and share of the pairs that agree
REFUSED = 0.25  # share of the parts that may be refused
FREE = ["inertia", "com", "friction"]
MARKERS = {"time_unit": "s", "unit": "m", "y_axis": "up"}
RECORDINGS: dict[str, tuple[str, dict[str, str], list[str]]] = {
    "triple": ("multiarm_triple/TriplePendulumDataForParameterEstimation.mat", {}, FREE),
    "single": ("multiarm_single/SinglePendulumDataForParameterEstimation.mat", {}, FREE),
    "IBM 06": ("ibm_double_pendulum/run06_500Hz.csv", MARKERS, [*FREE, "gravity_angle"]),
    "IBM 16": ("ibm_double_pendulum/run16_500Hz.csv", MARKERS, [*FREE, "gravity_angle"]),
}


def guess_of(recording: hf.Recording) -> hf.Rope:
    """Return a first guess: known lengths, uniform links of 0.1 kg."""
    lengths = {1: [0.3], 3: [0.1727, 0.2286, 0.2413]}
    markers = recording.kind == "markers"
    length = recording.link_lengths() if markers else lengths[recording.n_links]
    return hf.Rope(length=length, mass=0.1, friction=1e-4)


def measure(folder: Path, name: str, count: int) -> list[dict[str, Any]]:
    """Return a row for each part of a recording: ratios with deviations and intervals, grade, model error of
    friction."""
    path, units, free = RECORDINGS[name]
    whole = hf.read_recording(folder / path, **units)  # type: ignore[arg-type]
    guess, rows = guess_of(whole), []
    for begin in whole.t[0] + whole.duration / count * np.arange(count):
        part = whole.window(float(begin), float(begin + whole.duration / count))
        began = time.process_time()
        found = hf.identify(part, guess, free, options=hf.FitOptions(train=np.inf))
        row = {"recording": name, "begin": float(begin), "seconds": time.process_time() - began}
        row |= {"grade": str(found.grade), "reason": text_of(found.findings[0])}
        parts = [percent(each.values["part"]) for each in found.findings if each.kind is Kind.FRICTION_MODEL]
        row["friction"] = f"up to {parts[0]}" if parts else ""
        # without errors of lengths, clock and torque, which are common to all parts of a recording
        information = replace(found.basis.information, scaled=0.0)
        parameters = found.basis.plant.parameters
        own, laws = (ratio_spread(parameters, information, model=model) for model in (False, True))
        row["ratios"] = {
            f"{kind}[{k}]": numbers
            for kind, values in found.ratios.items()
            for k, value in enumerate(values)
            if (numbers := numbers_of(found, f"{kind}[{k}]", float(value), float(own[kind][k]), float(laws[kind][k])))
        }
        print(json.dumps(row), flush=True)
        rows.append(row)
    return rows


def numbers_of(found: hf.Identification, label: str, value: float, own: float, laws: float) -> list[float]:
    """Return value and deviations (stated, without common errors, of noise), or an empty list if unknown or fixed."""
    name, place = label[:-1].split("[")
    std = float(found.ratio_std[name][int(place)])
    if label not in found.intervals or not (np.isfinite(std) and own > 0.0):
        return []
    return [value, std, own, float(np.sqrt(max(own**2 - laws**2, 0.0)))]


def compared(rows: list[dict[str, Any]], label: str) -> dict[str, float]:
    """Return the agreement of the usable parts on a ratio."""
    there = [row for row in rows if label in row["ratios"]]
    used = np.array([row["grade"] != "do not use" for row in there])
    if used.sum() < 2:
        return {"parts": int(used.sum())}
    every = np.array([row["ratios"][label] for row in there])
    value, std, own, noise = every[used].T
    mean = float((value / own**2).sum() / (1.0 / own**2).sum())
    chi, stated = (float((((value - mean) / each) ** 2).sum() / (value.size - 1)) for each in (own, std))
    numbers = {"mean": mean, "scatter": float(value.std(ddof=1))}
    numbers |= {name: float(np.median(each)) for name, each in (("noise", noise), ("own", own), ("std", std))}
    numbers |= {"chi_squared": chi, "stated": stated, "agree": agreeing(value, own)}
    return {"parts": value.size, **numbers, "overlap": overlapping(value, own), "all": agreeing(*every.T[[0, 2]])}


def agreeing(value: np.ndarray, std: np.ndarray) -> float:
    """Return the share of the pairs whose difference is within its 95 % range."""
    pairs = combinations(range(value.size), 2)
    return float(np.mean([abs(value[i] - value[j]) <= BAND * np.hypot(std[i], std[j]) for i, j in pairs]))


def overlapping(value: np.ndarray, std: np.ndarray) -> float:
    """Return the share of the pairs whose 95 % intervals overlap."""
    pairs = combinations(range(value.size), 2)
    return float(np.mean([abs(value[i] - value[j]) <= BAND * (std[i] + std[j]) for i, j in pairs]))


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a line for each ratio of each recording, with whether it is judged and passes."""
    lines = []
    for name in dict.fromkeys(row["recording"] for row in rows):
        own = [row for row in rows if row["recording"] == name]
        for label in dict.fromkeys(label for row in own for label in row["ratios"]):
            line = {"recording": name, "ratio": label, **compared(own, label)}
            told = [row["friction"] for row in own if row["friction"]] if label[0] not in "Jp" else []
            line |= {"model_error": ", ".join(dict.fromkeys(told)), "told": len(told)}
            holds = line.get("chi_squared", 0.0) <= MOST and line.get("agree", 1.0) >= LEAST
            line["holds"] = None if not holds and own and len(told) == len(own) else holds
            lines.append(line)
    return lines


def refused_of(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the parts that are not to be used."""
    return [row for row in rows if row["grade"] == "do not use"]


def too_many_refused(rows: list[dict[str, Any]]) -> list[str]:
    """Return the recordings with too many refused parts."""
    names = dict.fromkeys(row["recording"] for row in rows)
    own = {name: [row for row in rows if row["recording"] == name] for name in names}
    return [name for name, each in own.items() if len(refused_of(each)) > REFUSED * len(each)]


def text(rows: list[dict[str, Any]]) -> str:
    """Return the page."""
    lines = ["# Parts of real recordings, fitted separately", ""]
    heads = ("recording", "ratio", "parts used", "mean", "scatter", "std of noise", "std without common errors")
    heads += ("stated std", "chi^2 per degree, without common errors", "as stated", "pairs that agree")
    heads += ("intervals that overlap", "agree, refused parts too", "holds")
    lines += [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for each in summary(rows):
        if "mean" in each:
            cells = [f"{each[k]:.4g}" for k in ("mean", "scatter", "noise", "own", "std")]
            cells += [f"{each[k]:.2f}" for k in ("chi_squared", "stated")]
            cells += [f"{each[k]:.0%}" for k in ("agree", "overlap", "all")]
        else:
            cells = ["-"] * 10
        told = f"model error, reported in {each['told']}: {each['model_error']}"
        word = {True: f"yes ({told})" if each["told"] else "yes", False: "**no**", None: told}
        lines.append(
            f"| {each['recording']} | {each['ratio']} | {each['parts']} | {' | '.join(cells)} | {word[each['holds']]} |"
        )
    lines += [
        "",
        f"Goals: chi-squared per degree of freedom at most {MOST:g}; {LEAST:.0%} of the pairs agree (their difference",
        "is within 1.96 of its deviation; with right deviations 95 % do, and 99.4 % of the intervals overlap); at most",
        f'{REFUSED:.0%} of the parts are graded "do not use" and omitted. Frictions that fail are a model error.',
    ]
    for name in dict.fromkeys(row["recording"] for row in rows):
        own = [row for row in rows if row["recording"] == name]
        refused = [f"{row['begin']:.1f} s: {row['reason']}" for row in refused_of(own)]
        took = f"{np.median([row['seconds'] for row in own]):.1f} s of processor time a fit (median)"
        graded = f'graded "do not use": {len(refused)} of {len(own)}.'
        lines += ["", f"{name}: {took}; {graded} {' '.join(refused)}".rstrip()]
    return "\n".join(lines)


def main() -> int:
    """Fit, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of the real recordings")
    parser.add_argument("--count", type=int, default=8, help="parts of each recording (8)")
    parser.add_argument("--only", nargs="+", choices=RECORDINGS, default=list(RECORDINGS), help="which recordings")
    parser.add_argument("--out", default=str(RESULTS), help=f"folder for the page (benchmarks/{RESULTS.name}); -: none")
    options = parser.parse_args()
    about = machine.describe()
    rows = [row for name in options.only for row in measure(options.data, name, options.count)]
    about["load after"] = machine.load()
    page = f"{text(rows)}\n\n{machine.sentence(about)}\n"
    print(page)
    if options.out != "-":
        folder = Path(options.out)
        files.write_text(folder / "windows.json", json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")
        files.write_text(folder / "windows.md", page)
    return int(bool(too_many_refused(rows)) or any(line["holds"] is False for line in summary(rows)))


if __name__ == "__main__":
    sys.exit(main())
