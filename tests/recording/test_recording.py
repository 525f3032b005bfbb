"""recording: refusals of a Recording, conversions that must be declared, and each reader on good and bad files."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
import scipy.io

from hyperflex.checks import Array
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.recording import Recording, read_recording
from tests.refusals import fails, refuses

NAN = float("nan")


def swing(n: int = 2, samples: int = 400, step: float = 5e-3) -> tuple[Array, Array, Array]:
    """Smooth angles (T, n) with their exact rates."""
    t = step * np.arange(samples)
    pace, size = 2.0 + np.arange(n), 0.8 / (1.0 + np.arange(n))
    return t, size * np.cos(pace * t[:, None]), -size * pace * np.sin(pace * t[:, None])


def places(angles: Array, lengths: Array) -> Array:
    """Marker positions (T, 2n + 2) of a chain whose pivot is at (0.1, 0.2)."""
    joints = np.zeros((angles.shape[0], angles.shape[1] + 1, 2)) + np.array([0.1, 0.2])
    joints[:, 1:, 0] += np.cumsum(lengths * np.sin(angles), axis=1)
    joints[:, 1:, 1] -= np.cumsum(lengths * np.cos(angles), axis=1)
    return joints.reshape(angles.shape[0], -1)


# ---- the Recording


def test_arrays_are_read_only_copies():
    data = np.array([[0.1], [0.2]])
    recording = Recording([0.0, 0.1], data)
    data[0] = 9.0
    assert recording.data[0, 0] == 0.1
    with pytest.raises(ValueError, match="read-only"):
        recording.data[0] = 1.0
    with pytest.raises(AttributeError):
        recording.t = np.zeros(2)


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "inf": ({"data": [[0.1], [math.inf]]}, r"data\[1, 0\].*NaN marks a gap"),
    "nan time": ({"t": [0.0, NAN]}, r"t\[1\]"),
    "repeated time": ({"t": [0.0, 0.0]}, "repeats a time at sample 1"),
    "unsorted": ({"t": [0.0, 0.2, 0.1], "data": np.zeros((3, 1))}, "back in time at sample 2"),
    "one sample": ({"t": [0.0], "data": [[0.1]]}, "too few samples"),
    "none": ({"t": [], "data": np.zeros((0, 1))}, "too few samples"),
    "wrong length": ({"data": [[0.1], [0.1], [0.1]]}, "wrong shape"),
    "flat": ({"kind": "markers", "data": [0.1, 0.2]}, "wrong shape"),
    "ragged": ({"data": [[0.1], [0.1, 0.2]]}, "not an array of numbers"),
    "a time step": ({"t": 0.1}, "got 0.1. Allowed: a list of numbers"),
    "no columns": ({"data": np.zeros((2, 0))}, "wrong number of columns"),
    "all gaps": ({"data": [[0.1, NAN], [0.2, NAN]]}, "link 1 has no value"),
    "odd markers": ({"kind": "markers", "data": np.zeros((2, 5))}, "wrong number of columns"),
    "half a marker": ({"kind": "markers", "data": np.zeros((2, 1))}, "wrong number of columns"),
    "kind": ({"kind": "video"}, "kind is not known"),
    "noise 0": ({"noise": 0.0}, "noise"),
    "noise nan": ({"noise": NAN}, "noise"),
    "noise shape": ({"noise": [0.1, 0.1]}, "noise"),
    "noise word": ({"noise": "small"}, "noise"),
    "rates": ({"rates": [[0.1, 0.2], [0.1, 0.2]]}, "rates"),
    "words": ({"data": [["a"], ["b"]]}, "not an array of numbers"),
}


def test_the_angles_of_one_link_may_be_a_vector():
    """A message names the column of the file that a link or marker was in."""
    assert Recording([0.0, 0.1], [0.1, 0.2], rates=[1.0, 1.0]).data.tolist() == [[0.1], [0.2]]
    named = Recording([0.0, 0.1], [[0.1, 0.2]] * 2, columns=("th1", "th2"))
    assert (named.label(1), named.window(0.0, 1.0).label(1), Recording([0.0, 0.1], [0.1, 0.2]).label(0)) == (
        "link 1 (th2)",
        "link 1 (th2)",
        "link 0",
    )


@pytest.mark.parametrize(("change", "match"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_used_is_refused(change, match):
    refuses(match, Recording, **{"t": [0.0, 0.1], "data": [[0.1], [0.2]]} | change)


def test_uneven_times_gaps_and_noise_are_fine():
    recording = Recording([0.0, 0.1, 0.5], [[0.1, 1.0], [NAN, 1.1], [0.3, 1.2]], noise=[1e-3, 2e-3])
    assert (recording.n_links, recording.gaps, recording.duration) == (2, 1, 0.5)
    np.testing.assert_array_equal(recording.noise, [[1e-3, 2e-3]] * 3)
    assert "1 gaps" in repr(recording)


def test_window_and_decimate_keep_all_arrays_together():
    t, data, rates = swing()
    recording = Recording(t, data, rates=rates, noise=np.arange(1.0, 801.0).reshape(400, 2), name="swing")
    before, after = recording.window(-np.inf, 0.5), recording.window(0.5, np.inf)
    assert (before.t[-1], after.t[0]) == (t[99], t[100])  # t < 0.5 and t >= 0.5, with t[100] = 0.5
    part = recording.window(0.5, 1.0).decimate(7)
    chosen = np.arange(100, 200, 7)
    for name in ("t", "data", "rates", "noise"):
        np.testing.assert_array_equal(getattr(part, name), getattr(recording, name)[chosen])
    assert part.name == "swing"
    refuses(r"0 to 1.995 s", recording.window, 5.0, np.inf)
    refuses("step", recording.decimate, 0)


def test_markers_give_back_the_angles_through_whole_turns():
    t = np.linspace(0.0, 2.0, 201)
    angles = np.stack([5.0 * t, 0.3 - 9.0 * t], axis=1)
    markers = places(angles, np.array([0.2, 0.1]))
    recording = Recording(t, markers, kind="markers", noise=1e-3)
    found = recording.angles()
    np.testing.assert_allclose(found.data, angles, atol=1e-12)  # rounding of sin, cos and atan2 only
    np.testing.assert_allclose(recording.link_lengths(), [0.2, 0.1], rtol=1e-12)  # likewise
    # Equal noise of both ends, whichever way the link points: sqrt(2) * 1 mm over its length.
    np.testing.assert_allclose(found.noise, np.broadcast_to([math.sqrt(2e-6) / 0.2, math.sqrt(2e-6) / 0.1], (201, 2)))
    assert found.angles() is found
    refuses("no lengths", found.link_lengths)


def test_a_missing_or_doubled_marker_is_a_gap_of_its_links():
    t, angles, _ = swing(samples=50)
    markers = places(angles, np.array([0.2, 0.1]))
    markers[10, 4] = NAN  # end of link 1
    markers[20, 2:4] = markers[20, 0:2]  # joint on the pivot
    found = Recording(t, markers, kind="markers", noise=1e-3).angles()
    expected = np.zeros((50, 2), bool)
    expected[10, 1] = expected[20, 0] = True
    np.testing.assert_array_equal(np.isnan(found.data), expected)


# ---- CSV


def csv(tmp_path: Path, header: str, rows: Array, notes: str = "") -> Path:
    path = tmp_path / "swing.csv"
    body = "\n".join(",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows)
    path.write_text(f"{notes}{header}\n{body}\n")
    return path


def test_csv_angles_with_rates_and_a_gap(tmp_path):
    t, data, rates = swing()
    data[3, 1] = NAN
    path = csv(tmp_path, "t,th1,th2,w1,w2", np.column_stack([t, data, rates]))
    recording = read_recording(path, time_unit="s", unit="rad", noise=1e-3)
    for name, expected in (("t", t), ("data", data), ("rates", rates)):
        np.testing.assert_array_equal(getattr(recording, name), expected)
    assert (recording.name, recording.gaps, recording.noise is not None) == ("swing", 1, True)


def test_csv_conversions(tmp_path):
    t, data, rates = swing()
    relative = np.diff(data, axis=1, prepend=0.0)
    degrees = -np.degrees(relative + np.array([math.pi, 0.0]))  # upright zero, other sense
    table = np.column_stack([1e3 * t, degrees, -np.degrees(np.diff(rates, axis=1, prepend=0.0))])
    path = csv(tmp_path, "t,th1,th2,w1,w2", table)
    recording = read_recording(
        path, time_unit="ms", unit="deg", zero="up", sense="-x", angles="relative", noise=math.degrees(1e-3)
    )
    np.testing.assert_allclose(recording.t, t, atol=1e-15)  # rounding
    np.testing.assert_allclose(recording.data, data, atol=1e-13)  # rounding of some ten operations
    np.testing.assert_allclose(recording.rates, rates, atol=1e-12)
    np.testing.assert_allclose(recording.noise[0], [1e-3, math.sqrt(2e-6)], rtol=1e-12)
    assert "relative angles in deg" in recording.convention


def test_csv_declares_itself_in_header_or_notes(tmp_path):
    t, data, _ = swing(n=1)
    table = np.column_stack([1e3 * t, np.degrees(data)])
    in_header = read_recording(csv(tmp_path, "t [ms],th1 [deg]", table))
    in_notes = read_recording(csv(tmp_path, "t,th1", table, "# time_unit: ms\n# unit: deg\n# other: 3\n"))
    np.testing.assert_allclose(in_header.data, data, atol=1e-13)  # rounding
    np.testing.assert_array_equal(in_notes.data, in_header.data)
    refuses(r"argument something else.*'rad'", read_recording, tmp_path / "swing.csv", unit="rad")
    refuses("header and notes disagree", read_recording, csv(tmp_path, "t [ms],th1 [deg]", table, "# unit: rad\n"))
    refuses("not a number", read_recording, csv(tmp_path, "t,th1", table, "# frame_rate: fast\n"))
    refuses("one unit to all", read_recording, csv(tmp_path, "t [ms],th1 [deg],th2", np.column_stack([table, data])))


def test_csv_notes_declare_wrapping_and_noise(tmp_path):
    t = np.linspace(0.0, 2.0, 201)
    angle = 8.0 * t
    table = np.column_stack([t, (angle + math.pi) % (2 * math.pi) - math.pi])
    notes = "# time_unit: s\n# unit: rad\n# wrapped: True\n# noise: 0.01\n"
    undeclared = csv(tmp_path, "t,th1", table)
    refuses("wrapped=True", read_recording, undeclared, time_unit="s", unit="rad")
    path = csv(tmp_path, "t,th1", table, notes)
    found = read_recording(path)
    np.testing.assert_allclose(found.data[:, 0], angle, atol=1e-12)  # rounding
    np.testing.assert_array_equal(found.noise, 0.01)
    assert read_recording(path, noise=0.01, wrapped=True).noise is not None
    for argument in ({"noise": 0.02}, {"wrapped": False}):
        refuses(f"declares {next(iter(argument))} = .*argument something else", read_recording, path, **argument)
    refuses("noise twice", read_recording, csv(tmp_path, "t,th1,std_th1", np.column_stack([table, t + 1.0]), notes))
    two = csv(tmp_path, "t,th1,th2", np.column_stack([t, angle, angle]), notes.replace("0.01", "0.01, 0.02"))
    noise = read_recording(two).noise
    np.testing.assert_array_equal(noise[7], [0.01, 0.02])


BAD_NOTES = {
    "wrapped: maybe": "'true', 'yes', 'false', 'no'",
    "noise: -1": "'noise' has the wrong sign",
    "noise: low": "'noise' is not a number",
    "scale: 0": "'scale' has the wrong sign",
    "zero: left": "'hanging', 'up'",
    "units: deg": r"# units: deg.*time_unit.*wrapped.*noise",
    "y axis: up": "looks like a declaration",
    "angle unit: deg": "looks like a declaration",
    "sence: -x": "looks like a declaration",
    "max_rate: 500": "looks like a declaration",
}


@pytest.mark.parametrize(("note", "match"), BAD_NOTES.items(), ids=BAD_NOTES.keys())
def test_csv_notes_that_would_be_lost_are_refused(tmp_path, note, match):
    t, data, _ = swing(n=1)
    path = csv(tmp_path, "t [s],th1 [rad]", np.column_stack([t, data]), f"# {note}\n")
    refuses(match, read_recording, path)


def test_csv_comments_are_no_declarations(tmp_path):
    t, data, _ = swing(n=1)
    notes = "# swing of Tuesday\n# name: lab\n# source: own\n# time: 12:30\n# date: 1 May\n# camera: 200 Hz\n"
    path = csv(tmp_path, "t [s],th1 [rad]", np.column_stack([t, data]), notes)
    np.testing.assert_array_equal(read_recording(path).data, data)


def test_csv_markers_in_pixels_and_frames(tmp_path):
    t, angles, _ = swing()
    markers = places(angles, np.array([0.2, 0.1]))
    pixels = markers / 5e-4 * np.array([1.0, -1.0] * 3)
    path = csv(tmp_path, "t,x0,y0,x1,y1,x2,y2", np.column_stack([np.arange(t.size), pixels]))
    recording = read_recording(
        path, time_unit="frame", frame_rate=200.0, unit="px", scale=5e-4, y_axis="down", noise=1.0
    )
    np.testing.assert_allclose(recording.t, t, atol=1e-15)  # rounding
    np.testing.assert_allclose(recording.data, markers, atol=1e-15)  # rounding
    np.testing.assert_allclose(recording.noise, 5e-4)


def test_csv_columns_by_name_and_noise_columns(tmp_path):
    t, data, _ = swing()
    path = csv(tmp_path, "clock,upper,lower,humidity", np.column_stack([t, data, t]))
    named = read_recording(
        path, time="clock", time_unit="s", unit="rad", kind="angles", columns=["upper", "lower"], name="lab"
    )
    np.testing.assert_array_equal(named.data, data)
    assert named.name == "lab"
    path = csv(tmp_path, "t,th0,th1,std_th0,std_th1", np.column_stack([t, data, np.full((t.size, 2), 2e-3)]))
    noisy = read_recording(path, time_unit="s", unit="rad")
    np.testing.assert_array_equal(noisy.noise, 2e-3)


def test_what_is_not_declared_is_refused_by_name(tmp_path):
    t, data, _ = swing(n=1)
    angles = csv(tmp_path, "t,th1", np.column_stack([t, data]))
    with pytest.raises(
        InvalidInput,
        match=r"not all .* is declared\. Pass time_unit=\.\.\. \(s .*, unit=\.\.\. \(rad .*nothing is guessed",
    ):
        read_recording(angles)
    refuses(r"Pass frame_rate=\.\.\. \(frames/s\)", read_recording, angles, time_unit="frame", unit="rad")
    (tmp_path / "m").mkdir()
    markers = csv(tmp_path / "m", "t,x0,y0,x1,y1", np.column_stack([t, places(data, np.array([0.2]))]))
    refuses(r"Pass time_unit=.*unit=.*y_axis=\.\.\. \(up", read_recording, markers)
    refuses(r"Pass scale=", read_recording, markers, time_unit="s", unit="px", y_axis="up")


CONTRADICTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "frame rate with seconds": ({"frame_rate": 100.0}, "frame_rate is for times that count frames"),
    "scale with angles": ({"scale": 1e-3}, "scale is for markers"),
    "axis with angles": ({"y_axis": "up"}, "y_axis is for markers"),
    "unknown unit": ({"unit": "grad"}, "'rad'"),
    "metres for angles": ({"unit": "m"}, "'rad'"),
    "zero": ({"zero": "left"}, "'hanging'"),
    "time column": ({"time": "clock"}, "no time column 'clock'"),
    "columns without kind": ({"columns": ["th1"]}, "without kind"),
    "unknown columns": ({"columns": ["th9"], "kind": "angles"}, "no such columns"),
    "kind without columns": ({"kind": "markers"}, "holds angles"),
    "noise": ({"noise": -1.0}, "noise"),
    "max_rate": ({"max_rate": NAN}, "max_rate"),
}


@pytest.mark.parametrize(("change", "match"), CONTRADICTIONS.values(), ids=CONTRADICTIONS.keys())
def test_contradictions_are_refused(tmp_path, change, match):
    t, data, _ = swing(n=1)
    path = csv(tmp_path, "t,th1", np.column_stack([t, data]))
    refuses(match, read_recording, path, **{"time_unit": "s", "unit": "rad"} | change)


HEADERS = {
    "hole": ("t,th1,th3", "without a hole"),
    "from two": ("t,th2,th3", "without a hole"),
    "too few rates": ("t,th1,th2,w1", "2 links"),
    "stranger": ("t,th1,weight", "which columns to take"),
    "no data": ("t,a", "which columns to take"),
    "both kinds": ("t,th1,x0,y0,x1,y1", "kind='angles' or 'markers'"),
    "half a marker": ("t,x0,y0,x1", "lacks coordinates"),
    "some noise": ("t,th1,th2,std_th1", "some columns only"),
}


@pytest.mark.parametrize(("header", "match"), HEADERS.values(), ids=HEADERS.keys())
def test_wrong_columns_are_refused(tmp_path, header, match):
    rows = np.tile(np.linspace(0.0, 1.0, 5)[:, None], (1, header.count(",") + 1))
    refuses(match, read_recording, csv(tmp_path, header, rows), time_unit="s", unit="rad")


def test_wrong_units_are_noticed_where_they_can_be(tmp_path):
    t, data, rates = swing(n=1)
    fast = csv(tmp_path, "t,th1", np.column_stack([t, np.degrees(5.0 * data)]))
    refuses(r"max_rate.*unit='deg'", read_recording, fast, time_unit="s", unit="rad")
    assert read_recording(fast, time_unit="s", unit="rad", max_rate=1e4).n_links == 1
    mixed = csv(tmp_path, "t,th1,w1", np.column_stack([t, np.degrees(0.1 * data), 0.1 * rates]))
    refuses(r"change 57.* times as fast", read_recording, mixed, time_unit="s", unit="rad")
    slow = csv(tmp_path, "t,th1,w1", np.column_stack([1e3 * t, data, rates]))
    refuses(r"change 0\.00.* times as fast", read_recording, slow, time_unit="s", unit="rad")


def test_missing_rows_do_not_look_like_wrong_units(tmp_path):
    t, data, rates = swing(n=1, samples=1000)
    kept = np.r_[0:100, 500:600]  # 2 s are missing, in which the link swings to and fro
    holed = csv(tmp_path, "t,th1,w1", np.column_stack([t, data, rates])[kept])
    np.testing.assert_array_equal(read_recording(holed, time_unit="s", unit="rad").t, t[kept])
    mixed = csv(tmp_path, "t,th1,w1", np.column_stack([t, np.degrees(0.1 * data), 0.1 * rates])[kept])
    refuses(r"change 57.* times as fast", read_recording, mixed, time_unit="s", unit="rad")


def test_other_suffixes_and_missing_files(tmp_path):
    (tmp_path / "swing.xlsx").write_bytes(b"PK\x03\x04")
    refuses("Excel workbook.*Save it as CSV", read_recording, tmp_path / "swing.xlsx")
    for suffix in ("csv", "nc", "mat"):
        fails(FileProblem, "There is no", read_recording, tmp_path / f"gone.{suffix}")
        (tmp_path / f"empty.{suffix}").write_bytes(b"")
        fails(FileProblem, "is empty", read_recording, tmp_path / f"empty.{suffix}")


# ---- NetCDF


def recordings() -> dict[str, Recording]:
    t, data, rates = swing()
    data[5, 0] = NAN
    return {
        "angles": Recording(t, data, rates=rates, noise=1e-3, name="lab", convention="as read"),
        "plain angles": Recording(t, data),
        "markers": Recording(t, places(data, np.array([0.2, 0.1])), kind="markers", noise=1e-4),
    }


@pytest.mark.parametrize("which", recordings())
def test_netcdf_comes_back_bit_for_bit(tmp_path, which):
    recording = recordings()[which]
    recording.to_netcdf(tmp_path / "r.nc")
    back = read_recording(tmp_path / "r.nc")
    for name in ("t", "data", "rates", "noise"):
        ours, theirs = getattr(recording, name), getattr(back, name)
        assert (ours is None) == (theirs is None)
        if ours is not None:
            np.testing.assert_array_equal(ours, theirs)  # equal, not close
    assert (back.kind, back.convention, back.name) == (recording.kind, recording.convention, recording.name or "r")


def altered(tmp_path: Path, change: Callable[[Any], None]) -> Path:
    path = tmp_path / "r.nc"
    recordings()["angles"].to_netcdf(path)
    with h5netcdf.File(path, "a") as file:
        change(file)
    return path


def test_netcdf_units_come_from_the_file(tmp_path):
    path = altered(tmp_path, lambda file: file.variables["angle"].attrs.update({"units": "mrad"}))
    refuses("'mrad/s'", read_recording, path)
    with h5netcdf.File(path, "a") as file:
        file.variables["rate"].attrs["units"] = "mrad/s"
    np.testing.assert_allclose(read_recording(path).data, 1e-3 * recordings()["angles"].data)
    path = altered(tmp_path, lambda file: file.variables["angle"].attrs.__delitem__("units"))
    refuses(r"Pass unit=\.\.\. \(rad", read_recording, path)
    refuses("holds angles", read_recording, path, kind="markers")
    refuses("no such columns: got \\['angle'\\]. Allowed: angle0", read_recording, path, columns=["angle"])
    refuses("time is not for", read_recording, path, time="clock")


def test_other_netcdf_is_refused(tmp_path):
    path = tmp_path / "o.nc"
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"time": 3}
        file.create_variable("time", ("time",), float, data=np.arange(3.0))
    refuses("does not say which columns", read_recording, path)
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"time": 3, "link": 2, "more": 2}
        file.create_variable("time", ("time",), float, data=np.arange(3.0))
        file.create_variable("angle", ("time", "link", "more"), float, data=np.zeros((3, 2, 2)))
        file.attrs["format"] = "hyperflex recording 1"
    refuses("wrong shape", read_recording, path)
    path.write_bytes(b"CDF\x01" + bytes(100))
    refuses("NetCDF-3", read_recording, path)
    path.write_bytes(b"t [s],th1 [rad]\n0,1\n1,2\n")
    assert read_recording(path).n_links == 1  # its suffix does not matter


# ---- MATLAB files of the MultiArm pendulum


def cell(pieces: list[Array]) -> Any:
    column = np.empty((len(pieces), 1), dtype=object)
    for k, piece in enumerate(pieces):
        column[k, 0] = piece
    return column


def mat_content(n: int, samples: int = 403) -> dict[str, Any]:
    """Return the output of the published preparation scripts, for n links in pieces of 100 samples."""
    t, data, rates = swing(n, samples)
    state = np.hstack([data + math.pi, rates]).T
    cuts = list(range(100, samples, 100))
    times, states = np.split(t[:, None], cuts), np.split(state, cuts, axis=1)
    return {
        "Time_id": cell(times[:3]),
        "Time_vad": cell(times[3:]),
        "Y_id": cell(states[:3]),
        "Y_vad": cell(states[3:]),
        "dt": 5e-3,
    }


def mat(tmp_path: Path, content: dict[str, Any]) -> Path:
    scipy.io.savemat(tmp_path / "p.mat", content, do_compression=True)
    return tmp_path / "p.mat"


@pytest.mark.parametrize("n", [1, 2, 3])
def test_mat_pieces_are_joined(tmp_path, n):
    t, data, rates = swing(n, 403)
    recording = read_recording(mat(tmp_path, mat_content(n)))
    np.testing.assert_array_equal(recording.t, t)
    np.testing.assert_allclose(recording.data, data, atol=1e-15)  # pi added and taken away
    np.testing.assert_array_equal(recording.rates, rates)
    assert "zero up" in recording.convention
    hanging = read_recording(tmp_path / "p.mat", zero="hanging")
    np.testing.assert_allclose(hanging.data, data + math.pi, atol=1e-15)  # a rig that counts from hanging
    refuses("argument something else", read_recording, tmp_path / "p.mat", unit="deg")


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in mat_content(2).items() if name != key}


BAD_MATS: dict[str, tuple[dict[str, Any], str]] = {
    "parameters": ({"EstimatedParameters": np.ones((1, 15))}, "which of its arrays"),
    "no dt": (without("dt"), "lacks dt"),
    "other step": (mat_content(2) | {"dt": 1e-3}, "do not step by its dt"),
    "odd rows": (mat_content(2) | {"Y_vad": cell([np.zeros((3, 100)), np.zeros((3, 3))])}, "fit together"),
    "too few pieces": (mat_content(2) | {"Y_vad": cell([np.zeros((4, 100))])}, "fit together"),
    "short piece": (mat_content(2) | {"Y_vad": cell([np.zeros((4, 99)), np.zeros((4, 3))])}, "fit together"),
    "text": (mat_content(2) | {"Y_vad": cell([np.array(["a"]), np.array(["b"])])}, "cell of number arrays"),
    "swapped": (
        mat_content(2) | {"Time_vad": mat_content(2)["Time_id"], "Y_vad": mat_content(2)["Y_id"]},
        "back in time at sample 300",
    ),
}


def test_arrays_of_any_mat_file_are_read_by_name(tmp_path):
    t, data, _ = swing(2, 50)
    scipy.io.savemat(tmp_path / "p.mat", {"clock": t, "run": data.T, "one": data[:, :1], "note": "of Tuesday"})
    declared = {"time": "clock", "kind": "angles", "time_unit": "s", "unit": "rad"}
    np.testing.assert_array_equal(read_recording(tmp_path / "p.mat", columns=["run"], **declared).data, data)
    np.testing.assert_array_equal(read_recording(tmp_path / "p.mat", columns=["one"], **declared).data, data[:, :1])
    refuses(r"which of its arrays are times.*'clock \(1, 50\)', 'run \(2, 50\)'", read_recording, tmp_path / "p.mat")
    refuses("no such columns: got .*'note'", read_recording, tmp_path / "p.mat", columns=["note"], **declared)


def test_mat_pieces_may_lie_apart(tmp_path):
    content = mat_content(2)
    for piece in content["Time_vad"].ravel():
        piece += 2.0
    recording = read_recording(mat(tmp_path, content))
    np.testing.assert_allclose(np.diff(recording.t).max(), 2.005, rtol=1e-12)  # one step of 5 ms more; rounding


@pytest.mark.parametrize(("content", "match"), BAD_MATS.values(), ids=BAD_MATS.keys())
def test_other_mat_files_are_refused(tmp_path, content, match):
    refuses(match, read_recording, mat(tmp_path, content))


@pytest.mark.parametrize(
    ("old", "new"),
    [((9, 176), (10, 176)), ((9, 176), (9, 8)), ((9, 176), (9, 1 << 31)), ((5, 8, 2, 11), (5, 8, 2, 1 << 30))],
    ids=["kind of numbers", "too few", "too many", "sizes"],
)
def test_elements_of_mat_files_are_checked(tmp_path, old, new):
    """A kind of numbers that there is not, which scipy's reader crashes the interpreter over, and wrong sizes."""
    content = mat_content(1) | {"Y_id": cell([np.zeros((2, 11))])}
    scipy.io.savemat(tmp_path / "bad.mat", content)
    raw = (tmp_path / "bad.mat").read_bytes()
    words = [np.array(each, dtype="<u4").tobytes() for each in (old, new)]
    assert words[0] in raw
    (tmp_path / "bad.mat").write_bytes(raw.replace(*words))
    fails(FileProblem, "damaged or cut off", read_recording, tmp_path / "bad.mat")


# ---- the real files


def test_real_mat_files_agree_with_their_csv_copies(data_dir):
    for folder, name in (("multiarm_triple", "Triple"), ("multiarm_single", "Single")):
        original = read_recording(data_dir / folder / f"{name}PendulumDataForParameterEstimation.mat")
        copy = read_recording(data_dir / folder / "angles_1kHz.csv", time_unit="s", unit="rad")
        np.testing.assert_allclose(original.t, copy.t, atol=1e-9)  # the copy is rounded to 1 ms, which the steps are
        np.testing.assert_allclose(original.data, copy.data, atol=5.1e-7)  # the copy is rounded to 1e-6 rad


def test_real_markers_agree_with_the_angles_they_came_from(data_dir):
    folder = data_dir / "multiarm_triple"
    markers = read_recording(folder / "markers_200Hz_from_angles.csv", time_unit="s", unit="m", y_axis="up")
    angles = read_recording(folder / "angles_1kHz.csv", time_unit="s", unit="rad").decimate(5)
    # Positions are rounded to 1e-5 m: at most 0.71e-5 m off at each end, over a shortest link of 0.1727 m.
    np.testing.assert_allclose(markers.angles().data, angles.data, atol=1e-4)
