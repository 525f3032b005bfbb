"""Results as they show themselves: in a line, in a notebook, as a figure."""

import pickle

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

import hyperflex as hf
from tests.planning.known import planned, unreachable
from tests.planning.known_whip import planned_whip
from tests.refusals import refuses

LONGEST = 240  # letters of a line
ROPE = hf.Rope(length=[0.17, 0.23], mass=[0.21, 0.16], com=[0.11, 0.09], inertia=[6e-4, 8e-4], friction=1e-3)


@pytest.fixture(scope="module")
def found(swing):
    return swing[1]


def made(kind, found):
    setup = hf.Setup(ROPE, hf.arm_swings(), hf.Arm(length=0.1), duration=0.5, pegs=(hf.Peg(1.0, 0.0, 0.1),))
    if kind == "sensitivities":
        return hf.sensitivities(ROPE, wrt=["friction", "q0"], duration=0.1)
    whole = {"setup": setup, "rope": ROPE, "identification": found, "cast": unreachable(), "miss": planned(winds=False)}
    return (whole | {"whip": planned_whip()})[kind]


@pytest.mark.parametrize("kind", ["setup", "rope", "sensitivities", "identification", "cast", "miss", "whip"])
def test_a_result_is_named_in_a_line(kind, found):
    told = repr(made(kind, found))
    assert len(told) < LONGEST
    assert "\n" not in told
    assert "array(" not in told


def test_a_notebook_shows_a_rope_and_an_identification(found):
    page = ROPE._repr_html_()
    assert "170 to 230\N{NO-BREAK SPACE}mm" in page
    assert "<table>" in page
    told = found._repr_html_()
    assert "success" in told
    assert found.report().splitlines()[0] in told
    assert "friction[0]" in told


def test_a_notebook_plays_a_run_and_a_plan():
    run = planned_whip().run
    for shown in (run, planned_whip()):
        page = shown._repr_html_()
        assert page.count("<iframe sandbox=") == 1
        assert len(page) < 4e5
    assert "m/s" in page  # the plan's figures
    none = unreachable()._repr_html_()
    assert "<iframe" not in none
    assert "out of reach" in none


def test_a_figure_shows_itself_in_a_notebook_and_can_be_copied():
    figure = planned_whip().run.plot("course", start=0.5, end=1.0)
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert pickle.loads(pickle.dumps(figure)).axes[0].get_xlim() == (0.5, 1.0)
    assert [axis.get_ylabel() for axis in figure.axes] == ["degrees", "m/s", "J", "N m"]


def test_results_draw_into_axes_that_are_given_and_pyplot_keeps_none_of_their_own(found):
    plan, recording = planned_whip(), hf.Recording(found.residual_t, found.residuals, name="what is left")
    figure = Figure()
    axes = figure.subplots(1, 3)
    for result, ax in ((plan, axes[0]), (plan.run, axes[1])):
        assert result.plot(ax=ax) is figure
        assert ax.get_aspect() == 1.0
        assert len(ax.collections) > 3
    assert found.plot(recording, axes[2]) is figure
    worst = int(np.argmax(found.residual_rms))
    assert axes[2].get_title("left").startswith(f"link {worst}: ")
    assert len(found.plot(recording).axes) == 2
    assert plan.plot() is not figure
    refuses("a course has several panels", plan.run.plot, "course", ax=axes[0])
    refuses("the plan has no run", unreachable().plot)
    assert plt.get_fignums() == []


def test_a_setup_with_a_field_replaced_is_checked_again(found):
    setup = made("setup", found)
    assert setup.replace(duration=2.0).duration == 2.0
    assert setup.replace(duration=2.0).pegs == setup.pegs
    refuses("a set-up does not know this key: got 'durration'", setup.replace, durration=2.0)
    refuses("duration", setup.replace, duration=-1.0)
