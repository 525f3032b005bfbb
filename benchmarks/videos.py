"""Tracking a rope in video: the paper's estimator, ours and a tracker without dynamics; and difficult videos.

python -m benchmarks.videos swings 5     free swings at 7.5 frames/s, as the paper's camera saw them: all four trackers
python -m benchmarks.videos hard 10      pumped casts at 30 frames/s, 30 % occluded, clutter, a blackout of 0.5 s
python -m benchmarks.videos half 10      casts without a blackout, 50 % occluded and no marker on the tip
python -m benchmarks.videos page         the page from the existing rows

Ropes of 100 links, rendered; trackers have 50. Each run adds a line to benchmarks/results/videos.jsonl (--out); on one
core a difficult video takes a minute, mainly for rendering and MP4 encoding.
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import log, machine
from benchmarks.hard_videos import HardVideo, follow

from hyperflex import files
from hyperflex.core.cache import SOURCE_HASH
from hyperflex.paper import estimation
from hyperflex.vision import VideoReader

RESULTS = Path(__file__).parent / "results"
HARD = {  # columns of the page: name, unit, factor, goal
    "tip": ("tip rms outside the blackout, mm", 1e3, "<= 10"),
    "tip, worst": ("worst, mm", 1e3, ""),
    "end of blackout": ("end of the blackout, mm", 1e3, "<= 60"),
    "inside 90 %": ("inside the stated 90 %", None, "yes"),
    "0.1 s later": ("0.1 s later, mm", 1e3, "< 15"),
    "right at the end": ("identities right at the end", None, "yes"),
    "captured": ("visible markers captured, %", 1e2, ""),
    "wrong": ("of them wrong, %", 1e2, ""),
    "within 90 %": ("frames within the stated 90 %, %", 1e2, ""),
}
SWING = {
    "captured": ("visible markers captured after 1 s, %", 1e2),
    "wrong": ("of them wrong, %", 1e2),
    "tip": ("tip rms at frames, mm", 1e3),
    "between": ("between frames, predicted, mm", 1e3),
    "velocity": ("tip velocity, %", 1e2),
    "rates": ("link rates, %", 1e2),
}


def hard(seed: int) -> dict[str, Any]:
    """A cast with a blackout, which is later for each seed."""
    return video(HardVideo(seed, blackout=5.0 + 0.5 * seed))


def half(seed: int) -> dict[str, Any]:
    """A cast with half of the markers covered, and no marker on the tip."""
    return video(HardVideo(seed, occluded=0.5, on_tip=False))


def video(subject: HardVideo) -> dict[str, Any]:
    """Render, write as MP4, read and track a cast."""
    motion = subject.motion()
    renderer = subject.renderer(motion)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cast.mp4"
        truth = renderer.write(path, subject.stamps)
        with VideoReader(path) as frames:
            found = follow(subject, motion, truth, frames)
    times = np.arange(subject.start, subject.end - 1e-3, 1e-3)
    speeds = np.linalg.norm(np.diff(motion.places(times, [estimation.LENGTH])[:, 0], axis=0), axis=1) / 1e-3
    return {"blackout": subject.blackout, "fastest": float(speeds.max()), **found.summary()}


def swings(seed: int) -> dict[str, Any]:
    """A free swing, tracked by each tracker, with and without a marker on the tip."""
    return {
        name + ("" if on_tip else ", none on the tip"): estimation.followed(name, seed, on_tip).summary()
        for on_tip in (True, False)
        for name in estimation.TRACKERS
    }


RUNS: dict[str, Callable[[int], dict[str, Any]]] = {"swings": swings, "hard": hard, "half": half}


def main() -> None:
    """Run the chosen videos and write a line for each, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=[*RUNS, "page"])
    parser.add_argument("runs", type=int, nargs="?", default=1)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--out", type=Path, default=RESULTS / "videos.jsonl")
    options = parser.parse_args()
    if options.kind == "page":
        rows = log.read(options.out)
        files.write_text(options.out.with_suffix(".md"), page(rows))
        return
    for seed in range(options.first, options.first + options.runs):
        row = {"kind": options.kind, "seed": seed, **RUNS[options.kind](seed), "kernels": SOURCE_HASH}
        log.append(options.out, row)
        print(row, flush=True)


def page(rows: list[log.Row]) -> str:
    """The results as Markdown."""
    kept = {(row["kind"], row["seed"]): row for row in rows}
    parts = ["# Tracking a rope in video\n", __doc__.split("\n\n")[2].replace("\n", " ").split(" Each run")[0] + "\n"]
    own = [row for (kind, _), row in sorted(kept.items()) if kind == "swings"]
    if own:
        parts.append(f"## Free swing of 1.2 m, {estimation.RATE} frames/s, {len(own)} seeds\n\n{swing_table(own)}")
    titles = {
        "hard": "Pumped cast, 30 frames/s, 1/100 s, 30 % occluded, blackout of 0.5 s",
        "half": "Pumped cast, 50 % occluded, no marker on the tip, no blackout",
    }
    for name, title in titles.items():
        own = [row for (kind, _), row in sorted(kept.items()) if kind == name]
        if own:
            parts.append(f"## {title}\n\n{video_table(own)}")
    return "\n".join([*parts, f"{log.made(kept.values())} {machine.sentence(machine.describe())}\n"])


def swing_table(rows: list[log.Row]) -> str:
    """One line a tracker: the mean over all seeds, and the worst."""
    names = [name for name, value in rows[0].items() if isinstance(value, dict)]
    lines = ["| tracker | " + " | ".join(title for title, _ in SWING.values()) + " |", "|---" * (1 + len(SWING)) + "|"]
    for name in names:
        cells = []
        for key, (_, factor) in SWING.items():
            values = [factor * row[name][key] for row in rows if row[name].get(key) is not None]
            worst = min if key == "captured" else max
            cells.append(f"{np.mean(values):.3g} ({worst(values):.3g})" if values else "-")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", "Means over the seeds, with the worst one in brackets.\n"])


def video_table(rows: list[log.Row]) -> str:
    """One line a video."""
    keys = [key for key in HARD if key in rows[0]]
    lines = ["| seed | fastest, m/s | " + " | ".join(HARD[key][0] for key in keys) + " |"]
    lines.append("|---" * (2 + len(keys)) + "|")
    if "end of blackout" in keys:
        lines.append("| goal | >= 12 | " + " | ".join(HARD[key][2] for key in keys) + " |")
    for row in rows:
        cells = []
        for key in keys:
            factor, value = HARD[key][1], row[key]
            cells.append(("yes" if value else "no") if factor is None else f"{factor * value:.3g}")
        lines.append(f"| {row['seed']} | {row['fastest']:.1f} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    main()
