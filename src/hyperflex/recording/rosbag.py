"""ROS 2 bags, folders or single files: joint states, poses and points."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hyperflex import extras
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.files import PathLike, as_path
from hyperflex.recording.declare import Raw
from hyperflex.recording.messages import Joints, Poses, Selection, Topic, choose, joints, poses, refuse_columns
from hyperflex.recording.recording import Kind

JOINTS = "sensor_msgs/msg/JointState"
KINDS: dict[str, Kind] = {JOINTS: "angles"}
KINDS |= {f"geometry_msgs/msg/{name}": "markers" for name in ("PoseArray", "PoseStamped", "PointStamped")}
# What the rosbags package raises on damaged bags, found by altering sound ones, beside its own errors.
_DAMAGE: tuple[type[Exception], ...] = (ValueError, LookupError, TypeError, AttributeError, OSError, EOFError)
_DAMAGE += (OverflowError, MemoryError, RuntimeError, AssertionError, SyntaxError)
MOST_NESTED = 100  # brackets of metadata.yaml in each other; with 3,000 the YAML reader gives up after 2.5 s


def is_bag(path: Path) -> bool:
    """Return whether a path is a folder that holds a bag."""
    return path.is_dir() and (path / "metadata.yaml").exists()


def read(path: PathLike, selection: Selection) -> Raw:
    """Return the messages of one topic as columns."""
    bags = extras.load("rosbags.highlevel", "ros", "ROS bags")
    stores = extras.load("rosbags.typesys", "ros", "ROS bags")
    apsw = extras.load("apsw", "ros", "ROS bags")
    known = stores.get_typestore(stores.Stores.ROS2_HUMBLE)  # of bags that do not say what their messages are
    try:
        _check_nesting(as_path(path, "bag"))
        with bags.AnyReader([as_path(path, "bag")], default_typestore=known) as reader:
            return _read(path, reader, selection)
    except (InvalidInput, FileProblem):
        raise
    except (*_DAMAGE, *bags.anyreader.ReaderErrors, bags.AnyReaderError, apsw.Error) as error:
        told = f"The bag {path} cannot be read: it is damaged, cut off or incomplete. Get it again."
        raise FileProblem(told) from error


def _check_nesting(path: Path) -> None:
    """Raise ValueError if the brackets of a bag's metadata are nested deeper than any bag's."""
    depth = 0
    for bracket in re.findall(rb"[][{}]", (path / "metadata.yaml").read_bytes()) if is_bag(path) else ():
        depth += 1 if bracket in b"[{" else -1
        if depth > MOST_NESTED:
            raise ValueError("nested too deep")


def _read(path: PathLike, reader: Any, selection: Selection) -> Raw:
    types = {name: each.msgtype for name, each in reader.topics.items()}
    topics = [
        Topic(name, KINDS[types[name]], each.msgcount) for name, each in reader.topics.items() if types[name] in KINDS
    ]
    topic = choose(path, topics, selection)
    rows = _rows(reader, [each for each in reader.connections if each.topic == topic.name], selection.time)
    if topic.kind == "angles":
        return joints(path, _joints(rows), selection.columns)
    refuse_columns(path, topic, selection)
    return poses(path, _poses(rows, types[topic.name]), selection.plane)


def _rows(reader: Any, connections: list[Any], time: str) -> Iterator[tuple[int, Any]]:
    """Yield times, whole ns, and messages."""
    for connection, logged, content in reader.messages(connections):
        message = reader.deserialize(content, connection.msgtype)
        stamp = message.header.stamp
        yield (logged if time == "log" else stamp.sec * 1_000_000_000 + stamp.nanosec), message


def _joints(rows: Iterable[tuple[int, Any]]) -> Iterator[Joints]:
    for time, message in rows:
        yield Joints(time, message.name, message.position, message.velocity)


def _poses(rows: Iterable[tuple[int, Any]], kind: str) -> Iterator[Poses]:
    for time, message in rows:
        if kind.endswith("PoseArray"):
            points = [each.position for each in message.poses]
        else:
            points = [message.point if kind.endswith("PointStamped") else message.pose.position]
        yield Poses(time, [value for each in points for value in (each.x, each.y, each.z)])
