"""One link on a driven arm: what no motion of it tells is neither tested nor spoken of."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.identification import FitOptions, Kind, RecordingSetup
from hyperflex.identification.pipeline import first_choice

MOTION, ARM = hf.arm_swings(0.7, 0.4, "minimum-jerk"), hf.Arm(length=0.1)
TRUE = hf.Rope(length=[0.3], mass=[0.1], com=[0.2], inertia=[8e-4], friction=[3e-4])


@pytest.mark.parametrize("noise", [0.0, 2e-3])
@pytest.mark.parametrize("free", [None, ["inertia", "friction"]])
@pytest.mark.parametrize("motion", [MOTION, hf.hold_arm(0.0)])
def test_one_link_on_a_driven_arm(noise, free, motion):
    """The length of the only link moves nothing once its inertia is free, and no length on an arm at rest."""
    t = np.arange(300) / 50.0
    run = hf.simulate(TRUE, motion, arm=ARM, duration=float(t[-1]), t_eval=t, tol=1e-10, q0=[0.8])
    q = run.q + noise * np.random.default_rng(0).standard_normal(run.q.shape)
    recording = hf.Recording(t, q, noise=noise or None)
    guess = TRUE.replace(inertia=1.3 * TRUE.inertia, friction=1e-3)
    found = hf.identify(recording, guess, free, setup=RecordingSetup(motion=motion, arm=ARM))
    assert found.success
    assert not [each for each in found.findings if each.kind is Kind.LENGTHS]
    assert found.rope.friction[0] / found.rope.mass[0] == pytest.approx(3e-3, rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_lengths_that_move_nothing_are_not_spoken_of(seed):
    """On an arm at rest com and friction absorb gravity and lengths: they seemed 390 % off, by rounding."""
    t, motion, true = np.arange(300) / 50.0, hf.hold_arm(0.5), hf.Rope(length=[0.3], mass=[0.1], friction=[3e-4])
    run = hf.simulate(true, motion, arm=ARM, duration=float(t[-1]), t_eval=t, tol=1e-10, q0=[0.8])
    q = run.q + 2e-3 * np.random.default_rng(seed).standard_normal(run.q.shape)
    setup, options = RecordingSetup(motion=motion, arm=ARM), FitOptions(intervals=None, train=np.inf)
    guess = true.replace(friction=1e-3)
    found = hf.identify(hf.Recording(t, q), guess, ["com", "friction"], setup=setup, options=options)
    assert not found.has(Kind.LENGTHS)


def test_a_torque_frees_the_masses_of_few_links_and_of_many():
    for rope, words in (
        (hf.Rope.uniform(1.0, 0.1, 3, friction=1e-4), ["mass", "inertia", "friction"]),
        (hf.Rope.uniform(1.0, 0.1, 8, friction=1e-4), ["mass:shared", "inertia:shared", "friction:shared"]),
    ):
        assert first_choice(rope, torque=True) == words
        assert first_choice(rope) == words[1:]
