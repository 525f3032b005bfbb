"""What a file of any format holds, in one form, and the choice of the angles or markers to take of it."""

import difflib
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, listed
from hyperflex.recording.declare import RADIANS, UNITS, FileNotes, Raw, unit_name
from hyperflex.recording.recording import KINDS, Kind

_AXES = "xyz"
_BETWEEN = "_ .:-"  # stand between the axis and the name of a marker
_MOTION = "vap"  # velocity, acceleration and momentum of a point, as Tracker names them
_LIKELIHOOD = ("likelihood", "score", "confidence")  # end the name of a channel with that of a marker
ALONE = "point"  # name of a marker whose columns are x and y


class Selection(NamedTuple):
    """What the caller asks for; see :func:`hyperflex.read_recording`."""

    kind: str | None = None
    time: str = "t"
    columns: Sequence[str] | None = None
    markers: Sequence[str] | None = None
    topic: str | None = None
    assume: bool = False  # the likeliest time column where the file does not say which one it is


@dataclass(frozen=True)
class Content(FileNotes):
    """What a file holds: T samples of named channels; and its notes, see :class:`FileNotes`.

    Attributes
    ----------
    t : ndarray (T,)
        Times, in ``declared["time_unit"]``; "frame" counts frames.
    names : sequence of str
        The channels, without the times.
    take : callable
        Returns channels (T, K) by their names, NaN in gaps.
    points : mapping of str to tuple of str
        Markers: the channels of x and y, or of x, y and z, of each.
    ordered : bool
        Whether these are known to be markers of the rope, in order: otherwise the caller must name them.
    angles : sequence of str
        Channels that are link angles, in order, as their names say.
    strangers : sequence of str
        Channels of unknown meaning beside angles or ordered markers: these are then not taken by default.
    rates, noise, likelihood, units : mapping of str to str
        By channel: the channels with its rate, standard deviation and likelihood; its unit.
    widths : mapping of str to int
        Number of columns of channels that have several.
    assumed : mapping
        Arguments of the reader that the caller lets it assume.
    sparse : bool
        Rows in which no chosen channel has a value belong to other channels, and are left out.
    advice : str
        What to do, where the file holds no angles and no markers.
    """

    t: Array
    names: Sequence[str]
    take: Callable[[Sequence[str]], Array]
    points: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    ordered: bool = False
    angles: Sequence[str] = ()
    strangers: Sequence[str] = ()
    rates: Mapping[str, str] = field(default_factory=dict)
    noise: Mapping[str, str] = field(default_factory=dict)
    likelihood: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    widths: Mapping[str, int] = field(default_factory=dict)
    assumed: Mapping[str, Any] = field(default_factory=dict)
    sparse: bool = False
    advice: str = ""


def content_of_markers(
    t: Array,
    markers: Mapping[str, Array],
    *,
    noises: Mapping[str, Array] = MappingProxyType({}),
    likelihoods: Mapping[str, Array] = MappingProxyType({}),
    **more: Any,
) -> Content:
    """Return the content of a file of markers, each (T, 2) or (T, 3), with their noise (T, 2) and likelihood (T,)."""
    points = {name: tuple(f"{name}_{axis}" for axis in "xyz"[: each.shape[1]]) for name, each in markers.items()}
    channels = {part: markers[name][:, k] for name, parts in points.items() for k, part in enumerate(parts)}
    channels |= {f"{name}_likelihood": each for name, each in likelihoods.items()}
    channels |= {f"{part}_noise": noises[name][:, k] for name in noises for k, part in enumerate(points[name])}
    return content_of_channels(
        t,
        channels,
        points=points,
        ordered=more.pop("ordered", len(points) == 1),
        likelihood=likelihood_of(points, channels),
        noise={part: f"{part}_noise" for name in noises for part in points[name]},
        **more,
    )


def content_of_channels(t: Array, channels: Mapping[str, Array], **more: Any) -> Content:
    """Return the content of a file of channels, each (T,), or (T, K) for several under one name."""
    widths = {name: each.size // t.size for name, each in channels.items() if each.size > t.size}

    def take(names: Sequence[str]) -> Array:
        return np.hstack([channels[name].reshape(t.size, -1) for name in names])

    return Content(t, list(channels), take, widths=widths, **more)


def unused(name: str, taken: Container[str]) -> str:
    """Return a name that is not taken: one that is gets a prime."""
    while name in taken:
        name += "'"
    return name


def points_of(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return markers by pairs or triples of names that differ in a letter x, y or z at their beginning or end."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        ways = ((name[:1], name[1:].lstrip(_BETWEEN)), (name[-1:], name[:-1].rstrip(_BETWEEN + "/")))
        for axis, of in ways:
            if axis and axis.lower() in _AXES:
                found.setdefault(of or ALONE, {}).setdefault(axis.lower(), name)
    points = {
        name: tuple(axes[key] for key in sorted(axes)) for name, axes in found.items() if {"x", "y"} <= axes.keys()
    }
    motion = {
        part if name == ALONE else f"{name}{mark}{part}" for name in points for part in _MOTION for mark in ("", "_")
    }
    return {name: parts for name, parts in points.items() if name not in motion}


def likelihood_of(points: Mapping[str, Sequence[str]], names: Container[str]) -> dict[str, str]:
    """Return the channels with the likelihood of the parts of markers, of those that are there."""
    return {
        part: name
        for marker, parts in points.items()
        for part in parts
        for name in (f"{marker}_{word}" for word in _LIKELIHOOD)
        if name in names
    }


def raw_of(content: Content, selection: Selection) -> Raw:
    """Return the columns that the caller asks for, by default those whose meaning the file tells.

    InvalidInput for names that the file does not have, where it does not say which to take, and for channels that are
    neither angles nor places.
    """
    if selection.columns is not None and selection.markers is not None:
        raise InvalidInput("columns and markers are both given", fix="Give markers alone: all axes of each are taken")
    if selection.markers is not None:
        if selection.kind == "angles":
            raise InvalidInput("markers are no angles", got=selection.kind, fix="Omit kind")
        kind: Kind = "markers"
        names, space = _of_markers(content, selection.markers)
    elif selection.columns is not None:
        names, space = _known(content, "columns", selection.columns, content.names), False
        if selection.kind is None and (shown := one_unit(content, names)) is None:
            raise InvalidInput("columns is given without kind", allowed="kind='angles' or kind='markers'")
        by_unit = "angles" if selection.kind is None and shown in RADIANS else "markers"
        kind = cast(Kind, checks.choice("kind", selection.kind or by_unit, KINDS))
    else:
        kind, names, space = _by_default(content, selection.kind)
    declared = dict(content.declared)
    unit = one_unit(content, names)
    if unit is not None:
        if unit not in UNITS[kind]:
            what = f"{content.source}: {names[0]!r} is in {unit}, which is no unit of {kind}"
            raise InvalidInput(what, got=list(names), allowed="angles or places", fix=content.advice or "Choose others")
        if declared.setdefault("unit", unit) != unit:
            what = f"{content.source}: header and notes disagree on unit"
            raise InvalidInput(what, got=[unit, declared["unit"]], fix="Correct one of them")
    t, data = content.t, content.take(names)
    rates, noise = (_beside(content, key, names) for key in ("rates", "noise"))
    if content.sparse:
        kept = ~np.isnan(data).all(axis=1)
        t, data = t[kept], data[kept]
        rates, noise = (each if each is None else each[kept] for each in (rates, noise))
    notes = {each.name: getattr(content, each.name) for each in fields(FileNotes)} | {"declared": declared}
    if space:
        notes["usual"] = {"y_axis": "up", **content.usual}  # as the plane says
    return Raw(
        t=t,
        data=data,
        kind=kind,
        noise=noise,
        rates=rates,
        likelihood=partial(_likelihood, content, names) if content.likelihood.keys() & set(names) else None,
        in_space=space,
        columns=tuple(names),
        **notes,
    )


def _likelihood(content: Content, names: Sequence[str]) -> Array:
    """Return the likelihood (T, C) of channels, 1 of those for which the file has none."""
    sure, by_name = np.ones((content.t.size, 1)), content.likelihood
    return np.hstack([content.take([by_name[name]]) if name in by_name else sure for name in names])


def _known(content: Content, what: str, names: object, known: Sequence[str]) -> list[str]:
    """Return names that the caller gives, all of which the file must have."""
    given = checks.sequence(what, names, f"a list of names: {listed(known)}")
    missing = [name for name in given if name not in known]
    if missing or not given:
        close = [each for name in missing for each in difflib.get_close_matches(str(name), known, 1)]
        raise InvalidInput(
            f"{content.source} has no such {what}",
            got=missing or given,
            allowed=listed(known) or "none: the file has no markers",
            fix=f"Perhaps {', '.join(close)} is meant" if close else "",
        )
    return given


def _of_markers(content: Content, markers: object) -> tuple[list[str], bool]:
    """Return the channels of markers, and whether these are places in space."""
    points = [content.points[name] for name in _known(content, "markers", markers, list(content.points))]
    sizes = {len(each) for each in points}
    if len(sizes) > 1:
        what = f"{content.source} has some of these markers in a plane, others in space"
        raise InvalidInput(what, got=points, fix="Name their columns: columns=[..] and kind='markers'")
    return [name for each in points for name in each], sizes == {3}


def _by_default(content: Content, kind: str | None) -> tuple[Kind, list[str], bool]:
    """Return kind and channels where the caller names none, and whether these are places in space."""
    source, angles, points, rest = content.source, list(content.angles), list(content.points), list(content.strangers)
    there = [each for each, names in zip(KINDS, (angles, points), strict=True) if names]
    if kind is not None and there and checks.choice("kind", kind, KINDS) not in there:
        raise InvalidInput(f"{source} holds {there[0]}", got=kind, fix="Omit kind, or name columns=[..]")
    if not there or (rest and (content.ordered or angles)):
        known = (*UNITS["angles"], *UNITS["markers"])
        usable = [name for name in content.names if unit_name(content.units.get(name, "m")) in known]
        named = f"Name them, such as columns={usable[:2]} and kind='angles' or 'markers'"
        raise InvalidInput(
            f"{source} does not say which columns to take" + (", and has others" if there else ""),
            got=rest or list(content.names),
            allowed="th1, th2, .. (and w1, w2, ..) or x0, y0, x1, y1, .. with the time, std_.. for their noise",
            fix=content.advice or named,
        )
    if kind is None and len(there) > 1:
        fix = "Pass kind='angles' or 'markers'"
        raise InvalidInput(f"{source} holds angles and markers", got=[*angles, *points], fix=fix)
    chosen = cast(Kind, kind or ("angles" if angles else "markers"))
    if chosen == "angles":
        return chosen, angles, False
    if not content.ordered:
        example = ", ".join(map(repr, points[:3]))
        raise InvalidInput(
            f"{source} does not say which markers to take, and in which order they are along the rope",
            got=listed(points),
            fix=f"Name them from the pivot to the tip: markers=[{example}]",
        )
    return chosen, *_of_markers(content, points)


def one_unit(content: Content, names: Sequence[str]) -> str | None:
    """Return the unit of channels; None if the file does not give it, InvalidInput if they do not have the same."""
    units = {name: unit_name(content.units[name]) if name in content.units else None for name in names}
    unit, *others = set(units.values())
    if others:
        raise InvalidInput(
            f"{content.source} does not give one unit to all columns",
            got=units,
            fix="Choose some of one unit, or give all the same",
        )
    return unit


def _beside(content: Content, what: str, names: Sequence[str]) -> Array | None:
    """Return the rates or noise (T, C) of channels; None if the file has none."""
    by_name: Mapping[str, str] = getattr(content, what)
    found = [by_name[name] for name in names if name in by_name]
    if not found:
        return None
    if len(found) < len(names):
        given = f"{content.source} gives the {what} of some columns only"
        raise InvalidInput(given, got=found, allowed="such a column for each or none")
    if what == "noise" and "noise" in content.declared:
        fix = "Remove one of them"
        raise InvalidInput(f"{content.source} gives its noise twice", got=[*found, "# noise: .."], fix=fix)
    if what == "rates" and (units := {content.units[name] for name in found if name in content.units}):
        expected = f"{content.units.get(names[0], '')}/s"
        if names[0] in content.units and units != {expected}:
            given = f"{content.source}: the unit of columns {', '.join(found)} does not fit"
            raise InvalidInput(given, got=sorted(units), allowed=repr(expected))
    return content.take(found)
