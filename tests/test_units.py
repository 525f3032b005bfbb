"""Values in a wrong unit, such as millimetres for metres: errors that name the unit, and accepted values."""

import json
import warnings
from collections.abc import Callable

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.cli import output
from hyperflex.cli.app import run
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=0.9, mass=0.05, n_links=10, friction=0.0)
SLIPS: list[tuple[Callable[[], object], str]] = [
    (
        lambda: hf.Rope.uniform(length=900, mass=0.05, n_links=10, friction=0.0),
        "rope length is 900 m: is it meant in mm.*are 0.9",
    ),
    (
        lambda: hf.Rope.uniform(length=0.9, mass=50, n_links=10, friction=0.0),
        "mass over length is 55.5.*kg/m: is it meant in g/m",
    ),
    (lambda: hf.Arm(length=150), "arm length is 150 m: is it meant in mm.*are 0.15"),
    (lambda: hf.Peg(x=-800, y=-0.6, radius=0.03), "peg x is -800 m: is it meant in mm.*are -0.8"),
    (lambda: hf.TipTarget(x=0.3, y=-2050, direction=0.2), "target y is -2050 m: is it meant in mm"),
    (lambda: hf.arm_swings(t_move=730), "t_move is 730 s: is it meant in ms.*are 0.73"),
    (lambda: hf.move_arm(0.0, 90.0, 1.0), "arm angle is 90 rad: is it meant in degrees"),
    (lambda: hf.hold_arm(-90), "angle is -90 rad"),
    (lambda: hf.arm_moves([0.0, 90.0], [0.0], [1.0]), "angles is 90 rad"),
    (lambda: hf.MotorLimits(angles=(-180, 180)), "motor angles is -180 rad"),
    (lambda: hf.Setup(ROPE, q0=np.full(10, 90.0)), "q0 is 90 rad"),
]


@pytest.mark.parametrize(("call", "words"), SLIPS, ids=[words.split(":")[0] for _, words in SLIPS])
def test_a_value_off_by_a_unit_is_named_with_it(call, words):
    with pytest.warns(UserWarning, match=words) as told:
        call()
    assert told[0].filename == __file__


def test_real_large_ropes_and_arms_pass():
    """Warnings are errors in these tests."""
    assert hf.Rope.uniform(length=30.0, mass=60.0, n_links=30, radius=0.02, friction=0.0).total_length == pytest.approx(
        30.0
    )
    assert hf.Rope(length=[0.3], mass=[60.0]).mass[0] == 60.0  # masses in proportion, from angles alone
    assert hf.Arm(length=3.0).length == 3.0
    assert hf.move_arm(-4.0 * np.pi, 4.0 * np.pi, 60.0).breaks[-1] == 60.0


def test_limits_of_the_motor_belong_to_its_limits():
    for plan, name in ((hf.plan_cast, "torque"), (hf.plan_whip, "speed"), (hf.plan_insert, "acceleration")):
        refuses(rf"{name}.* belongs to limits=MotorLimits\(\.\.\.\)", plan, ROPE, hf.Arm(), None, **{name: 2.0})


def test_a_run_continues_from_many_turns():
    """As after a long rotation; a start at rest gives a question about its unit."""
    setup = hf.Setup(ROPE, arm=hf.Arm(), q0=np.full(10, 90.3), qd0=np.full(10, 12.0))
    assert setup.replace(duration=0.1).q0 is not None


def test_the_command_line_says_it_in_a_line(tmp_path, capsys):
    path = tmp_path / "long.toml"
    hf.Setup(ROPE, duration=0.1).to_toml(path)
    path.write_text(path.read_text().replace("link_length = 0.09", "link_length = 90.0"))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert run(["simulate", str(path), "--json", "-o", str(tmp_path / "long.nc")]) == 0
    told = capsys.readouterr()
    assert "hyperflex: rope length is 900 m: is it meant in mm? Give it in m; 900 mm are 0.9.\n" in told.err
    assert json.loads(told.out)


def test_the_command_line_says_it_once(capsys):
    show = output.warner()
    for text in ("a", "b", "a"):
        show(UserWarning(text), UserWarning, __file__, 1)
    assert capsys.readouterr().err == "hyperflex: a\nhyperflex: b\n"
