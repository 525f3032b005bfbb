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
TORQUE_NOISE = 0.01  # part of the torque that holds arm and rope out level, all mass at the tip


@dataclass(frozen=True)
class DesignQuestion:
    """What was asked of :func:`design_experiment`."""

    rope: Rope
    want: tuple[str, ...]
    free: tuple[str, ...]
    arm: Arm | None
    noise: float


def advise_alternatives(asked: DesignQuestion, experiments: Sequence[Experiment], seen: ExpectedInformation) -> str:
    """Return in words why none of the simulated `experiments` tells what is wanted, and what would."""
    lost = [name for name, (std, _) in seen.spreads(asked.want).items() if not np.isfinite(std)]
    names = ", ".join(lost) or ", ".join(asked.want)
    if common_factor(seen.parameters, seen.information.x, seen.information.unknown) is None:
        why = "it does not act in these motions, or acts just as others that are free"
        weighed = _weigh(asked, experiments) or "Free fewer parameters, or try motions in which they act differently."
        return f"No candidate can tell {names}: {why}. {weighed}"
    why = "no known force or torque acts; all masses, inertias and frictions are known to a common factor only"
    known = [name for name in ("J/p1", "p/p1", "c/p1") if _tells(seen, name)]
    ratio = f"Known without it are the ratios over the first moment, want={known!r}." if known else ""
    helps = (_weigh(asked, experiments), _torque(asked, experiments), ratio)
    return " ".join([f"No candidate can tell {names}: {why}.", *(text for text in helps if text)])


def _weigh(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return how weighing the links would help."""
    kept = tuple(word for word in asked.free if word.partition(":")[0].partition("[")[0] not in WEIGHED)
    own = [word for word in asked.want if word.partition("[")[0] in WEIGHED]
    if own:
        return f"Weigh it: a pair of scales, and a knife edge for com, tell {', '.join(own)} directly."
    if not kept or kept == asked.free:
        return ""
    found = _best(replace(asked, free=kept), experiments)
    weighed = " and ".join(word for word in asked.free if word not in kept)
    return "" if not found else f"Weigh the links and leave {weighed} out of free: {found}."


def _torque(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return how a measured motor torque would help."""
    if asked.arm is None:
        return "Or swing it by a motor whose torque is measured (arm=..., torque_noise)."
    moved = [each for each in experiments if each.motion is not None and each.torque_noise is None]
    reach = asked.arm.length + asked.rope.total_length
    noise = float(f"{TORQUE_NOISE * asked.rope.total_mass * float(np.hypot(*asked.rope.gravity)) * reach:.1g}")
    found = _best(asked, [replace(each, torque_noise=noise) for each in moved])
    return "" if not found else f"Or measure the motor's torque, say to {noise:g} N m: {found}."


def _tells(seen: ExpectedInformation, name: str) -> bool:
    spreads = seen.spreads([name])
    return bool(spreads) and all(np.isfinite(std) for std, _ in spreads.values())


def _best(asked: DesignQuestion, experiments: Sequence[Experiment]) -> str:
    """Return which experiment then tells what is wanted, and how well; empty if none does."""
    scores: dict[str, float] = {}
    for experiment in experiments:
        try:
            expected = expected_information(asked.rope, experiment, asked.free, asked.arm, asked.noise)
            scores[experiment.name] = max(part for _, part in expected.spreads(asked.want).values())
        except HyperflexError:
            continue
    name = min(scores, key=lambda each: scores[each], default="")
    if not name or not np.isfinite(scores[name]):
        return ""
    return f"then {name} tells {', '.join(asked.want)} to {100.0 * scores[name]:.3g} %"
