import numpy as np
import pytest

import hyperflex as hf


@pytest.fixture(scope="session")
def short_cast() -> hf.Trajectory:
    """A coarse rope, cast for a second and a half."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, friction=1e-3)
    times = np.linspace(0.0, 1.5, 301)
    return hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=1.5, t_eval=times)
