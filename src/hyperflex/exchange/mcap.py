"""Runs and recordings as MCAP files with Foxglove's JSON messages, numbers to the last bit.

Joint states on ``/joints`` contain absolute link angles; poses on ``/rope`` contain positions, x right, z up. Each
message contains its exact time ``t``, s. A drive's log on ``/drive`` contains its columns by their names.
"""

import heapq
import json
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from typing import NamedTuple

import numpy as np

from hyperflex import checks, extras, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.recording import JOINT_STATES, MCAP_FORMAT, MCAP_METADATA, POSES_IN_FRAME, Recording
from hyperflex.trajectory import Trajectory

DRIVE_LOG = "hyperflex.DriveLog"
TOPICS = {JOINT_STATES: "/joints", POSES_IN_FRAME: "/rope", DRIVE_LOG: "/drive"}


class Channel(NamedTuple):
    """Messages of one schema: times (T,), s, their common form, and the numbers (T, N) that fill it."""

    schema: str
    t: Array
    form: str
    values: Array


def write_mcap(
    source: Trajectory | Recording | None, path: PathLike, *, drive: Mapping[str, Array] | None = None
) -> None:
    """Write a run or a recording as an MCAP file, for Foxglove and other readers of its JSON messages.

    Parameters
    ----------
    source : Trajectory or Recording, or None
        For a run, angles and rates of arm and links go to the topic ``/joints`` and the positions of joints and tip to
        ``/rope``; for a recording, its angles or markers. :func:`hyperflex.read_recording` reads both, bit for bit,
        including gaps.
    path : path-like
        File to write, whole or not at all.
    drive : dict of str to (K,) float64, optional
        Columns of a drive's log, for the topic ``/drive``; "t" are its times, s, on the clock of the source.

    Raises
    ------
    InvalidInput
        If `source` is something else, or there is nothing to write.
    MissingPackage
        If the package mcap is not installed.
    """
    writer = extras.load("mcap.writer", "mcap", "MCAP files")
    notes: dict[str, str] = {}
    channels: list[Channel] = []
    if isinstance(source, Trajectory):
        notes, channels = _run(source)
    elif isinstance(source, Recording):
        notes, channels = _recording(source)
    elif source is not None or drive is None:
        raise InvalidInput("source is neither a run nor a recording", got=type(source), allowed="Trajectory, Recording")
    if drive is not None:
        channels.append(_drive(drive))
    first = min(0.0, *(float(each.t[0]) for each in channels))
    with files.atomic(path, "wb") as stream:
        out = writer.Writer(stream)
        out.start(profile="", library="hyperflex")
        if notes:
            own = {"format": MCAP_FORMAT, **{key: value for key, value in notes.items() if value}}
            out.add_metadata(MCAP_METADATA, own)
        queues = []
        for each in channels:
            schema = (resources.files(__package__) / "templates" / f"{each.schema}.json").read_bytes()
            known = out.register_schema(each.schema, "jsonschema", schema)
            queues.append(_messages(out.register_channel(TOPICS[each.schema], "json", known), each, first))
        for stamp, channel, k, message in heapq.merge(*queues):
            out.add_message(channel, stamp, message.encode(), stamp, k)
        out.finish()


def _run(run: Trajectory) -> tuple[dict[str, str], list[Channel]]:
    """Return the metadata of a run, and its messages."""
    links = [f"link{k}" for k in range(run.q.shape[1])]
    notes = {"kind": "angles", "plane": "xz", "columns": json.dumps(links), "name": run.rope.name}
    notes |= {"source": "simulated", "status": run.status, "message": run.message, "setup": run.setup.dumps()}
    angles = np.column_stack([run.arm_angle, run.q])
    rates = np.column_stack([run.arm_rate, run.qd])
    joints = _joint_states(run.t, ["arm", *links], angles, rates)
    return notes, [joints, _poses(run.t, run.joints.reshape(run.t.size, -1))]


def _recording(recording: Recording) -> tuple[dict[str, str], list[Channel]]:
    """Return the metadata of a recording, and its messages."""
    notes = {key: getattr(recording, key) for key in ("kind", "convention", "name", "source")} | {"plane": "xz"}
    if recording.kind == "markers":
        return notes, [_poses(recording.t, recording.data, recording.noise)]
    names = [f"link{k}" for k in range(recording.n_links)]
    return notes, [_joint_states(recording.t, names, recording.data, recording.rates, recording.noise)]


def _drive(columns: Mapping[str, Array]) -> Channel:
    t = checks.times("times of the drive's log", columns["t"], least=1)
    names = [name for name in columns if name != "t"]
    form = ",".join(f'"{name}":%s' for name in names)
    return Channel(DRIVE_LOG, t, form, np.column_stack([columns[name] for name in names]))


def _joint_states(
    t: Array, names: Sequence[str], position: Array, velocity: Array | None, noise: Array | None = None
) -> Channel:
    rate = "" if velocity is None else ',"velocity":%s'
    states = ",".join(f'{{"name":"{name}","position":%s{rate}}}' for name in names)
    values = position if velocity is None else np.stack([position, velocity], axis=-1).reshape(t.size, -1)
    return _with_noise(JOINT_STATES, t, f'"joints":[{states}]', values, noise)


def _poses(t: Array, places: Array, noise: Array | None = None) -> Channel:
    one = '{"position":{"x":%s,"y":0.0,"z":%s},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}'
    held = ",".join([one] * (places.shape[1] // 2))
    return _with_noise(POSES_IN_FRAME, t, f'"frame_id":"world","poses":[{held}]', places, noise)


def _with_noise(schema: str, t: Array, form: str, values: Array, noise: Array | None) -> Channel:
    if noise is None:
        return Channel(schema, t, form, values)
    deviations = ",".join(["%s"] * noise.shape[1])
    return Channel(schema, t, f'{form},"std":[{deviations}]', np.column_stack([values, noise]))


def _messages(number: int, channel: Channel, first: float) -> Iterator[tuple[int, int, int, str]]:
    """Yield stamps, ns since `first`, s, the channel's number, the message's, and its text.

    The shortest decimals of a float (repr) are read back as the same float.
    """
    form = f'{{"timestamp":{{"sec":%d,"nsec":%d}},"t":%r,{channel.form}}}'
    for k, (time, row) in enumerate(zip(channel.t.tolist(), channel.values, strict=True)):
        stamp = round((time - first) * 1e9)
        numbers = ("null" if value != value else repr(value) for value in row.tolist())
        yield stamp, number, k, form % (*divmod(stamp, 1_000_000_000), time, *numbers)
