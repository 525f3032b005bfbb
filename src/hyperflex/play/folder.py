"""The folder that the page may read from and write to: nothing outside it, and no existing file is replaced."""

import re
from pathlib import Path
from typing import NamedTuple

from hyperflex import files
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.model import PLAN, Rope, Setup
from hyperflex.planning import AnyPlan, MotorLimits, read_limits, read_plan
from hyperflex.play.session import Recorded
from hyperflex.trajectory import read_trajectory

OPENED, SAVED = (".nc", ".csv", ".toml"), (".nc", ".html", ".toml", ".csv")


class Opened(NamedTuple):
    """An initial set-up: from its own file, or from a plan, whose `rope` is the original, undivided one."""

    setup: Setup
    rope: Rope
    limits: MotorLimits | None = None
    plan: AnyPlan | None = None


def read_opened(path: str | Path) -> Opened:
    """Read the TOML file of a set-up, or of a plan; FileProblem or InvalidInput if it is neither."""
    if PLAN in files.read_toml(path):
        plan = read_plan(path)
        return Opened(plan.setup(), plan.problem.rope, plan.problem.limits, plan)
    setup = Setup.from_toml(path)
    return Opened(setup, setup.rope, read_limits(path))


class Folder:
    """A folder.

    Parameters
    ----------
    path : path-like
        Existing folder; FileProblem otherwise.
    """

    def __init__(self, path: files.PathLike) -> None:
        self.path = files.as_path(path, "folder").resolve()
        if not self.path.is_dir():
            raise FileProblem(f"There is no folder {path}. Make it, or choose another.")

    def names(self) -> list[str]:
        """Return the files in it, and in its folders, that can be opened."""
        found = (each for pattern in ("[!.]*", "[!.]*/[!.]*") for each in self.path.glob(pattern))
        shown = (
            each
            for each in found
            if each.suffix in OPENED and each.is_file() and each.resolve().is_relative_to(self.path)
        )
        return sorted(each.relative_to(self.path).as_posix() for each in shown)[:200]  # as many as a person reads

    def page(self, name: str, rope: str = "") -> str:
        """Return the player of a saved run, or of a recording with the `rope` that was identified from it."""
        from hyperflex.play.comparison import comparison_page
        from hyperflex.report import player_html

        path = self._existing(name, ".nc", ".csv")
        if rope:
            return comparison_page(path, self._existing(rope, ".toml"))
        if path.suffix == ".csv":
            raise InvalidInput(f"{name} is a recording", fix="Choose the file (.toml) of its rope, too")
        return player_html(read_trajectory(path), title=f"{name}, simulated")

    def opened(self, name: str) -> Opened:
        """Return the set-up or plan of a file."""
        return read_opened(self._existing(name, ".toml"))

    def save(self, name: str, recorded: Recorded, plan: AnyPlan | None) -> str:
        """Write a new file by its suffix; return its name.

        ``.nc``: the run; ``.html``: its player; ``.toml``: the set-up, from its beginning; ``.csv``: the motion of the
        plan, for the motor.
        """
        path = self._new(name)
        if path.suffix == ".nc":
            recorded.run().to_netcdf(path)
        elif path.suffix == ".html":
            recorded.run().to_html(path, title=f"{path.stem}, simulated")
        elif path.suffix == ".toml":
            whole = recorded.duration + (0.0 if recorded.begin is None else recorded.begin.t)
            recorded.setup.replace(duration=max(whole, 1.0)).to_toml(path)
        elif plan is None:
            raise InvalidInput("there is no plan whose motion could be saved", fix="Plan first")
        else:
            plan.to_csv(path)
        return name

    def _existing(self, name: str, *suffixes: str) -> Path:
        if name not in self.names() or not name.endswith(suffixes):
            raise InvalidInput(
                "there is no such file in the folder", got=name, allowed=f"its files {', '.join(suffixes)}"
            )
        return self.path / name

    def _new(self, name: str) -> Path:
        plain = re.fullmatch(r"[^./\\][^/\\]{,95}", name) and name.isprintable()
        if not plain or Path(name).suffix not in SAVED:
            raise InvalidInput("the file's name cannot be used", got=name, allowed=f"a name with {', '.join(SAVED)}")
        path = self.path / name
        if path.exists() or path.is_symlink():
            raise InvalidInput("the file is there already", got=name, fix="Take another name")
        return path
