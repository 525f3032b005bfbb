"""Rounds of a fit as they go: a bar where somebody watches, else lines."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hyperflex import progress
from hyperflex.identification.fit.multiple_shooting import Report

BEGIN = "first states (Ctrl-C keeps the best so far)"


@contextmanager
def rounds_shown(show: bool | Report) -> Iterator[Report]:
    """Show rounds on standard error if asked; yields the callable that gets them, `show` itself if it is one."""
    if callable(show):
        yield show
    elif not show:
        yield lambda entry: None
    elif (watched := progress.terminal()) is None:
        with progress.lines() as say:
            say(BEGIN)
            yield lambda entry: say(message(entry))
    else:
        with _bar(watched) as report:
            yield report


@contextmanager
def _bar(watched: Any) -> Iterator[Callable[[dict[str, Any]], None]]:
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), BarColumn(bar_width=24), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=watched, transient=True) as bar:
        task = bar.add_task(BEGIN, total=1.0)
        yield lambda entry: bar.update(task, completed=part_done(entry), description=message(entry))


def part_done(entry: dict[str, Any]) -> float:
    """Return the part of a fit that is done after a round: stages count alike, rounds of a stage less and less."""
    of_stage: float = 1.0 - 0.7 ** (entry["round"] + 1.0)
    return float((entry["stage"] + of_stage) / entry["stages"])


def message(entry: dict[str, Any]) -> str:
    """Return what a round did, in words."""
    stage = f"stage {entry['stage'] + 1:.0f} of {entry['stages']:.0f}, windows of {entry['window']:.3g} s"
    about = f"profile of {entry['parameter']}, " if "parameter" in entry else ""
    return f"{about}{stage}: round {entry['round'] + 1:.0f} gained {100.0 * entry['gain']:.2g} %"
