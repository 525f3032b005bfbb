import numpy as np
import pytest

import hyperflex as hf
from hyperflex.identification import Identification

NOISE = 2e-3  # rad
ROPE = hf.Rope(length=[0.17, 0.23], mass=[0.21, 0.16], com=[0.11, 0.09], inertia=[6e-4, 8e-4], friction=[1.2e-3, 5e-4])
GUESS = ROPE.replace(friction=1e-3)


@pytest.fixture(scope="session")
def short_cast() -> hf.Trajectory:
    """A coarse rope, cast for a second and a half."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, friction=1e-3)
    times = np.linspace(0.0, 1.5, 301)
    return hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=1.5, t_eval=times)


@pytest.fixture(scope="session")
def swing() -> tuple[hf.Recording, Identification]:
    """Angles of two links, of which the common factor cannot be known."""
    t = np.arange(500) * 0.02
    run = hf.simulate(ROPE, duration=t[-1], t_eval=t, q0=[0.6, 0.9])
    data = run.q + np.random.default_rng(1).normal(0.0, NOISE, run.q.shape)
    recording = hf.Recording(t, data, noise=NOISE, name="two <links>", source="simulated")
    return recording, hf.identify(recording, GUESS, ["inertia", "com", "friction"])
