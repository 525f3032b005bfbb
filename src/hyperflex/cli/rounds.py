"""A bar that follows a fit: which stage it is in, how many rounds it took, what the last one gained."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hyperflex.cli import output

Heard = Callable[[dict[str, float]], None]


def reached(entry: dict[str, float]) -> float:
    """Return the part of a fit that is done after a round: stages count alike, rounds of a stage less and less."""
    of_stage: float = 1.0 - 0.7 ** (entry["round"] + 1.0)
    return (entry["stage"] + of_stage) / entry["stages"]


def told(entry: dict[str, float]) -> str:
    """Return a round in words."""
    stage = f"stage {entry['stage'] + 1:.0f} of {entry['stages']:.0f}, windows of {entry['window']:.3g} s"
    return f"{stage}: round {entry['round'] + 1:.0f} gained {100.0 * entry['gain']:.2g} %"


@contextmanager
def bar(as_json: bool) -> Iterator[Heard]:
    """Show a bar on standard error, if somebody watches; yields what hears of each round."""
    if not output.watched(as_json):
        yield lambda entry: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), BarColumn(bar_width=24), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("first states (Ctrl-C keeps the best so far)", total=1.0)
        yield lambda entry: progress.update(task, completed=reached(entry), description=told(entry))
