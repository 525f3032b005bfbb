"""Hard looks for the synthetic camera: textures, shine, shadow, bars, steps of an automatic exposure, and blackouts."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex.checks import Array, Flags
from hyperflex.core.image.exposure import Capsules, RowTimes
from hyperflex.vision import Occluder, Renderer, Scene
from hyperflex.vision.renderer.renderer import Colour, Layer

LIGHT = (-0.6, -0.8)  # direction to the light in the picture, right and down
HIGHLIGHT = 0.4  # width of the highlight over the rope's; its middle is at most half of the rope's radius aside


class Bar(NamedTuple):
    """A straight bar along the rope, as the links of a pendulum are.

    Attributes
    ----------
    start, end : float
        Arc lengths of its ends, m.
    width : float
        m; its ends are round.
    colour : (float, float, float)
        Blue, green, red, 0 to 255.
    """

    start: float
    end: float
    width: float
    colour: Colour


@dataclass(frozen=True, eq=False)
class HardScene(Scene):
    """A scene that is harder to see.

    Parameters
    ----------
    rope_texture : float
        Relative standard deviation of the brightness of pieces of the rope, each twice as long as the rope is wide.
    shine : float
        Brightness of a highlight along the rope, levels, like that of a wire: on the side of the light, which comes
        from the upper left, and weaker where the rope points towards it.
    shadow : (float, float, float)
        Of the rope on the wall: how far to the right and up, m, and the share of the light that is missing in it.
    bars : tuple of Bar
        Drawn over the rope and below the markers.
    wall_texture : float
        Standard deviation of the wall's grain, levels, in sizes from a pixel to a sixteenth of the picture.
    exposure_steps : tuple of (float, float)
        Of an automatic exposure: from which time on, s, the picture is by which factor brighter.
    blackouts : tuple of (float, float)
        From when to when nothing of the rope is seen, s.
    """

    rope_texture: float = 0.0
    shine: float = 0.0
    shadow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bars: tuple[Bar, ...] = ()
    wall_texture: float = 0.0
    exposure_steps: tuple[tuple[float, float], ...] = ()
    blackouts: tuple[tuple[float, float], ...] = ()

    def bare_wall(self, rng: np.random.Generator, shape: tuple[int, int]) -> Array:
        """Return the wall with its grain."""
        wall = super().bare_wall(rng, shape)
        return wall + self.wall_texture * _grain(rng, shape) if self.wall_texture else wall

    def light(self, t: float) -> Array:
        """Return the factor (3,) of each channel at a time, s."""
        step = next((factor for since, factor in self.exposure_steps[::-1] if since <= t), 1.0)
        return step * super().light(t)

    def is_black(self, t: float) -> bool:
        """Whether nothing of the rope is seen at a time, s."""
        return any(start <= t < end for start, end in self.blackouts)

    def covered(self, t: float) -> Flags:
        """Return which markers (K,) are covered at a time, s."""
        return super().covered(t) | self.is_black(t)


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Return noise (*shape, 3) of standard deviation 1, in sizes that double; colours vary by a third."""
    import cv2

    sizes = 2.0 ** np.arange(int(np.log2(min(shape) / 16)) + 1)
    total = np.zeros((*shape, 3))
    for size in sizes.tolist():
        coarse = tuple(int(np.ceil(side / size)) for side in shape)
        part = rng.standard_normal((*coarse, 1)) + rng.standard_normal((*coarse, 3)) / 3.0
        total += cv2.resize(part, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(total / total.std())


class _Highlight(Layer):
    """The highlight along the rope."""


class HardRenderer(Renderer):
    """The synthetic camera before a :class:`HardScene`."""

    scene: HardScene

    def behind(self, stamp: float) -> npt.NDArray[np.float32]:
        """Return the wall with the rope's shadow."""
        levels = super().behind(stamp)
        *shift, dark = self.scene.shadow
        if dark and not self.scene.is_black(stamp):
            for part, shade in self.exposures(stamp, self.rope()[:1], shift=shift):
                levels[part] *= 1.0 - np.float32(dark) * shade[:, :, 3:]
        return levels

    def rope(self) -> list[Layer]:
        """Return the rope, in pieces of different brightness, and the highlight along it."""
        scene, joints, layers = self.scene, self.motion.joint_arc_lengths, super().rope()
        if layers and scene.rope_texture:
            counts = np.ceil(np.diff(joints) / (2.0 * scene.rope_width)).astype(int)
            pieces = [
                np.linspace(start, end, count, endpoint=False)
                for start, end, count in zip(joints[:-1].tolist(), joints[1:].tolist(), counts.tolist(), strict=True)
            ]
            arcs = np.concatenate([*pieces, joints[-1:]])
            rng = np.random.default_rng((scene.seed, 3))
            brightness = 1.0 + scene.rope_texture * rng.standard_normal((len(arcs) - 1, 1))
            colours = np.clip(brightness * np.asarray(scene.rope_colour), 0.0, 255.0)
            layers = [Layer(np.stack([arcs[:-1], arcs[1:]], axis=1), layers[0].radius, colours)]
        if layers and scene.shine:
            links = np.stack([joints[:-1], joints[1:]], axis=1)
            layers.append(_Highlight(links, HIGHLIGHT * layers[0].radius, scene.rope_colour))
        return layers

    def layers(self, stamp: float) -> list[Layer]:
        """Return the drawn shapes from back to front: rope, bars, markers."""
        if self.scene.is_black(stamp):
            return []
        layers, count = super().layers(stamp), len(self.rope())
        bars = [Layer(np.array([[bar.start, bar.end]]), 0.5 * bar.width, bar.colour) for bar in self.scene.bars]
        return [*layers[:count], *bars, *layers[count:]]

    def capsules(
        self, stamp: float, layers: list[Layer], fronts: tuple[Occluder, ...], shift: ArrayLike
    ) -> tuple[Capsules, RowTimes]:
        """Return the shapes with the highlight on the side of the light, brighter where the rope is across it."""
        found, times = super().capsules(stamp, layers, fronts, shift)
        bright = np.concatenate([[False], *(np.full(len(each.arcs), isinstance(each, _Highlight)) for each in layers)])
        shown = np.flatnonzero(bright[1:])
        if shown.size:
            turned = 1 if self.camera.readout_direction in ("down", "up") else -1
            ends = found.ends.reshape(len(found.ends), -1, 2, 2)[..., ::turned]
            along = (ends[:, shown, 1] - ends[:, shown, 0]) @ np.array([1.0, 1.0j])
            normal = 1j * along / np.maximum(np.abs(along), 1e-9)
            facing = normal.real * LIGHT[0] + normal.imag * LIGHT[1]
            aside = 0.5 * found.radii[shown] / HIGHLIGHT * facing * normal
            ends[:, shown] += np.stack([aside.real, aside.imag], axis=-1)[:, :, None]
            brighter = self.scene.shine * facing[len(ends) // 2, :, None] ** 2
            found.colours[shown] = self.lit(np.minimum(np.asarray(self.scene.rope_colour) + brighter, 255.0))
        return found, times
