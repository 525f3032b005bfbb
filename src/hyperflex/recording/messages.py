"""Messages of joints and poses as columns, whatever the file: which topic, which joints, in which plane."""

from array import array
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.recording.declare import Raw
from hyperflex.recording.recording import Kind

PLANES = {"xz": (0, 2), "xy": (0, 1), "yz": (1, 2)}  # axes to the right and up, of poses in space
TIMES = ("t", "log")  # stamps in the messages, or times at which they were recorded


class Topic(NamedTuple):
    """A topic of a file that can be read: its name, what it holds, and in how many messages."""

    name: str
    kind: Kind
    messages: int


class Selection(NamedTuple):
    """What the caller asks for: a topic and a kind where there are several, joints by name, a plane, which times."""

    topic: str | None = None
    kind: str | None = None
    columns: Sequence[str] | None = None
    plane: str | None = None
    time: str = TIMES[0]


class Joints(NamedTuple):
    """A message of joints: time (s, or whole ns), names, angles and rates (none, or one a joint)."""

    time: float
    names: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]


class Poses(NamedTuple):
    """A message of poses: time (s, or whole ns), and x, y, z of each, one after the other."""

    time: float
    places: Sequence[float]


def choose(path: PathLike, topics: Sequence[Topic], selection: Selection) -> Topic:
    """Return the selected topic; InvalidInput where there is none, or where several could be meant."""
    checks.choice("time", selection.time, TIMES)
    if selection.plane is not None:
        checks.choice("plane", selection.plane, tuple(PLANES))
    listed = ", ".join(f"{each.name} ({each.kind})" for each in topics) or "none"
    fit = [each for each in topics if selection.kind in (None, each.kind) and selection.topic in (None, each.name)]
    if not fit:
        got = selection.topic or selection.kind or "other topics"
        allowed = f"joint states, poses or points; here: {listed}"
        raise InvalidInput(f"{path} has no such topic to read", got=got, allowed=allowed)
    if len(fit) > 1:
        raise InvalidInput(f"{path} has several topics to read", got=listed, fix="Name one: topic=...")
    if not fit[0].messages:
        raise InvalidInput(f"{path}: topic {fit[0].name} has no messages", fix="Record it again")
    return fit[0]


def refuse_columns(path: PathLike, topic: Topic, selection: Selection) -> None:
    """Refuse names of joints for a topic of poses."""
    if selection.columns is not None:
        raise InvalidInput(f"{path}: columns are names of joints, {topic.name} holds poses", fix="Leave them out")


def joints(path: PathLike, rows: Iterable[Joints], columns: Sequence[str] | None) -> Raw:
    """Return joint states as columns in the order of the given names, by default the first message's; NaN in gaps."""
    times: list[float] = []
    position, velocity, order, moving = array("d"), array("d"), list(columns or ()), True
    for row in rows:
        order = order or list(row.names)
        if len(row.position) != len(row.names):
            raise InvalidInput(f"{path}: message {len(times)} has not one position a joint", got=len(row.position))
        moving &= len(row.velocity) == len(row.names)
        times.append(row.time)
        if list(row.names) == order:
            position.extend(row.position)
            velocity.extend(row.velocity if moving else ())
        else:
            at = {name: k for k, name in enumerate(row.names)}
            position.extend(row.position[at[name]] if name in at else np.nan for name in order)
            velocity.extend(row.velocity[at[name]] if moving and name in at else np.nan for name in order)
    data = np.array(position).reshape(len(times), -1)
    if unseen := [name for name, column in zip(order, data.T, strict=True) if np.isnan(column).all()]:
        raise InvalidInput(f"{path} has no joints of these names", got=unseen, fix="Check columns=[...]")
    rates = np.array(velocity).reshape(data.shape) if moving else None
    usual = {"angles": "relative"}  # joint coordinates
    declared = {"time_unit": "s", "unit": "rad"}
    return Raw(_seconds(times), data, "angles", rates=rates, declared=declared, usual=usual, source=str(path))


def poses(path: PathLike, rows: Iterable[Poses], plane: str | None) -> Raw:
    """Return the places of poses in a plane as columns."""
    if plane is None:
        allowed = "'xz' (x right, z up), 'xy' or 'yz'"
        fix = "Pass plane=...: the axes to the right and up, in which the rope swings"
        raise InvalidInput(f"{path} holds places in space, and no plane is declared", allowed=allowed, fix=fix)
    times: list[float] = []
    places, size = array("d"), 0
    for row in rows:
        size = size or len(row.places)
        if len(row.places) != size:
            got = f"{len(row.places) // 3}, the first one {size // 3}"
            raise InvalidInput(f"{path}: message {len(times)} has another number of poses", got=got)
        times.append(row.time)
        places.extend(row.places)
    data = np.array(places).reshape(len(times), -1, 3)[:, :, PLANES[plane]].reshape(len(times), -1)
    declared, usual = {"time_unit": "s", "unit": "m"}, {"y_axis": "up"}
    return Raw(_seconds(times), data, "markers", declared=declared, usual=usual, source=str(path))


def _seconds(times: Sequence[float]) -> Array:
    """Return times in s; whole nanoseconds are counted from the first."""
    if times and isinstance(times[0], int):
        stamps = np.array(times, dtype=np.int64)
        return np.asarray((stamps - stamps[0]) / 1e9)
    return np.array(times, dtype=np.float64)
