"""Air drag: identified from twins finer than the model, distinguished from joint friction, and its ratio."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.identification import Kind
from hyperflex.model import divided
from hyperflex.recording import Recording
from tests.identification.twins import recorded

NOISE = 2e-3  # m
DRAG = 0.0045  # kg/m^2: a cord of 6 mm, coefficient 1.25
CORD = hf.Rope.uniform(0.6, 0.012, 10, radius=0.003, friction=2e-5, drag=DRAG)  # light: 20 g/m
BARE = CORD.replace(drag=0.0, friction=1e-4)
MODELS = {"joint friction": ["friction:shared"], "drag": ["drag:shared"], "both": ["friction:shared", "drag:shared"]}


def swing(rope: hf.Rope, seed: int = 1) -> tuple[Recording, Array]:
    """Markers at every second joint of `rope` while one swings whose links are half as long; and where they sit, m."""
    t = np.arange(201) / 50
    run = hf.simulate(divided(rope, 2), duration=t[-1], t_eval=t, q0=np.full(2 * rope.n_links, 1.0), tol=1e-9)
    places = run.joints[:, ::4]
    noise = NOISE * np.random.default_rng(seed).standard_normal(places.shape)
    arc_lengths = np.append(0.0, np.cumsum(rope.length))[::2]
    return Recording(t, (places + noise).reshape(t.size, -1), kind="markers", noise=np.array(NOISE)), arc_lengths


@pytest.fixture(scope="module")
def windy() -> tuple[Recording, Array]:
    return swing(CORD)


def within(found: hf.Identification, name: str, truth: float) -> bool:
    return truth in found.intervals[name]


def test_drag_is_known_beside_joint_friction(windy):
    recording, arc_lengths = windy
    guess = CORD.replace(drag=0.0, friction=1e-4)
    setup = hf.RecordingSetup(arc_lengths=arc_lengths, origin=(0.0, 0.0))
    found = hf.identify(recording, guess, ["friction:shared", "drag:shared"], setup=setup)
    assert found.success
    assert within(found, "drag:shared", DRAG)
    assert within(found, "friction:shared", CORD.friction[0])
    assert found.std["drag"][0] < 0.02 * DRAG


def test_what_a_free_swing_of_unknown_mass_tells_of_drag_is_its_ratio(windy):
    """Drag grows with the masses; over the first moment it is known as well as if the rope had been weighed."""
    recording, arc_lengths = windy
    words = ["mass:factor", "inertia:factor", "friction:shared", "drag:shared"]
    found = hf.identify(recording, CORD, words, setup=hf.RecordingSetup(arc_lengths=arc_lengths, origin=(0.0, 0.0)))
    assert not found.identifiable
    (unknown,) = (each.values["names"] for each in found.findings if each.kind is Kind.COMBINATION)
    assert unknown == ["mass", "inertia", "friction", "drag"]
    assert np.isinf(found.std["drag"]).all()
    assert np.isfinite(found.ratio_std["d/p1"]).all()
    truth = DRAG / hf.identification.lumped(CORD)[0][0]
    assert within(found, "d/p1[0]", truth)


@pytest.mark.parametrize(
    ("name", "value", "duration", "said"),
    [("drag", 0.01, 3.0, True), ("dry_friction", 2e-3, 3.0, True), ("friction", 8e-4, 20.0, False)],
)
def test_friction_that_represents_all_damping_is_reported(name, value, duration, said):
    """The residuals of a short swing are only noise with any damping law: the fit is right, with friction free."""
    t, rod = np.arange(0.0, duration, 1.0 / 60.0), hf.Rope(length=[0.6], mass=[0.05], com=[0.6], inertia=[1e-4])
    seen = recorded(rod.replace(**{name: value}), [0.8], t, 2e-3, seed=3)
    found = hf.identify(seen, rod.replace(friction=1e-3), ["inertia", "friction"])
    lines = [each for each in found.findings if each.kind is Kind.FRICTION_MODEL]
    assert [each.values["included"] for each in lines] == [False] * said
    assert all("stands for all that damps the motion, air included" in str(each) for each in lines)
    assert all(str(each) in found.report() for each in lines)


@pytest.mark.nightly
@pytest.mark.parametrize("rope", [CORD.replace(friction=0.0), BARE], ids=["drag", "joint friction"])
def test_drag_is_distinguished_from_joint_friction(rope):
    """Twins with only one of them: their own model is preferred, though both have one parameter."""
    recording, arc_lengths = swing(rope)
    guess = CORD.replace(friction=0.0, drag=0.0)
    found = hf.compare_models(
        recording, guess, MODELS, setup=hf.RecordingSetup(arc_lengths=arc_lengths, origin=(0.0, 0.0))
    )
    assert found.preferred == ("drag" if rope.drag.any() else "joint friction")
    both = found["both"].identification
    # Without any joint friction the finer twin bends more sharply than ten links can: that moves drag by 3 %.
    assert both.values["drag"][0] == pytest.approx(rope.drag[0], rel=0.06, abs=4.0 * both.std["drag"][0])
    assert both.values["friction"][0] == pytest.approx(rope.friction[0], rel=0.06, abs=4.0 * both.std["friction"][0])
