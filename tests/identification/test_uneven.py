"""Resistances that are fitted as one value of all joints, and are not: the first joint's own, and growth along it."""

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE, FREE, noisy, swing

from hyperflex.identification import Finding, Identification, Kind, identify, ratios
from hyperflex.identification.model import Parameter, Parameters, parse
from hyperflex.model import Rope
from hyperflex.recording import Recording
from tests.identification import twins
from tests.refusals import refuses

FRICTION, NOISE, N = 4e-4, 5e-3, 8
ROPE = Rope.uniform(length=1.0, mass=0.05, n_links=N, friction=FRICTION)
GUESS = ROPE.replace(friction=1e-3)
SHARED = ["inertia:shared", "friction:shared"]


def recorded(rope: Rope, seed: int) -> Recording:
    return twins.recorded(rope, np.full(N, 0.8), np.arange(200) / 50.0, NOISE, seed)


def away(found: Identification, rope: Rope) -> float:
    """Return by how many standard deviations the worst ratio is off."""
    worst = 0.0
    for name, true in ratios(rope, found.values).items():
        std = found.ratio_std[name]
        known = (std > 0.0) & np.isfinite(std)
        worst = max(worst, float(np.max(np.abs(found.ratios[name] - true)[known] / std[known], initial=0.0)))
    return worst


def told(found: Identification) -> list[Finding]:
    return [each for each in found.findings if each.kind is Kind.UNEVEN_RESISTANCE]


TAPERED = ROPE.replace(friction=FRICTION * 2.0 ** np.linspace(0.5, -0.5, N))
BEARINGS = {value: ROPE.replace(friction=np.r_[value, np.full(N - 1, FRICTION)]) for value in (4e-5, 1e-3)}
UNEVEN = {
    "taper": (TAPERED, ["friction:factor", "friction:taper"]),
    "easy bearing": (BEARINGS[4e-5], ["friction[0]", "friction:inner"]),
    "stiff bearing": (BEARINGS[1e-3], ["friction[0]", "friction:inner"]),
}


@pytest.mark.parametrize(("rope", "free"), UNEVEN.values(), ids=UNEVEN.keys())
@pytest.mark.nightly
def test_it_is_reported_and_included_in_the_deviations(rope, free):
    """c/p1 was off by 10 to 18 standard deviations, and nothing was suspected."""
    recording = recorded(rope, 1)
    found = identify(recording, GUESS, SHARED)
    assert found.grade == "usable for ratios"
    assert found.findings[0].kind is Kind.UNEVEN_RESISTANCE
    assert found.findings[0].values["words"] == [f"'{word}'" for word in free]
    assert away(found, rope) < 2.0
    chosen = identify(recording, GUESS)
    assert chosen.settings["free"] == ["inertia:shared", *free]
    assert away(chosen, rope) < 3.0
    assert told(chosen) == []


def test_of_two_joints():
    t, q = swing(DOUBLE, [0.9, 0.6])
    found = identify(Recording(t, noisy(q, seed=6)), DOUBLE, ["inertia", "com", "friction:shared"])
    assert found.findings[0].kind is Kind.UNEVEN_RESISTANCE
    assert away(found, DOUBLE) < 2.0
    own = identify(Recording(t, noisy(q, seed=6)), DOUBLE, FREE)
    assert not any(":" in each.name for each in own.score_tests)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_alike_stays_one_value(seed):
    found = identify(recorded(ROPE, seed), GUESS)
    assert found.settings["free"] == SHARED
    assert told(found) == []
    assert away(found, ROPE) < 3.0
    assert found.ratio_std["c/p1"][0] < 0.03 * found.ratios["c/p1"][0]


@pytest.mark.parametrize("name", ["friction:shared", "friction:factor"])
@pytest.mark.parametrize("law", ["taper", "pivot"])
def test_derivatives_beside_one_value(name, law):
    each = parse(ROPE, [name])[0]
    start = 1.0 if law == "pivot" else 0.0
    both = Parameters(ROPE, [each, Parameter("friction", tuple(range(N)), f"friction:{law}", start, 1.0, law)])
    x = both.start + np.array([0.2, 0.7])
    step = 1e-6
    for k, part in both.parts(x):
        up, down = (both.rope(x + d * np.eye(2)[k]).friction for d in (step, -step))
        np.testing.assert_allclose(part["friction"], (up - down) / (2.0 * step), rtol=1e-6, atol=1e-14)


def test_inner_is_one_value_of_all_links_but_the_first():
    both = Parameters(ROPE, parse(ROPE, ["friction[0]", "friction:inner"]))
    assert both.labels == ("friction[0]", "friction:inner")
    x = both.start + np.array([0.0, 0.5])
    np.testing.assert_allclose(both.rope(x).friction, [FRICTION, *[both.values(x)[1]] * (N - 1)])
    refuses("there is one link", parse, Rope(length=[1.0], mass=0.1), ["friction:inner"])
    refuses("the same thing twice", parse, ROPE, ["friction[1]", "friction:inner"])


@pytest.mark.nightly
@pytest.mark.parametrize("stiffness", [2e-3, 1e-2])
def test_an_elastic_rope_on_a_hinge(stiffness):
    """Told was "use more links", or that masses change: `stiffness:shared` puts a spring into the hinge, too."""
    rope = ROPE.replace(stiffness=np.r_[0.0, np.full(N - 1, stiffness)])
    recording = recorded(rope, 5)
    chosen = identify(recording, GUESS)
    assert chosen.settings["free"] == [*SHARED, "stiffness:inner"]
    assert chosen.grade == "usable for ratios"
    assert away(chosen, rope) < 3.0
    assert chosen.residual_rms_all < 1.05 * NOISE
    found = identify(recording, GUESS, SHARED)
    assert "'stiffness:inner'" in [each.values.get("name") for each in found.findings[:2]]


def test_a_spring_in_every_joint_is_one_value_of_all():
    rope = ROPE.replace(stiffness=2e-3)
    assert identify(recorded(rope, 5), GUESS).settings["free"] == [*SHARED, "stiffness:shared"]
