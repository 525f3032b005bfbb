"""One link on a driven arm: quantities that its motion does not determine are neither tested nor reported."""

import warnings

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.identification import Kind, RecordingSetup
from hyperflex.identification.declarations.held import SCALES
from hyperflex.identification.declarations.score_tests import ScoreTest, determined
from hyperflex.identification.model import scales as parameter_scales
from hyperflex.identification.pipeline import first_choice
from hyperflex.identification.symptoms import score_findings
from tests.identification.twins import QUICK, WHOLE_QUICK, recorded

MOTION, ARM = hf.arm_swings(0.7, 0.4, "minimum-jerk"), hf.Arm(length=0.1)
TRUE = hf.Rope(length=[0.3], mass=[0.1], com=[0.2], inertia=[8e-4], friction=[3e-4])


@pytest.mark.parametrize("noise", [0.0, 2e-3])
@pytest.mark.parametrize("free", [None, ["inertia", "friction"]])
@pytest.mark.parametrize("motion", [MOTION, hf.hold_arm(0.0)])
def test_one_link_on_a_driven_arm(noise, free, motion):
    """The length of the only link moves nothing once its inertia is free, and no length on an arm at rest."""
    t = np.arange(300) / 50.0
    recording = recorded(TRUE, [0.8], t, noise, declared=noise or None, motion=motion, arm=ARM, tol=1e-10)
    guess = TRUE.replace(inertia=1.3 * TRUE.inertia, friction=1e-3)
    found = hf.identify(recording, guess, free, setup=RecordingSetup(motion=motion, arm=ARM))
    assert found.success
    assert not [each for each in found.findings if each.kind is Kind.LENGTHS]
    assert found.rope.friction[0] / found.rope.mass[0] == pytest.approx(3e-3, rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_lengths_that_move_nothing_are_not_spoken_of(seed):
    """On an arm at rest com and friction absorb gravity and lengths: they seemed 390 % off, by rounding."""
    t, motion, true = np.arange(300) / 50.0, hf.hold_arm(0.5), hf.Rope(length=[0.3], mass=[0.1], friction=[3e-4])
    recording = recorded(true, [0.8], t, 2e-3, seed, motion=motion, arm=ARM, tol=1e-10)
    setup, options = RecordingSetup(motion=motion, arm=ARM), WHOLE_QUICK
    guess = true.replace(friction=1e-3)
    found = hf.identify(recording, guess, ["com", "friction"], setup=setup, options=options)
    assert not found.has(Kind.LENGTHS)


def test_a_torque_frees_the_masses_of_few_links_and_of_many():
    for rope, words in (
        (hf.Rope.uniform(1.0, 0.1, 3, friction=1e-4), ["mass", "inertia", "friction"]),
        (hf.Rope.uniform(1.0, 0.1, 8, friction=1e-4), ["mass:shared", "inertia:shared", "friction:shared"]),
    ):
        assert first_choice(rope, torque=True) == words
        assert first_choice(rope) == words[1:]


@pytest.mark.parametrize(
    "known",
    [
        np.zeros((2, 2)),  # nothing moves
        np.diag([1e6, 0.0]),  # one of the two does not act
        1e9 * np.ones((2, 2)),  # both have the same effect
        np.array([[1.0, 1.0 - 1e-12], [1.0 - 1e-12, 1.0]]),  # but for rounding
        np.full((2, 2), np.inf),  # no noise
        np.full((2, 2), np.nan),
    ],
)
def test_information_that_is_singular_says_nothing_of_lengths(known):
    assert not determined(known)
    scales = ScoreTest(SCALES, 0.9, np.array([2.0, 2.0, 2.0]), information=np.pad(known, (0, 1)))
    assert score_findings([scales], odd=False, known=True, wrong=False) == []


def test_information_that_determines_lengths_tells_them():
    scales = ScoreTest(SCALES, 0.9, np.array([1.1, 1.0, 1.0]), information=np.diag([1e6, 1e6, 1e6]))
    (found,) = score_findings([scales], odd=False, known=True, wrong=False)
    assert (found.kind, found.values["off"]) == (Kind.LENGTHS, pytest.approx(np.log(1.1)))


def test_two_links_always_in_line_are_no_crash_and_ask_nothing_of_the_user():
    """A rod divided in two: its parts have the same effect, and a free length may diverge; intermediate ropes are
    internal."""
    rod = hf.Rope([0.3], [0.1], friction=[3e-4])
    t = np.arange(150) / 50.0
    run = hf.simulate(rod, duration=float(t[-1]), t_eval=t, q0=[0.8])
    q = run.q + 2e-3 * np.random.default_rng(0).standard_normal((t.size, 1))
    guess = hf.Rope([0.15, 0.15], [0.05, 0.05], friction=3e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = hf.identify(hf.Recording(t, np.column_stack([q, q])), guess, ["length", "friction"], options=QUICK)
    assert not found.has(Kind.LENGTHS)
    basis = found._basis
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as "rope length is 164 m: is it meant in mm?"
        far = basis.plant.parameters.rope(basis.fit.x + 7.0)
    assert far.total_length > 100.0


def test_a_friction_that_starts_from_zero_has_a_scale_where_the_mass_is_at_the_joint():
    rope = TRUE.replace(com=[0.0], inertia=[1e-6], friction=[0.0])
    for name in ("friction", "dry_friction", "stiffness"):
        assert (parameter_scales(rope, name, np.zeros(1)) > 0.0).all()
