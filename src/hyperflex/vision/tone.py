"""Tone curves of cameras: the light represented by the levels of a picture. Blur mixes light, not levels."""

import numpy as np

from hyperflex.checks import Array


def linear_tone() -> Array:
    """Return the light (256,), 0 to 255, of the levels 0 to 255 of a picture that are proportional to it."""
    return np.arange(256.0)


def light_per_level(light: Array, tone: Array) -> Array:
    """Return by how much light a level differs from the next where there is so much light (...)."""
    return np.interp(light, tone, np.gradient(tone))


def srgb_tone() -> Array:
    """Return the light (256,), 0 to 255, of the levels 0 to 255 of usual cameras' pictures (sRGB, IEC 61966-2-1).

    Read so, pictures by ITU-R BT.709 show a rope that covers a tenth of a pixel with 0.83 to 1.12 of its contrast.
    """
    level = linear_tone() / 255.0
    return 255.0 * np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
