"""MCAP files and ROS 2 bags: joint states, poses and points as columns."""

import json
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hyperflex import checks, extras
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import LARGEST, PathLike, as_path, not_damaged, regular_file
from hyperflex.recording.declare import Raw
from hyperflex.recording.recording import Kind

MCAP_FORMAT = "hyperflex mcap 1"
MCAP_METADATA = "hyperflex"  # name of the record that declares what a file of ours holds
JOINT_STATES, POSES_IN_FRAME, POSE_IN_FRAME = "foxglove.JointStates", "foxglove.PosesInFrame", "foxglove.PoseInFrame"
KINDS: dict[str, Kind] = {  # by schema
    JOINT_STATES: "angles",
    POSES_IN_FRAME: "markers",
    POSE_IN_FRAME: "markers",
    "sensor_msgs/msg/JointState": "angles",
    "geometry_msgs/msg/PoseArray": "markers",
    "geometry_msgs/msg/PoseStamped": "markers",
    "geometry_msgs/msg/PointStamped": "markers",
}
PLANES = {"xz": (0, 2), "xy": (0, 1), "yz": (1, 2)}  # axes to the right and up, of poses in space
TIMES = ("t", "log")  # stamps in the messages, or times at which they were recorded


class Topic(NamedTuple):
    """A topic of a file: its name, the schema and the number of its messages."""

    name: str
    schema: str
    messages: int


class Selection(NamedTuple):
    """What the caller asks for: a topic and a kind where there are several, joints by name, a plane, which times."""

    topic: str | None = None
    kind: str | None = None
    columns: Sequence[str] | None = None
    plane: str | None = None
    time: str = TIMES[0]


class Message(NamedTuple):
    """A message: time (s, or whole ns), names of joints, and their angles and rates, or x, y, z of each pose.

    And the standard deviations of the angles, or of x and y of each pose, as a file of ours has them.
    """

    time: float
    names: Sequence[str]
    values: Sequence[float]
    rates: Sequence[float] = ()
    std: Sequence[float] = ()


def is_bag(path: Path) -> bool:
    """Return whether a path is a folder that holds a bag."""
    return path.is_dir() and (path / "metadata.yaml").exists()


def read_mcap(path: PathLike, selection: Selection) -> Raw:
    """Return the messages of one topic of an MCAP file as columns, with what the file declares."""
    reader = extras.load("mcap.reader", "mcap", "MCAP files")
    file = regular_file(path, "MCAP file")
    with not_damaged("MCAP file", path, "Get it again; mcap recover may help"), file.open("rb") as stream:
        opened = reader.SeekingReader(stream, validate_crcs=True, record_size_limit=LARGEST)
        if (summary := opened.get_summary()) is None:
            raise InvalidInput(f"{path} has no summary", fix="It was not closed: mcap recover mends such files")
        channels = list(summary.channels.values())
        if not channels or any(each.message_encoding != "cdr" for each in channels):
            return _of_mcap(path, opened, summary, selection)
    return read_bag(path, selection)


def _of_mcap(path: PathLike, reader: Any, summary: Any, selection: Selection) -> Raw:
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    topics = [
        Topic(each.topic, summary.schemas[each.schema_id].name, counts.get(each.id, 1))
        for each in summary.channels.values()
        if each.message_encoding == "json" and each.schema_id in summary.schemas
    ]
    ours = (each for each in reader.iter_metadata() if each.name == MCAP_METADATA)
    own = next((dict(each.metadata) for each in ours if each.metadata.get("format") == MCAP_FORMAT), {})
    if own and selection.kind is selection.topic is None:  # of a run its angles
        selection = selection._replace(kind=own["kind"])
    topic = _choose(path, topics, selection)
    messages = _json_messages(reader, topic, selection.time, exact=bool(own))
    if not own:
        return _columns(path, topic, messages, selection)
    selection = selection._replace(plane=selection.plane or own.get("plane"))
    if KINDS[topic.schema] == "angles":
        selection = selection._replace(columns=selection.columns or json.loads(own.get("columns", "null")))
    raw = _columns(path, topic, messages, selection)
    axes = {"angles": "absolute"} if raw.kind == "angles" else {"y_axis": "up"}
    convention = own.get("convention", "") if raw.kind == own["kind"] else ""
    return replace(raw, declared={**raw.declared, **axes}, usual={}, convention=convention, name=own.get("name", ""))


def _json_messages(reader: Any, topic: Topic, time: str, *, exact: bool) -> Iterator[Message]:
    """Yield messages. With `exact` the times are those of a file of ours, s."""
    for _, _, each in reader.iter_messages([topic.name]):
        message = json.loads(each.data)
        if exact:
            when = float(message["t"])
        else:
            stamp = message["timestamp"]
            when = each.log_time if time == "log" else int(stamp["sec"]) * 1_000_000_000 + int(stamp["nsec"])
        std = message.get("std", ())
        if topic.schema == JOINT_STATES:
            joints = message["joints"]
            rates = [_number(joint["velocity"]) for joint in joints if "velocity" in joint]
            position = [_number(joint.get("position")) for joint in joints]
            yield Message(when, [joint["name"] for joint in joints], position, rates, std)
        else:
            held = [message["pose"]] if topic.schema == POSE_IN_FRAME else message["poses"]
            yield Message(when, (), [_number(pose["position"][axis]) for pose in held for axis in "xyz"], std=std)


def _number(value: Any) -> float:
    """Return a number; null, as gaps are written, is NaN."""
    return float("nan") if value is None else float(value)


def read_bag(path: PathLike, selection: Selection) -> Raw:
    """Return the messages of one topic of a ROS 2 bag as columns."""
    bags = extras.load("rosbags.highlevel", "ros", "ROS bags")
    stores = extras.load("rosbags.typesys", "ros", "ROS bags")
    known = stores.get_typestore(stores.Stores.ROS2_HUMBLE)  # of bags that do not say what their messages are
    with (
        not_damaged("bag", path, "Get it again"),
        bags.AnyReader([as_path(path, "bag")], default_typestore=known) as reader,
    ):
        topics = [Topic(name, each.msgtype or "", each.msgcount) for name, each in reader.topics.items()]
        topic = _choose(path, topics, selection)
        return _columns(path, topic, _ros_messages(reader, topic, selection.time), selection)


def _ros_messages(reader: Any, topic: Topic, time: str) -> Iterator[Message]:
    for connection, logged, content in reader.messages(reader.topics[topic.name].connections):
        message = reader.deserialize(content, connection.msgtype)
        stamp = message.header.stamp
        when = logged if time == "log" else stamp.sec * 1_000_000_000 + stamp.nanosec
        if KINDS[topic.schema] == "angles":
            yield Message(when, message.name, message.position, message.velocity)
            continue
        if topic.schema.endswith("PoseArray"):
            points = [each.position for each in message.poses]
        else:
            points = [message.point if topic.schema.endswith("PointStamped") else message.pose.position]
        yield Message(when, (), [value for each in points for value in (each.x, each.y, each.z)])


def _choose(path: PathLike, topics: Sequence[Topic], selection: Selection) -> Topic:
    """Return the selected topic; InvalidInput where there is none, or where several could be meant."""
    checks.choice("time", selection.time, TIMES)
    if selection.plane is not None:
        checks.choice("plane", selection.plane, tuple(PLANES))
    known = sorted(each for each in topics if each.schema in KINDS)
    listed = ", ".join(f"{each.name} ({KINDS[each.schema]})" for each in known) or "none"
    fit = [
        each for each in known if selection.kind in (None, KINDS[each.schema]) and selection.topic in (None, each.name)
    ]
    if not fit:
        got = selection.topic or selection.kind or "other topics"
        allowed = f"joint states, poses or points; here: {listed}"
        raise InvalidInput(f"{path} has no such topic to read", got=got, allowed=allowed)
    if len(fit) > 1:
        raise InvalidInput(f"{path} has several topics to read", got=listed, fix="Name one: topic=...")
    if not fit[0].messages:
        raise InvalidInput(f"{path}: topic {fit[0].name} has no messages", fix="Record it again")
    return fit[0]


def _columns(path: PathLike, topic: Topic, messages: Iterator[Message], selection: Selection) -> Raw:
    """Return messages as columns."""
    return (_joints if KINDS[topic.schema] == "angles" else _poses)(path, topic, messages, selection)


def _joints(path: PathLike, topic: Topic, messages: Iterator[Message], selection: Selection) -> Raw:
    """Return joints as columns in the order of the given names, by default the first message's; NaN in gaps."""
    times: list[float] = []
    order, columns = list(selection.columns or ()), {"values": array("d"), "rates": array("d"), "std": array("d")}
    for row in messages:
        order = order or list(row.names)
        if len(row.values) != len(row.names):
            what, fix = f"{path}: message {len(times)} has not one position a joint", "Record it again"
            raise InvalidInput(what, got=len(row.values), fix=fix)
        times.append(row.time)
        at = {name: k for k, name in enumerate(row.names)}
        for key, column in columns.items():
            found: Sequence[float] = getattr(row, key)
            if len(found) == len(row.names):
                column.extend(found[at[name]] if name in at else np.nan for name in order)
    shape = len(times), len(order)
    whole = {key: np.array(each).reshape(shape) for key, each in columns.items() if len(each) == shape[0] * shape[1]}
    if unseen := [name for name, column in zip(order, whole["values"].T, strict=True) if np.isnan(column).all()]:
        raise InvalidInput(f"{path} has no joints of these names", got=unseen, fix="Check columns=[...]")
    declared, usual = {"time_unit": "s", "unit": "rad"}, {"angles": "relative"}  # joint coordinates
    noise, rates = whole.get("std"), whole.get("rates")
    return Raw(_seconds(times), whole["values"], "angles", noise, rates, declared, usual, source=str(path))


def _poses(path: PathLike, topic: Topic, messages: Iterator[Message], selection: Selection) -> Raw:
    """Return the places of poses in a plane as columns."""
    if selection.columns is not None:
        raise InvalidInput(f"{path}: columns are names of joints, {topic.name} holds poses", fix="Omit them")
    if selection.plane is None:
        allowed = "'xz' (x right, z up), 'xy' or 'yz'"
        fix = "Pass plane=...: the axes to the right and up, in which the rope swings"
        raise InvalidInput(f"{path} holds places in space, and no plane is declared", allowed=allowed, fix=fix)
    times, places, std = zip(*((row.time, row.values, row.std) for row in messages), strict=True)
    sizes = [len(each) for each in places]
    if len(set(sizes)) > 1:
        k = next(k for k, size in enumerate(sizes) if size != sizes[0])
        got = f"{sizes[k] // 3}, the first one {sizes[0] // 3}"
        raise InvalidInput(f"{path}: message {k} has another number of poses", got=got, fix="Select another topic")
    data = np.array(places).reshape(len(times), -1, 3)[:, :, PLANES[selection.plane]].reshape(len(times), -1)
    declared, usual = {"time_unit": "s", "unit": "m"}, {"y_axis": "up"}
    noise = np.array(std).reshape(data.shape) if std[0] else None
    return Raw(_seconds(times), data, "markers", noise, None, declared, usual, source=str(path))


def _seconds(times: Sequence[float]) -> Array:
    """Return times in s; whole nanoseconds are counted from the first."""
    if times and isinstance(times[0], int):
        stamps = np.array(times, dtype=np.int64)
        return np.asarray((stamps - stamps[0]) / 1e9)
    return np.array(times, dtype=np.float64)
