"""A plain rope that swings before an emulated camera: is it tracked live from the first picture on?

python -m benchmarks.watch            a minute; to benchmarks/results/watch.md
python -m benchmarks.watch --out -    nothing is written
chrt -r 1 python -m benchmarks.watch  with priority over other programs on a busy machine

The camera is emulated: a thread provides rendered pictures of 1280x720 pixels 30 times per second in real time, whether
they are used or not. The rope (100 links, 2 m, 5 mm thick, 1/500 s) swings from the first picture on. It is tracked
like `hyperflex watch --length 2.0`, with 43 links and nine parameters, twice: pictures that arrive during the search
are processed later, or skipped in favour of the newest one. The times exclude decoding.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np
from benchmarks import machine
from threadpoolctl import threadpool_limits

from hyperflex import files
from hyperflex.cli.plain import Plain
from hyperflex.cli.track import Markers
from hyperflex.estimate import FrameThread, LiveEstimate, TrackingTask, Watch
from hyperflex.vision import Camera, Frame, Image, Renderer, RopeMotion, Scene, srgb_tone
from tests.estimate.runs import free_swing

RESULTS = Path(__file__).parent / "results" / "watch.md"
SEED, LENGTH, RATE, SECONDS, BEGIN = 5648, 2.0, 30.0, 5.0, 0.4  # m, frames/s, s, s
SIZE, SETTLED = (1280, 720), 3.0  # px, s after the first picture


class Filmed:
    """A camera that provides pictures in real time."""

    def __init__(self, images: list[Image]) -> None:
        self.images, self.image_size, self.notes = images, SIZE, list[str]()

    def __iter__(self) -> Iterator[Frame]:
        begun = time.monotonic()
        for k, image in enumerate(self.images):
            time.sleep(max(0.0, begun + k / RATE - time.monotonic()))
            yield Frame(BEGIN + k / RATE, image, k)

    def close(self) -> None:
        """Do nothing: there is no device to close."""


def watched(task: TrackingTask, images: list[Image]) -> tuple[list[LiveEstimate], list[float], int]:
    """Track the rope until shortly before the last picture; return estimates, processor times, s, and skipped
    frames."""
    found, spent, source = list[LiveEstimate](), list[float](), Filmed(images)
    with FrameThread(lambda: source, live=True) as frames:
        follow = Watch(frames, task.tracker())
        begun = time.thread_time()
        for each in follow:
            if each.frame is not None:
                found.append(each)
                spent.append(time.thread_time() - begun)
                if each.frame.index >= len(images) - 2:
                    return found, spent, follow.skipped
            begun = time.thread_time()
    raise AssertionError("the camera ended")


def row(rule: str, motion: RopeMotion, found: list[LiveEstimate], spent: list[float], skipped: int) -> str:
    """Return a row of the table."""
    t = np.array([each.t for each in found])
    off = [each.tip for each in found] - motion.places(t, [LENGTH])[:, 0, :2]
    off = np.where([each.found for each in found], 1e3 * np.linalg.norm(off, axis=1), np.inf)
    late, busy = 1e3 * np.array([each.latency for each in found]), 1e3 * np.array(spent)
    steady = t > BEGIN + SETTLED
    level = np.flatnonzero(late > 1e3 / RATE)
    caught = t[min(level[-1] + 1, len(t) - 1)] - BEGIN
    cells = [
        rule,
        f"{len(found)}, {skipped}",
        f"{late.max():.0f}",
        f"{caught:.1f}",
        f"{np.median(late[steady]):.1f}, {np.quantile(late[steady], 0.99):.1f}",
        f"{np.median(busy[steady]):.1f}, {np.quantile(busy[steady], 0.99):.1f}",
        f"{1e3 * spent[0]:.0f}",
        f"{np.sqrt(np.mean(off[steady] ** 2)):.2g}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Render, track, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default=str(RESULTS), help="page; -: none")
    out, about = parser.parse_args().out, machine.describe()
    motion = RopeMotion.from_trajectory(free_swing(SEED, BEGIN + SECONDS + 0.5))
    camera = Camera.facing(SIZE, pixels_per_metre=SIZE[0] / 4.5, origin=(640.0, 60.0), exposure=0.002)
    renderer = Renderer(camera, motion, Scene([], rope_width=0.005, tone=srgb_tone(), seed=SEED))
    images = [renderer.image(t) for t in BEGIN + np.arange(0.0, SECONDS, 1.0 / RATE)]
    with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
        plain = Plain(length=LENGTH, pivot=(640.0, 60.0), tip="found", size="rope", mass="unknown", exposure=0.002)
        task = Markers().plain_task(plain.scene(lambda _: images[0], Path(folder) / "camera-0"))
        task.rehearse()
        rows = [row("are processed later", motion, *watched(task, images))]
        with patch.object(FrameThread, "catch_up", lambda _: 0):
            rows.append(row("are skipped", motion, *watched(task, images)))
    about["load after"] = machine.load()
    head = (
        "pictures during the search | taken, skipped | greatest latency, ms | latency below a frame's time after, s | "
        "latency from 3 s on, median, 99 %, ms | processor time of a picture, median, 99 %, ms | of the first search, "
        "ms | error of the free end from 3 s on, rms, mm |"
    )
    lines = ["# A plain rope, tracked live", "", " ".join(str(__doc__).split("\n\n")[2].split()), "", f"| {head}"]
    page = "\n".join([*lines, "|---" * 8 + "|", *rows, "", f"{machine.sentence(about)}\n"])
    print(page)
    if out != "-":
        files.write_text(Path(out), page)


if __name__ == "__main__":
    main()
