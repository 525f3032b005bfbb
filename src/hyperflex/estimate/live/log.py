"""The log of a live estimate: a NetCDF file, written whole when the run ends, however it ends."""

import tempfile
from types import TracebackType
from typing import Self

import numpy as np

from hyperflex import __version__
from hyperflex.errors import FileProblem
from hyperflex.estimate.live.watch import LiveEstimate
from hyperflex.files import NetCDF, PathLike, Variable, as_path, rescued, write_netcdf

# name -> dimensions beyond time, unit, what it is
_COLUMNS = {
    "t": ((), "s", "instant of the estimate, on the clock of the frames' time stamps"),
    "q": (("link",), "rad", "angle of each link"),
    "qd": (("link",), "rad/s", "rate of each link"),
    "q_std": (("link",), "rad", "standard deviation of each angle; NaN where the rope is not found"),
    "qd_std": (("link",), "rad/s", "standard deviation of each rate; NaN where the rope is not found"),
    "tip": (("axis",), "m", "place of the tip"),
    "tip_std": ((), "m", "standard deviation of the tip along the worse direction; inf where the rope is not found"),
    "age": ((), "s", "time since a marker was last seen"),
    "latency": ((), "s", "from the frame's arrival to the estimate; NaN where no frame came"),
    "pixels": (("marker", "axis"), "px", "where each marker was seen; NaN: it was not"),
    "places": (("marker", "axis"), "m", "where each marker was seen, in the swing plane; NaN: it was not"),
    "predicted": (("marker", "axis"), "px", "where each marker was looked for"),
    "frame": ((), "1", "1 where a frame came, 0 where the rope's equations alone spoke"),
    "found": ((), "1", "1 where the rope had been found"),
}


class WatchLog:
    """Notes estimates, and writes them to a NetCDF file when the block ends.

    Parameters
    ----------
    path : path-like
        Ends in .nc. Nothing stands there until the end; then all of it.
    links, markers : int
    source : str
        Where the frames come from.

    Attributes
    ----------
    ending : str
        Why the run ended, for the file.
    interrupted : bool
        Whether it was cut short.

    Notes
    -----
    Estimates wait in an unnamed file beside `path`, not in memory, so that a run may last for hours. Where the block
    ends in an error or Ctrl-C, what was noted until then is written all the same, and the attributes ``interrupted``
    and ``ending`` say so; only a process that is killed leaves nothing.
    """

    def __init__(self, path: PathLike, links: int, markers: int, source: str) -> None:
        self.path, self.source = as_path(path, "log"), source
        self.ending, self.interrupted = "interrupted", False
        sizes = {"link": links, "marker": markers, "axis": 2}
        fields = [(name, np.float64, tuple(sizes[dim] for dim in dims)) for name, (dims, _, _) in _COLUMNS.items()]
        self._row = np.zeros(1, dtype=np.dtype(fields))
        self._messages: list[tuple[float, str]] = []
        self._count = 0

    def __enter__(self) -> Self:
        try:
            self._file = tempfile.TemporaryFile(dir=self.path.parent)
        except OSError as error:
            raise FileProblem(
                f"No log can be written in {self.path.parent}: {error.strerror}. Give another -o."
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.interrupted = True
            self.ending = "interrupted" if issubclass(kind, KeyboardInterrupt) else f"failed: {error}"
        with self._file:
            if self._count:
                self._write()

    def note(self, estimate: LiveEstimate) -> None:
        """Add an estimate."""
        row, state, tracked = self._row[0], estimate.state, estimate.tracked
        wide = np.full(2 * state.q.size, np.nan)
        if estimate.found and state.covariance is not None:
            wide = np.sqrt(np.diagonal(state.covariance))
        n = state.q.size
        values = {
            "t": estimate.t,
            "q": state.q,
            "qd": state.qd,
            "q_std": wide[:n],
            "qd_std": wide[n:],
            "tip": estimate.tip,
            "tip_std": estimate.tip_std,
            "age": estimate.age,
            "latency": estimate.latency,
            "pixels": np.nan if tracked is None else tracked.pixels,
            "places": np.nan if tracked is None else tracked.places,
            "predicted": np.nan if tracked is None else tracked.predicted,
            "frame": estimate.frame is not None,
            "found": estimate.found,
        }
        for name, value in values.items():
            row[name] = value
        try:
            self._file.write(self._row.tobytes())
        except OSError as error:
            raise FileProblem(f"The log {self.path} cannot go on: {error.strerror}. Free some space.") from error
        self._count += 1
        self._messages += [(estimate.t, words) for words in estimate.messages]

    def _write(self) -> None:
        self._file.flush()
        rows = np.memmap(self._file, dtype=self._row.dtype, mode="r", shape=(self._count,))
        variables = {
            name: Variable(("time", *dims), rows[name], {"units": unit, "long_name": about})
            for name, (dims, unit, about) in _COLUMNS.items()
        }
        attributes = {
            "title": "live estimate of a rope",
            "source": self.source,
            "ending": self.ending,
            "interrupted": int(self.interrupted),
            "messages": "\n".join(f"{t:.3f} s: {words}" for t, words in self._messages),
            "hyperflex": __version__,
        }
        content = NetCDF(variables, attributes)
        rescued(lambda path: write_netcdf(path, content), self.path)
