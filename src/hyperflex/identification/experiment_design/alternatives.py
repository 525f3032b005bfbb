"""Advice on measurements where no candidate motion can tell what is wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.errors import HyperflexError
from hyperflex.identification.experiment_design.experiments import Experiment
from hyperflex.identification.experiment_design.fisher_information import ExpectedInformation, expected_information
from hyperflex.identification.model.scale import common_factor
from hyperflex.model import Arm, Rope

WEIGHED = ("mass", "com", "tip_mass")  # what a pair of scales can tell
TORQUE_NOISE = (
    0.01  # of the torque that holds arm and rope out level, all mass at the tip: a motor torque that could be measured
)


@dataclass(frozen=True)
class DesignQuestion:
    """What was asked of ``design``."""

    rope: Rope
    want: tuple[str, ...]
    free: tuple[str, ...]
    arm: Arm | None
    noise: float


def advise_alternatives(asked: DesignQuestion, experiments: Sequence[Experiment], seen: ExpectedInformation) -> str:
    """Return in words why no candidate tells what is wanted, and what would.

    Parameters
    ----------
    asked : Asked
    experiments : sequence of Experiment
        Those that could be simulated.
    seen : Foresight
        What one of them tells.
    """
    lost = [name for name, (std, _) in seen.spreads(asked.want).items() if not np.isfinite(std)]
    names = ", ".join(lost) or ", ".join(asked.want)
    if not _common(seen):
        why = "it does not act in these motions, or acts just as others that are free"
        weighed = _weigh(asked, experiments) or "Free fewer parameters, or try motions in which they act differently."
        return f"No candidate can tell {names}: {why}. {weighed}"
    why = (
        "no known force or torque acts, and without one all masses, inertias and frictions are known to a common factor"
    )
    helps = (_weigh(asked, experiments), _torque(asked, experiments), _ratio(seen))
    return " ".join([f"No candidate can tell {names}: {why} only.", *(text for text in helps if text)])


def _common(seen: ExpectedInformation) -> bool:
    """Tell whether the common factor of all moments and frictions is among what is unknown."""
    return common_factor(seen.parameters, seen.information.x, seen.information.unknown) is not None


def _weigh(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return what weighing the links would help."""
    kept = tuple(word for word in asked.free if word.partition(":")[0].partition("[")[0] not in WEIGHED)
    own = [word for word in asked.want if word.partition("[")[0] in WEIGHED]
    if own:
        return f"Weigh it: a pair of scales, and a knife edge for com, tell {', '.join(own)} directly."
    if not kept or kept == asked.free:
        return ""
    found = _best(replace(asked, free=kept), experiments)
    return "" if not found else f"Weigh the links and leave {_without(asked.free, kept)} out of free: {found}."


def _torque(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return what a measured motor torque would help."""
    moved = [each for each in experiments if each.motion is not None and each.torque_noise is None]
    if asked.arm is None or not moved:
        return (
            "" if asked.arm is not None else "Or swing it by a motor whose torque is measured (arm=..., torque_noise)."
        )
    reach = asked.arm.length + asked.rope.total_length
    noise = float(f"{TORQUE_NOISE * asked.rope.total_mass * float(np.hypot(*asked.rope.gravity)) * reach:.1g}")
    found = _best(asked, [replace(each, torque_noise=noise) for each in moved])
    return "" if not found else f"Or measure the motor's torque, say to {noise:g} N m: {found}."


def _ratio(seen: ExpectedInformation) -> str:
    """Return which ratios are known anyway."""
    known = [name for name in ("J/p1", "p/p1", "c/p1") if _tells(seen, name)]
    return f"Known without it are the ratios over the first moment, want={known!r}." if known else ""


def _tells(seen: ExpectedInformation, name: str) -> bool:
    spreads = seen.spreads([name])
    return bool(spreads) and all(np.isfinite(std) for std, _ in spreads.values())


def _best(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return which experiment then tells what is wanted, and how well; empty if none does."""
    scores: dict[str, float] = {}
    for experiment in experiments:
        try:
            spreads = expected_information(asked.rope, experiment, asked.free, asked.arm, asked.noise).spreads(
                asked.want
            )
        except HyperflexError:
            continue
        scores[experiment.name] = max(part for _, part in spreads.values())
    name = min(scores, key=lambda each: scores[each], default="")
    if not name or not np.isfinite(scores[name]):
        return ""
    return f"then {name} tells {', '.join(asked.want)} to {100.0 * scores[name]:.3g} %"


def _without(free: Sequence[str], kept: Sequence[str]) -> str:
    return " and ".join(word for word in free if word not in kept)
