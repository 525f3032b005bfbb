from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

import hyperflex as hf
from tests.browser import NAMES, Browser, found


@pytest.fixture(scope="session")
def short_cast() -> hf.Trajectory:
    """A coarse rope, cast for a second and a half."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, friction=1e-3)
    times = np.linspace(0.0, 1.5, 301)
    return hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.1), duration=1.5, t_eval=times)


@pytest.fixture(scope="session")
def hanging() -> hf.Trajectory:
    """A rope that swings from a fixed point, without an arm."""
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=4, friction=1e-3)
    return hf.simulate(rope, duration=0.5, q0=[0.4, 0.4, 0.4, 0.4])


@pytest.fixture(scope="session")
def browser(pytestconfig: pytest.Config) -> Iterator[Browser]:
    """A browser without a window; without one the test skips, or fails under --require-data and in CI."""
    program = found()
    if program is None:
        reason = f"no browser found ({', '.join(NAMES)}): on Debian, apt-get install chromium"
        if pytestconfig.getoption("--require-data") or os.environ.get("CI"):
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
    page = Browser(program)
    yield page
    page.close()
