"""Stroboscopic pictures, films and figures: what they show, and what they refuse."""

import io

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

import hyperflex as hf
from hyperflex.report.pictures import animate, strobe_figure
from hyperflex.report.scene import Overlay, last_sweep, shapes
from hyperflex.report.style import png
from hyperflex.vision import VideoReader
from tests.planning.known import PEG as TARGET
from tests.planning.known import planned
from tests.planning.known_whip import planned_whip
from tests.refusals import refuses


def opened(content: bytes) -> Image.Image:
    image = Image.open(io.BytesIO(content))
    image.load()
    return image


def reddish(path):
    """Return rows and columns of the red pixels of an animation's first frame."""
    frame = np.asarray(opened(path.read_bytes()).convert("RGB"))
    return np.nonzero((frame[..., 0] > 150) & (frame[..., 1] < 120))


def test_strobe_draws_ropes_on_a_dark_ground(short_cast):
    image = opened(png(strobe_figure(short_cast, count=12, title="a cast"), dpi=60)).convert("RGB")
    pixels = np.asarray(image).reshape(-1, 3)
    background = np.array([12, 19, 34])
    drawn = (np.abs(pixels.astype(int) - background).max(axis=1) > 40).mean()
    assert 0.005 < drawn < 0.5  # lines, neither an empty nor a full picture
    assert image.width == 540  # 9 inches at 60 dots


def test_a_strobe_shows_the_last_sweep(short_cast):
    """A pendulum of 1 m, let go at 1 rad, is back after 2.14 s: its last whole sweep of 5 s begins after three."""
    rod = hf.Rope(length=[1.0], mass=[0.1], com=[1.0], inertia=[1e-9])
    swing = hf.simulate(rod, duration=5.0, q0=1.0)
    np.testing.assert_allclose(
        last_sweep(swing), [3.21, 4.28], atol=0.02
    )  # s: half periods of 1.07 s; samples of 10 ms
    low, high = run_key(swing.plot()), run_key(swing.plot(start=0.0))
    assert (low, high) == (["3.21 s", "4.28 s"], ["0.00 s", "5.00 s"])
    hit = hf.simulate(rod, duration=0.9, q0=1.0)  # it does not turn back
    assert last_sweep(hit) == (0.0, 0.9)
    settled = hf.simulate(rod.replace(friction=0.3), duration=9.0, q0=1.0)  # small ones at the end do not count
    assert last_sweep(settled)[1] < 4.0


def run_key(figure):
    """The first and the last time that a strobe shows."""
    return [each.get_text() for each in figure.axes[0].child_axes[0].get_xticklabels()]


def test_strobe_shows_the_time_of_each_colour_and_hides_no_wraps(short_cast):
    (axis,) = strobe_figure(short_cast, start=0.25, end=1.25, count=5).axes
    axis.figure.canvas.draw()
    (key,) = axis.child_axes
    assert [text.get_text() for text in key.get_xticklabels()] == ["0.25 s", "1.25 s"]
    (colours,) = (each for each in key.collections if each.get_array() is not None)
    ends = colours.get_cmap()([0.0, 1.0])
    np.testing.assert_allclose(ends[:, :3], axis.collections[0].get_colors()[[0, -1], :3], atol=1e-2)
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, radius=0.004, friction=1e-3)
    run = hf.simulate(hf.Setup(rope, duration=0.1, pegs=(hf.Peg(0.3, -0.5, 0.05),)))
    (axis,) = strobe_figure(run).axes
    assert axis.patches[0].get_zorder() < min(each.get_zorder() for each in axis.collections)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"count": 1}, "count"), ({"start": 9.0}, "no part of the run"), ({"end": np.nan}, "not finite")],
)
def test_strobe_refuses(short_cast, arguments, message):
    refuses(message, strobe_figure, short_cast, **arguments)


def test_shapes_between_samples_are_those_of_a_finer_run(short_cast):
    times = np.linspace(0.0, 1.5, 997)
    fine = hf.simulate(short_cast.setup, duration=1.5, t_eval=times)
    between = shapes(short_cast, times)
    # Samples are 5 ms apart, the fastest motion of this rope takes some 50 ms: (pi/10)^4/384 of 1 m is 25 um.
    np.testing.assert_allclose(between.joints, fine.joints, atol=1e-4)
    np.testing.assert_allclose(between.pivots, 0.0, atol=1e-4)
    lengths = np.linalg.norm(np.diff(between.joints, axis=1), axis=2)
    np.testing.assert_allclose(lengths, 1.0 / 6.0, rtol=1e-12)


def test_pictures_leave_matplotlib_as_it_was_and_repeat_byte_by_byte(short_cast):
    before = dict(mpl.rcParams)
    assert png(strobe_figure(short_cast, count=5), dpi=40) == png(strobe_figure(short_cast, count=5), dpi=40)
    assert dict(mpl.rcParams) == before


def test_walls_and_grounds_are_drawn(tmp_path):
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, radius=0.004, friction=1e-3)
    obstacles = (hf.Wall(1.4, -0.9, 1.4, -0.5), hf.Ground(0.0, -0.9))
    run = hf.simulate(hf.Setup(rope, duration=0.1, pegs=obstacles, q0=np.full(6, 1.5)))
    (axis,) = strobe_figure(run).axes
    wall, ground = axis.patches
    assert np.array_equal(wall.get_path().vertices, [[1.4, -0.9], [1.4, -0.5]])
    assert ground.contains_point(axis.transData.transform((0.7, -0.92)))
    assert not ground.contains_point(axis.transData.transform((0.7, -0.88)))
    assert axis.get_xlim()[1] > 1.4  # the view reaches as far
    run.animate(tmp_path / "a.gif", frame_rate=10, width=300)
    frame = np.asarray(Image.open(io.BytesIO((tmp_path / "a.gif").read_bytes())).convert("RGB")).astype(int)
    tall, wide = np.nonzero((frame[..., 0] > 180) & (frame[..., 1] < 120))  # the wall
    assert np.ptp(tall) > 5 * np.ptp(wide)
    low = frame[-2]
    assert (np.ptp(low, axis=0) < 40).all()
    assert low.sum(axis=1).min() > frame[2].sum(axis=1).min()  # the ground is lighter than the night


def test_pegs_and_targets_are_drawn_to_scale_and_in_view(tmp_path):
    run = planned(winds=False).run
    animate(run, tmp_path / "a.gif", end=0.1, frame_rate=10, width=300)
    _, columns = reddish(tmp_path / "a.gif")
    seen = np.concatenate(
        [run.joints.reshape(-1, 2), [[TARGET.x - 0.04, TARGET.y - 0.04], [TARGET.x + 0.04, TARGET.y + 0.04]]]
    )
    wide, tall = np.ptp(seen, axis=0)
    margin = 0.06 * max(wide, tall)  # on each side, and twice above
    view = max(wide + 2.0 * margin, (tall + 3.0 * margin) / 1.15)  # a tall view is widened
    assert np.ptp(columns) + 1 == pytest.approx(300 * 0.08 / view, abs=1.5)  # whole pixels
    run = planned_whip().run
    far = Overlay(targets=np.array([[1.5, 0.5]]))  # beyond all that the rope reaches: the view must grow
    animate(run, tmp_path / "b.gif", end=0.1, frame_rate=10, width=300, overlay=far)
    rows, columns = reddish(tmp_path / "b.gif")
    assert 18 <= np.ptp(columns) + 1 <= 26  # a ring of 15 points and its line at 100 dots an inch: 23 pixels
    assert columns.min() > 200
    assert rows.max() < 0.4 * 300
    assert strobe_figure(run, start=0.5, end=1.0, count=4, overlay=far).axes[0].get_xlim()[1] > 1.5
    width, height = strobe_figure(run, start=0.0, end=0.05, count=4).get_size_inches()
    assert height == pytest.approx(1.15 * width)


def test_a_film_has_room_for_its_note(short_cast, tmp_path):
    heights = []
    for note in (None, lambda _: "one", lambda _: "one\ntwo\nthree"):
        animate(short_cast, tmp_path / "a.gif", end=0.1, frame_rate=10, width=200, overlay=Overlay(note))
        heights.append(opened((tmp_path / "a.gif").read_bytes()).height)
    assert heights == [heights[0], heights[0] + 36, heights[0] + 72]


def test_a_film_has_its_frames_in_time(short_cast, tmp_path):
    seen = []
    path = tmp_path / "cast.gif"
    animate(short_cast, path, frame_rate=20, width=160, title="t", progress=lambda *done: seen.append(done))
    film = Image.open(io.BytesIO(path.read_bytes()))
    assert film.n_frames == 31  # 1.5 s at 20 frames a second, both ends
    assert film.info["duration"] == 50
    assert film.width == 160
    assert seen[0] == (1, 31)
    assert seen[-1] == (31, 31)
    film.seek(0)
    first = np.asarray(film.convert("RGB")).astype(int)
    film.seek(30)
    last = np.asarray(film.convert("RGB")).astype(int)
    assert np.abs(first - last).max() > 100  # the rope has moved


def test_a_film_keeps_its_colours_though_its_first_frame_has_few(short_cast, tmp_path):
    animate(short_cast, tmp_path / "cast.gif", frame_rate=10, width=200)
    film = Image.open(io.BytesIO((tmp_path / "cast.gif").read_bytes()))
    film.seek(14)
    red, green, blue = np.asarray(film.convert("RGB")).reshape(-1, 3).T.astype(int)
    assert ((red > blue + 60) & (green > blue + 40)).sum() > 50  # the rope is yellow
    assert ((green > red + 60) & (blue > red + 60)).sum() > 50  # its trail is green-blue


def test_a_slow_film_takes_longer(short_cast, tmp_path):
    animate(short_cast, tmp_path / "slow.gif", start=0.5, end=1.0, frame_rate=20, speed=0.5, width=100)
    assert Image.open(io.BytesIO((tmp_path / "slow.gif").read_bytes())).n_frames == 21


def test_a_film_as_a_video_has_the_same_frames_in_time(short_cast, tmp_path):
    animate(short_cast, tmp_path / "cast.gif", end=0.5, frame_rate=20, width=161)
    short_cast.animate(tmp_path / "cast.mp4", end=0.5, frame_rate=20, width=161)
    drawn = Image.open(io.BytesIO((tmp_path / "cast.gif").read_bytes()))
    with VideoReader(tmp_path / "cast.mp4") as video:
        frames = list(video)
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(11) / 20.0, atol=1e-5)  # s, ticks of 1/90000
    for number in (0, 10):
        drawn.seek(number)
        seen = frames[number].image[: drawn.height, : drawn.width, ::-1].astype(float)
        # H.264 keeps colours at half the resolution: thin lines lose some, the picture as a whole does not
        assert np.abs(seen - np.asarray(drawn.convert("RGB"))).mean() < 4.0


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("a.avi", {}, "kind of file"),
        ("a.mp4", {"frame_rate": 0}, "frame_rate"),
        ("a.gif", {"frame_rate": 30}, "frame_rate"),
        ("a.gif", {"speed": 0.0}, "speed"),
        ("a.gif", {"start": 1.0, "end": 0.5}, "no part of the run"),
        ("a.gif", {"end": 99.0}, "no part of the run"),
    ],
)
def test_a_film_refuses(short_cast, tmp_path, name, arguments, message):
    refuses(message, animate, short_cast, tmp_path / name, **arguments)
    assert list(tmp_path.iterdir()) == []
