"""Cast: wind the rope round a target that is sampled in each episode."""

from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array, ByName, Flags, Indices
from hyperflex.envs.vector import RopeEnv, RopeVectorEnv
from hyperflex.envs.worlds import PegWorld
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg
from hyperflex.planning import Problem, WindCriteria, check_feasibility
from hyperflex.trajectory import swept

DRAWS = 100  # targets at most, until one is in reach


class CastVectorEnv(RopeVectorEnv):
    """:class:`CastEnv` for several members, one after the other; the arguments are the same.

    `num_envs` is the number of members; `target`, if given, is the target of each episode.
    """

    world_class, n_links, extra = PegWorld, 40, 3

    def __init__(self, num_envs: int = 1, *, target: Peg | None = None, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        self.target = None if target is None else checks.instance("target", target, Peg)
        self._turns, self._wound = np.zeros(self.num_envs), np.zeros(self.num_envs)

    def _target(self, rng: np.random.Generator) -> Peg:
        """Return the target, or a peg of 50 mm to either side that the planner's feasibility check calls in reach."""
        if self.target is not None:
            return self.target
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

    def _extra(self) -> Array:
        """Return the targets: x and y from the shaft, and radius, m."""
        x, y = self.arm.pivot
        return np.array([(peg.x - x, peg.y - y, peg.radius) for peg in self.pegs])

    def _about(self, places: Array) -> Array:
        """Return the turns about the targets from the first joint to the tip (M,)."""
        centres = np.array([(peg.x, peg.y) for peg in self.pegs])
        return np.asarray(np.nan_to_num(swept(places - centres[:, None]).sum(axis=1)) / (2.0 * np.pi))

    def _start(self, which: Indices, places: Array) -> None:
        self._turns[which], self._wound[which] = self._about(places)[which], 0.0

    def _score(self, places: Array) -> tuple[Array, Flags]:
        part = [np.minimum(np.abs(turns) / WindCriteria.turns, 1.0) for turns in (self._turns, self._about(places))]
        self._turns = self._about(places)
        self._wound = np.where(part[1] < 1.0, 0.0, self._wound + self.dt)
        return part[1] - part[0] + self._held, self._held

    def _values(self) -> ByName:
        return {"turns": self._turns, "is_success": self._held}

    @property
    def _held(self) -> Flags:
        """Whether members have been wound for 1 s (M,)."""
        return self._wound > 1.0 - 0.5 * self.dt


class CastEnv(RopeEnv):
    """A cast: wind a rope round a peg so that it holds there.

    ## Description

    A rope of 2 m, 40 links in the plane, hangs from an arm of 105 mm that a motor turns. Somewhere to the side is a peg
    of 50 mm radius. The arm must swing the rope so that it strikes the peg and winds round it; friction then holds it.
    Registered as ``hyperflex/Cast-v0``, with episodes of 15 s (750 steps).

    ## Action Space

    As of :class:`SwingEnv`: accelerations of the arm, or with ``action="timing"`` starts of half turns.

    ## Observation Space

    As of :class:`SwingEnv`, for 40 links; after that x and y of the peg's centre from the shaft, and its radius, m. So
    (126,) with ``observation="state"``, (26,) with ``observation="markers"``.

    ## Rewards

    What the step added to the turns about the peg, from the arm's tip to the rope's end and counted up to 1.25 in
    either sense, as a part of these 1.25 turns; and 1 when the cast succeeds. So a success returns about 1.8: at the
    start, seen from the peg, the rope takes part of a turn already.

    ## Starting State

    As of :class:`SwingEnv`. The peg is drawn: to the left or to the right, 0.6 to 1.1 m to the side and as far below
    the shaft (uniform; 0.3 to 0.55 of the rope's length, if you give another rope), again and again until
    :func:`hyperflex.planning.check_feasibility` calls it in reach. Its friction coefficient is 0.3.

    ## Episode End

    Terminated when the rope has turned 1.25 times about the peg for 1 s (``info["is_success"]``). Truncated after 750
    steps. Terminated, without a reward, also where the run cannot be simulated (``info["failed"]``). ``info["turns"]``
    are the turns, positive counterclockwise.

    ## Arguments

    Those of :class:`SwingEnv`, and `target`, a :class:`hyperflex.Peg` that is the same in each episode:
    ``gymnasium.make("hyperflex/Cast-v0", target=hf.Peg(0.9, -0.8, 0.05))``.

    The rope's links are not cut finer at the peg, and it passes through itself and the arm: what winds here may fail
    the checks of :func:`hyperflex.plan_cast`.

    ## Version history

    - v0: initial version.
    """

    vector_class = CastVectorEnv
