"""Control of a cast: so far the pseudo-energy that tells how far the rope has been pumped up."""

from hyperflex.control.pseudo_energy import (
    PhasePortrait,
    Spiral,
    driving_constant,
    phase_portrait,
    pseudo_energy,
    spiral,
)

__all__ = ["PhasePortrait", "Spiral", "driving_constant", "phase_portrait", "pseudo_energy", "spiral"]
