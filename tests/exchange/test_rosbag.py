"""ROS 2 bags of both storages, as their own package writes them."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import FileProblem
from tests.exchange import bags
from tests.refusals import fails, refuses

START = 1_700_000_000_123_456_789  # ns
STAMPS = START + np.cumsum(np.random.default_rng(1).integers(10**6, 10**7, 9))  # too few for rates to be tested
ANGLES = np.cumsum(np.random.default_rng(2).normal(size=(9, 3)) * 1e-3, axis=0)


@pytest.mark.parametrize("storage", bags.SUFFIX)
@pytest.mark.parametrize("whole", [True, False], ids=["the folder", "its file"])
def test_joint_states_bit_for_bit(storage, whole, tmp_path):
    rows = [
        (int(2 * t - START), bags.joint_state(t, ["a", "b", "c"], x, x[::-1]))
        for t, x in zip(STAMPS, ANGLES, strict=True)
    ]
    bag = bags.write(tmp_path / "bag", {"/joint_states": (bags.JOINT_STATE, rows)}, storage)
    path = bag if whole else next(bag.glob(f"*{bags.SUFFIX[storage]}"))
    got = hf.read_recording(path, angles="absolute", max_rate=1e9, columns=["a", "b"])
    np.testing.assert_array_equal(got.t, (STAMPS - STAMPS[0]) / 1e9)
    np.testing.assert_array_equal(got.data, ANGLES[:, :2])
    np.testing.assert_array_equal(got.rates, ANGLES[:, :0:-1])
    np.testing.assert_array_equal(hf.read_recording(path).data, np.cumsum(ANGLES, axis=1))  # joints are relative
    assert hf.read_recording(path, time="log").t[-1] == pytest.approx(2.0 * got.t[-1])


@pytest.mark.parametrize("kind", [bags.POSE_ARRAY, bags.POSE, bags.POINT])
def test_places_bit_for_bit(kind, tmp_path):
    def message(stamp, place):
        if kind == bags.POINT:
            return bags.make(kind, bags.header(stamp), bags.point(place))
        held = bags.pose(place)
        return bags.make(kind, bags.header(stamp), [held, held] if kind == bags.POSE_ARRAY else held)

    rows = [(int(t), message(t, x)) for t, x in zip(STAMPS, ANGLES, strict=True)]
    other = [(START, bags.joint_state(START, ["a"], [0.0]))]
    bag = bags.write(tmp_path / "bag", {"/seen": (kind, rows), "/joint_states": (bags.JOINT_STATE, other)})
    refuses("several topics", hf.read_recording, bag)
    refuses("markers in space.*plane=", hf.read_recording, bag, topic="/seen")
    got = hf.read_recording(bag, kind="markers", plane="xz")
    np.testing.assert_array_equal(got.data, np.tile(ANGLES[:, [0, 2]], 2 if kind == bags.POSE_ARRAY else 1))
    refuses("columns are names of joints", hf.read_recording, bag, topic="/seen", columns=["a"], plane="xz")


def test_a_bag_that_does_not_say_what_its_messages_are(tmp_path):
    """As ROS 2 wrote them until 2023: the types are those of Humble, which later ones share."""
    bags.content_of("sqlite3")(tmp_path)
    with closing(sqlite3.connect(next((tmp_path / "sqlite3").glob("*.db3")))) as held:
        held.execute("delete from message_definitions")
        held.commit()
    assert hf.read_recording(tmp_path / "sqlite3").n_links == 2


def test_an_incomplete_bag_is_refused(tmp_path):
    bag = bags.write(tmp_path / "bag", {"/joint_states": (bags.JOINT_STATE, [])})
    refuses("has no messages", hf.read_recording, bag)
    next(bag.glob("*.db3")).unlink()
    fails(FileProblem, "incomplete", hf.read_recording, bag)
    (bag / "metadata.yaml").unlink()
    fails(FileProblem, "is a folder", hf.read_recording, bag)
