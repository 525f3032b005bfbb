"""Recording: measured angles or marker positions, validated and read-only, in SI units and the package's axes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import NetCDF, PathLike, Variable
from hyperflex.model import unit_across

if TYPE_CHECKING:
    from hyperflex.identification import Finding

Kind = Literal["angles", "markers"]

KINDS: tuple[Kind, ...] = ("angles", "markers")
FORMAT = "hyperflex recording 1"
VARIABLE: dict[Kind, str] = {"angles": "angle", "markers": "position"}  # of a NetCDF file
FACTS = {"epoch": "s", "out_of_plane": "m", "tilt": "rad"}  # numbers about a recording that are attributes in NetCDF
UNIT = {"angles": "rad", "markers": "m"}
CONVENTION = {
    "angles": "absolute link angles in rad, 0 hanging, positive towards +x",
    "markers": "positions in m, x right, y up",
}


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Measured motion of a rope or pendulum; arrays are read-only copies.

    Parameters
    ----------
    t : array_like (T,), s
        Strictly increasing sample times, T >= 2; uneven steps are fine.
    data : array_like (T, C), or (T,) of the angles of one link
        ``kind="angles"``: C = n absolute link angles in rad, unwrapped (0 hanging, positive towards +x; link 0 nearest
        the motor). ``kind="markers"``: C = 2 (n + 1) positions ``x0, y0, x1, y1, ...`` in m (x right, y up) of markers
        at the joints, the first at the pivot; or of any markers, with `arc_lengths` of `identify`. NaN marks a gap.
    kind : {"angles", "markers"}
        What `data` holds.
    noise : array_like (T, C), (C,) or float, optional
        Standard deviation of each sample, in the unit of `data`.
    rates : array_like (T, n), rad/s, optional
        Angular rates in the file. Readers check units with them; they are not fitted, because rates in files are mostly
        computed from the angles.
    convention, name, source : str
        For reports: the declared and converted units and axes, a short name, and the source of the data.
    columns : tuple of str, optional
        For messages: the columns of each link or marker in the file.
    epoch : float, s, optional
        Time 0 in seconds since 1970, if the file has such stamps.
    out_of_plane : float, m, optional
        Root mean square of the motion out of the plane of the swing, of markers that were measured in space.
    tilt : float, rad, optional
        Tilt out of that plane, as the ``tilt`` of a plan: the amplitude of a steady swing whose lines between
        neighbouring markers have the same root mean square angle over the whole recording. Noise alone gives twice its
        standard deviation over the distance of the markers, because both ends of a line have noise.

    Raises
    ------
    InvalidInput
        For infinite values, times that are not strictly increasing, a channel without a single value, a number of
        columns that does not fit the kind, or noise that is not positive. The message names the sample.

    Examples
    --------
    >>> recording = Recording([0.0, 0.1, 0.2], [[0.30], [float("nan")], [0.28]])
    >>> recording.n_links, recording.gaps
    (1, 1)
    """

    t: Array
    data: Array
    kind: Kind = "angles"
    noise: Array | None = None
    rates: Array | None = None
    convention: str = ""
    name: str = ""
    source: str = ""
    columns: tuple[str, ...] = ()
    epoch: float | None = None
    out_of_plane: float | None = None
    tilt: float | None = None

    def __post_init__(self) -> None:
        kind = cast(Kind, checks.choice("kind", self.kind, KINDS))
        t = checks.times("t", self.t, least=2)
        data = checks.array("data", _as_column(kind, self.data), (t.size, -1), unit=UNIT[kind], gaps=True)
        if data.shape[1] < 1 or (kind == "markers" and data.shape[1] % 2):
            allowed = {"angles": "one column a link", "markers": "x and y of each marker: 2, 4, 6, ... columns"}
            raise InvalidInput("data has the wrong number of columns", got=data.shape[1], allowed=allowed[kind])
        for name in ("convention", "name", "source"):
            checks.text(f"recording {name}", getattr(self, name))
        values: dict[str, object] = {"t": t, "data": data, "convention": self.convention or CONVENTION[kind]}
        for name, unit in FACTS.items():
            if (fact := getattr(self, name)) is not None:
                values[name] = checks.number(f"recording {name}", fact, unit=unit)
        if self.noise is not None:
            values["noise"] = per_sample(self.noise, data)
        if self.rates is not None:
            shape = t.size, data.shape[1] if kind == "angles" else 0
            values["rates"] = checks.array("rates", _as_column(kind, self.rates), shape, unit="rad/s", gaps=True)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        empty = np.isnan(data).all(axis=0)
        if empty.any():
            raise InvalidInput(
                f"{self.label(int(np.argmax(empty)) // (1 if kind == 'angles' else 2))} has no value at all, only gaps",
                allowed="at least one value in each channel",
                fix="Leave that link out of the model or the recording, or take a longer span",
            )

    def __repr__(self) -> str:
        name = f"{self.name!r}: " if self.name else ""
        what = f"{self.kind} of {self.n_links} links" if self.n_links else "one marker"
        return f"<Recording {name}{what}, {self.t.size} samples, {self.t[0]:g} to {self.t[-1]:g} s, {self.gaps} gaps>"

    def label(self, k: int) -> str:
        """Return the name of link or marker `k`, counted from 0, with its columns in the file where these are known."""
        what, count = ("link", self.n_links) if self.kind == "angles" else ("marker", self.n_links + 1)
        return f"{what} {k} ({self.columns[k]})" if len(self.columns) == count else f"{what} {k}"

    def channel(self, k: int) -> str:
        """Return the name of channel `k`, counted from 0: the angle of a link, x or y of a marker."""
        number, axis = (k, "angle") if self.kind == "angles" else (k // 2, "xy"[k % 2])
        return f"{axis} of {self.label(number)}"

    @property
    def n_links(self) -> int:
        """Number of links that the channels describe; 0 for a marker alone."""
        columns = int(self.data.shape[1])
        return columns if self.kind == "angles" else columns // 2 - 1

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.t[-1] - self.t[0])

    @property
    def gaps(self) -> int:
        """Number of missing values over all channels."""
        return int(np.isnan(self.data).sum())

    def window(self, start: float, end: float) -> "Recording":
        """Return the samples with ``start <= t < end`` (s); InvalidInput for fewer than two, or an empty channel."""
        for name, each in (("start", start), ("end", end)):
            if not (isinstance(each, float) and np.isinf(each)):
                checks.number(name, each, unit="s")
        inside = (self.t >= start) & (self.t < end)
        if inside.sum() < 2:
            allowed = f"a span within {self.t[0]:g} to {self.t[-1]:g} s"
            raise InvalidInput("the span contains fewer than two samples", got=[start, end], allowed=allowed)
        return self._pick(inside)

    def decimate(self, step: int) -> "Recording":
        """Return every `step`-th sample, the first included (picked, not averaged)."""
        step = checks.count("step", step, most=self.t.size)
        return self._pick(np.arange(0, self.t.size, step))

    def angles(self) -> "Recording":
        """Return absolute link angles (rad): the recording itself, or angles of the lines from marker to marker.

        Angles of markers are unwrapped, gaps bridged: a link must turn less than half a turn between known samples. A
        link with an end missing is a gap. Noise of the positions passes to the angles to first order.

        Examples
        --------
        >>> markers = Recording([0.0, 0.1], [[0, 0, 0.1, 0.0], [0, 0, 0.0, -0.1]], kind="markers")
        >>> markers.angles().data.round(3).tolist()
        [[1.571], [0.0]]
        """
        if self.kind == "angles":
            return self
        along = self._lines("angles of links")
        distance = np.hypot(along[..., 0], along[..., 1])
        angle = np.arctan2(along[..., 0], -along[..., 1])
        angle[~(distance > 0.0)] = np.nan
        noise = None
        if self.noise is not None:
            # A link's angle changes by the difference of its ends' errors across it, over its length.
            across = unit_across(angle)
            squares = self.noise.reshape(self.t.size, -1, 2) ** 2
            with np.errstate(divide="ignore", invalid="ignore"):
                noise = np.sqrt(((squares[:, :-1] + squares[:, 1:]) * across**2).sum(axis=-1)) / distance
            noise = np.where(np.isfinite(noise), noise, np.pi)  # a gap says nothing: any angle
        convention = f"{CONVENTION['angles']}; from the lines between markers ({self.convention})"
        return replace(self, data=unwrap(angle), kind="angles", noise=noise, convention=convention, columns=())

    def link_lengths(self) -> Array:
        """Return the median distance (n,) between neighbouring markers, m; InvalidInput for angles."""
        if self.kind == "angles":
            raise InvalidInput("a recording of angles has no lengths", got=self.kind, allowed="markers")
        along = self._lines("lengths of links")
        return np.nanmedian(np.hypot(along[..., 0], along[..., 1]), axis=0)

    def check(self) -> "list[Finding]":
        """Return the faults of the samples; nothing is repaired.

        These are samples that programs write for a lost marker (such as exact (0, 0)), repeated and missing frames,
        wrapped angles, channels that jump by a constant, and a rope that was held before it moved. `identify` reports
        them first. A fault that is small relative to noise and motion is not found. ``print(finding)`` shows a line.

        Examples
        --------
        >>> swing = np.sin(np.linspace(0.0, 20.0, 400))
        >>> print(*Recording(np.arange(400) / 60.0, np.repeat(swing[::2], 2)[:, None]).check())  # doctest: +ELLIPSIS
        48 % of the frames repeat the frame before, to the last digit, while the rope moves. ...
        """
        from hyperflex.identification import faults

        return faults(self)

    def to_netcdf(self, path: PathLike, attributes: Mapping[str, Any] | None = None) -> None:
        """Write to NetCDF-4, for ``read_recording(path)``; FileProblem on failure: an earlier file is then unchanged.

        `attributes` (numbers, texts or arrays) are added to those of the file; readers ignore them.
        """
        marked = self.kind == "markers"
        dims = ("time", "marker", "axis") if marked else ("time", "link")
        shape = (self.t.size, -1, 2)[: len(dims)]
        axes = {"y_axis": "up"} if marked else {"zero": "hanging", "sense": "+x", "angles": "absolute"}
        variables = {"time": Variable(("time",), self.t, {"units": "s", "long_name": "sample time"})}
        for name, values, unit, long_name in (
            (VARIABLE[self.kind], self.data, UNIT[self.kind], f"measured {self.kind}, NaN in gaps"),
            ("noise", self.noise, UNIT[self.kind], "standard deviation of each sample"),
            ("rate", self.rates, "rad/s", "angular rates that came with the angles"),
        ):
            if values is not None:
                variables[name] = Variable(dims, values.reshape(shape), {"units": unit, "long_name": long_name})
        own = {key: getattr(self, key) for key in ("kind", "convention", "name", "source")}
        own |= {key: fact for key in FACTS if (fact := getattr(self, key)) is not None}
        files.write_netcdf(path, NetCDF(variables, {**(attributes or {}), "format": FORMAT, **axes, **own}))

    def _lines(self, what: str) -> Array:
        """Return the lines from marker to marker (T, n, 2), m; a marker alone is refused."""
        if self.n_links < 1:
            raise InvalidInput(
                f"a marker alone shows no {what}",
                got=f"{self.data.shape[1]} columns",
                allowed="x and y of the pivot and of the far end of each link: 4, 6, 8, ... columns",
                fix="To identify a rope by it, say where along the rope it sits: arc_lengths=[...] and origin=(x, y)",
            )
        return np.diff(self.data.reshape(self.t.size, -1, 2), axis=1)

    def _pick(self, rows: Array | np.ndarray[tuple[int], np.dtype[np.bool_ | np.intp]]) -> "Recording":
        return replace(
            self,
            t=self.t[rows],
            data=self.data[rows],
            noise=None if self.noise is None else self.noise[rows],
            rates=None if self.rates is None else self.rates[rows],
        )


def unwrap(angle: Array) -> Array:
    """Return angles (T, n) without jumps of whole turns, gaps (NaN) bridged and kept."""
    result = angle.copy()
    for column in result.T:
        known = ~np.isnan(column)
        column[known] = np.unwrap(column[known])
    return result


def _as_column(kind: Kind, values: object) -> object:
    """Return the angles (T,) of one link as (T, 1); other values as they are."""
    try:
        return np.asarray(values)[:, None] if kind == "angles" and np.ndim(values) == 1 else values  # type: ignore[arg-type]
    except ValueError:  # ragged
        return values


def per_sample(noise: object, data: Array) -> Array:
    """Return the noise of each sample (T, C) from one number, one a channel, or all of them."""
    given = checks.array("noise", noise, None, sign="positive")
    if given.shape not in ((), data.shape[1:], data.shape):
        allowed = f"one number, {data.shape[1]} of them, or {data.shape[0]} x {data.shape[1]}"
        raise InvalidInput("noise has the wrong shape", got=given.shape, allowed=allowed)
    return checks.array("noise", np.broadcast_to(given, data.shape), data.shape)
