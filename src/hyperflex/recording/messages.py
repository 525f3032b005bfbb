"""MCAP files and ROS 2 bags: joint states, poses and points as columns."""

import json
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hyperflex import checks, extras
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import LARGEST, PathLike, as_path, not_damaged, regular_file
from hyperflex.recording.content import Content, Selection, content_of_channels, content_of_markers
from hyperflex.recording.declare import EPOCHS, PLANES
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
TIMES = ("t", "log")  # stamps in the messages, or times at which they were recorded


class Topic(NamedTuple):
    """A topic of a file: its name, the schema and the number of its messages."""

    name: str
    schema: str
    messages: int


class Message(NamedTuple):
    """A message: time (s, or whole ns), names of joints, and their angles and rates, or x, y, z of each pose.

    And the standard deviations of the angles, or of x and y of each pose, as a file of ours has them.
    """

    time: float
    names: Sequence[str]
    values: Sequence[float]
    rates: Sequence[float] = ()
    std: Sequence[float] = ()


def read_mcap(path: PathLike, selection: Selection) -> Content:
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


def _of_mcap(path: PathLike, reader: Any, summary: Any, selection: Selection) -> Content:
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
        return _content(path, topic, messages, selection)
    if KINDS[topic.schema] == "angles":
        selection = selection._replace(columns=selection.columns or json.loads(own.get("columns", "null")))
    content = _content(path, topic, messages, selection, own.get("plane"))
    kind = KINDS[topic.schema]
    axes = {"angles": "absolute"} if kind == "angles" else {"y_axis": "up"}
    convention = own.get("convention", "") if kind == own["kind"] else ""
    declared = {**content.declared, **axes}
    return replace(content, declared=declared, usual={}, convention=convention, name=own.get("name", ""))


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


def read_bag(path: PathLike, selection: Selection) -> Content:
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
        return _content(path, topic, _ros_messages(reader, topic, selection.time), selection)


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


def _content(
    path: PathLike, topic: Topic, messages: Iterator[Message], selection: Selection, plane: str | None = None
) -> Content:
    """Return messages as the content of a file; `plane` is that of poses in a file of ours."""
    if KINDS[topic.schema] == "angles":
        return _joints(path, messages, selection)
    return _poses(path, topic, messages, selection, plane)


def _joints(path: PathLike, messages: Iterator[Message], selection: Selection) -> Content:
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
    beside = {key: {name: f"{name} {key}" for name in order} for key in ("rates", "std") if key in whole}
    channels = dict(zip(order, whole["values"].T, strict=True))
    for key, names in beside.items():
        channels |= zip(names.values(), whole[key].T, strict=True)
    t, facts = _seconds(times)
    return content_of_channels(
        t,
        channels,
        angles=order,
        rates=beside.get("rates", {}),
        noise=beside.get("std", {}),
        units=dict.fromkeys(order, "rad"),
        declared={"time_unit": "s"},
        usual={"angles": "relative"},  # joint coordinates
        facts=facts,
    )


def _poses(
    path: PathLike, topic: Topic, messages: Iterator[Message], selection: Selection, plane: str | None
) -> Content:
    """Return the places of poses, numbered from 0; in a plane with their noise where the file says which."""
    if selection.columns is not None:
        raise InvalidInput(f"{path}: columns are names of joints, {topic.name} holds poses", fix="Omit them")
    times, places, std = zip(*((row.time, row.values, row.std) for row in messages), strict=True)
    sizes = [len(each) for each in places]
    if len(set(sizes)) > 1:
        k = next(k for k, size in enumerate(sizes) if size != sizes[0])
        got = f"{sizes[k] // 3}, the first one {sizes[0] // 3}"
        raise InvalidInput(f"{path}: message {k} has another number of poses", got=got, fix="Select another topic")
    data = np.array(places).reshape(len(times), -1, 3)
    data = data if plane is None else data[:, :, PLANES[plane]]
    markers = {str(k): data[:, k] for k in range(data.shape[1])}
    t, facts = _seconds(times)
    noise = {}
    if plane is not None and std[0]:
        noise = dict(zip(markers, np.array(std).reshape(len(times), -1, 2).swapaxes(0, 1), strict=True))
    declared = {"time_unit": "s", "unit": "m"}
    usual = {"y_axis": "up"}
    return content_of_markers(t, markers, noises=noise, ordered=True, declared=declared, usual=usual, facts=facts)


def _seconds(times: Sequence[float]) -> tuple[Array, dict[str, float]]:
    """Return times in s, and the epoch if they are stamps; whole nanoseconds are counted from the first."""
    if times and isinstance(times[0], int):
        stamps = np.array(times, dtype=np.int64)
        epoch = float(stamps[0]) / 1e9
        return np.asarray((stamps - stamps[0]) / 1e9), {"epoch": epoch} if epoch > EPOCHS[0] else {}
    return np.array(times, dtype=np.float64), {}
