"""Draw the pictures of the documentation into docs/images: ``python docs/draw.py``."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from docs.commands import commands, settings
from PIL import Image

import hyperflex as hf
from hyperflex.cli.app import run
from hyperflex.demo import twin
from hyperflex.paper import casting, estimation, identification
from hyperflex.report.identification.figures import FittedChannels, prediction_figure
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.style import BLUE, GREY, RED, new_figure, save_png
from hyperflex.vision import VideoReader

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMAGES = Path(__file__).parent / "images"
DPI = 100


def cast() -> hf.Trajectory:
    """Swing the paper's cable up, as README does."""
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    return hf.simulate(cable, hf.arm_swings(t_move=0.73, t_rest=0.53), arm=hf.Arm(length=0.105), duration=10.0)


def whip() -> hf.Trajectory:
    """Crack a tapered whip with one stroke of a longer arm."""
    taper = np.linspace(1.0, 0.15, 60)
    rope = hf.Rope(length=0.025, mass=5e-3 * taper**2, friction=1.2e-3 * taper**3)
    motion = hf.move_arm(-np.pi / 2, 3 * np.pi / 4, 0.4)
    return hf.simulate(rope, motion, arm=hf.Arm(length=0.25), duration=0.48, t_eval=np.linspace(0.0, 0.48, 121))


def growth() -> Figure:
    """Growth of small errors along the paper's cast, with its friction and with none."""
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    with new_figure(6.4, 3.0) as figure:
        axes = figure.add_subplot()
        axes.axhspan(100.0, 1e12, color="#f3f4f6", lw=0)
        axes.text(4.6, 160.0, "0.01 mm has become more than 1 mm", color=GREY, size=8.5)
        for friction, colour, name in ((5e-4, BLUE, "with the cable's friction"), (0.0, RED, "without friction")):
            found = hf.predictability(cable.replace(friction=friction), hf.arm_swings(), arm=hf.Arm(), duration=10.0)
            axes.semilogy(found.t, found.amplification, color=colour, label=name)
            print(f"friction {friction:g}: horizon {found.horizon(1e-3):.2g} s, {found.amplification.max():.2g}-fold")
        axes.set(xlim=(0.0, 10.0), ylim=(0.7, 1e5), xlabel="time, s", ylabel="growth of the worst error")
        axes.minorticks_off()
        axes.legend(loc="upper right")
    return figure


def vibration() -> Figure:
    """Tilt at which a vibrating arm holds a rod."""
    rod = hf.Rope(length=[0.3], mass=[0.05], friction=[1e-4])
    ways, rates = np.linspace(0.002, 0.03, 160), np.linspace(15.0, 90.0, 120)
    found = hf.vibration_map(rod, ways, rates, np.radians(135.0), arm=hf.Arm(length=0.3))
    return found.plot(hf.MotorLimits(speed=15.0, acceleration=4000.0))


def identified() -> Figure:
    """Prediction of the held-out part of the recording in how-to/identify.md."""
    truth = hf.Rope(
        length=[0.17, 0.23], mass=[0.21, 0.16], com=[0.11, 0.09], inertia=[6e-4, 8e-4], friction=[1.2e-3, 5e-4]
    )
    swing = hf.simulate(truth, duration=10.0, q0=[0.6, 0.9], t_eval=np.arange(0, 1000) * 0.01)
    noise = np.radians(np.random.default_rng(1).normal(0.0, 0.2, swing.q.shape))
    recording = hf.Recording(swing.t, swing.q + noise, noise=np.radians(0.2))
    found = hf.identify(recording, truth.replace(friction=1e-3), ["inertia", "friction"])
    view, held = FittedChannels(recording, found), found.held_out
    if held is None:
        raise SystemExit("nothing is held out")
    print(f"identified: {100.0 * held.inside:.0f} % within the band")
    return prediction_figure(view, held)


def tutorial(folder: Path) -> None:
    """Draw the pictures of tutorials/video.md in what its commands find, in an empty folder."""
    page = Path(__file__).parent / "tutorials" / "video.md"
    for name, content in zip(("rope.toml", "finer.toml"), settings(page), strict=True):
        (folder / name).write_text(content, "utf-8")
    (folder / "swing.mp4").write_bytes(twin.BUNDLED.read_bytes())
    twin.camera().write(folder / "camera.toml")
    with contextlib.chdir(folder):
        for command in commands(page):
            if command[0] != "calibrate" and run(command):
                raise SystemExit(f"failed: {' '.join(command)}")
    with VideoReader(folder / "seen.mp4") as video:
        frames = [frame.image for frame in video]
    pair = np.hstack([frames[k] for k in (4, 42)])[..., ::-1]  # blue, green, red to red, green, blue
    picture(Image.fromarray(np.ascontiguousarray(pair)), "tutorial-seen.png", 1400)
    rope = hf.Rope.from_toml(folder / "finer.toml")
    recording = hf.read_recording(folder / "markers.nc")
    found = hf.identify(
        recording,
        rope,
        ["friction:shared", "inertia:shared"],
        setup=hf.RecordingSetup(arc_lengths=twin.ARC_LENGTHS, origin=(0.0, 0.0)),
    )
    if found.held_out is None:
        raise SystemExit("nothing is held out")
    save_png(
        prediction_figure(FittedChannels(recording, found), found.held_out), IMAGES / "tutorial-predicted.png", dpi=DPI
    )
    picture(Image.open(folder / "cast" / "strike.png").convert("RGB"), "tutorial-strike.png", 640)


def picture(image: Image.Image, name: str, width: int) -> None:
    """Save a picture, made smaller to `width`, px."""
    size = (width, round(image.height * width / image.width))
    image.resize(size, Image.Resampling.LANCZOS).save(IMAGES / name, optimize=True)


def main() -> None:
    """Draw them all, and print the figures that the captions name."""
    IMAGES.mkdir(exist_ok=True)
    swung, cracked = cast(), whip()
    save_png(swung.plot(), IMAGES / "cast.png", dpi=DPI)
    swung.to_html(IMAGES / "cast.html", start=7.56, end=10.0, title="The paper's cable, simulated")
    save_png(strobe_figure(cracked, count=70, width=6.0), IMAGES / "whip.png", dpi=DPI)
    speed = np.linalg.norm(cracked.tip_velocity, axis=1)
    print(f"whip: {speed.max():.0f} m/s at t = {cracked.t[speed.argmax()]:.2f} s")
    save_png(growth(), IMAGES / "growth.png", dpi=2 * DPI)
    items = identification.PART.items | estimation.PART.items | casting.PART.items
    for name in ("fig3", "fig5", "fig6", "fig8", "fig10", "fig11", "fig12"):
        save_png(items[name].draw(), IMAGES / f"{name}.png", dpi=DPI)
    save_png(vibration(), IMAGES / "vibration.png", dpi=DPI)
    save_png(identified(), IMAGES / "identified.png", dpi=DPI)
    with tempfile.TemporaryDirectory() as folder:
        tutorial(Path(folder))


if __name__ == "__main__":
    main()
