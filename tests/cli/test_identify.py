"""``hyperflex identify``: a recording and a guess in, a rope out; what is not declared is refused."""

import dataclasses
import io
import json
import re
import signal

import numpy as np
import pytest
from rich.console import Console

import hyperflex as hf
from hyperflex import files, identification, progress, report
from hyperflex.errors import Interrupted
from hyperflex.identification import pipeline
from hyperflex.status import Status


@pytest.fixture
def swing(tmp_path):
    """A swing of one link, in degrees and milliseconds, and a guess with twice its friction."""
    true = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    t = np.linspace(0.0, 4.0, 201)
    run = hf.simulate(true, duration=4.0, t_eval=t, q0=[0.8])
    files.write_table(tmp_path / "swing.csv", ["t", "th1"], np.column_stack([1e3 * t, np.degrees(run.q)]))
    true.replace(friction=4e-4).to_toml(tmp_path / "guess.toml")
    return tmp_path


DECLARED = ("--time-unit", "ms", "--unit", "deg")


def test_a_long_table_of_ratios_is_cut_and_says_where_the_rest_is(hyperflex, swing, monkeypatch):
    """Five rows of each ratio, and 24 in all."""
    rows = [(f"r{k}/p1", str(link), "1", "0", "0 to 2", "") for k in range(6) for link in range(8)]
    table = report.TextTable(("ratio", "link", "value", "std", "95 % interval", "what it is"), tuple(rows))
    monkeypatch.setattr(report, "ratios_table", lambda _: table)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "found")
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments, *DECLARED)
    assert code == 0
    shown = re.findall(r"^ (r\d)/p1 +(\d)", out, re.M)
    assert [link for name, link in shown if name == "r0"] == list("01234")
    assert len(shown) == 24
    assert f"and 24 more, in {swing / 'found' / 'report.html'}" in out


def test_identify_writes_the_rope_and_its_figures(hyperflex, swing):
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml")
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments, *DECLARED)
    assert code == 0
    assert "friction" in out
    assert "prediction error" not in out  # 0.8 s are too short for a prediction of 1 s after 0.5 s
    # Noise-free data of the same model: only the rollout's tolerance of 1e-5 m is left.
    assert hf.Rope.from_toml(swing / "rope.toml").friction[0] == pytest.approx(2e-4, rel=1e-2)
    assert files.read_toml(swing / "rope.toml")["identification"]["status"] == "success"


def test_identify_as_json_with_a_held_out_part(hyperflex_json, swing):
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "--free", "inertia", "--train", "2")
    code, result = hyperflex_json("identify", swing / "swing.csv", *arguments, "-o", swing / "rope.toml", *DECLARED)
    assert code == 0
    assert result["values"]["friction"][0] == pytest.approx(2e-4, rel=1e-2)
    assert result["held_out"]["ahead"] == 1.0
    assert result["output"] == str(swing / "rope.toml")


def test_what_is_not_declared_is_refused(hyperflex_json, swing):
    code, result = hyperflex_json(
        "identify", swing / "swing.csv", "--rope", swing / "guess.toml", "-o", swing / "rope.toml", "--time-unit", "ms"
    )
    assert code == 2
    assert "unit" in result["error"]
    assert not (swing / "rope.toml").exists()


def test_columns_can_be_named(hyperflex_json, swing):
    names, values, *_ = files.read_table(swing / "swing.csv")
    files.write_table(swing / "other.csv", ["clock", "hinge", "note"], np.column_stack([values, values[:, 0]]))
    assert names == ["t", "th1"]
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    named = ("--kind", "angles", "--time", "clock", "--columns", "hinge")
    code, result = hyperflex_json("identify", swing / "other.csv", *arguments, *named)
    assert code == 0
    assert result["values"]["friction"][0] == pytest.approx(2e-4, rel=1e-2)


def test_ctrl_c_keeps_the_best_so_far_and_exits_with_130(hyperflex_json, swing, monkeypatch):
    whole = identification.identify

    def interrupted(*arguments, **options):
        found = whole(*arguments, **options)
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise Interrupted(dataclasses.replace(found, ended=Status.INTERRUPTED)) from None

    monkeypatch.setattr(identification, "identify", interrupted)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the tests' own parent has set
    try:
        code, result = hyperflex_json("identify", swing / "swing.csv", *arguments)
    finally:
        signal.signal(signal.SIGINT, before)
    assert code == 130
    assert (result["error"], result["success"], result["status"]) == ("interrupted", False, "interrupted")
    assert files.read_toml(swing / "rope.toml")["identification"]["status"] == "interrupted"


def test_a_fit_that_did_not_converge_is_written_marked_and_exits_with_3(hyperflex, swing, monkeypatch):
    whole = identification.identify

    def unsettled(*arguments, **options):
        return dataclasses.replace(whole(*arguments, **options), converged=False)

    monkeypatch.setattr(identification, "identify", unsettled)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments)
    assert code == 3
    assert files.read_toml(swing / "rope.toml")["identification"]["status"] == "failed"
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments, "--json")
    assert code == 3
    assert (json.loads(out)["success"], json.loads(out)["status"]) == (False, "failed")


def test_ctrl_c_prints_the_best_so_far(hyperflex, swing, monkeypatch):
    whole = identification.identify

    def interrupted(*arguments, **options):
        raise Interrupted(dataclasses.replace(whole(*arguments, **options), ended=Status.INTERRUPTED))

    monkeypatch.setattr(identification, "identify", interrupted)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    code, out, err = hyperflex("identify", swing / "swing.csv", *arguments)
    assert code == 130
    assert "friction" in out
    assert "interrupted" in out
    assert "best so far" in err


def test_intervals_and_the_fastest_turn_can_be_chosen(hyperflex, hyperflex_json, swing):
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / "rope.toml", *DECLARED)
    code, result = hyperflex_json("identify", swing / "swing.csv", *arguments, "--intervals", "none")
    assert code == 0
    assert result["intervals"] == {}
    code, result = hyperflex_json("identify", swing / "swing.csv", *arguments, "--intervals", "profile")
    assert result["intervals"]["friction[0]"]["kind"] == "profile"
    code, out, err = hyperflex("identify", swing / "swing.csv", *arguments, "--intervals", "all")
    assert (code, out) == (2, "")
    assert "intervals is not known: got 'all'" in err
    assert "Allowed: 'auto', 'covariance', 'profile', None (none on the command line)" in err
    code, out, err = hyperflex("identify", swing / "swing.csv", *arguments, "--max-rate", "1")
    assert (code, out) == (2, "")
    for words in ("--max-rate = 1", "--unit deg", "--wrapped", "--time-unit ms", "a larger --max-rate"):
        assert words in err
    assert "max_rate" not in err


@pytest.mark.parametrize("taken", ["swing.csv", "guess.toml"])
def test_no_input_is_overwritten(hyperflex, swing, taken):
    before = (swing / taken).read_bytes()
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", "-o", swing / taken, *DECLARED)
    code, out, err = hyperflex("identify", swing / "swing.csv", *arguments)
    assert (code, out) == (2, "")
    assert "is one of the inputs" in err
    assert (swing / taken).read_bytes() == before


def test_a_wrong_suffix_is_refused(hyperflex, swing):
    arguments = ("--rope", swing / "guess.toml", "-o", swing / "rope.nc", *DECLARED)
    code, _, err = hyperflex("identify", swing / "swing.csv", *arguments)
    assert code == 2
    assert ".toml" in err
    assert not (swing / "rope.nc").exists()


# ---- a folder with the report


def test_a_folder_gets_rope_figures_and_page(hyperflex, swing):
    arguments = ("--rope", swing / "guess.toml", "--free", "friction,inertia", "--train", "2", *DECLARED)
    code, out, _ = hyperflex("identify", swing / "swing.csv", *arguments, "-o", swing / "found")
    assert code == 0
    assert sorted(path.name for path in (swing / "found").iterdir()) == [
        "identification.json",
        "report.html",
        "rope.toml",
    ]
    assert hf.Rope.from_toml(swing / "found" / "rope.toml").friction[0] == pytest.approx(2e-4, rel=1e-2)
    page = (swing / "found" / "report.html").read_text("utf-8")
    assert "swing, identified" in page
    assert "first guess" in page
    for words in ("friction[0]", "inertia[0]", "prediction error over 1 s", "report.html", "µN"):
        assert words in out
    content = json.loads((swing / "found" / "identification.json").read_text("utf-8"))
    assert content["settings"]["free"] == ["friction", "inertia"]


def test_a_folder_as_json_names_its_files(hyperflex_json, swing):
    (swing / "found.v2").mkdir()  # a folder that is there already may have any name
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", *DECLARED)
    code, result = hyperflex_json("identify", swing / "swing.csv", *arguments, "-o", swing / "found.v2")
    assert code == 0
    assert result["files"]["page"] == str(swing / "found.v2" / "report.html")
    assert result["output"] == str(swing / "found.v2")


def test_a_folder_does_not_overwrite_its_own_input(hyperflex, swing):
    (swing / "found").mkdir()
    guess = swing / "found" / "rope.toml"
    (swing / "guess.toml").rename(guess)
    before = guess.read_bytes()
    code, _, err = hyperflex("identify", swing / "swing.csv", "--rope", guess, "-o", swing / "found", *DECLARED)
    assert code == 2
    assert "is one of the inputs" in err
    assert guess.read_bytes() == before


def test_ctrl_c_while_the_page_is_drawn_leaves_the_rope(hyperflex_json, swing, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("hyperflex.report.identification.page.residual_figure", interrupted)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", *DECLARED)
    code, result = hyperflex_json("identify", swing / "swing.csv", *arguments, "-o", swing / "found")
    assert (code, result["error"], result["success"]) == (130, "interrupted", True)
    assert sorted(path.name for path in (swing / "found").iterdir()) == ["identification.json", "rope.toml"]
    assert (sorted(result["files"]), result["missing"]) == (["figures", "rope"], "the page")
    assert result["values"]["friction"]


def test_an_interrupted_fit_leaves_a_whole_folder_marked_as_such(hyperflex, swing, monkeypatch):
    whole = identification.identify

    def interrupted(*arguments, **options):
        raise Interrupted(dataclasses.replace(whole(*arguments, **options), ended=Status.INTERRUPTED))

    monkeypatch.setattr(identification, "identify", interrupted)
    arguments = ("--rope", swing / "guess.toml", "--free", "friction", *DECLARED)
    code, out, err = hyperflex("identify", swing / "swing.csv", *arguments, "-o", swing / "found")
    assert code == 130
    assert "friction" in out  # the table of the best so far
    assert "marked as interrupted" in err
    assert "usable" in (swing / "found" / "report.html").read_text("utf-8")


# ---- markers along the rope, a led first joint


@pytest.fixture
def led(tmp_path):
    """Four markers on three links that hang from an arm in motion, seen from an origin of the camera's own."""
    rope = hf.Rope.uniform(length=0.3, mass=0.1, n_links=3, friction=2e-4)
    swings = hf.arm_swings(t_move=0.4, t_rest=0.3)
    setup = hf.Setup(rope, swings, hf.Arm(length=0.1), duration=3.0)
    t = np.linspace(0.0, 3.0, 101)
    run = hf.simulate(setup, t_eval=t)
    middle = 0.5 * (run.joints[:, :1] + run.joints[:, 1:2])
    places = np.concatenate([middle, run.joints[:, 1:]], axis=1) + np.array([0.05, -0.02])
    table = np.column_stack([t, places.reshape(t.size, -1)])
    files.write_table(tmp_path / "led.csv", ["t", *(f"{axis}{k}" for k in range(4) for axis in "xy")], table)
    setup.to_toml(tmp_path / "setup.toml")
    rope.replace(friction=4e-4).to_toml(tmp_path / "guess.toml")
    return tmp_path


MARKERS = ("--kind", "markers", "--time-unit", "s", "--unit", "m", "--y-axis", "up", "--free", "friction:shared")


@pytest.mark.parametrize(
    "arc_lengths", [("--arc-lengths", "0.05,0.1,0.2,0.3"), ("--arc-lengths", "0.05,0.1", "--arc-lengths", "0.2,0.3")]
)
def test_arcs_origin_and_setup_reach_the_fit(hyperflex_json, led, arc_lengths):
    arguments = ("--rope", led / "guess.toml", "--setup", led / "setup.toml", "--origin", "0.05", "-0.02", *arc_lengths)
    options = ("--loss", "huber", "--train", "inf", *MARKERS)
    code, result = hyperflex_json("identify", led / "led.csv", *arguments, *options, "-o", led / "rope.toml")
    assert code == 0
    # Noise-free data of the same model: only the rollout's tolerance is left.
    assert result["values"]["friction"] == pytest.approx([2e-4] * 3, rel=1e-2)
    settings = result["settings"]
    assert (settings["arc_lengths"], settings["origin"], settings["loss"]) == (
        [0.05, 0.1, 0.2, 0.3],
        [0.05, -0.02],
        "huber",
    )
    assert settings["base"] == "moved by an arm of 0.1 m"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--arc-lengths", "0.1,here"), "--arc-lengths is not made of numbers"),
        (("--arc-lengths", "0.05,0.1,0.2,0.3", "--loss", "cubes"), "loss"),
    ],
)
def test_bad_options_are_refused_by_name(hyperflex, led, options, message):
    arguments = ("--rope", led / "guess.toml", *options, *MARKERS, "-o", led / "found")
    code, _, err = hyperflex("identify", led / "led.csv", *arguments)
    assert code == 2
    assert message in err
    assert not (led / "found").exists()


def test_a_torque_cannot_lead_an_identification(hyperflex, led):
    rope = hf.Rope.from_toml(led / "guess.toml")
    torque = hf.torque_profile([0.0, 1.0], [0.1, 0.1])
    hf.Setup(rope, arm=hf.Arm(length=0.1, inertia=1e-3), torque=torque).to_toml(led / "torque.toml")
    arguments = (
        "--rope",
        led / "guess.toml",
        "--arc-lengths",
        "0.05,0.1,0.2,0.3",
        "--setup",
        led / "torque.toml",
        *MARKERS,
    )
    code, _, err = hyperflex("identify", led / "led.csv", *arguments, "-o", led / "found")
    assert code == 2
    assert "drives its arm by a torque" in err


# ---- the bar


def test_the_bar_moves_forward_and_tells_stage_and_round(monkeypatch, capsys):
    entries = [
        {"stage": stage, "stages": 2, "round": k, "window": 0.25, "gain": 0.5} for stage in range(2) for k in range(9)
    ]
    parts = [pipeline.part_done(entry) for entry in entries]
    assert parts == sorted(parts)
    assert 0.0 < parts[0] < 0.5
    assert parts[9] > 0.5
    assert parts[-1] < 1.0
    assert pipeline.message(entries[10]) == "stage 2 of 2, windows of 0.25 s: round 2 gained 50 %"
    monkeypatch.setattr(progress, "terminal", lambda: Console(file=io.StringIO(), force_terminal=True))
    with pipeline.rounds_shown(True) as hear:
        for entry in entries:
            hear(entry)
    assert capsys.readouterr().out == ""


def test_a_fit_tells_its_stages(swing):
    recording = hf.read_recording(swing / "swing.csv", time_unit="ms", unit="deg")
    heard = []
    hf.identify(
        recording,
        hf.Rope.from_toml(swing / "guess.toml"),
        ["friction"],
        options=hf.FitOptions(window=3.0),
        progress=heard.append,
    )
    assert {entry["stage"] for entry in heard} == {0, 1, 2}  # 0.75, 1.5 and 3 s: the usual length is 1.1 s
    assert [entry["stage"] for entry in heard] == sorted(entry["stage"] for entry in heard)
    assert heard[-1]["stage"] == heard[-1]["stages"] - 1
