"""What is drawn at the start of an episode: the true rope, how it hangs, and the target of a cast."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import MotorLimits, Problem, Uncertainty, check_feasibility, scaled_rope

FACTORS = ("length", "mass", "friction")  # of the rope, that a mismatch and a randomization name
DRAWS = 100  # targets at most, until one is in reach


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
        checks.keys("mismatch", checks.mapping("mismatch", mismatch), FACTORS)
        checks.keys("randomization", checks.mapping("randomization", randomization), (*FACTORS, "mu"))
        factors = [checks.number(f"mismatch {name}", mismatch.get(name, 1.0), sign="positive") for name in FACTORS]
        self.model, self.arm, self.limits, self.true = rope, arm, limits, scaled_rope(rope, *factors)
        self._cast = Problem(self.true, arm, limits) if randomization else None
        spreads: dict[str, Any] = {**dict.fromkeys((*FACTORS, "mu", "lag", "timing"), 0.0), **randomization}
        self._uncertainty = Uncertainty(**spreads)

    def angles(self, rng: np.random.Generator) -> Array:
        """Return the angles (n,), rad, of a rope that hangs straight, up to 0.1 rad from the vertical."""
        return np.full(self.true.n_links, self.true.hanging_angle + rng.uniform(-0.1, 0.1))

    def target(self, rng: np.random.Generator) -> Peg:
        """Return a peg of 50 mm to either side of the arm that the planner's feasibility check calls in reach.

        It is 0.3 to 0.55 lengths of the rope to the side of the shaft, and as far below.

        Raises
        ------
        InvalidInput
            If none of DRAWS is in reach.
        """
        problem = Problem(self.model, self.arm, self.limits, side=-1)
        length, (x, y) = self.model.total_length, self.arm.pivot
        for _ in range(DRAWS):
            side = 1.0 if rng.random() < 0.5 else -1.0
            aside, up = length * rng.uniform(0.3, 0.55), length * rng.uniform(-0.55, -0.3)
            peg = Peg(x + side * aside, y + up, 0.05)
            found = check_feasibility(problem, peg)
            if found.feasible:
                return peg
        raise InvalidInput(
            f"no target can be drawn for this rope, arm and motor: of {DRAWS} none is in reach",
            got=found.message,
            allowed="a target in reach",
            fix="Give target=hyperflex.Peg(x, y, radius), or another rope, arm or limits",
        )

    def scenario(self, rng: np.random.Generator, peg: Peg) -> tuple[Rope, Peg]:
        """Return the true rope of an episode, and the peg with its true friction."""
        if self._cast is None:
            return self.true, peg
        drawn = self._uncertainty.sample(1, self._cast, peg, seed=int(rng.integers(2**31)))[0]
        return drawn.rope, drawn.peg
