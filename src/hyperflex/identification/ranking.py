"""What rankings of candidates have in common: how they ended, their file, and their table as text."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from hyperflex import files
from hyperflex.files import PathLike
from hyperflex.status import Status


class Ranking(ABC):
    """Candidates that were tried and ranked; a result adds its table and which candidate is `best`."""

    recommendation: str
    ended: Status | None

    @property
    @abstractmethod
    def best(self) -> Any:
        """The best candidate, or None."""

    def summary(self) -> dict[str, Any]:
        """Return status, message and recommendation; a result adds its table."""
        names = ("success", "status", "message", "recommendation")
        return {name: getattr(self, name) for name in names}

    @property
    def status(self) -> Status:
        """SUCCESS if all candidates were tried and there is a best one."""
        return self.ended or (Status.FAILED if self.best is None else Status.SUCCESS)

    @property
    def success(self) -> bool:
        """Whether all candidates were tried and there is a best one."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why it is no success; empty on success."""
        return "" if self.success else f"{self.status}: {self.recommendation}"

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def _text(self, title: str, rows: Sequence[tuple[Sequence[str], str]]) -> str:
        """Return rows of cells, each with a remark after it, in columns under a title; the recommendation last."""
        widths = [max(map(len, column)) for column in zip_longest(*(cells for cells, _ in rows), fillvalue="")]
        lines = [f"{title} ({self.status})"]
        for (first, *cells), remark in rows:
            aligned = [first.ljust(widths[0]), *map(str.rjust, cells, widths[1:]), remark]
            lines.append("  " + "  ".join(aligned).rstrip())
        return "\n".join([*lines, f"  {self.recommendation}"])
