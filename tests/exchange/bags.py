"""ROS 2 bags as the rosbags package writes them: joint states, poses and points."""

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
SUFFIX = {"sqlite3": ".db3", "mcap": ".mcap"}
JOINT_STATE, POSE_ARRAY = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseArray"
POSE, POINT = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped"
Topics = dict[str, tuple[str, Iterable[tuple[int, Any]]]]  # by name: type, and messages with the times they came at, ns


def make(kind: str, *parts: Any) -> Any:
    return STORE.types[kind](*parts)


def header(stamp: int) -> Any:
    time = make("builtin_interfaces/msg/Time", int(stamp // 10**9), int(stamp % 10**9))
    return make("std_msgs/msg/Header", time, "world")


def joint_state(stamp: int, names: list[str], position: Any, velocity: Any = ()) -> Any:
    numbers = [np.array(values, dtype=np.float64) for values in (position, velocity, ())]
    return make(JOINT_STATE, header(stamp), names, *numbers)


def point(place: Any) -> Any:
    return make("geometry_msgs/msg/Point", *map(float, place))


def pose(place: Any) -> Any:
    return make("geometry_msgs/msg/Pose", point(place), make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))


def write(folder: Path, topics: Topics, storage: str = "sqlite3") -> Path:
    """A bag with these messages; one that is there is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(exist_ok=True)
    with Writer(folder, version=8, storage_plugin=StoragePlugin[storage.upper()]) as bag:
        for topic, (kind, messages) in topics.items():
            connection = bag.add_connection(topic, kind, typestore=STORE)
            for time, message in messages:
                bag.write(connection, time, STORE.serialize_cdr(message, kind))
    return folder


def content_of(storage: str) -> Callable[[Path], bytes]:
    """What makes the bytes of a small bag's one file."""

    def content(folder: Path) -> bytes:
        rows = [(10**9 + k * 10**7, joint_state(10**9 + k * 10**7, ["a", "b"], [0.1, 0.01 * k])) for k in range(6)]
        bag = write(folder / storage, {"/joint_states": (JOINT_STATE, rows)}, storage)
        return next(bag.glob(f"*{SUFFIX[storage]}")).read_bytes()

    return content


def metadata(folder: Path) -> bytes:
    """The description of a small bag, which stays beside it."""
    content_of("sqlite3")(folder / "described")
    return (folder / "described" / "sqlite3" / "metadata.yaml").read_bytes()


def described(path: Path) -> Path:
    """The bag of :func:`metadata` with another description."""
    bag = path.parent / "described" / "sqlite3"
    shutil.copy(path, bag / "metadata.yaml")
    return bag
