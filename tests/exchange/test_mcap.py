"""MCAP files: ours are read back bit for bit, those of others by their declarations, and the mcap package reads
both."""

import json
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np
import pytest
from mcap.reader import make_reader

import hyperflex as hf
from tests.refusals import refuses

ODD = np.array([0.1 + 0.2, np.pi, 5e-324, 1e-300, 2.0**53 + 2.0, -1.0 / 3.0])


@pytest.fixture(scope="module")
def run() -> hf.Trajectory:
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=4, friction=1e-3, name="cord")
    return hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=0.5)


def messages(path: Path) -> list[tuple[str, str, int, Any]]:
    """Schema, topic, time and content of each, by the mcap package."""
    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages()
        return [(s.name, c.topic, m.log_time, json.loads(m.data)) for s, c, m in found if s is not None]


def test_a_run_is_read_as_angles_and_as_places(run, tmp_path):
    path = tmp_path / "run.mcap"
    hf.write_mcap(run, path)
    angles, places = hf.read_recording(path), hf.read_recording(path, kind="markers")
    np.testing.assert_array_equal(angles.t, run.t)
    np.testing.assert_array_equal(angles.data, run.q)
    np.testing.assert_array_equal(angles.rates, run.qd)
    np.testing.assert_array_equal(places.data, run.joints.reshape(run.t.size, -1))
    assert (angles.name, angles.n_links) == ("cord", 4)
    found = messages(path)
    assert {each[:2] for each in found} == {("foxglove.JointStates", "/joints"), ("foxglove.PosesInFrame", "/rope")}
    assert len(found) == 2 * run.t.size
    states = next(each[3] for each in found if each[1] == "/joints" and each[2] == 250_000_000)
    assert states["timestamp"] == {"sec": 0, "nsec": 250_000_000}
    assert [each["name"] for each in states["joints"]] == ["arm", "link0", "link1", "link2", "link3"]
    assert states["joints"][0]["position"] == run.arm_angle[25]
    with path.open("rb") as stream:
        told = next(iter(make_reader(stream).iter_metadata())).metadata
    assert (told["source"], told["status"]) == ("simulated", "success")
    assert hf.Setup.loads(told["setup"]).rope == run.setup.rope


@pytest.mark.parametrize("kind", ["angles", "markers"])
@pytest.mark.parametrize("extra", [False, True], ids=["plain", "with noise and rates"])
def test_a_recording_comes_back_bit_for_bit(kind, extra, tmp_path):
    rng = np.random.default_rng(0)
    data = np.tile(ODD[:4] if kind == "angles" else ODD, (7, 1)) * rng.uniform(0.5, 1.0, (7, 1))
    data[3, 1] = data[5, 2] = np.nan
    others: dict[str, Any] = {"noise": rng.uniform(1e-4, 1e-3, data.shape)} if extra else {}
    if extra and kind == "angles":
        others["rates"] = np.where(np.isnan(data), np.nan, rng.normal(size=data.shape))
    t = np.sort(rng.uniform(-1.0, 2.0, 7))
    given = hf.Recording(
        t, data, kind, convention="as it was measured", name="Fishing line, 2 mm", source="x", **others
    )
    hf.write_mcap(given, tmp_path / "a.mcap")
    got = hf.read_recording(tmp_path / "a.mcap", max_rate=1e30)
    for name in ("t", "data", "noise", "rates"):
        np.testing.assert_array_equal(getattr(got, name), getattr(given, name), strict=True)
    assert (got.kind, got.convention, got.name) == (kind, given.convention, given.name)
    assert [each[2] for each in messages(tmp_path / "a.mcap")] == sorted(
        np.round((t - t[0]) * 1e9).astype(int).tolist()
    )


def test_noise_follows_the_order_of_the_joints(tmp_path):
    hf.write_mcap(hf.Recording([0.0, 0.1], [[0.1, 0.2], [0.1, 0.3]], noise=[1e-3, 2e-3]), tmp_path / "a.mcap")
    got = hf.read_recording(tmp_path / "a.mcap", columns=["link1", "link0"])
    assert got.data[0].tolist() == [0.2, 0.1]
    assert got.noise[0].tolist() == [2e-3, 1e-3]


def foreign(path: Path, schema: str, contents: list[dict[str, Any]], topics: tuple[str, ...] = ("/seen",)) -> Path:
    """A file of another program; messages come a second after they were taken."""
    with path.open("wb") as stream:
        out = mcap.writer.Writer(stream)
        out.start()
        known = out.register_schema(schema, "jsonschema", b"{}")
        for topic in topics:
            channel = out.register_channel(topic, "json", known)
            for content in contents:
                stamp = content["timestamp"]["sec"] * 10**9 + content["timestamp"]["nsec"]
                out.add_message(channel, 2 * (stamp + 10**9), json.dumps(content).encode(), stamp)
        out.finish()
    return path


def stamped(**parts: Any) -> list[dict[str, Any]]:
    return [{"timestamp": {"sec": 1_700_000_000, "nsec": k * 10**7}, **parts} for k in range(3)]


def test_joint_states_of_others(tmp_path):
    """Joint coordinates are relative; joints are picked by name, and one that a message lacks is a gap."""
    contents = stamped(joints=[{"name": "b", "position": 0.2}, {"name": "gripper"}, {"name": "a", "position": 0.1}])
    contents[1] = contents[1] | {"joints": contents[1]["joints"][2:]}
    path = foreign(tmp_path / "a.mcap", "foxglove.JointStates", contents)
    got = hf.read_recording(path, columns=["a", "b"])
    np.testing.assert_array_equal(got.t, [0.0, 0.01, 0.02])
    np.testing.assert_array_equal(got.data, [[0.1, 0.1 + 0.2], [0.1, np.nan], [0.1, 0.1 + 0.2]])
    assert hf.read_recording(path, columns=["a"], time="log").duration == pytest.approx(0.04)
    refuses(r"no joints of these names.*gripper", hf.read_recording, path, columns=["a", "gripper"])


@pytest.mark.parametrize("schema", ["foxglove.PosesInFrame", "foxglove.PoseInFrame"])
def test_poses_of_others_need_a_plane(schema, tmp_path):
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    held = {"poses": [pose]} if schema.endswith("PosesInFrame") else {"pose": pose}
    path = foreign(tmp_path / "a.mcap", schema, stamped(frame_id="world", **held))
    refuses(r"markers in space.*plane=", hf.read_recording, path)
    for plane, wanted in (("xz", [1.0, 3.0]), ("xy", [1.0, 2.0]), ("yz", [2.0, 3.0])):
        np.testing.assert_array_equal(hf.read_recording(path, plane=plane).data[0], wanted)
    np.testing.assert_array_equal(hf.read_recording(path, plane="xy", y_axis="down").data[0], [1.0, -2.0])


def test_what_cannot_be_meant_is_refused(run, tmp_path):
    two = foreign(tmp_path / "a.mcap", "foxglove.JointStates", stamped(joints=[]), ("/left", "/right"))
    refuses(r"several topics.*/left.*topic=", hf.read_recording, two)
    other = foreign(tmp_path / "b.mcap", "foxglove.Log", stamped(message="hello"))
    refuses(r"no such topic.*joint states.*here: none", hf.read_recording, other)
    hf.write_mcap(run, tmp_path / "run.mcap")
    for wrong, named in (
        ({"topic": "/rope", "columns": ["x"]}, "columns"),
        ({"time": "clock"}, "time"),
        ({"plane": "zz"}, "plane"),
    ):
        refuses(named, hf.read_recording, tmp_path / "run.mcap", **wrong)
    (tmp_path / "a.csv").write_text("t,th1\n0,0\n1,0\n")
    refuses("for markers in space", hf.read_recording, tmp_path / "a.csv", plane="xz", time_unit="s", unit="rad")
    refuses("topic is not for", hf.read_recording, tmp_path / "a.csv", topic="/rope")
    refuses("neither a run nor a recording", hf.write_mcap, run.setup, tmp_path / "c.mcap")
    assert not (tmp_path / "c.mcap").exists()
