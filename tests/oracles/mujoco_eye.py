"""MuJoCo's renderer (OpenGL through EGL) as an independent eye: a rope of capsules before a wall, lit by lamps.

Nothing of `hyperflex.vision` draws: pinhole, perspective, shading, shine and shadows are MuJoCo's. The exposure is the
mean of pictures at instants within it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hyperflex.vision import Camera, RopeMotion, Scene
from tests.reference.dense import Real

NEAR = 0.9  # m from the swing plane to the wall behind it


@dataclass(frozen=True)
class Look:
    """What rope and wall look like: colours blue, green, red, 0 to 255."""

    rope: tuple[float, float, float] = (40.0, 40.0, 40.0)
    radius: float = 0.004  # m
    shine: float = 0.3  # 0 to 1
    wall: tuple[float, float, float] = (190.0, 185.0, 180.0)
    grain: float = 0.0  # levels, standard deviation of the wall's texture
    shadow: bool = True
    noise: float = 2.0  # levels


class Eye:
    """Takes pictures of ropes with some number of capsules.

    Parameters
    ----------
    size : (int, int)
        px.
    focal, distance : float
        px, and m from the camera to the swing plane (z = 0), which it faces; the origin is seen at `origin`, px.
    count : int
        Capsules.
    """

    def __init__(
        self, size: tuple[int, int], focal: float, distance: float, origin: Real, count: int, look: Look, seed: int = 0
    ) -> None:
        from mujoco.egl import GLContext

        width, height = size
        middle = 0.5 * (np.array(size) - 1.0)
        x, y = (middle - origin) * [1.0, -1.0] * distance / focal  # of the camera, m
        fovy = 2.0 * np.degrees(np.arctan(0.5 * height / focal))
        self._rng = np.random.default_rng(seed)
        rgb = " ".join(f"{value / 255.0:.4f}" for value in look.rope[::-1])
        capsules = "".join(
            f'<body mocap="true" name="b{k}"><geom type="capsule" size="{look.radius} .01" material="rope"/></body>'
            for k in range(count)
        )
        self.model = mujoco.MjModel.from_xml_string(f"""
<mujoco><visual><global offwidth="{width}" offheight="{height}"/><quality shadowsize="4096" offsamples="8"/>
<headlight ambient=".35 .35 .35" diffuse=".2 .2 .2" specular="0 0 0"/></visual>
<asset><texture name="wall" type="2d" builtin="flat" rgb1="1 1 1" width="512" height="512"/>
<material name="wall" texture="wall" specular="0" shininess="0"/>
<material name="rope" rgba="{rgb} 1" specular="{look.shine}" shininess=".6"/></asset>
<worldbody><light pos="-1.5 2.5 4" dir=".25 -.5 -1" diffuse=".6 .6 .6" specular=".7 .7 .7"
castshadow="{str(look.shadow).lower()}"
cutoff="80" exponent="0"/>
<camera name="eye" pos="{x} {y} {distance}" fovy="{fovy}"/>
<geom type="box" size="6 6 .01" pos="0 0 {-NEAR}" material="wall"/>{capsules}</worldbody></mujoco>""")
        grain = np.zeros((512, 512, 3))
        for side in (8, 32, 128, 512):
            part = np.repeat(np.repeat(self._rng.standard_normal((side, side, 1)), 512 // side, 0), 512 // side, 1)
            grain += look.grain * part / 2.0
        texture = np.clip(np.array(look.wall[::-1]) + grain, 0, 255).astype(np.uint8)
        self.model.tex_data[: texture.size] = texture.ravel()
        self.data = mujoco.MjData(self.model)
        self._size, self._noise = size, look.noise
        self._context = GLContext(width, height)
        self._context.make_current()
        self._scene, self._camera = mujoco.MjvScene(self.model, 2000), mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = look.shadow
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._gpu = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gpu)

    def picture(self, instants: Real, gain: float | Real = 1.0) -> Any:
        """Return the picture (height, width, 3), blue, green, red, of joints (S, n + 1, 2), m, at instants exposed."""
        width, height = self._size
        total = np.zeros((height, width, 3))
        for joints in instants:
            self._put(joints)
            shown = np.empty((height, width, 3), np.uint8)
            mujoco.mjr_render(mujoco.MjrRect(0, 0, width, height), self._scene, self._gpu)
            mujoco.mjr_readPixels(shown, None, mujoco.MjrRect(0, 0, width, height), self._gpu)
            total += shown[::-1, :, ::-1]
        levels = gain * total / len(instants) + self._noise * self._rng.standard_normal(total.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def _put(self, joints: Real) -> None:
        ends = np.pad(joints, ((0, 0), (0, 1)))
        along = np.diff(ends, axis=0)
        self.data.mocap_pos[:] = 0.5 * (ends[1:] + ends[:-1])
        angle = np.arctan2(
            along[:, 0], along[:, 1]
        )  # capsules lie along z: to x, y by a turn about an axis in the plane
        self.data.mocap_quat[:] = np.sqrt(0.5) * np.stack(
            [np.ones_like(angle), -np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1
        )
        self.model.geom_size[1:, 1] = 0.5 * np.linalg.norm(along, axis=1)
        mujoco.mj_forward(self.model, self.data)
        option, kinds = mujoco.MjvOption(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self.model, self.data, option, None, self._camera, kinds, self._scene)

    def close(self) -> None:
        """Free the context."""
        self._gpu.free()
        self._context.free()


def film(camera: Camera, motion: RopeMotion, scene: Scene, stamps: Iterable[float], count: int = 60) -> Iterator[Any]:
    """Yield pictures of a plain rope by MuJoCo, of what camera and scene say: a capsule for each of `count` parts.

    Between two of the instants that make up an exposure, the rope moves by 1.5 px at most.
    """
    look = Look(
        tuple(np.asarray(scene.rope_colour)), 0.5 * scene.rope_width, float(scene.shine > 0.0),
        tuple(np.asarray(scene.background)), scene.wall_texture, scene.shadow[2] > 0.0, scene.noise,
    )  # fmt: skip
    focal, away, origin = camera.matrix[0, 0], camera.axes[1][2], camera.project([[0.0, 0.0]])[0]
    eye = Eye(camera.image_size, float(focal), float(away), origin, count, look, scene.seed)
    arcs = np.linspace(0.0, motion.joint_arc_lengths[-1], count + 1)
    for stamp in stamps:
        before, after = motion.places(stamp + camera.exposure * np.array([-0.5, 0.5]), arcs)
        moved = float(np.linalg.norm(after - before, axis=1).max()) * camera.pixels_per_metre
        parts = max(2, int(np.ceil(moved / 1.5)))
        times = stamp + camera.exposure * ((np.arange(parts) + 0.5) / parts - 0.5)
        yield eye.picture(motion.places(times, arcs)[:, :, :2], scene.light(stamp))
    eye.close()
