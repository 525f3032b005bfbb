"""Runs and recordings as MCAP files with Foxglove's JSON messages, numbers to the last bit.

Joint states on ``/joints`` contain absolute link angles; poses on ``/rope`` contain positions, x right, z up. Each
message contains its exact time ``t``, s.
"""

import json
from collections.abc import Iterator, Sequence
from importlib import resources

import numpy as np

from hyperflex import extras, files
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.recording import JOINT_STATES, MCAP_FORMAT, MCAP_METADATA, POSES_IN_FRAME, Recording
from hyperflex.trajectory import Trajectory

TOPICS = {JOINT_STATES: "/joints", POSES_IN_FRAME: "/rope"}
Channel = Iterator[tuple[int, str]]  # messages with their times, ns


def write_mcap(source: Trajectory | Recording, path: PathLike) -> None:
    """Write a run or a recording as an MCAP file, for Foxglove and other readers of its JSON messages.

    Parameters
    ----------
    source : Trajectory or Recording
        Of a run, angles and rates of arm and links are written to the topic ``/joints`` and the places of joints and
        tip to ``/rope``; of a recording its angles or markers. :func:`hyperflex.read_recording` reads both, bit for
        bit, gaps included.
    path : path-like
        File to write, whole or not at all.

    Raises
    ------
    InvalidInput
        If `source` is something else.
    MissingPackage
        If the package mcap is not installed.
    """
    writer = extras.load("mcap.writer", "mcap", "MCAP files")
    if isinstance(source, Trajectory):
        notes, channels = _run(source)
    elif isinstance(source, Recording):
        notes, channels = _recording(source)
    else:
        raise InvalidInput("source is neither a run nor a recording", got=type(source), allowed="Trajectory, Recording")
    with files.atomic(path, "wb") as stream:
        out = writer.Writer(stream)
        out.start(profile="", library="hyperflex")
        out.add_metadata(
            MCAP_METADATA, {"format": MCAP_FORMAT, **{key: value for key, value in notes.items() if value}}
        )
        ids = []
        for kind in channels:
            schema = (resources.files(__package__) / "templates" / f"{kind}.json").read_bytes()
            ids.append(out.register_channel(TOPICS[kind], "json", out.register_schema(kind, "jsonschema", schema)))
        for k, together in enumerate(zip(*channels.values(), strict=True)):
            for channel, (stamp, message) in zip(ids, together, strict=True):
                out.add_message(channel, stamp, message.encode(), stamp, k)
        out.finish()


def _run(run: Trajectory) -> tuple[dict[str, str], dict[str, Channel]]:
    """Return the metadata of a run, and its messages by schema."""
    links = [f"link{k}" for k in range(run.q.shape[1])]
    notes = {"kind": "angles", "plane": "xz", "columns": json.dumps(links), "name": run.setup.rope.name}
    notes |= {"source": "simulated", "status": run.status, "message": run.message, "setup": run.setup.dumps()}
    angles = np.column_stack([run.arm_angle, run.q])
    rates = np.column_stack([run.arm_rate, run.qd])
    joints = _joint_states(run.t, ["arm", *links], angles, rates)
    return notes, {JOINT_STATES: joints, POSES_IN_FRAME: _poses(run.t, run.joints.reshape(run.t.size, -1))}


def _recording(recording: Recording) -> tuple[dict[str, str], dict[str, Channel]]:
    """Return the metadata of a recording, and its messages by schema."""
    notes = {key: getattr(recording, key) for key in ("kind", "convention", "name", "source")} | {"plane": "xz"}
    if recording.kind == "markers":
        return notes, {POSES_IN_FRAME: _poses(recording.t, recording.data, recording.noise)}
    names = [f"link{k}" for k in range(recording.n_links)]
    states = _joint_states(recording.t, names, recording.data, recording.rates, recording.noise)
    return notes, {JOINT_STATES: states}


def _joint_states(
    t: Array, names: Sequence[str], position: Array, velocity: Array | None, noise: Array | None = None
) -> Channel:
    rate = "" if velocity is None else ',"velocity":%s'
    states = ",".join(f'{{"name":"{name}","position":%s{rate}}}' for name in names)
    values = position if velocity is None else np.stack([position, velocity], axis=-1).reshape(t.size, -1)
    return _filled(t, f'"joints":[{states}]', values, noise)


def _poses(t: Array, places: Array, noise: Array | None = None) -> Channel:
    one = '{"position":{"x":%s,"y":0.0,"z":%s},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}'
    held = ",".join([one] * (places.shape[1] // 2))
    return _filled(t, f'"frame_id":"world","poses":[{held}]', places, noise)


def _filled(t: Array, form: str, values: Array, noise: Array | None) -> Channel:
    """Yield messages. The shortest decimals of a float (repr) are read back as the same float."""
    if noise is not None:
        form += ',"std":[' + ",".join(["%s"] * noise.shape[1]) + "]"
        values = np.column_stack([values, noise])
    form = f'{{"timestamp":{{"sec":%d,"nsec":%d}},"t":%r,{form}}}'
    first = min(0.0, float(t[0]))
    for time, row in zip(t.tolist(), values, strict=True):
        stamp = round((time - first) * 1e9)
        numbers = ("null" if value != value else repr(value) for value in row.tolist())
        yield stamp, form % (*divmod(stamp, 1_000_000_000), time, *numbers)
