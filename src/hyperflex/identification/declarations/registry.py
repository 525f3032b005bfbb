"""All tests of declarations. To add one, write its object in a file of its own, and list it here.

Its kind of finding goes to findings.py, and its text to texts.py.
"""

from hyperflex.identification.declarations import angles, clock, drive, resistances, rope
from hyperflex.identification.declarations.held import HeldQuantity
from hyperflex.identification.model import Plant
from hyperflex.model import RESISTANCES

LAWS = tuple(each.name for each in RESISTANCES)
# Tested by freeing them to first order (score tests)
HELD: tuple[HeldQuantity, ...] = (
    angles.ZERO,
    clock.CLOCK,
    angles.ANGLE_SCALE,
    drive.DELAY,
    drive.ARM_INERTIA,
    drive.ARM_FRICTION,
    resistances.RESISTANCE,
    rope.HELD,
    rope.MASS_TAPER,
    rope.REST_BEND,
    resistances.UNEVEN,
    rope.MARKER_PLACES,
    rope.LENGTH,
)
NAMED = {each.name: each for each in (*HELD, clock.CLOCK_DRIFT) if each.name}


def words_for_tests(plant: Plant, *, angles: bool) -> list[list[str]]:
    """Return words for what is held, those that are tested in one linearisation together."""
    together = [word for each in HELD if not each.apart for word in each.words(plant, angles)]
    return [together, *(words for each in HELD if each.apart and (words := each.words(plant, angles)))]


def quantity(name: str) -> HeldQuantity:
    """Return what a test of this name is about."""
    if name in NAMED:
        return NAMED[name]
    if resistances.is_uneven(name):
        return resistances.UNEVEN
    return resistances.RESISTANCE if name.partition(":")[0] in LAWS else rope.HELD
