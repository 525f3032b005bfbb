"""Files of motion trackers: recognised by content, and read to the last digit."""

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.recording import Recording, read_recording
from hyperflex.recording.read import propose, python_line
from tests.faults.bounds import apart, examples, refused_or_done
from tests.faults.test_readers import CHANGE, changed
from tests.recording.samples import ANGLE, BOTH, RATE, SAMPLES, Sample
from tests.refusals import fails, refuses


def written(folder: Path, sample: Sample, suffix: str | None = None) -> Path:
    path = folder / f"swing{sample.suffix if suffix is None else suffix}"
    path.write_bytes(sample.content)
    return path


def made(folder: Path, name: str) -> tuple[Path, dict[str, Any]]:
    sample = SAMPLES[name]()
    return written(folder, sample), dict(sample.arguments)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_file_is_read_to_the_last_digit_whatever_its_suffix(tmp_path, name):
    sample = SAMPLES[name]()
    # Both are the same decimals, converted to m and s: roundings of the last bit. Tracker's axes are rotated, and a
    # stamp since 1970 has 2e-7 s.
    space, time = {"trk": (1e-12, 1e-15), "plotjuggler": (1e-14, 5e-7)}.get(name, (1e-15, 1e-15))
    for suffix in (None, ".dat"):
        recording = read_recording(written(tmp_path, sample, suffix), **sample.arguments)
        np.testing.assert_allclose(recording.t, sample.t, rtol=1e-15, atol=time)
        np.testing.assert_allclose(recording.data, sample.data, rtol=1e-14, atol=space)


@pytest.mark.parametrize("name", [name for name in SAMPLES if name not in ("matlab73", "hdf5", "plotjuggler")])
def test_several_markers_must_be_named_and_come_in_the_order_given(tmp_path, name):
    path, arguments = made(tmp_path, name)
    names = arguments.pop("markers")
    refuses(r"which markers to take.*from the pivot to the tip: markers=\[", read_recording, path, **arguments)
    refuses("no such markers: got .*nobody", read_recording, path, markers=[names[0], "nobody"], **arguments)
    there, back = (read_recording(path, markers=each, **arguments).data for each in (names, names[::-1]))
    np.testing.assert_array_equal(np.hstack([back[:, 2:], back[:, :2]]), there)


MISSING = {  # what each file does not declare
    "motive": ["plane"],
    "motive_frames": ["plane"],
    "vicon": ["plane"],
    "qualisys": ["plane"],
    "trc": ["plane"],
    "c3d": ["plane"],
    "kinovea": ["time_unit", "unit", "y_axis"],
    "kva": [],
    "trk": [],
    "tracker_table": ["time_unit", "unit", "y_axis"],
    "deeplabcut": ["frame_rate", "scale"],
    "deeplabcut_h5": ["frame_rate", "scale"],
    "sleap": ["frame_rate", "scale"],
    "anipose": ["unit", "frame_rate", "plane"],
    "idtracker": ["scale"],
    "animalta": ["unit", "y_axis"],
}


@pytest.mark.parametrize(("name", "missing"), MISSING.items())
def test_missing_declarations_of_a_file_are_named(tmp_path, name, missing):
    path, arguments = made(tmp_path, name)
    names = {"markers": arguments["markers"]}
    if not missing:
        assert read_recording(path, **names).n_links == 1
        return
    with pytest.raises(InvalidInput, match="nothing is guessed") as caught:
        read_recording(path, **names)
    asked = str(caught.value).partition("Pass ")[2]
    assert [key for key in hf.recording.Declarations.__dataclass_fields__ if f"{key}=..." in asked] == [
        key for key in hf.recording.Declarations.__dataclass_fields__ if key in missing
    ]


@pytest.mark.parametrize("name", ["deeplabcut", "deeplabcut_h5"])
def test_unlikely_places_are_gaps_and_reported(tmp_path, name):
    path, arguments = made(tmp_path, name)
    del arguments["min_likelihood"]
    said = "likelihood below 0.6 in 1 of 12 frames"
    with pytest.warns(UserWarning, match=f"{said}.*min_likelihood"):
        recording = read_recording(path, **arguments)
    assert said in recording.convention
    assert read_recording(path, **arguments, min_likelihood=0.04).gaps == 0
    columns = {"columns": ["pivot_x", "pivot_y", "tip_x", "tip_y"], "kind": "markers"}
    by_column = read_recording(path, **columns, scale=1e-3, frame_rate=RATE, min_likelihood=0.6)
    np.testing.assert_array_equal(by_column.data, recording.data)
    words = r"marker 0 \(pivot_x\) have a likelihood below.*at most 0.99"
    refuses(words, read_recording, path, **arguments, min_likelihood=0.995)


def test_other_formats_have_no_least_likelihood_but_can_be_given_one(tmp_path):
    for name, gaps in (("sleap", 2), ("anipose", 2)):
        path, arguments = made(tmp_path, name)
        assert read_recording(path, **arguments).gaps == gaps
        assert read_recording(path, **arguments, min_likelihood=0.6).gaps == gaps + 2
    path, arguments = made(tmp_path, "motive")
    refuses("min_likelihood is for data with likelihoods", read_recording, path, **arguments, min_likelihood=0.5)


def test_quaternions_and_errors_of_rigid_bodies_are_no_markers(tmp_path):
    path, arguments = made(tmp_path, "motive")
    assert list(propose(path).content.points) == ["base", "rope:pivot", "rope:tip"]
    base = read_recording(path, markers=["base"], plane="xz")
    np.testing.assert_array_equal(base.data, read_recording(path, **arguments).data[:, :2])


def test_each_column_of_a_vicon_file_has_its_own_unit(tmp_path):
    """Model outputs with the trajectories: angles are not markers, and a force is neither."""
    lines = ["Trajectories", "100", ",,pivot,,,tip,,,knee,,,plate,,", f"Frame,Sub Frame{',X,Y,Z' * 4}"]
    lines += [f",,{','.join(3 * ['mm'] + 3 * ['m'] + 3 * ['deg'] + 3 * ['N'])}"]
    lines += [f"{k + 1},0,0,0,0,0.1,0,-0.4,{k},0,0,1,2,3" for k in range(12)]
    path = tmp_path / "vicon.csv"
    path.write_text("\n".join([*lines, ""]))
    knee = read_recording(path, columns=["knee_x"])
    assert knee.kind == "angles"
    np.testing.assert_allclose(knee.data[:, 0], np.radians(np.arange(12.0)), rtol=1e-15)
    tip = read_recording(path, markers=["tip"], plane="xz")
    np.testing.assert_array_equal(tip.data[0], [0.1, -0.4])
    assert list(propose(path).content.points) == ["pivot", "tip"]
    refuses("not give one unit to all columns", read_recording, path, markers=["pivot", "tip"], plane="xz")
    refuses("'plate_x' is in N, which is no unit of", read_recording, path, columns=["plate_x"])
    refuses("no such markers: got .*knee", read_recording, path, markers=["knee"], plane="xz")


# ---- markers in space


def turned(folder: Path, about: float, lean: float, noise: float = 0.0) -> Path:
    """A Motive-like table, z up, of a swing in a plane turned about the vertical, and leaning from it."""
    t = np.arange(400) / 100.0
    angle = 0.5 * np.cos(6.0 * t)
    tip = np.stack([np.sin(angle), np.zeros(t.size), -np.cos(angle)], axis=1)
    a, b = about, lean
    rotation = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    rotation = rotation @ np.array([[1.0, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    places = np.hstack([np.zeros((t.size, 3)), tip @ rotation.T])
    places += np.random.default_rng(1).normal(scale=noise, size=places.shape) if noise else 0.0
    path = folder / "space.csv"
    header = "t [s],pivot_x [m],pivot_y [m],pivot_z [m],tip_x [m],tip_y [m],tip_z [m]"
    np.savetxt(path, np.column_stack([t, places]), delimiter=",", header=header, comments="", fmt="%.17g")
    return path


@pytest.mark.parametrize("about", [0.0, 0.7, -1.2])
def test_the_plane_of_the_swing_is_fitted(tmp_path, about):
    recording = read_recording(turned(tmp_path, about, 0.0), **BOTH, plane="fit", up="z")
    angle = recording.angles().data[:, 0]
    expected = 0.5 * np.cos(6.0 * np.arange(400) / 100.0)
    np.testing.assert_allclose(angle * np.sign(angle[0]), expected, atol=1e-12)  # rounding; the view has two sides
    assert recording.out_of_plane == pytest.approx(0.0, abs=1e-12)
    noisy = read_recording(turned(tmp_path, about, 0.0, 1e-3), **BOTH, plane="fit", up="z")
    assert noisy.out_of_plane == pytest.approx(1e-3, rel=0.05)  # of 800 samples: 2.5 % is one standard deviation
    assert "mm rms of motion out of it" in noisy.convention
    # the pivot stays, so a line leans by both markers' noise over its length; a swing of that size is root 2 as high
    assert recording.tilt == pytest.approx(0.0, abs=1e-12)
    assert noisy.tilt == pytest.approx(np.sqrt(2.0) * np.sqrt(2.0) * 1e-3, rel=0.1)


def test_a_leaning_plane_is_reported_and_a_lying_one_refused(tmp_path):
    path = turned(tmp_path, 0.3, np.radians(8.0))
    assert "8.0 degrees from the vertical" in read_recording(path, **BOTH, plane="fit", up="z").convention
    refuses(r"71 degrees from the vertical.*plane='xz'", read_recording, path, **BOTH, plane="fit", up="y")
    refuses(r"Pass up=\.\.\. \(x | y | z\)", read_recording, path, **BOTH, plane="fit")
    assert read_recording(path, **BOTH, plane="xz").out_of_plane == pytest.approx(0.0712, abs=1e-3)


def test_the_axis_up_follows_from_a_c3d_file(tmp_path):
    path, arguments = made(tmp_path, "c3d")
    fitted = read_recording(path, **arguments | {"plane": "fit"})
    assert fitted.out_of_plane < 5e-4  # m; 1 mm sin(9 t) of the tip, over both markers, in part along the swing
    assert propose(path).arguments["plane"] == "xz"


def test_a_screen_axis_that_points_down_tells_no_axis_up(tmp_path):
    sample = SAMPLES["c3d"]()
    assert sample.content.count(b"+Z") == 1
    path = tmp_path / "down.c3d"
    path.write_bytes(sample.content.replace(b"+Z", b"-Z"))
    refuses(r"Pass up=\.\.\.", read_recording, path, **sample.arguments | {"plane": "fit"})


def test_tracks_of_different_units_are_not_mixed(tmp_path):
    sample = SAMPLES["kva"]()
    path = tmp_path / "mixed.kva"
    path.write_bytes(sample.content.replace(b'UserUnitLength="mm"', b'UserUnitLength="px"', 1))
    refuses("not give one unit to all columns", read_recording, path, **sample.arguments | {"unit": "mm"})


def test_facts_come_back_from_netcdf(tmp_path):
    Recording([0.0, 1.0], [[0.1], [0.2]], epoch=1.7e9, out_of_plane=0.002, tilt=0.03).to_netcdf(tmp_path / "r.nc")
    back = read_recording(tmp_path / "r.nc")
    assert (back.epoch, back.out_of_plane, back.tilt) == (1.7e9, 0.002, 0.03)
    assert back.window(0.0, 2.0).epoch == 1.7e9


def test_a_c3d_file_that_is_cut_off_is_refused(tmp_path):
    sample = SAMPLES["c3d"]()
    path = tmp_path / "cut.c3d"
    path.write_bytes(sample.content[:-200])  # 12 frames of 32 bytes are padded to a block of 512: two frames are gone
    fails(FileProblem, "damaged or cut off", read_recording, path, **sample.arguments)


# ---- times


def table(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "table.csv"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("cells", "epoch"),
    [
        (["1700000000.25", "1700000000.5", "1700000001.25"], 1700000000.25),
        (["2023-11-14 22:13:20.25", "2023-11-14 22:13:20.50", "2023-11-14T22:13:21.25"], 1700000000.25),
        (["0:59:59.75", "1:00:00.00", "1:00:00.75"], None),
        (["59:59,75", "60:00,00", "60:00,75"], None),
    ],
    ids=["stamps", "dates", "hours", "minutes"],
)
def test_stamps_and_clock_times_become_seconds(tmp_path, cells, epoch):
    rows = "".join(f"{cell};{k}\n" for k, cell in enumerate(cells))
    recording = read_recording(table(tmp_path, f"t [s];th1 [deg]\n{rows}"))
    assert recording.epoch == epoch
    np.testing.assert_allclose(recording.t - recording.t[0], [0.0, 0.25, 1.0], atol=3e-7)  # doubles at 1.7e9
    assert recording.t[0] == (0.0 if epoch else 3599.75)


@pytest.mark.parametrize(("unit", "size"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_stamps_of_any_unit_are_read_and_of_a_wrong_one_refused(tmp_path, unit, size):
    rows = "".join(f"{(1_700_000_000 * 4 + k) * size // 4},{0.1 * k}\n" for k in (0, 4, 8))
    path = table(tmp_path, f"%time,th1\n{rows}")
    recording = read_recording(path, time_unit=unit, unit="rad")
    assert (recording.t.tolist(), recording.epoch) == ([0.0, 1.0, 2.0], pytest.approx(1.7e9))
    for larger in ("s", "ms", "us")[: ("s", "ms", "us", "ns").index(unit)]:
        refuses(f"years after 1970.*Pass time_unit='{unit}'", read_recording, path, time_unit=larger, unit="rad")


def test_a_clock_of_whole_seconds_is_no_fault_of_single_rows(tmp_path):
    rows = "".join(f"{k // 30},0.1\n" for k in range(90))
    refuses("Write times with more digits", read_recording, table(tmp_path, f"t [s],th1 [rad]\n{rows}"))
    refuses("drop repeated ones", read_recording, table(tmp_path, "t [s],th1 [rad]\n0,1\n0,1\n1,1\n2,1\n3,1\n"))


def test_stamps_in_two_columns_are_joined(tmp_path):
    """As ROS writes them; each alone repeats or goes back."""
    rows = "".join(f"{1_700_000_000 + k // 4},{k % 4 * 250_000_000},0.1\n" for k in range(8))
    path = table(tmp_path, f"header.stamp.secs,header.stamp.nsecs,th1\n{rows}")
    for time in ({}, {"time": "header.stamp"}, {"time": "header.stamp.secs"}):
        recording = read_recording(path, **time, unit="rad")
        np.testing.assert_allclose(recording.t, 0.25 * np.arange(8), atol=5e-7)  # doubles at 1.7e9
        assert recording.epoch == 1.7e9
    assert propose(path).arguments == {"unit": "rad"}


def test_a_time_column_of_another_name_is_assumed_by_the_proposal_alone(tmp_path):
    path = table(tmp_path, "index;Zeit [s];Winkel [°]\n0;0,5;10,5\n1;0,75;9,5\n2;1,0;11,5\n")
    refuses("no time column 't': got .*'Zeit'", read_recording, path, columns=["Winkel"])
    proposal = propose(path)
    assert (proposal.arguments, proposal.assumed) == ({"time": "Zeit", "columns": ["Winkel"]}, ("time",))
    assert proposal.recording.t.tolist() == [0.5, 0.75, 1.0]
    refuses("no time column", propose, table(tmp_path, "a,b\n1,2\n1,2\n"))


def test_whole_turns_of_a_joint_are_taken_away_where_it_is_declared_to_be_wrapped(tmp_path):
    path, arguments = made(tmp_path, "plotjuggler")
    assert read_recording(path, **arguments | {"wrapped": False}).data[0, 0] == pytest.approx(ANGLE[0] + 2 * np.pi)
    assert propose(path).arguments == arguments


# ---- text


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
@pytest.mark.parametrize("start", ["", "sep=;\n"])
def test_tables_of_spreadsheets(tmp_path, encoding, start):
    path = table(tmp_path, f'{start}t [s];th1 [°]\n0,0;"10,5"\n0,1;11\n', encoding)
    np.testing.assert_allclose(read_recording(path).data[:, 0], np.radians([10.5, 11.0]))


def test_decimal_commas_in_quotes_between_commas(tmp_path):
    path = table(tmp_path, '# t, th1\n"1,5", "0,25"\n"1,75", "0,5"\n')
    recording = read_recording(path, time_unit="s", unit="rad")
    assert (recording.t.tolist(), recording.data[:, 0].tolist()) == ([1.5, 1.75], [0.25, 0.5])


def test_columns_that_are_not_chosen_may_contain_anything(tmp_path):
    path = table(tmp_path, "t [s],a [deg],b,note\n0,1,inf,on\n1,2,oops,off\n2,3,1,on\n")
    assert read_recording(path, columns=["a"]).n_links == 1
    refuses("column 'b', is infinite", read_recording, path, columns=["b"], kind="angles", unit="rad")


def test_a_marker_whose_columns_are_x_and_y_needs_no_name(tmp_path):
    path = table(tmp_path, "Time (s),X (mm),Y (mm)\n0,1,2\n1,3,4\n")
    np.testing.assert_allclose(read_recording(path, y_axis="up").data, [[1e-3, 2e-3], [3e-3, 4e-3]], rtol=1e-15)


def test_messages_name_the_column(tmp_path):
    path = table(tmp_path, "t [s],th1 [rad],th2 [rad]\n0,0,0\n0.01,0,9\n0.02,0,9\n")
    refuses(r"link 1 \(th2\) turns by 9 rad", read_recording, path)
    path, arguments = made(tmp_path, "motive")
    label = read_recording(path, **arguments).label(1)
    assert label == "marker 1 (rope:tip_x, rope:tip_y, rope:tip_z)"


def test_files_without_motion_are_reported(tmp_path):
    for what, unit in (("Acceleration", "m/s^2"), ("Gyroscope", "rad/s")):
        phone = table(tmp_path, f'"Time (s)","{what} x ({unit})","{what} y ({unit})"\n0,1,2\n0.1,1,2\n')
        refuses("Accelerations and rates are no angles", read_recording, phone)
        with pytest.raises(InvalidInput, match=f"is in {re.escape(unit)}, which is no unit of angles"):
            read_recording(phone, columns=[f"{what} x"], kind="angles")
        assert propose(phone).content.names == [f"{what} x", f"{what} y"]
        assert "Accelerations and rates" in propose(phone).problem
    unnamed = table(tmp_path, "t [s],ax,ay,az\n0,1,2,3\n1,1,2,3\n")  # accelerations, maybe: nothing is taken unasked
    refuses(r"which markers to take.*markers=\['a'\]", read_recording, unnamed)
    devices = table(tmp_path, "Devices\n1000\n,,Force\nFrame,Sub Frame,Fx\n,,N\n1,0,0.5\n1,1,0.6\n")
    refuses(r"without markers: got \['Devices'\].*Export the trajectories", read_recording, devices)
    for content, said in ((b"\x80\x04K\x01.", "a pickle"), (b"\0\0\0\x18ftypmp42", "a video"), (b"\0\1\2", "no known")):
        (tmp_path / "other").write_bytes(content)
        refuses(said, read_recording, tmp_path / "other")


# ---- the real files


MM, SI, VIDEO = {"scale": 1e-3}, {"time_unit": "s", "unit": "rad"}, {"frame_rate": 30.0, "scale": 1e-3}
SURE, METRES = VIDEO | {"min_likelihood": 0.6}, {"time_unit": "s", "unit": "m", "y_axis": "up"}
REAL: dict[str, dict[str, Any]] = {
    "vicon_nexus_trajectories_first200frames.csv": {"markers": ["boite:gauche_ext", "boite:gauche_int"], "plane": "xz"},
    "opensim_markers_first200.trc": {"markers": ["ASISl", "ASISr"], "plane": "xy"},
    "deeplabcut_single.csv": {"markers": ["head", "stinger"], **SURE},
    "deeplabcut_multi_animal.csv": {"markers": ["individual1_snout", "individual1_leftear"], **SURE},
    "sleap_analysis.h5": {"markers": ["AEON3B_TP2_centroid"], "frame_rate": 50.0, **MM},
    "anipose_3d.csv": {"markers": ["l-base", "l-edge"], "plane": "xy", "unit": "mm", "frame_rate": 30.0},
    "idtrackerai_trajectories.csv": {"markers": ["1", "2"], **MM},
    "animalta_wide.csv": {"markers": ["Arena0_Ind0"], "unit": "px", "y_axis": "down", **MM},
    "synthetic/dlc_first_row_empty.csv": {**BOTH, **SURE},
    "synthetic/dlc_multi_animal.csv": {"markers": ["rope_pivot", "rope_tip"], **VIDEO},
    "synthetic/motive_1.23.csv": {"markers": ["rope:0", "rope:1"], "plane": "xy"},
    "synthetic/tracker_two_masses.txt": {"markers": ["mass_A", "mass_B"], **METRES},
    "synthetic/tracker_comma_exponent.txt": METRES,
    "synthetic/vernier_style.csv": {"columns": ["Angle"]},
    "synthetic/excel_sep_line.csv": SI,
    "synthetic/quoted_all.csv": SI,
    "synthetic/utf16.csv": SI,
    "synthetic/engauge_quoted_commas.csv": {"time": "x", "columns": ["Curve1"], "kind": "angles", **SI},
    "synthetic/clock_times.csv": {"unit": "m", "y_axis": "up"},
    "synthetic/latin1_degree_sign.csv": {},
    "synthetic/utf8_degree_sign.csv": {},
}


@pytest.mark.parametrize("name", REAL)
def test_real_files_are_read(data_dir, name):
    path = data_dir / "lab_files" / name
    assert read_recording(path, **REAL[name]).t.size > 1
    if name not in ("synthetic/engauge_quoted_commas.csv", "deeplabcut_multi_animal.csv"):  # no name for the time; lost
        assert propose(path).problem == ""


# ---- the proposal


@pytest.mark.parametrize("name", [name for name in SAMPLES if name not in ("matlab73", "hdf5", "plotjuggler")])
def test_the_proposed_line_reads_the_file(tmp_path, name):
    path, _ = made(tmp_path, name)
    proposal = propose(path)
    assert proposal.problem == ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of unlikely places
        read = eval(python_line(path, proposal), {"hf": hf})
    np.testing.assert_array_equal(read.data, proposal.recording.data)
    assert set(proposal.assumed) >= set(MISSING[name]) - {"time_unit"}


def test_a_range_beyond_a_turn_leaves_the_unit_undecided(tmp_path):
    """A swing-up in rad looks as a small swing in degrees does; the columns that are not read are listed."""
    t = np.arange(300) / 100.0
    path = tmp_path / "swing_up.csv"
    for size, unit, doubt in (
        (0.5, "rad", ""),
        (8.0, "rad", "may be deg: .* 16, which is 2.5 turns"),
        (90.0, "deg", ""),
    ):
        rows = np.column_stack([t, size * np.cos(5.0 * t), 0.0 * t, 0.1 * t])
        np.savetxt(path, rows, delimiter=",", header="time,position,velocity,torque", comments="")
        proposal = propose(path)
        assert (proposal.arguments["unit"], proposal.unused) == (unit, ("velocity", "torque"))
        assert bool(proposal.problem) == bool(doubt)
        assert re.search(doubt, proposal.problem)


def test_the_proposal_takes_the_markers_of_one_body(tmp_path):
    """The swing is in xy; the body is 0.5 m in front of it."""
    angle = 0.3 * np.cos(6.0 * np.arange(50) / 50.0)
    rope = [np.column_stack([r * np.sin(angle), -r * np.cos(angle), 0.5 + 0.0 * angle]) for r in (0.0, 0.2, 0.4)]
    places = np.hstack([np.arange(50)[:, None] / 50.0, np.tile([0.01, 0.02, 0.0], (50, 1)), *rope])
    names = ["box:1", "rope:pivot", "rope:mid", "rope:tip"]
    header = ",".join(["t", *(f"{name}_{axis}" for name in names for axis in "xyz")])
    np.savetxt(tmp_path / "bodies.csv", places, delimiter=",", header=header, comments="")
    proposal = propose(tmp_path / "bodies.csv")
    assert proposal.arguments["markers"] == names[1:]
    assert (proposal.arguments["plane"], proposal.unused) == ("xy", ("box:1",))


def test_the_proposal_takes_the_markers_of_one_animal(tmp_path):
    path, _ = made(tmp_path, "deeplabcut")
    individuals = b"individuals,rope,rope,rope,box,box,box\nbodyparts,tip,tip,tip,tip,tip,tip"
    parts = path.read_bytes().replace(b"bodyparts,pivot,pivot,pivot,tip,tip,tip", individuals)
    path.write_bytes(parts)
    assert propose(path).arguments["markers"] == ["rope_tip", "box_tip"]  # one of each is no chain of one
    path.write_bytes(parts.replace(b"tip,tip,tip,tip,tip,tip", b"a,a,a,b,b,b").replace(b"box", b"rope"))
    assert propose(path).arguments["markers"] == ["rope_a", "rope_b"]


# ---- variants


def test_motive_with_semicolons_and_decimal_commas(tmp_path):
    path, arguments = made(tmp_path, "motive")
    expected = read_recording(path, **arguments)
    path.write_bytes(path.read_bytes().replace(b",", b";").replace(b".", b","))
    np.testing.assert_array_equal(read_recording(path, **arguments).data, expected.data)


@pytest.mark.parametrize("first", [0, 1, 2])
def test_qualisys_without_frames_or_times(tmp_path, first):
    path, arguments = made(tmp_path, "qualisys")
    expected = read_recording(path, **arguments)
    lines = path.read_text().split("\n")
    top = next(k for k, line in enumerate(lines) if line.startswith("Frame\tTime"))
    cut = ["\t".join(line.split("\t")[2 - first :]) for line in lines[top:] if line]
    path.write_text("\n".join(lines[:top] + cut).replace("\t0.000\t0.000\t0.000", "\tNULL\tNULL\tNULL"))
    np.testing.assert_array_equal(read_recording(path, **arguments).data, expected.data)


def test_arrays_of_structs_and_of_places(tmp_path):
    """Fields of structs are named as paths; places may be (T, n, 2), and the proposal shows columns."""
    from scipy.io import savemat

    t = np.arange(40) / 20.0
    places = np.random.default_rng(0).normal(size=(40, 3, 2))
    angle = np.column_stack([0.1 * np.cos(t), 0.2 * np.cos(t)])
    savemat(tmp_path / "m5.mat", {"ang": angle, "run": {"t": t, "xy": places, "pair": places[:, :2]}, "s": "text"})
    read = read_recording(tmp_path / "m5.mat", columns=["run/xy"], kind="markers", time_unit="s", unit="m", y_axis="up")
    np.testing.assert_array_equal(read.data, places.reshape(40, 6))
    proposal = propose(tmp_path / "m5.mat")
    assert (proposal.arguments["columns"], proposal.content.widths["ang"], proposal.unused) == (["ang"], 2, ("run/xy",))
    refuses("no such columns.*Perhaps run/xy is meant", read_recording, tmp_path / "m5.mat", columns=["run.xy"])
    savemat(tmp_path / "two.mat", {"stamps": t, "ang": angle})
    assert propose(tmp_path / "two.mat").arguments["time"] == "stamps"


# ---- damage


@pytest.mark.parametrize("count", [4, pytest.param(1000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", SAMPLES)
def test_damage_is_reported_or_harmless(tmp_path, name, count):
    from hypothesis import given
    from hypothesis import strategies as st

    sample = SAMPLES[name]()
    path = tmp_path / f"damaged{sample.suffix}"

    @examples(count)
    @given(st.lists(CHANGE, min_size=1, max_size=3))
    def damage(changes):
        path.write_bytes(changed(sample.content, changes))
        refused_or_done(lambda: read_recording(path, **sample.arguments))
        refused_or_done(lambda: propose(path))

    apart(damage)


@pytest.mark.parametrize("name", ["(" * 100_000, "a" + " " * 100_000 + "]", "-" * 100_000 + "q"])
def test_a_column_name_of_any_length_is_split_at_once(tmp_path, name):
    path = tmp_path / "long.csv"
    path.write_text(f"t,{name}\n0,1\n1,2\n2,3\n")
    refused_or_done(lambda: read_recording(path, kind="angles"))
