"""The log of a live estimate: a NetCDF file, written whole when the run ends, however it ends."""

import tempfile
from types import TracebackType
from typing import Any, Self

import numpy as np

from hyperflex import __version__
from hyperflex.errors import FileProblem
from hyperflex.estimate.live.watch import LiveEstimate
from hyperflex.files import NetCDF, PathLike, Variable, as_path, rescued, write_netcdf

# name: dimensions besides time, unit, meaning
_VARIABLES = {
    "t": ((), "s", "instant of the estimate, on the clock of the frames' time stamps"),
    "q": (("link",), "rad", "angle of each link"),
    "qd": (("link",), "rad/s", "rate of each link"),
    "q_std": (("link",), "rad", "standard deviation of each angle; NaN if the rope is not found"),
    "qd_std": (("link",), "rad/s", "standard deviation of each rate; NaN if the rope is not found"),
    "tip": (("axis",), "m", "position of the tip"),
    "tip_std": ((), "m", "standard deviation of the tip along the worse direction; inf if the rope is not found"),
    "age": ((), "s", "time since a marker was last seen"),
    "latency": ((), "s", "from the frame's arrival to the estimate; NaN if no frame came"),
    "pixels": (("marker", "axis"), "px", "where each marker was seen; NaN: not seen"),
    "places": (("marker", "axis"), "m", "where each marker was seen, in the swing plane; NaN: not seen"),
    "predicted": (("marker", "axis"), "px", "where each marker was expected"),
    "frame": ((), "1", "1 if a frame came, 0 if the estimate is a prediction"),
    "found": ((), "1", "1 if the rope had been found"),
}


def _row(estimate: LiveEstimate) -> tuple[Any, ...]:
    """Return the values of an estimate in the order of the variables."""
    state, tracked, nothing = estimate.state, estimate.tracked, np.full((estimate.markers, 2), np.nan)
    wide = np.full(2 * state.q.size, np.nan)
    if estimate.found and state.covariance is not None:
        wide = np.sqrt(np.diagonal(state.covariance))
    seen = [nothing] * 3 if tracked is None else [tracked.pixels, tracked.places, tracked.predicted]
    tip = estimate.tip, estimate.tip_std, estimate.age, estimate.latency
    return estimate.t, state.q, state.qd, *np.split(wide, 2), *tip, *seen, estimate.frame is not None, estimate.found


class WatchLog:
    """Collects estimates, and writes them to a NetCDF file when the block ends.

    Parameters
    ----------
    path : path-like
        Ends in .nc. The file appears when the block ends, complete.
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
    Estimates are kept in an unnamed file next to `path`, not in memory, so that a run may last for hours. If the block
    ends in an error or Ctrl-C, all estimates until then are written, and the attributes ``interrupted`` and ``ending``
    say so; only a process that is killed leaves nothing.
    """

    def __init__(self, path: PathLike, links: int, markers: int, source: str) -> None:
        self.path, self.source = as_path(path, "log"), source
        self.ending, self.interrupted = "interrupted", False
        sizes = {"link": links, "marker": markers, "axis": 2}
        fields = [(name, np.float64, tuple(sizes[dim] for dim in dims)) for name, (dims, *_) in _VARIABLES.items()]
        self._row = np.zeros(1, dtype=np.dtype(fields))
        self._messages: list[str] = []
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
        self._row[0] = _row(estimate)
        try:
            self._file.write(self._row.tobytes())
        except OSError as error:
            raise FileProblem(f"The log {self.path} cannot be continued: {error.strerror}. Free some space.") from error
        self._count += 1
        self._messages += [f"{estimate.t:.3f} s: {message}" for message in estimate.messages]

    def _write(self) -> None:
        self._file.flush()
        rows = np.memmap(self._file, dtype=self._row.dtype, mode="r", shape=(self._count,))
        variables = {
            name: Variable(("time", *dims), rows[name], {"units": unit, "long_name": about})
            for name, (dims, unit, about) in _VARIABLES.items()
        }
        attributes = {
            "title": "live estimate of a rope",
            "source": self.source,
            "ending": self.ending,
            "interrupted": int(self.interrupted),
            "messages": "\n".join(self._messages),
            "hyperflex": __version__,
        }
        content = NetCDF(variables, attributes)
        rescued(lambda path: write_netcdf(path, content), self.path)
