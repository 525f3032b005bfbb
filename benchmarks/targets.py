"""Benchmarks over drawn targets (whip, insert, switches): their command line, their page and their files."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import log, machine

from hyperflex import files

RESULTS = Path(__file__).parent / "results"


class Benchmark(NamedTuple):
    """A benchmark over targets: its `name`, the file of its `drawn` targets, and what it does with them.

    `what` is a target, `several` are some; `draw` returns new ones as tables for a seed, `read` those of the file.
    """

    name: str
    drawn: Path
    what: str
    several: str
    draw: Callable[[int], list[dict[str, float]]]
    read: Callable[[], list[Any]]

    def parser(self, text: str | None) -> argparse.ArgumentParser:
        """Return the command line with the help `text`."""
        parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
        parser.add_argument("--only", type=int, metavar="INDEX", help=f"this {self.what} only; writes nothing")
        parser.add_argument(f"--{self.several}", dest="seed", type=int, metavar="SEED", help=f"draw new {self.several}")
        parser.add_argument("--out", default=str(RESULTS / f"{self.name}.json"), metavar="FILE")
        return parser

    def drew(self, seed: int | None) -> bool:
        """Draw and write new targets if a seed is given; return whether it is."""
        if seed is not None:
            files.write_text(self.drawn, json.dumps(self.draw(seed), indent=1) + "\n")
        return seed is not None

    def run(
        self,
        text: str | None,
        measure: Callable[[int, Any], dict[str, Any]],
        summary: Callable[[list[dict[str, Any]]], dict[str, Any]],
        page: Callable[[dict[str, Any]], str],
    ) -> None:
        """Measure the targets, print and write."""
        parser = self.parser(text)
        parser.add_argument("--count", type=int, metavar="N", help=f"the first {self.several} only")
        options = parser.parse_args()
        if self.drew(options.seed):
            return
        marks, about = self.read()[: options.count], machine.describe()
        if options.only is not None:
            print(json.dumps(measure(options.only, marks[options.only]), indent=1))
            return
        rows = log.go_on(Path(options.out).with_suffix(".jsonl"), marks, measure)
        publish(options.out, about, rows, summary, page)


def publish(
    out: str,
    about: dict[str, str],
    rows: list[dict[str, Any]],
    summary: Callable[[list[dict[str, Any]]], dict[str, Any]],
    page: Callable[[dict[str, Any]], str],
) -> None:
    """Write rows with their summary as JSON and as a page, and print the page."""
    about["load after"] = machine.load()
    found = {"machine": about, "summary": summary(rows), "rows": rows}
    files.write_text(out, json.dumps(found, indent=1) + "\n")
    files.write_text(Path(out).with_suffix(".md"), page(found))
    print(page(found))


def markdown(title: str, text: str, lines: list[str], about: dict[str, str], name: str) -> str:
    """Return a page of Markdown: a title, text, the lines of a table, the machine, and the command."""
    where = machine.sentence(about)
    return "\n".join(
        [f"# {title}", "", text, "", *lines, "", where, "", f"Reproduce: `python -m benchmarks.{name}`", ""]
    )
