"""What is drawn at the start of an episode: the true rope, how it hangs, and the target of a cast."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import CastSetup, MotorLimits, Uncertainty, scaled_rope

ROPE = ("length", "mass", "friction")  # factors that a mismatch and a randomization name
SWAY = 0.1  # rad, by which a rope may hang to either side at the start
NEAR, FAR, BELOW = (0.6, 1.1), (-1.1, -0.6), 0.05  # m: |x| and y of targets, their radius


def default_rope(n_links: int) -> Rope:
    """Return the paper's cable, 2 m and 125 g, with the same friction of the whole rope for any number of links."""
    return Rope.uniform(length=2.0, mass=0.125, n_links=n_links, radius=0.0025, friction=1e-5 * n_links)


class Drawing:
    """How the start of an episode is drawn.

    Parameters
    ----------
    rope, arm, limits : Rope, Arm, MotorLimits
        The model, which a scripted policy knows.
    mismatch : mapping of str to float
        Factors of the true rope's ``length``, ``mass`` and ``friction``, the same in each episode.
    randomization : mapping of str to float
        Relative standard deviations of the same names, and of a peg's ``mu``, drawn in each episode as
        :class:`hyperflex.Uncertainty` draws them.

    Raises
    ------
    InvalidInput
        If a name or a number cannot be used.
    """

    def __init__(
        self,
        rope: Rope,
        arm: Arm,
        limits: MotorLimits,
        mismatch: Mapping[str, float],
        randomization: Mapping[str, float],
    ) -> None:
        checks.keys("mismatch", checks.mapping("mismatch", mismatch), ROPE)
        checks.keys("randomization", checks.mapping("randomization", randomization), (*ROPE, "mu"))
        factors = [checks.number(f"mismatch {name}", mismatch.get(name, 1.0), sign="positive") for name in ROPE]
        self.arm, self.true = arm, scaled_rope(rope, *factors)
        self._cast = CastSetup(self.true, arm, limits) if randomization else None
        spreads: dict[str, Any] = {**dict.fromkeys((*ROPE, "mu", "lag", "timing"), 0.0), **randomization}
        self._uncertainty = Uncertainty(**spreads)

    def angles(self, rng: np.random.Generator) -> Array:
        """Return the angles (n,), rad, of a rope that hangs straight, up to SWAY from the vertical."""
        return np.full(self.true.n_links, self.true.hanging_angle + rng.uniform(-SWAY, SWAY))

    def target(self, rng: np.random.Generator) -> Peg:
        """Return a peg to either side of the arm."""
        side = 1.0 if rng.random() < 0.5 else -1.0
        return Peg(self.arm.pivot[0] + side * rng.uniform(*NEAR), self.arm.pivot[1] + rng.uniform(*FAR), BELOW)

    def scenario(self, rng: np.random.Generator, peg: Peg) -> tuple[Rope, Peg]:
        """Return the true rope of an episode, and the peg with its true friction."""
        if self._cast is None:
            return self.true, peg
        drawn = self._uncertainty.sample(1, self._cast, peg, seed=int(rng.integers(2**31)))[0]
        return drawn.rope, drawn.peg
