"""The player of a run: small, true to the run, and at work in a browser without a network."""

import re
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.report import CastReport, WhipReport, player_html
from hyperflex.report.player import MOST_FRAMES
from tests.planning.known import planned
from tests.planning.known_whip import planned_whip
from tests.refusals import refuses

LARGEST = 1.5e6  # bytes of a page of 10 s, 50 links, 60 Hz
PRECISE = 1e-4  # m
BETWEEN = 2e-4  # m, between samples 10 ms apart


@pytest.fixture(scope="module")
def cast(tmp_path_factory):
    """The paper's cable with two pegs and a floor off its path, 10 s at 60 Hz, read from a file, and its page."""
    folder = tmp_path_factory.mktemp("player")
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    t = np.arange(601) / 60.0
    run = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.105), duration=10.0, t_eval=t)
    run.to_netcdf(folder / "cast.nc")
    run.to_html(folder / "cast.html", title="cable <& arm>")
    return hf.read_trajectory(folder / "cast.nc"), folder / "cast.html"


@pytest.fixture
def page(browser, cast):
    """The player in the browser, paused at 2 s."""
    browser.open(f"{cast[1].as_uri()}#t=2")
    return browser


def frames_of(page):
    """Return the frames' times (k,), s, and the points (k, m, 2), m, that the page draws then."""
    times = np.array(page.evaluate("Array.from(player.times)"))
    points = page.evaluate("Array.from(player.times).map((t) => Array.from(player.points(t)))")
    return times, np.array(points).reshape(times.size, -1, 2)


def test_a_page_is_small_enough_to_be_sent(cast):
    assert cast[1].stat().st_size < LARGEST
    text = cast[1].read_text("utf-8")
    assert "cable &lt;&amp; arm&gt;" in text
    assert not re.search(r"(src|href)=.(?!data:)|https?://|@import|fetch\(|XMLHttp", text)


def test_the_page_draws_what_the_file_holds(cast, page):
    run, _ = cast
    times, points = frames_of(page)
    np.testing.assert_array_equal(times, run.t)  # the frames are samples where these are as close as the frames
    assert np.hypot(*(points[:, 1:] - run.joints).T).max() < PRECISE
    shaft = run.base - 0.105 * np.stack([np.sin(run.arm_angle), -np.cos(run.arm_angle)], axis=-1)
    assert np.hypot(*(points[:, 0] - shaft).T).max() < PRECISE
    assert page.requests == [page.evaluate("location.href").split("#")[0]]
    assert page.complaints == []


def test_the_page_is_true_to_samples_that_are_closer_than_frames_and_to_what_lies_between(browser, tmp_path):
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    fine = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.105), duration=4.0, t_eval=np.arange(1601) / 400.0)
    sampled = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.105), duration=4.0, t_eval=np.arange(401) / 100.0)
    assert np.hypot(*fine.tip_velocity.T).max() > 4.0  # 40 mm between two samples
    sampled.to_html(tmp_path / "close.html")
    browser.open((tmp_path / "close.html").as_uri())
    points = browser.evaluate("Array.from({length: 1601}, (_, k) => Array.from(player.points(k / 400)))")
    away = np.hypot(*(np.reshape(points, (1601, -1, 2))[:, 1:] - fine.joints).T).max(axis=0)
    assert away[::4].max() < PRECISE
    assert away.max() < BETWEEN, away.max()


def test_a_rope_of_20_m_is_as_precise(browser, tmp_path):
    rope = hf.Rope.uniform(length=20.0, mass=1.0, n_links=8, friction=0.0)
    run = hf.simulate(rope, duration=1.0, q0=np.full(8, 1.2), t_eval=np.linspace(0.0, 1.0, 61))
    run.to_html(tmp_path / "long.html")
    browser.open((tmp_path / "long.html").as_uri())
    _, points = frames_of(browser)
    assert np.hypot(*(points - run.joints).T).max() < PRECISE


def test_it_is_scrubbed_by_keys_slider_plot_and_address(page):
    now = "player.time"
    assert (page.evaluate(now), page.evaluate("player.playing")) == (2.0, False)
    page.press("ArrowRight")
    assert page.evaluate(now) == pytest.approx(2.0 + 1.0 / 60.0)
    page.press("ArrowLeft", shift=True)
    assert page.evaluate(now) == pytest.approx(2.0 - 9.0 / 60.0)
    page.press("End")
    assert page.evaluate(now) == 10.0
    page.press("Home")
    assert page.evaluate(now) == 0.0
    box = "slider.getBoundingClientRect()"
    x, y, width = page.evaluate(f"(({{x, y, width, height}}) => [x, y + height / 2, width])({box})")
    page.drag(x + 0.5 * width, y, x + 0.5 * width, y)
    assert page.evaluate(now) == pytest.approx(5.0, abs=0.2)
    box = "document.querySelector('.plot div').getBoundingClientRect()"
    x, y, width = page.evaluate(f"(({{x, y, width}}) => [x, y + 20, width])({box})")
    page.drag(x + 0.5 * width, y, x + width, y)
    assert page.evaluate(now) == 10.0
    page.evaluate("new Promise((done) => { addEventListener('hashchange', () => done(1)); location.hash = '#t=7.5'; })")
    assert page.evaluate(now) == 7.5
    assert page.evaluate("document.getElementById('time').textContent") == "t = 7.50 s"


def test_it_plays_at_the_requested_speed_and_restarts(page):
    page.press("+")
    assert page.evaluate("player.speed") == 2.0
    page.press(" ")
    look = "const look = () => player.time %s ? done(player.time) : requestAnimationFrame(look); look();"
    later = f"new Promise((done) => {{ {look} }})"
    assert page.evaluate(later % "> 2.3") <= 10.0
    page.evaluate("player.seek(9.95)")
    assert page.evaluate(later % "< 1") < 1.0
    page.press(" ")
    assert not page.evaluate("player.playing")


@pytest.mark.parametrize("phone", [False, True], ids=["desk", "phone"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_everything_is_in_sight(browser, cast, tmp_path, phone, dark):
    browser.open(f"{cast[1].as_uri()}#t=8.9", phone=phone, dark=dark)
    browser.screenshot(tmp_path / "seen.png")
    assert (tmp_path / "seen.png").stat().st_size > 10_000
    hidden = "[document.documentElement.scrollWidth - innerWidth, document.body.scrollHeight - innerHeight]"
    assert browser.evaluate(hidden) == [0, 0]
    assert browser.evaluate("document.querySelectorAll('.plot').length") == 4
    assert browser.evaluate("document.documentElement.dataset.theme") == ("dark" if dark else "light")
    # the tip is drawn as a disc of its own colour: look at its middle, by the view that the page was given
    tip = browser.evaluate("""(() => {
        const [x0, y0, x1, y1] = D.view, w = canvas.clientWidth, h = canvas.clientHeight;
        const p = player.points(player.time);
        const scale = Math.min(w / (x1 - x0), h / (y1 - y0)), ratio = canvas.width / w;
        const x = w / 2 + scale * (p.at(-2) - (x0 + x1) / 2), y = h / 2 - scale * (p.at(-1) - (y0 + y1) / 2);
        return Array.from(pen.getImageData(ratio * x, ratio * y, 1, 1).data);
    })()""")
    assert tip == ([255, 255, 255, 255] if dark else [29, 39, 51, 255])
    browser.press("d")
    assert browser.evaluate("document.documentElement.dataset.theme") == ("light" if dark else "dark")
    assert browser.complaints == []


@pytest.mark.parametrize("made", ["cast", "whip"])
def test_the_page_of_a_plan_plays_its_run(browser, tmp_path, made):
    report = CastReport(planned(winds=False), None) if made == "cast" else WhipReport(planned_whip(), None)
    page = report.add_page(tmp_path)["page"]
    assert page.stat().st_size < 2.5e6
    browser.open(page.as_uri())
    browser.evaluate("document.querySelector('iframe').scrollIntoView()")
    assert [url for url in browser.requests if not url.startswith(("file:", "data:"))] == []
    assert browser.complaints == []
    document = browser.evaluate("document.querySelector('iframe').srcdoc")
    (tmp_path / "alone.html").write_text(document, "utf-8")
    browser.open(f"{(tmp_path / 'alone.html').as_uri()}#t={report.plan.run.t[-1]}")
    note = browser.evaluate("document.getElementById('note').textContent")
    assert note == report.film_note(report.plan.run.t[-1]).rstrip()
    titles = browser.evaluate("Array.from(document.querySelectorAll('.plot b')).map((b) => b.textContent)")
    assert ("turns, clockwise (1.25 required): " in titles) == (made == "cast")
    assert browser.complaints == []


def test_pegs_that_turn_walls_and_floors_are_drawn(browser, tmp_path):
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, radius=0.004, friction=1e-3)
    obstacles = (hf.Peg(0.0, -0.6, 0.05, inertia=1e-5), hf.Wall(0.4, -0.9, 0.4, -0.5), hf.Ground(0.0, -1.2))
    setup = hf.Setup(rope, duration=0.5, q0=np.full(6, 0.9), pegs=obstacles)
    hf.simulate(setup).to_html(tmp_path / "pegs.html")
    browser.open(f"{(tmp_path / 'pegs.html').as_uri()}#t=0.5")
    drawn = browser.evaluate("D.obstacles.map((o) => [o.kind, o.turns])")
    assert drawn == [["peg", 0], ["wall", None], ["ground", None]]
    assert browser.complaints == []


def test_obstacles_are_distinguished_from_the_target(browser, tmp_path):
    walls = (hf.Wall(-1.9, -1.8, -1.7, -0.6), hf.Ground(0.0, -2.4), hf.Peg(1.4, 0.3, 0.12))
    plan = planned()
    known = replace(plan.problem, obstacles=walls)
    run = replace(plan.run, setup=plan.run.setup.replace(pegs=(plan.target, *known.obstacles)))
    page = CastReport(replace(plan, problem=known, outcome=replace(plan.outcome, run=run)), None).add_page(tmp_path)
    browser.open(page["page"].as_uri())
    words = browser.evaluate("document.body.innerText")
    assert words.count("Violet: obstacles, which the rope must not touch.") == 2  # below the film and the strike
    told = "a wall from (-1.9, -1.8) to (-1.7, -0.6) m; a ground through (0, -2.4) m; a peg at (1.4, 0.3) m, radius 120"
    assert f"Obstacles, which the rope must not touch: {told}" in words.replace("\xa0", " ")
    assert "clear of arm and obstacles" in words.lower()
    (tmp_path / "alone.html").write_text(browser.evaluate("document.querySelector('iframe').srcdoc"), "utf-8")
    colours = """(() => {
        const to = mapping(D.view, canvas.clientWidth, canvas.clientHeight), ratio = canvas.width / canvas.clientWidth;
        const at = (o) => Array.from(pen.getImageData(ratio * to.X(o.x), ratio * to.Y(o.y), 1, 1).data).slice(0, 3);
        return D.obstacles.filter((o) => o.kind === "peg").map(at);
    })()"""
    browser.open(f"{(tmp_path / 'alone.html').as_uri()}#t=0")
    assert browser.complaints == []
    assert browser.evaluate(colours) == [[200, 69, 47], [123, 75, 183]]  # the target; the obstacle


def test_a_long_run_has_no_more_frames_than_others():
    rope = hf.Rope.uniform(length=0.3, mass=0.01, n_links=1, friction=1e-3)
    run = hf.simulate(rope, duration=200.0, q0=[0.5], t_eval=np.linspace(0.0, 200.0, 4001))
    page = player_html(run)
    assert len(page) < 4 * MOST_FRAMES * 8 + 200_000
    assert len(player_html(run, frame_rate=5.0)) < len(page)


@pytest.mark.parametrize(
    ("options", "told"),
    [({"frame_rate": 0.0}, "frame_rate"), ({"speed": -1.0}, "speed"), ({"end": 99.0}, "end=99 is no part of the run")],
)
def test_a_page_refuses(cast, options, told):
    refuses(told, player_html, cast[0], **options)
