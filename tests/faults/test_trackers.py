"""Tables of trackers, spreadsheets and scripts, and errors in tables: file, line, column, value."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import FileProblem, InvalidInput
from tests.faults.bounds import readable
from tests.refusals import fails, refuses

T, TH = [0.0, 0.1, 0.2], [0.5, 0.25, 0.125]
SI = {"time_unit": "s", "unit": "rad"}
PIXELS = {"unit": "px", "scale": 0.001, "y_axis": "down"}

ANGLES = {  # one link at T with TH, however it is written
    "commas": "t,th1\n0,0.5\n0.1,0.25\n0.2,0.125\n",
    "byte order mark, carriage returns": "\ufefft,th1\r\n0,0.5\r\n0.1,0.25\r\n0.2,0.125\r\n",
    "no last line feed": "t,th1\n0,0.5\n0.1,0.25\n0.2,0.125",
    "semicolons": "t;th1\n0;0.5\n0.1;0.25\n0.2;0.125\n",
    "semicolons, decimal commas": "t;th1\n0,0;0,5\n0,1;0,25\n0,2;0,125\n",
    "tabs": "t\tth1\n0\t0.5\n0.1\t0.25\n0.2\t0.125\n",
    "tabs, decimal commas": "t\tth1\n0,0\t0,5\n0,1\t0,25\n0,2\t0,125\n",
    "spaces": "t th1\n0 0.5\n0.1  0.25\n  0.2 0.125 \n",
    "spaces and units": "t [s] th1 [rad]\n0 0.5\n0.1 0.25\n0.2 0.125\n",
    "frame column": "frame,t,th1\n10,0,0.5\n11,0.1,0.25\n12,0.2,0.125\n",
    "index of pandas": ",t,th1\n0,0.0,0.5\n1,0.1,0.25\n2,0.2,0.125\n",
    "header of numpy": "# t th1\n0.000e+00 5.000e-01\n1.000e-01 2.500e-01\n2.000e-01 1.250e-01\n",
    "header with commas above spaces": "# t, th1\n0 0.5\n0.1 0.25\n0.2 0.125\n",
    "note with columns": "# columns: t, th1\n# made by hand\n0,0.5\n0.1,0.25\n0.2,0.125\n",
    "note and header": "# columns: t, th1\nt,th1\n0,0.5\n0.1,0.25\n0.2,0.125\n",
    "quoted names": '"t","th1"\n0,"0.5"\n0.1,0.25\n0.2,0.125\n',
    "a title of Tracker": "mass A\nt,th1\n0,0.5\n0.1,0.25\n0.2,0.125\n",
    "a title, tabs, last tab": "mass A\t\nt\tth1\t\n0\t0.5\t\n0.1\t0.25\t\n0.2\t0.125\t\n",
    "another name of the time": "Time,th1\n0,0.5\n0.1,0.25\n0.2,0.125\n",
    "blank lines": "t,th1\n0,0.5\n\n0.1,0.25\n0.2,0.125\n\n",
    "comments between": "t,th1\n0,0.5\n# the lamp went out\n0.1,0.25\n0.2,0.125\n# end\n",
}


def written(tmp_path: Path, text: str, name: str = "swing.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize("text", ANGLES.values(), ids=ANGLES.keys())
def test_a_table_is_read_however_it_is_written(tmp_path, text):
    recording = hf.read_recording(written(tmp_path, text), **SI)
    assert recording.t.tolist() == T
    assert recording.data[:, 0].tolist() == TH


@pytest.mark.parametrize("gap", ["", "NA", "na", "NaN", "nan", "n/a", "null", "None", "-", "--"])
@pytest.mark.parametrize("end", ["\n", ""])
def test_gaps_are_gaps_also_at_the_end(tmp_path, gap, end):
    rows = f"t,th1,th2\n0,0.5,1\n0.1,{gap},2\n0.2,0.125,{gap or ' '}\n0.3,0.5,{gap}{end}"
    recording = hf.read_recording(written(tmp_path, rows), **SI)
    assert np.isnan(recording.data).tolist() == [[False, False], [True, False], [False, True], [False, True]]


def test_frames_are_the_time_where_there_is_no_other(tmp_path):
    path = written(tmp_path, "frame,th1\n0,0.5\n1,0.25\n2,0.125\n")
    assert hf.read_recording(path, unit="rad", frame_rate=10.0).t.tolist() == [0.0, 0.1, 0.2]
    refuses(r"frame_rate=\.\.\. \(frames/s\)", hf.read_recording, path, unit="rad")
    refuses("declares time_unit = 'frame'", hf.read_recording, path, **SI)


def test_groups_of_names(tmp_path):
    deeplabcut = written(
        tmp_path,
        "scorer,net,net,net,net,net,net\nbodyparts,hip,hip,hip,tip,tip,tip\n"
        "coords,x,y,likelihood,x,y,likelihood\n0,10,20,0.9,30,40,1\n1,11,21,0.9,31,,1\n",
    )
    found = files.read_table(deeplabcut)
    assert found.names == ["frame", "hip_x", "hip_y", "hip_likelihood", "tip_x", "tip_y", "tip_likelihood"]
    assert found.values[0].tolist() == [0.0, 10.0, 20.0, 0.9, 30.0, 40.0, 1.0]
    columns = ["hip_x", "hip_y", "tip_x", "tip_y"]
    recording = hf.read_recording(deeplabcut, kind="markers", columns=columns, frame_rate=30.0, **PIXELS)
    assert recording.data[0].tolist() == [0.01, -0.02, 0.03, -0.04]
    tracker = written(tmp_path, ",mass_A,,mass_B,\nt,x,y,x,y\n0,1,2,3,4\n1,1,2,3,4\n")
    assert files.read_table(tracker).names == ["t", "mass_A_x", "mass_A_y", "mass_B_x", "mass_B_y"]


FAULTS = {
    "a word": ("t,th1\n0,0.5\n0.1,oops\n", "line 3, column 'th1', is not a number: got 'oops'"),
    "Python's own digits": ("t,th1\n0,0.5\n0.1,1_000\n", "line 3, column 'th1', is not a number: got '1_000'"),
    "other digits": ("t,th1\n0,0.5\n0.1,٣\n", "line 3, column 'th1', is not a number"),
    "infinite": ("t,th1\n0,0.5\n0.1,-Infinity\n", "line 3, column 'th1', is infinite"),
    "a clock": (
        "# T X Y\n0:00:00:00 866.00 320.00 \n",
        "line 2, column 'T', is not a time: got '0:00:00:00'.*write seconds",
    ),
    "time goes back": ("# x\nt,th1\n0,1\n0.2,1\n0.1,1\n", "line 5, column 't' goes back in time: got 0.1"),
    "time repeats": ("t,th1\n0,1\n0,1\n", "line 3, column 't' repeats a time: got 0.0"),
    "no time": ("t,th1\n0,1\nNA,1\n", "line 3, column 't' is a gap"),
    "a column too many": ("t,th1,lamp\n0,1,2\n1,1,2\n", r"has others: got \['lamp'\]"),
    "thousands or decimals": ("t;th1\n0;1,234\n1;2,345\n", "line 2: the comma may be .* group thousands: got '1,234'"),
    "commas and points": ("t;th1\n0;0,5\n1;1.5\n", "the comma may be a decimal comma or group thousands; other"),
    "decimal commas between commas": ("t,th1\n0,0,1,0\n", "line 2, does not have .* semicolons or tabs"),
    "header against note": ("# columns: t, th2\nt,th1\n0,1\n1,1\n", "header and the note 'columns' disagree"),
    "a row cut short": ("t,th1,th2\n0,1,2\n0.1,1", "line 3, does not have .*cut off"),
    "huge": ("t,th1\n0,1\n1,1e300\n", "line 3, column 'th1', is too large"),
    "only gaps": ("t,th1,th2\n0,1,\n1,1,-\n", r"swing.csv: link 1 \(th2\) .* only gaps"),
}


@pytest.mark.parametrize(("text", "said"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_name_file_line_column_and_value(tmp_path, text, said):
    with pytest.raises(InvalidInput, match=said) as caught:
        hf.read_recording(written(tmp_path, text), **SI)
    assert "swing.csv" in str(caught.value)
    readable(caught.value)


@pytest.mark.parametrize("name", ["x.csv", "x.toml", "x.nc", "x.mat", "x.mp4"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_special_files_are_refused(tmp_path, name, kind):
    from hyperflex.vision import VideoReader

    path = tmp_path / name
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    read = {"x.toml": hf.Setup.from_toml, "x.mp4": VideoReader}.get(name, hf.read_recording)
    fails(FileProblem, "is a device, pipe or socket", read, path)


@pytest.mark.parametrize("name", ["x.csv", "x.toml"])
def test_sizes_are_bounded(tmp_path, name):
    path = tmp_path / name
    with path.open("wb") as file:
        file.write(b"t,th1\n" * 20_000)
        file.truncate(10**10)  # a hole: it takes no room
    with pytest.raises(FileProblem, match="has 10000 MB"):
        hf.Setup.from_toml(path) if name == "x.toml" else hf.read_recording(path)


ROPE = "[rope]\nn_links = 3\nlink_length = 0.1\nlink_mass = 0.1\n"
TOML = {
    "deep": ("[rope]\nlength = " + "[" * 5000 + "]" * 5000, "too deep"),
    "inline tables": ("rope = " + "{a=" * 3000 + "1" + "}" * 3000, "too deep"),
    "long number": (f"duration = {'9' * 5000}\n{ROPE}", "cannot be read"),
    "number beyond floats": (f"duration = {'9' * 400}\n{ROPE}", "set-up.toml: duration is too large"),
    "long key": ("a" + ".a" * 20_000 + " = 1", "line 1: a key has too many parts"),
    "unknown": (f"durations = 1.0\n{ROPE}", "does not know this key: got 'durations'.*'duration' is meant"),
    "in the wrong table": (f"{ROPE}duration = 1.0", r"\[rope\] does not know this key: got 'duration'.*at the top"),
    "another table": (f"{ROPE}[arm]\nt_move = 1.0", r"\[arm\] .* got 't_move'.*\[motion\]|\[arm\] .* got 't_move'"),
    "of a motion": (f"{ROPE}[arm]\n[motion]\nkind = 'swings'\nt_mov = 1", r"\[motion\] .*'t_mov'.*'t_move' is meant"),
    "lacking": (f"{ROPE}[motion]\nkind = 'move'\nstart = 0.0\nend = 1.0", "'move' lacks duration"),
    "no arm": (f"{ROPE}[motion]\nkind = 'swings'", r"turns an arm, but there is none\. Give a table \[arm\] with"),
    "no kind": (f"{ROPE}[motion]\nangle = 1.0", "kind"),
    "text for links": (ROPE.replace("3", '"five"'), "five"),
    "NaN": (f"duration = nan\n{ROPE}", "duration is not finite"),
    "a value": (ROPE.replace("0.1", "-0.1"), "set-up.toml: rope link_.* got -0.1"),
}


@pytest.mark.parametrize(("text", "said"), TOML.values(), ids=TOML.keys())
def test_set_up_files_say_which_key_and_where_it_belongs(tmp_path, text, said):
    with pytest.raises(InvalidInput, match=said) as caught:
        hf.Setup.from_toml(written(tmp_path, text, "set-up.toml"))
    assert "set-up.toml" in str(caught.value)
    readable(caught.value)


def test_a_damaged_netcdf_file_leaves_no_traceback_behind(tmp_path):
    path = tmp_path / "swing.nc"
    hf.Recording(T, np.array(TH)[:, None]).to_netcdf(path)
    sound = path.read_bytes()
    code = (
        "import sys, hyperflex as hf\nfor k in range(40):\n    try: hf.read_recording(f'{sys.argv[1]}/{k}.nc')\n"
        "    except hf.HyperflexError as error: print(error)"
    )
    for k in range(40):
        damaged = bytearray(sound)
        place = k * len(sound) // 40
        damaged[place : place + 64] = bytes(64)
        (tmp_path / f"{k}.nc").write_bytes(damaged)
    run = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")
    assert "damaged or cut off" in run.stdout


@pytest.mark.parametrize("shown", [10**5000, [[[]]] * 200, float, "x" * 10**6], ids=["digits", "deep", "class", "long"])
def test_whatever_was_got_can_be_shown(shown):
    with pytest.raises(InvalidInput) as caught:
        hf.Arm(length=shown)
    assert len(str(caught.value)) < 300
