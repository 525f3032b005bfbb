"""Air drag: identified from twins that are cut finer than the model, told from joint friction, and its ratio."""

from __future__ import annotations

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.model import divided
from hyperflex.recording import Recording

NOISE = 1e-3  # m
DRAG = 0.0045  # kg/m^2: a cord of 6 mm, coefficient 1.25
CORD = hf.Rope.uniform(0.6, 0.012, 4, radius=0.003, friction=2e-5, drag=DRAG)  # light: 20 g/m
BARE = CORD.replace(drag=0.0, friction=1e-4)
START = [1.2, 1.3, 1.4, 1.5]
MODELS = {
    "joint friction": ["friction:shared"],
    "drag": ["drag:shared"],
    "both": ["friction:shared", "drag:shared"],
}


def swing(rope: hf.Rope, *, seed: int = 1, pieces: int = 3, duration: float = 6.0) -> tuple[Recording, Array]:
    """Markers at the joints of `rope` while a finer one, each link in pieces, swings; and where they sit, m."""
    t = np.arange(round(50 * duration) + 1) / 50
    run = hf.simulate(divided(rope, pieces), duration=t[-1], t_eval=t, q0=np.repeat(START, pieces), tol=1e-9)
    places = run.joints[:, ::pieces]
    noise = NOISE * np.random.default_rng(seed).standard_normal(places.shape)
    arcs = np.append(0.0, np.cumsum(rope.length))
    return Recording(t, (places + noise).reshape(t.size, -1), kind="markers", noise=np.array(NOISE)), arcs


@pytest.fixture(scope="module")
def windy() -> tuple[Recording, Array]:
    return swing(CORD)


def within(found: hf.Identification, name: str, truth: float) -> bool:
    return truth in found.intervals[name]


def test_drag_is_known_beside_joint_friction(windy: tuple[Recording, Array]) -> None:
    recording, arcs = windy
    guess = CORD.replace(drag=0.0, friction=1e-4)
    found = hf.identify(recording, guess, ["friction:shared", "drag:shared"], arcs=arcs, origin=(0.0, 0.0))
    assert found.status == "converged"
    assert within(found, "drag:shared", DRAG)
    assert found.sd["drag"][0] < 0.1 * DRAG


def test_what_a_free_swing_of_unknown_mass_tells_of_drag_is_its_ratio(windy: tuple[Recording, Array]) -> None:
    """Drag grows with the masses; over the first moment it is known as well as if the rope had been weighed."""
    recording, arcs = windy
    words = ["mass:factor", "inertia:factor", "friction:shared", "drag:shared"]
    found = hf.identify(recording, CORD, words, arcs=arcs, origin=(0.0, 0.0))
    assert not found.identifiable
    assert "One common factor of mass, inertia, friction, drag" in found.verdict[0]
    assert np.isinf(found.sd["drag"]).all()
    assert np.isfinite(found.ratio_sd["d/p1"]).all()
    truth = DRAG / hf.identification.lumped(CORD)[0][0]
    assert within(found, "d/p1[0]", truth)


@pytest.mark.parametrize("rope", [CORD.replace(friction=0.0), BARE], ids=["drag", "joint friction"])
def test_drag_is_told_from_joint_friction(rope: hf.Rope) -> None:
    """Twins with only one of them: their own model is preferred, though both have one parameter."""
    recording, arcs = swing(rope)
    guess = CORD.replace(friction=0.0, drag=0.0)
    found = hf.compare_models(recording, guess, MODELS, arcs=arcs, origin=(0.0, 0.0))
    assert found.preferred == ("drag" if rope.drag.any() else "joint friction")
    both = found["both"].identification
    assert both is not None
    for name in ("friction", "drag"):
        value, sd, truth = both.values[name][0], both.sd[name][0], getattr(rope, name)[0]
        assert abs(value - truth) < 4.0 * sd or (value == truth == 0.0)
