"""The page in a browser: load, set a target, plan, cast, see turns counted, scrub; on a desk and a phone."""

from dataclasses import asdict, replace

import pytest

import hyperflex as hf
from hyperflex.play import Folder, PlayServer, Session, Settings, read_opened
from tests.planning.known import planned
from tests.screens import compare

WAIT = "new Promise((done) => {{ const look = () => {} ? done(true) : setTimeout(look, 20); look(); }})"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    settings = Settings().changed({"links": 12})
    with PlayServer(Folder(tmp_path_factory.mktemp("play")), Session(settings)) as running:
        yield running


@pytest.fixture
def page(browser, server):
    with server.runner.news:
        server.runner.act("hang")
    browser.open(server.address)
    wait(browser, "window.play && play.scene && play.frames.length")
    return browser


def wait(browser, what):
    assert browser.evaluate(WAIT.format(what))


def click(browser, name):
    browser.evaluate(f"document.querySelector('[data-button={name}]').click()")


def where(browser, x, y):
    """Return the place of x, y, m, on the screen, CSS pixels."""
    return browser.evaluate(
        "(() => { const c = document.querySelector('#stage canvas').getBoundingClientRect();"
        f"const m = mapping(play.scene.view, c.width, c.height); return [c.left + m.X({x}), c.top + m.Y({y})]; }})()"
    )


def test_a_target_is_set_planned_for_cast_at_and_scrubbed(page, server):
    page.drag(*where(page, -0.83, -1.07), *where(page, 0.8, -1.0))
    wait(page, "Math.abs(play.scene.settings.target_x - 0.8) < 0.02")
    assert server.runner.session.setup.pegs[0].x == pytest.approx(0.8, abs=0.02)
    assert float(page.evaluate("document.getElementById('target_x').value")) == pytest.approx(0.8, abs=0.02)
    page.evaluate("document.querySelector('#stage canvas').focus()")
    before = server.runner.session.settings.target_x
    page.press("ArrowLeft", shift=True)
    wait(page, f"play.scene.settings.target_x < {before - 0.09}")
    page.evaluate("set({time_budget: 2})")
    wait(page, "play.scene.settings.time_budget === 2")
    page.press("p")
    wait(page, "play.scene.planning")
    wait(page, "play.scene.plan && !play.scene.planning")
    failed = not server.runner.plan.success  # the search had two seconds
    assert page.evaluate("document.querySelector('[data-button=cast]').disabled") is failed
    plan = planned()  # one that winds
    with server.runner.news:
        server.runner.plan = plan
        server.runner.changed()
    wait(page, "play.scene.plan.success")
    click(page, "wind")
    wait(page, "play.scene.activity === 'cast' && play.frames.length > 5")
    page.evaluate("set({speed: 2})")
    wait(page, "Math.abs(play.shown[play.at.turns]) > 1.25")
    assert "turns" in page.evaluate("document.getElementById('time').textContent")
    now, first = page.evaluate("[play.shown[0], play.frames[0][0]]")
    page.evaluate("(() => { const s = document.getElementById('scrub'); s.value = 0; s.oninput(); })()")
    assert page.evaluate("play.shown[0]") == pytest.approx(first)
    assert page.evaluate("[document.getElementById('live').disabled, play.shown[0]]")[1] < now
    wait(page, "!document.getElementById('live').disabled")
    page.evaluate("document.getElementById('live').click()")
    assert page.evaluate("play.shown[0]") >= now
    own = server.address.removeprefix("http://")
    assert set(page.requests) == {f"http://{own}", f"http://{own}stream", f"http://{own}do"}
    assert page.complaints == []


def test_keys_and_sliders_do_what_they_say_and_errors_are_read_out(page, server):
    page.press("s")
    wait(page, "play.scene.activity === 'swing'")
    page.press(" ")
    wait(page, "play.scene.paused && document.querySelector('[data-button=pause]').textContent === 'Continue'")
    slide = (
        "(() => { const s = document.querySelector('[type=range][data-set=length]'); s.value = 1.5; s.oninput(); })()"
    )
    page.evaluate(slide)
    wait(page, "play.scene.settings.length === 1.5")
    assert server.runner.session.setup.rope.length.sum() == pytest.approx(1.5)
    typed = "(() => { const s = document.getElementById('mass'); s.value = 99; s.onchange(); })()"
    page.evaluate(typed)
    wait(page, "document.getElementById('said').textContent.includes('out of range')")
    wait(page, "document.getElementById('mass').value === '0.125'")
    unnamed = "[...document.querySelectorAll('button, input, select')].filter((e) => !(e.ariaLabel || e.textContent || "
    assert page.evaluate(unnamed + "e.labels?.[0]?.textContent)).map((e) => e.outerHTML)") == []
    page.evaluate("set({length: 2})")
    assert page.complaints == []


def test_the_sliders_show_the_opened_rope(page, server, tmp_path):
    cord = hf.Rope.uniform(length=1.2, mass=0.08, n_links=9, friction=2e-3, radius=0.003, name="my cord")
    hf.Setup(cord, arm=hf.Arm(length=0.3)).to_toml(tmp_path / "my.toml")
    server.runner.open(read_opened(tmp_path / "my.toml"))
    wait(page, "play.scene.rope.startsWith('my cord')")
    names = ["length", "mass", "links", "friction", "arm_length"]
    assert [float(page.evaluate(f"document.getElementById('{name}').value")) for name in names] == [
        1.2,
        0.08,
        9,
        0.002,
        0.3,
    ]
    slide = "(() => { const s = document.querySelector('[type=range][data-set=mass]'); s.value = 0.1; s.oninput(); })()"
    page.evaluate(slide)
    wait(page, "play.scene.rope === 'my cord, changed, 1.2 m, 100 g, 9 links'")
    failed = replace(planned(), message="it slips")
    with server.runner.news:
        server.runner.plan = failed
        server.runner.changed()
    wait(page, "play.scene.plan && !play.scene.plan.success")
    disabled = "['cast', 'wind'].map((name) => document.querySelector(`[data-button=${name}]`).disabled)"
    assert page.evaluate(disabled) == [True, False]
    with server.runner.news:
        server.runner.session, server.runner.plan = Session(Settings().changed({"links": 12})), None
    assert page.complaints == []


def test_a_run_is_saved_and_played_in_the_page(page, server):
    wait(page, "play.frames.length > 10")
    page.evaluate("document.getElementById('name').value = 'mine.nc'; document.getElementById('save').click()")
    wait(page, "document.getElementById('said').textContent === 'saved mine.nc'")
    wait(page, "document.getElementById('files').value === 'mine.nc'")
    page.evaluate("document.getElementById('open').click()")
    wait(page, "document.querySelector('iframe').contentWindow.player")
    assert page.evaluate("document.querySelector('iframe').contentWindow.player.times.length") > 10
    page.evaluate("document.getElementById('close').click()")
    assert page.complaints == []


@pytest.mark.parametrize("phone", [False, True], ids=["desk", "phone"])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_everything_is_in_reach(browser, server, tmp_path, phone, dark):
    browser.open(server.address, phone=phone, dark=dark)
    wait(browser, "window.play && play.frames.length > 3")
    browser.screenshot(tmp_path / "seen.png")
    assert (tmp_path / "seen.png").stat().st_size > 10_000
    across, down = browser.evaluate(
        "[document.documentElement.scrollWidth - innerWidth, document.body.scrollHeight - innerHeight]"
    )
    assert across == 0
    assert phone or down == 0
    assert browser.evaluate("document.documentElement.dataset.theme") == ("dark" if dark else "light")
    wide = "[...document.querySelectorAll('button')].filter((b) => b.offsetHeight && b.offsetHeight < 32).length"
    assert browser.evaluate(wide) == 0
    assert browser.complaints == []


def test_a_page_that_lost_the_server_reports_it_and_finds_it_again(page, server):
    page.evaluate("source.dispatchEvent(new Event('error'))")
    wait(page, "document.getElementById('said').textContent.startsWith('The connection was lost')")
    wait(page, "source.readyState === 1")
    count = page.evaluate("play.counts.frames")
    wait(page, f"play.counts.frames > {count} + 3")
    assert page.complaints == []


STATES = {  # what is done, simulated seconds until the picture
    "hang": (lambda runner: runner.session.hang(), 0.0),
    "swing": (lambda runner: runner.session.swing(), 3.0),
    "wound": (lambda runner: runner.act("wind"), 2.0),
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("shape", ["desk", "phone"])
def test_states_look_as_they_did(browser, server, tmp_path, state, shape):
    begin, seconds = STATES[state]

    def show():
        runner = server.runner
        runner.plan = planned() if state == "wound" else None
        runner.session.change(asdict(Settings().changed({"links": 12, "speed": 1.0})))
        runner.session.hang()
        begin(runner)
        for _ in range(round(60 * seconds)):
            runner.session.advance(1.0 / 60.0)
        runner.paused, runner._late = True, False  # whether the machine was busy before is of no interest
        runner.changed()

    browser.open("about:blank")  # nobody looks: nothing moves on
    with server.runner.news:
        show()
    browser.open(server.address, phone=shape == "phone", dark=state == "swing")
    wait(browser, "window.play && play.counts.painted > 0 && !dirty")
    compare(browser, f"play-{state}-{shape}", tmp_path / "seen.png")
    assert browser.complaints == []
