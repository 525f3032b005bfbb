"""Arguments of a run: a set-up or its parts, and output times."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, memory
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope, Setup, checked_obstacles, cuts, refine_rope

Pieces = npt.NDArray[np.int64]
SAMPLE_TIME = 0.01  # s, between outputs if the user does not choose
# Numbers for each link and output, without contact and with it: in memory while a run is written, and in its file
IN_MEMORY, IN_FILE = (11, 15), (5.5, 7.5)
MOST_OUTPUTS = 1e7  # of a run whose user has not chosen; more of them would fill the memory first


def setup_of(rope: Rope | Setup, fields: Mapping[str, Any], *, refine: bool = False) -> tuple[Setup, Pieces | None]:
    """Return the set-up of a rope and of the fields that are not None; or a set-up with these fields replaced.

    With `refine` a rope is cut where its pegs need it; the second value is then the number of pieces of each link.
    """
    given = {name: value for name, value in fields.items() if value is not None}
    if isinstance(rope, Setup):
        return rope.replace(**given) if given else rope, None
    if not isinstance(rope, Rope):
        raise InvalidInput("rope is not a rope", got=rope, allowed="a Rope or a whole Setup")
    if "duration" not in given:
        raise InvalidInput("duration is missing", allowed="a number > 0, in s", fix="Give duration=10.0, say")
    names = [name for name in ("arm_angle0", "arm_rate0") if name in given]
    if names and "torque" not in given:
        fix = "A motion defines where the arm begins; without one the arm rests at 0"
        raise InvalidInput("no torque drives the arm that these begin", got=names, allowed="with torque=...", fix=fix)
    pieces, pegs = None, checked_obstacles(given.get("pegs", ()))
    if pegs and refine:
        arm = given.get("arm")
        pieces = cuts(rope, pegs, arm=arm)
        rope = refine_rope(rope, pegs, arm=arm)
        starts = {name: checks.array(name, given[name], None) for name in ("q0", "qd0") if name in given}
        given |= {name: per_piece(values, pieces) for name, values in starts.items()}
    return build(rope, given), pieces


def build(rope: Rope, given: Mapping[str, Any]) -> Setup:
    """Return a set-up of a rope; a name that is no field of a set-up is refused."""
    if not given.keys() <= Setup.__dataclass_fields__.keys():
        checks.keys("a set-up", given, Setup.__dataclass_fields__)
    return Setup(rope, **given)


def per_piece(values: Any, pieces: Pieces) -> Any:
    """Return values (n,) of links as values of the pieces that each link was cut into; others as they are."""
    return np.repeat(values, pieces) if np.shape(values) == pieces.shape else values


def check_memory(setup: Setup, samples: int) -> None:
    """Refuse a run whose result of so many samples would not fit into the memory."""
    links = setup.rope.n_links
    memory.check(
        8.0 * IN_MEMORY[setup.touches] * (links + 2) * samples,
        f"a run of {links} links with {samples} outputs",
        "Ask for fewer outputs (t_eval=[...]), a shorter duration or fewer links",
    )


def file_size(setup: Setup, duration: float) -> float:
    """Return about how large the file of a run is, bytes, that lasts `duration`, s, with the usual outputs."""
    return 8.0 * IN_FILE[setup.touches] * setup.rope.n_links * duration / SAMPLE_TIME


def output_times(t_eval: npt.ArrayLike | None, begin: float, end: float) -> Array:
    """Check the output times (T,) of a run from `begin` to `end`, s; by default every SAMPLE_TIME and the end."""
    if t_eval is None:
        count = (end - begin) / SAMPLE_TIME
        if count > MOST_OUTPUTS:
            raise InvalidInput(
                f"the run is so long that an output every {SAMPLE_TIME:g} s would make {count:.3g} of them",
                got=f"{end - begin:g} s",
                allowed=f"up to {MOST_OUTPUTS * SAMPLE_TIME:g} s without t_eval",
                fix="Say when you want to see it: t_eval=[...]",
            )
        return np.append(begin + SAMPLE_TIME * np.arange(math.ceil((end - begin) / SAMPLE_TIME - 1e-9)), end)
    t = checks.times("t_eval", t_eval)
    if t[0] < begin or t[-1] > end:
        raise InvalidInput("t_eval leaves the run", got=[float(t[0]), float(t[-1])], allowed=f"{begin:g} to {end:g} s")
    return t
