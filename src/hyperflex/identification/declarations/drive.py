"""The drive: the delay of its motion, and the arm's own inertia and friction."""

from hyperflex.identification.declarations.held import HeldQuantity, free_names
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import Plant


def _delay(plant: Plant, angles: bool) -> list[str]:
    return ["delay"] if plant.motion is not None and "delay" not in free_names(plant) else []


def _arm(word: str, kind: Kind) -> HeldQuantity:
    def words(plant: Plant, angles: bool) -> list[str]:
        return [word] if plant.motor is not None and word not in free_names(plant) else []

    return HeldQuantity(kind, words, lambda name, values: {"value": float(values[0])}, word, reported=True)


DELAY = HeldQuantity(
    Kind.DELAY, _delay, lambda name, values: {"delay": float(values[0])}, "delay", declared=True, reported=True
)
ARM_INERTIA, ARM_FRICTION = _arm("arm_inertia", Kind.ARM_INERTIA), _arm("arm_friction", Kind.ARM_FRICTION)
