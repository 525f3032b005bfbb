"""Control of a cast: pseudo-energy, the paper's timing rule, better rules, and the loop that they run in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperflex.lazy import loader

if TYPE_CHECKING:
    from hyperflex.control.caster import Caster, swing_period
    from hyperflex.control.closed_loop import Swung, swing
    from hyperflex.control.pseudo_energy import (
        PhasePortrait,
        Spiral,
        driving_constant,
        phase_portrait,
        pseudo_energy,
        spiral,
    )
    from hyperflex.control.pumping import Pump, Regulate
    from hyperflex.control.reach import reach_time
    from hyperflex.control.rests import PumpPlan, plan_pumping
    from hyperflex.control.state_source import SimulatedCamera, TrueState
    from hyperflex.control.timing import CrossingRule, Rule

__all__ = [
    "Caster",
    "CrossingRule",
    "PhasePortrait",
    "Pump",
    "PumpPlan",
    "Regulate",
    "Rule",
    "SimulatedCamera",
    "Spiral",
    "Swung",
    "TrueState",
    "driving_constant",
    "phase_portrait",
    "plan_pumping",
    "pseudo_energy",
    "reach_time",
    "spiral",
    "swing",
    "swing_period",
]

__getattr__ = loader(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
