"""Arguments of a run: a set-up or its parts, and output times."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex import checks, memory
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope, Setup

SAMPLE_TIME = 0.01  # s, between outputs if the user does not choose
# Numbers for each link and output, without contact and with it: in memory while a run is written, and in its file
IN_MEMORY, IN_FILE = (11, 15), (5.5, 7.5)
MOST_OUTPUTS = 1e7  # of a run whose user has not chosen; more of them would fill the memory first


def whole_setup(rope: object, given: dict[str, Any], allowed: str) -> Setup:
    """Return the set-up that was given in place of a rope and stands for all arguments.

    `given` has by name what may not be given beside it, None where it was not, and `allowed` says what may.
    """
    if not isinstance(rope, Setup):
        raise InvalidInput("rope is not a rope", got=rope, allowed="a Rope or a whole Setup")
    if names := list(chosen(given)):
        fix = "Put them into the set-up: dataclasses.replace(setup, ...)"
        raise InvalidInput("arguments beside a whole set-up", got=names, allowed=allowed, fix=fix)
    return rope


def chosen(given: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments that are not None."""
    return {name: value for name, value in given.items() if value is not None}


def setup_of(rope: Rope | Setup, duration: float | None, allowed: str, **given: Any) -> Setup:
    """Return the set-up of what is given, a whole one or its parts; `allowed` as in :func:`whole_setup`."""
    if isinstance(rope, Rope):
        return Setup(rope, duration=needed(duration), **chosen(given))
    setup = whole_setup(rope, given, allowed)
    return setup if duration is None else replace(setup, duration=duration)


def needed(duration: float | None) -> float:
    """Return a duration, s, which must be given."""
    if duration is None:
        raise InvalidInput("duration is missing", allowed="a number > 0, in s", fix="Give duration=10.0, say")
    return duration


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
