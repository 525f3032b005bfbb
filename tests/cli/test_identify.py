"""``hyperflex identify``: a recording and a guess in, a rope out; missing declarations are refused."""

import dataclasses
import json
import re
import signal

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files, identification, report
from hyperflex.errors import Interrupted
from hyperflex.status import Status

DECLARED = ("--time-unit", "ms", "--unit", "deg")
FRICTION = ("--free", "friction", *DECLARED)
PARTS = {"identification.json", "report.html", "rope.toml"}


@pytest.fixture
def swing(tmp_path, monkeypatch):
    """A folder with a swing of one link, in degrees and milliseconds, and a guess with twice its friction."""
    true = hf.Rope(length=[0.3], mass=[0.1], friction=2e-4)
    t = np.linspace(0.0, 4.0, 201)
    run = hf.simulate(true, duration=4.0, t_eval=t, q0=[0.8])
    files.write_table(tmp_path / "swing.csv", ["t", "th1"], np.column_stack([1e3 * t, np.degrees(run.q)]))
    true.replace(friction=4e-4).to_toml(tmp_path / "guess.toml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def words(out, *more, recording="swing.csv", rope="guess.toml"):
    return ("identify", recording, "--rope", rope, "-o", out, *more)


@pytest.fixture
def ended(monkeypatch):
    """Let the fit end in another way."""
    whole = identification.identify

    def end(*, interrupt=False, heard=False, **changes):
        def work(*arguments, **options):
            found = dataclasses.replace(whole(*arguments, **options), **changes)
            if not interrupt:
                return found
            try:
                if heard:
                    signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                pass
            raise Interrupted(dataclasses.replace(found, ended=Status.INTERRUPTED))

        monkeypatch.setattr(identification, "identify", work)

    return end


def test_a_long_table_of_ratios_is_cut_and_reports_where_the_rest_is(hyperflex, swing, monkeypatch):
    """Five rows of each ratio, and 24 in all."""
    rows = [(f"r{k}/p1", str(link), "1", "0", "0 to 2", "") for k in range(6) for link in range(8)]
    table = report.TextTable(("ratio", "link", "value", "std", "95 % interval", "what it is"), tuple(rows))
    monkeypatch.setattr(report, "ratios_table", lambda _: table)
    code, out, _ = hyperflex(*words("found", *FRICTION))
    shown = re.findall(r"^ (r\d)/p1 +(\d)", out, re.M)
    assert (code, [link for name, link in shown if name == "r0"], len(shown)) == (0, list("01234"), 24)
    assert "and 24 more, in found/report.html" in out


def test_a_file_gets_the_rope_and_its_figures(hyperflex, hyperflex_json, swing):
    code, out, _ = hyperflex(*words("rope.toml", *FRICTION))
    assert (code, "friction" in out) == (0, True)
    assert "prediction error" not in out  # 0.8 s are too short for a prediction of 1 s after 0.5 s
    # Noise-free data of the same model: only the rollout's tolerance of 1e-5 m is left.
    assert hf.Rope.from_toml("rope.toml").friction[0] == pytest.approx(2e-4, rel=1e-2)
    assert files.read_toml("rope.toml")["identification"]["status"] == "success"
    code, result = hyperflex_json(*words("rope.toml", *FRICTION, "--free", "inertia", "--train", 2))
    assert (code, result["held_out"]["ahead"], result["output"]) == (0, 1.0, "rope.toml")
    assert result["values"]["friction"][0] == pytest.approx(2e-4, rel=1e-2)


def test_what_is_added_is_reported_and_a_camera_s_turn_stays_out_of_the_rope(hyperflex, swing):
    table, noise = files.read_table("swing.csv"), np.random.default_rng(0)
    table.values[:, 1] += 1.5 + 0.1 * noise.standard_normal(len(table.values))  # degrees
    files.write_table("turned.csv", table.names, table.values)
    read = ("--kind", "angles", "--time-unit", "ms", "--unit", "deg")
    out = hyperflex(*words("turned.toml", *read, recording="turned.csv"))[1]
    assert "Added because the recording shows it: gravity_angle" in out
    assert "gravity_angle is the camera's turn" in out
    np.testing.assert_array_equal(hf.Rope.from_toml("turned.toml").gravity, [0.0, -9.81])


def test_a_folder_gets_rope_figures_and_page(hyperflex, swing):
    code, out, _ = hyperflex(*words("found", *FRICTION, "--free", "inertia", "--train", 2))
    assert (code, {path.name for path in (swing / "found").iterdir()}) == (0, PARTS)
    assert hf.Rope.from_toml("found/rope.toml").friction[0] == pytest.approx(2e-4, rel=1e-2)
    page = (swing / "found" / "report.html").read_text("utf-8")
    assert "swing, identified" in page
    assert "first guess" in page
    for word in ("friction[0]", "inertia[0]", "prediction error over 1 s", "report.html", "µN"):
        assert word in out
    content = json.loads((swing / "found" / "identification.json").read_text("utf-8"))
    assert content["settings"]["free"] == ["friction", "inertia"]


def test_a_part_of_the_recording_is_fitted(hyperflex, hyperflex_json, swing):
    """As what follows the release of a rope that a hand held."""
    code, result = hyperflex_json(*words("rope.toml", *FRICTION, "--start", "0.5", "--end", "3.5", "--train", "inf"))
    assert (code, result["settings"]["fitted_from"]) == (0, 0.5)
    assert result["settings"]["fitted_to"] == pytest.approx(3.48)
    code, _, err = hyperflex(*words("rope.toml", *FRICTION, "--start", "4"))
    assert code == 2
    assert "the span contains fewer than two samples" in err


def test_intervals_and_the_fastest_turn_can_be_chosen(hyperflex, hyperflex_json, swing):
    code, result = hyperflex_json(*words("rope.toml", *FRICTION, "--intervals", "none"))
    assert (code, result["intervals"]) == (0, {})
    code, result = hyperflex_json(*words("rope.toml", *FRICTION, "--intervals", "profile"))
    assert (code, result["intervals"]["friction[0]"]["kind"]) == (0, "profile")
    code, out, err = hyperflex(*words("other.toml", *FRICTION, "--intervals", "all"))
    assert (code, out) == (2, "")
    assert "intervals is not known: got 'all'. Allowed: 'auto', 'covariance', 'profile', None (none on the" in err
    code, out, err = hyperflex(*words("other.toml", *FRICTION, "--max-rate", "1"))
    assert (code, out, "max_rate" in err) == (2, "", False)
    for word in ("--max-rate = 1", "--unit deg", "--wrapped", "--time-unit ms", "a larger --max-rate"):
        assert word in err


# ---- fits that end early


@pytest.mark.parametrize(
    ("out", "heard"),
    [
        ("rope.toml", False),
        ("found", True),
        pytest.param("rope.toml", True, marks=pytest.mark.nightly),
        pytest.param("found", False, marks=pytest.mark.nightly),
    ],
)
def test_ctrl_c_keeps_the_best_so_far(hyperflex, hyperflex_json, swing, ended, monkeypatch, out, heard):
    ended(interrupt=True, heard=heard)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the tests' own parent has set
    try:
        code, result = hyperflex_json(*words(out, *FRICTION))
        assert (code, result["error"], result["success"]) == (130, "interrupted", False)
        assert result["status"] == "interrupted"
        code, said, err = hyperflex(*words(out, *FRICTION))
    finally:
        signal.signal(signal.SIGINT, before)
    assert (code, "friction" in said, "interrupted" in said) == (130, True, True)
    assert f"the best so far is in {out}, marked as interrupted" in err
    kept = swing / out / ("rope.toml" if out == "found" else "")
    assert files.read_toml(kept)["identification"]["status"] == "interrupted"
    if out == "found":
        page = (swing / "found" / "report.html").read_text("utf-8")
        assert ("usable" in page, "data:image/png" in page) == (True, False)  # figures take seconds


def test_ctrl_c_while_the_page_is_drawn_leaves_the_rope(hyperflex_json, swing, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("hyperflex.report.identification.page.residual_figure", interrupted)
    code, result = hyperflex_json(*words("found", *FRICTION))
    assert (code, result["error"], result["success"]) == (130, "interrupted", True)
    assert {path.name for path in (swing / "found").iterdir()} == PARTS - {"report.html"}
    assert (sorted(result["files"]), result["missing"]) == (["figures", "rope"], "the page")
    assert result["values"]["friction"]


def test_a_fit_that_did_not_converge_is_written_marked_and_exits_with_3(hyperflex_json, swing, ended):
    ended(converged=False)
    code, result = hyperflex_json(*words("rope.toml", *FRICTION))
    assert (code, result["success"], result["status"]) == (3, False, "failed")
    assert files.read_toml("rope.toml")["identification"]["status"] == "failed"


# ---- what is refused


@pytest.mark.parametrize(
    ("out", "more", "message"),
    [
        ("swing.csv", DECLARED, "is one of the inputs"),
        ("guess.toml", DECLARED, "is one of the inputs"),
        ("rope.nc", DECLARED, ".toml"),
        ("rope.toml", DECLARED[:2], "unit"),
    ],
)
def test_outputs_that_cannot_be_and_what_is_not_declared_are_refused(hyperflex, swing, out, more, message):
    before = {path.name: path.read_bytes() for path in swing.iterdir()}
    code, said, err = hyperflex(*words(out, *more))
    assert (code, said, message in err) == (2, "", True)
    assert {path.name: path.read_bytes() for path in swing.iterdir()} == before


def test_a_folder_does_not_overwrite_its_own_input(hyperflex, swing):
    (swing / "found").mkdir()
    guess = (swing / "guess.toml").rename(swing / "found" / "rope.toml")
    before = guess.read_bytes()
    code, _, err = hyperflex(*words("found", *DECLARED, rope=guess))
    assert (code, "is one of the inputs" in err, guess.read_bytes()) == (2, True, before)


# ---- markers along the rope, a led first joint

ARCS = ("--arc-lengths", "0.05,0.1,0.2,0.3")
MARKERS = ("--kind", "markers", "--time-unit", "s", "--unit", "m", "--y-axis", "up", "--free", "friction:shared")


@pytest.fixture
def led(tmp_path, monkeypatch):
    """Four markers on three links that hang from an arm in motion, seen from an origin of the camera's own."""
    rope = hf.Rope.uniform(length=0.3, mass=0.1, n_links=3, friction=2e-4)
    setup = hf.Setup(rope, hf.arm_swings(t_move=0.4, t_rest=0.3), hf.Arm(length=0.1), duration=3.0)
    t = np.linspace(0.0, 3.0, 101)
    run = hf.simulate(setup, t_eval=t)
    middle = 0.5 * (run.joints[:, :1] + run.joints[:, 1:2])
    places = np.concatenate([middle, run.joints[:, 1:]], axis=1) + np.array([0.05, -0.02])
    table = np.column_stack([t, places.reshape(t.size, -1)])
    files.write_table(tmp_path / "led.csv", ["t", *(f"{axis}{k}" for k in range(4) for axis in "xy")], table)
    setup.to_toml(tmp_path / "setup.toml")
    torque = hf.torque_profile([0.0, 1.0], [0.1, 0.1])
    hf.Setup(rope, arm=hf.Arm(length=0.1, inertia=1e-3), torque=torque).to_toml(tmp_path / "torque.toml")
    rope.replace(friction=4e-4).to_toml(tmp_path / "guess.toml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_arcs_origin_and_setup_reach_the_fit(hyperflex_json, led):
    arcs = ("--arc-lengths", "0.05,0.1", "--arc-lengths", "0.2,0.3")
    more = (*MARKERS, *arcs, "--setup", "setup.toml", "--origin", 0.05, -0.02, "--loss", "huber", "--train", "inf")
    code, result = hyperflex_json(*words("rope.toml", *more, recording="led.csv"))
    # Noise-free data of the same model: only the rollout's tolerance is left.
    assert (code, result["values"]["friction"]) == (0, pytest.approx([2e-4] * 3, rel=1e-2))
    settings = {"arc_lengths": [0.05, 0.1, 0.2, 0.3], "origin": [0.05, -0.02], "loss": "huber"}
    settings["base"] = "moved by an arm of 0.1 m"
    assert {name: result["settings"][name] for name in settings} == settings


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--arc-lengths", "0.1,here"), "--arc-lengths is not made of numbers"),
        ((*ARCS, "--loss", "cubes"), "loss"),
        ((*ARCS, "--setup", "torque.toml"), "drives its arm by a torque"),
    ],
)
def test_bad_options_are_refused_by_name(hyperflex, led, options, message):
    code, _, err = hyperflex(*words("found", *MARKERS, *options, recording="led.csv"))
    assert (code, message in err, (led / "found").exists()) == (2, True, False)


# ---- the bar


def test_a_torque_column_drives_the_pendulum(hyperflex_json, refused, tmp_path, monkeypatch):
    """A motor at the first joint, its current in a column: the known mass determines the constant, declared 10 %
    wrong."""
    monkeypatch.chdir(tmp_path)
    rod = hf.Rope(length=[0.4], mass=[0.5], com=[0.3], inertia=[0.01], friction=[0.02])
    t = np.arange(501) / 100.0
    torque = 0.8 * np.sin(5.0 * t) + 0.5 * np.sin(2.3 * t)
    run = hf.simulate(rod, torque=hf.torque_profile(t, torque), duration=5.0, t_eval=t, tol=1e-9)
    angle = np.degrees(run.q[:, 0] + 1e-3 * np.random.default_rng(0).standard_normal(t.size))
    files.write_table("log.csv", ["time", "pos", "current"], np.column_stack([t, -angle, -torque / 0.05]))
    rod.replace(inertia=[0.02], friction=[0.01]).to_toml("rod.toml")  # angles grow to the other side
    read = ["--time", "time", "--time-unit", "s", "--columns", "pos", "--kind", "angles", "--unit", "deg"]
    read += ["--sense", "-x"]
    noise = "--noise", 0.0573, "--torque-constant", 0.055
    given = words("out.toml", *read, *noise, recording="log.csv", rope="rod.toml")
    known = ("--torque-std", 0.1, "--length-std", 0, "--intervals", "covariance")
    driven = (*given, "--torque", "current", *known, "--free", "inertia,friction,torque_constant")
    code, found = hyperflex_json(*driven)
    assert (code, found["values"]["torque_constant"]) == (0, pytest.approx([0.05], rel=0.01))
    code, part = hyperflex_json(*driven, "--start", 1.0)  # the torque is cut alike
    assert (code, part["values"]["torque_constant"]) == (0, pytest.approx([0.05], rel=0.02))
    assert found["values"]["friction"] == pytest.approx([0.02], rel=0.03)
    assert "no such columns" in refused(*given, "--torque", "amps")
    assert "--torque-constant is given without --torque" in refused(*given)
