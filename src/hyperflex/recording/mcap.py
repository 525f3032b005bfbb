"""MCAP files with Foxglove's JSON messages: joint states, and poses in a frame; those with ROS messages are bags."""

import json
import struct
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hyperflex import extras
from hyperflex.errors import FileProblem, InvalidInput, MissingPackage
from hyperflex.files import LARGEST, PathLike, regular_file
from hyperflex.recording import rosbag
from hyperflex.recording.declare import Raw
from hyperflex.recording.messages import Joints, Poses, Selection, Topic, choose, joints, poses, refuse_columns
from hyperflex.recording.recording import Kind

MCAP_FORMAT = "hyperflex mcap 1"
MCAP_METADATA = "hyperflex"  # name of the record that declares what a file of ours holds
JOINT_STATES, POSES_IN_FRAME, POSE_IN_FRAME = "foxglove.JointStates", "foxglove.PosesInFrame", "foxglove.PoseInFrame"
KINDS: dict[str, Kind] = {JOINT_STATES: "angles", POSES_IN_FRAME: "markers", POSE_IN_FRAME: "markers"}
# What the mcap package raises on damaged files, found by altering sound ones, beside its own errors.
_DAMAGE: tuple[type[Exception], ...] = (struct.error, ValueError, LookupError, TypeError, AttributeError, OSError)
_DAMAGE += (EOFError, OverflowError, MemoryError, RuntimeError, AssertionError, StopIteration)


def read(path: PathLike, selection: Selection) -> Raw:
    """Return the messages of one topic as columns, with what the file declares."""
    reader = extras.load("mcap.reader", "mcap", "MCAP files")
    errors = extras.load("mcap.exceptions", "mcap", "MCAP files")
    zstandard = extras.load("zstandard", "mcap", "MCAP files")
    file = regular_file(path, "MCAP file")
    try:
        with file.open("rb") as stream:
            return _read(path, reader.SeekingReader(stream, validate_crcs=True, record_size_limit=LARGEST), selection)
    except (InvalidInput, FileProblem, MissingPackage):
        raise
    except (*_DAMAGE, errors.McapError, zstandard.ZstdError) as error:
        told = f"The MCAP file {path} cannot be read: it is damaged or cut off. Get it again; mcap recover may help."
        raise FileProblem(told) from error


def _read(path: PathLike, reader: Any, selection: Selection) -> Raw:
    summary = reader.get_summary()
    if summary is None:
        raise InvalidInput(f"{path} has no summary", fix="It was not closed: mcap recover mends such files")
    channels = list(summary.channels.values())
    if channels and all(each.message_encoding == "cdr" for each in channels):
        return rosbag.read(path, selection)
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    known = [each for each in channels if each.message_encoding == "json" and each.schema_id in summary.schemas]
    schemas = {each.topic: summary.schemas[each.schema_id].name for each in known}
    sizes = {each.topic: counts.get(each.id, 1) for each in known}
    own = _own(reader)
    if own and selection.kind is selection.topic is None:  # of a run its angles
        selection = selection._replace(kind=own["kind"])
    topics = [Topic(name, KINDS[kind], sizes[name]) for name, kind in sorted(schemas.items()) if kind in KINDS]
    topic, noise = choose(path, topics, selection), array("d")
    rows = _messages(reader, topic.name, noise)
    if topic.kind == "angles":
        columns = selection.columns or json.loads(own.get("columns", "null"))
        raw = joints(path, _joints(rows, bool(own), selection.time), columns)
    else:
        refuse_columns(path, topic, selection)
        single = schemas[topic.name] == POSE_IN_FRAME
        raw = poses(path, _poses(rows, single, bool(own), selection.time), selection.plane or own.get("plane"))
    return _declared(raw, own, noise)


def _declared(raw: Raw, own: Mapping[str, str], noise: "array[float]") -> Raw:
    """Return columns with what a file of ours declares of them."""
    if not own:
        return raw
    convention = {"angles": ("angles", "absolute"), "markers": ("y_axis", "up")}[raw.kind]
    return replace(
        raw,
        declared={**raw.declared, convention[0]: convention[1]},
        usual={},
        noise=np.array(noise).reshape(raw.data.shape) if noise else None,
        convention=own.get("convention", "") if raw.kind == own["kind"] else "",
        name=own.get("name", ""),
    )


def _messages(reader: Any, topic: str, noise: "array[float]") -> Iterator[tuple[int, Any]]:
    """Yield when each message was recorded, ns, and what it holds; standard deviations go to `noise`."""
    for _, _, each in reader.iter_messages([topic]):
        message = json.loads(each.data)
        noise.extend(message.get("std", ()))
        yield each.log_time, message


def _own(reader: Any) -> Mapping[str, str]:
    """Return what a file of ours declares; nothing for others."""
    for each in reader.iter_metadata():
        if each.name == MCAP_METADATA and each.metadata.get("format") == MCAP_FORMAT:
            return dict(each.metadata)
    return {}


def _time(logged: int, message: Mapping[str, Any], exact: bool, time: str) -> float:
    """Return when a message was taken: of ours to the bit, s, of others by their stamps or the log, whole ns."""
    if exact:
        return float(message["t"])
    stamp = message["timestamp"]
    return logged if time == "log" else int(stamp["sec"]) * 1_000_000_000 + int(stamp["nsec"])


def _joints(rows: Iterable[tuple[int, Any]], exact: bool, time: str) -> Iterator[Joints]:
    for logged, message in rows:
        states = message["joints"]
        position = [_number(each.get("position")) for each in states]
        velocity = [_number(each["velocity"]) for each in states if "velocity" in each]
        yield Joints(_time(logged, message, exact, time), [each["name"] for each in states], position, velocity)


def _poses(rows: Iterable[tuple[int, Any]], single: bool, exact: bool, time: str) -> Iterator[Poses]:
    for logged, message in rows:
        held = [message["pose"]] if single else message["poses"]
        places = [_number(each["position"][axis]) for each in held for axis in "xyz"]
        yield Poses(_time(logged, message, exact, time), places)


def _number(value: Any) -> float:
    """Return a number; null, as gaps are written, is NaN."""
    return float("nan") if value is None else float(value)
