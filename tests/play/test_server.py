"""The server of the page: who is answered and who is not, what messages do, files, several pages at once."""

import base64
import http.client
import json
import socket
import struct
import threading
import time
from dataclasses import replace
from multiprocessing import Pipe

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import FileProblem
from hyperflex.play import Folder, PlayServer, Session, Settings, planning_process
from tests.planning.known import planned
from tests.refusals import fails, refuses

SMALL = {"links": 6, "target_solid": 0}
PATIENCE = 60.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("play")
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=5, friction=1e-3)
    setup = hf.Setup(rope, hf.arm_swings(), hf.Arm(length=0.1), duration=0.5)
    (path / "kept").mkdir()
    hf.simulate(setup).to_netcdf(path / "kept" / "run.nc")
    setup.to_toml(path / "setup.toml")
    (path / "notes.txt").write_text("mine")
    (path.parent / "outside.toml").write_text(setup.dumps())
    (path / "link.toml").symlink_to(path.parent / "outside.toml")
    return path


@pytest.fixture(scope="module")
def server(folder):
    with PlayServer(Folder(folder), Session(Settings().changed(SMALL))) as running:
        yield running


class Page:
    """What a page does: it reads the stream, and sends commands."""

    def __init__(self, server):
        self.server, self.frames, self.scene = server, [], None
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
        connection.request("GET", "/stream")
        self.stream = connection.getresponse()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stream.close()

    def ask(self, **message):
        return json.loads(post(self.server, json.dumps(message))[1])

    def read(self):
        """Read an event; return whether it is a scene."""
        event = "".join(iter(lambda: self.stream.readline().decode().removesuffix("\n"), ""))
        _, _, data = event.partition("data: ")
        if event.startswith("event: frame"):
            self.frames.append(np.frombuffer(base64.b64decode(data), "<f4"))
        elif data:
            self.scene = json.loads(data)
            return True
        return False

    def until(self, wanted):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if self.read() and wanted(self.scene):
                return self.scene
        raise AssertionError("the server did not say it")

    def see(self, count):
        while len(self.frames) < count:
            self.read()


def requested(server, way, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    connection.request(way, path, body, headers={"Host": f"127.0.0.1:{server.port}", **headers})
    answer = connection.getresponse()
    return answer.status, answer.read().decode(), answer.headers


def get(server, path="/", **headers):
    return requested(server, "GET", path, **headers)


def post(server, body, **headers):
    return requested(server, "POST", "/do", body, **headers)[:2]


@pytest.fixture
def page(server):
    with Page(server) as opened:
        opened.ask(button="hang")
        yield opened


def test_the_page_needs_nothing_else_and_nobody_may_frame_it(server):
    status, text, headers = get(server)
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]
    assert "http://" not in text
    assert "https://" not in text
    assert server.runner.session.settings.links == 6


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "evil.example:{port}"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1.evil.example:{port}"},
        {"Origin": "http://127.0.0.1:{port}@evil.example"},
    ],
    ids=lambda given: str(*given.values()),
)
def test_foreign_hosts_and_origins_get_403(server, headers):
    headers = {name: value.format(port=server.port) for name, value in headers.items()}
    assert get(server, **headers)[0] == 403
    assert get(server, "/view?name=kept/run.nc", **headers)[0] == 403
    assert get(server, "/stream", **headers)[0] == 403
    assert post(server, '{"button": "hang"}', **headers)[0] == 403


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        (["GET / HTTP/1.1", "Host: {own}", "Host: {own}"], 403),
        (["GET / HTTP/1.1", "Host: {own}", "Host: evil.example"], 403),
        (["GET / HTTP/1.1", "Host: {own}", "Origin: http://{own}", "Origin: http://evil.example"], 403),
        (["GET / HTTP/1.1", "Host: {own}", "Origin: http://["], 403),
        (["GET / HTTP/1.1", "Host: {own}", "Origin: "], 403),
        (["GET / HTTP/1.1", "Origin: http://{own}"], 403),
        (["GET http://[/ HTTP/1.1", "Host: {own}"], 400),
        (["GET / HTTP/1.1", "Host: {own}"], 200),
    ],
)
def test_odd_requests_are_refused_in_silence(server, capfd, lines, status):
    """Neither they nor a connection that is lost end as a traceback of the server."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE) as connection:
        text = "\r\n".join(lines).format(own=f"127.0.0.1:{server.port}")
        connection.sendall(f"{text}\r\n\r\n".encode())
        assert connection.recv(12).decode() == f"HTTP/1.0 {status}"
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset, not closed
    with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE) as connection:
        connection.sendall(b"GET / HT")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    get(server)
    assert capfd.readouterr().err == ""


def test_own_origins_and_allowed_hosts_are_answered(server, folder):
    for name in ("127.0.0.1", "localhost"):
        own = f"{name}:{server.port}"
        assert get(server, Host=own, Origin=f"http://{own}")[0] == 200
    with PlayServer(Folder(folder), allow=["lab.example:80"]) as other:
        assert get(other, Host="lab.example:80", Origin="http://lab.example:80")[0] == 200
        assert get(other, Host="lab.example:81")[0] == 403
    refuses("allow is no host", PlayServer, Folder(folder), allow=["["])
    refuses("no page can be shown", PlayServer, Folder(folder), port=server.port)


def test_frames_come_while_it_runs_and_none_move_while_it_is_paused(server, page):
    assert page.ask(button="swing") == {}
    page.until(lambda scene: scene["activity"] == "swing")  # frames of before may be of any time
    begun = len(page.frames)
    page.see(begun + 10)
    assert (np.diff([frame[0] for frame in page.frames[begun:]]) > 0.0).all()
    page.ask(button="pause")
    page.until(lambda scene: scene["paused"])
    before = server.runner.session.t
    page.ask(button="step")
    assert server.runner.session.t == pytest.approx(before + 1.0 / 60.0)
    page.ask(set={"speed": 0.1})
    page.ask(button="step")
    assert server.runner.session.t == pytest.approx(before + 1.1 / 60.0)
    page.ask(set={"speed": 1.0})


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ({}, "has no command"),
        ({"button": "explode"}, "no such button"),
        ({"button": ["hang"]}, "no such button"),
        ({"button": "cast"}, "no plan has been made"),
        ({"set": {"length": 99}}, "out of range"),
        ({"set": {"length": None}}, "not a number"),
        ({"set": [1]}, "set"),
        ({"open": "../outside.toml"}, "no such file"),
        ({"open": "link.toml"}, "no such file"),
        ({"open": "notes.txt"}, "no such file"),
        ({"open": 3}, "open"),
        ({"save": "../run.nc"}, "name cannot be used"),
        ({"save": "sub/run.nc"}, "name cannot be used"),
        ({"save": "run.exe"}, "name cannot be used"),
        ({"save": ".nc"}, "name cannot be used"),
        ({"save": "a\0.nc"}, "name cannot be used"),
        ({"save": "setup.toml"}, "there already"),
        ({"save": "link.toml"}, "there already"),
        ({"save": "motion.csv"}, "no plan"),
    ],
    ids=str,
)
def test_impossible_requests_are_reported_and_change_nothing(page, message, told):
    assert told in page.ask(**message)["error"]
    assert "error" not in page.ask(button="hang")


@pytest.mark.parametrize("text", ["", "not json", "[]", "3", "NaN", '{"id": ' + "[" * 50_000], ids=range(6))
def test_messages_that_are_none_are_refused(server, page, text):
    assert "error" in json.loads(post(server, text)[1])
    assert "error" not in page.ask(button="hang")


def test_a_bug_is_reported_and_the_connection_stays(server, page, monkeypatch, capsys):
    monkeypatch.setattr(server.runner, "act", lambda name: 1 / 0)
    assert page.ask(button="hang")["error"] == "This is a bug in hyperflex: division by zero"
    monkeypatch.undo()
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert "error" not in page.ask(button="hang")


@pytest.mark.parametrize("size", [1 << 17, -1, "many"])
def test_a_message_of_an_unusable_size_is_refused(server, page, size):
    assert post(server, None, **{"Content-Length": str(size)})[0] == 413
    assert "error" not in page.ask(button="hang")


def test_files_are_listed_opened_and_saved_within_the_folder(server, page, folder):
    assert page.ask(files=True)["files"] == ["kept/run.nc", "setup.toml"]
    status, text, _ = get(server, "/view?name=kept/run.nc")
    assert (status, "kept/run.nc, simulated" in text) == (200, True)
    status, text, _ = get(server, "/view?name=kept/run.nc&rope=setup.toml")  # no recording
    assert (status, "<html" in text) == (404, False)
    for name in ("", "setup.toml", "../outside.toml", "%2e%2e/outside.nc"):
        assert get(server, f"/view?name={name}")[0] == 404
    assert get(server, "/elsewhere")[0] == 404
    assert page.ask(open="setup.toml") == {}
    assert server.runner.session.setup.rope.n_links == 5
    while server.runner.session.t < 0.2:  # frames of before may still be in the stream, so they are not counted
        page.read()
    for suffix in ("nc", "html", "toml"):
        assert page.ask(save=f"seen.{suffix}")["saved"] == f"seen.{suffix}"
    run = hf.read_trajectory(folder / "seen.nc")
    again = hf.simulate(hf.Setup.from_toml(folder / "seen.toml"), duration=float(run.t[-1]), t_eval=run.t)
    np.testing.assert_allclose(again.joints, run.joints, atol=1e-9)
    assert "seen, simulated" in (folder / "seen.html").read_text("utf-8")
    assert "there already" in page.ask(save="seen.nc")["error"]
    assert (folder / "notes.txt").read_text() == "mine"
    fails(FileProblem, "no folder", Folder, folder / "missing")


def test_pages_see_the_same_and_one_that_breaks_off_harms_none(server, page):
    with Page(server) as other:
        other.ask(set={"mass": 0.2})
        page.until(lambda scene: scene["settings"]["mass"] == 0.2)
    page.see(len(page.frames) + 10)
    page.ask(set={"mass": 0.125})


def test_nothing_moves_while_nobody_looks(folder):
    with PlayServer(Folder(folder), Session(Settings().changed(SMALL))) as alone:
        time.sleep(0.1)
        assert alone.runner.session.t == 0.0
        with Page(alone) as opened:
            opened.see(5)
        assert alone.runner.session.t > 0.0


def test_a_plan_is_searched_in_a_separate_process_and_cancelled(server, page):
    runner = server.runner
    page.ask(set={"links": 10, "target_x": -0.83, "time_budget": 60.0})
    page.ask(button="plan")
    page.until(lambda scene: (scene["planning"] or {}).get("spent", 0.0) > 0.0)
    process = runner._planning._child._process
    assert "a plan is being made" in page.ask(button="whip")["error"]
    begin = time.monotonic()
    page.ask(button="cancel")
    assert time.monotonic() - begin < 30.0  # the figure, 1 s, is measured by benchmarks/play.py
    assert process.exitcode is not None
    page.ask(set={"target_x": 5.0, "target_y": 5.0})
    page.ask(button="plan")  # out of reach: said at once
    plan = page.until(lambda scene: scene["plan"])["plan"]
    assert (plan["success"], plan["message"][:12]) == (False, "out of reach")
    assert "the plan fails" in page.ask(button="cast")["error"]
    with runner.news:
        runner.plan = replace(planned(), message="it slips")
    assert "the plan fails: it slips" in page.ask(button="cast")["error"]
    assert page.ask(button="wind") == {}  # why it fails can be seen


def test_a_plan_that_succeeds_can_be_carried_out_while_a_better_one_is_sought(server, page):
    runner = server.runner
    page.ask(set={"links": 10, "target_x": -0.83, "time_budget": 60.0})
    ours, theirs = Pipe(duplex=False)
    with runner.news:  # what the process sends comes from here, before it can send anything
        runner.act("plan")
        runner._planning._child.link = ours
    theirs.send((0, (0, None)))
    assert page.until(lambda scene: (scene["planning"] or {}).get("spent", 0.0) > 0.0)["planning"]["found"] is False
    for plan in (replace(planned(), seconds=seconds) for seconds in (1.0, 2.0)):
        theirs.send((0, (1, plan)))
        told = page.until(lambda scene: (scene["planning"] or {}).get("found"))
        assert told["plan"]["success"]
        page.until(lambda _, plan=plan: runner.plan.seconds == plan.seconds)
        page.ask(button="cast")
        assert runner.session.activity == "cast"
    page.ask(button="cancel")
    assert runner.scene()["planning"] is None
    assert runner.plan.success  # the earlier file is kept


def test_the_planning_process_sends_each_plan_that_succeeds(monkeypatch):
    known = planned()
    where = (known.problem.rope, known.problem.arm, known.target, (), known.problem.limits, 60.0)

    def plan_cast(*_, on_plan, **__):
        on_plan(replace(known, seconds=1.0))
        return replace(known, seconds=2.0)

    monkeypatch.setattr(planning_process, "plan_cast", plan_cast)
    monkeypatch.setattr(planning_process.os, "nice", lambda _: None)
    ours, theirs = Pipe(duplex=False)
    reader = threading.Thread(target=lambda: heard.extend(ours.recv()[1] for _ in range(3)))
    heard = []
    reader.start()
    planning_process.work(theirs, planning_process.PlanningTask("cast", *where))
    reader.join()
    assert [(kind, plan and plan.seconds) for kind, plan in heard] == [(0, None), (1, 1.0), (2, 2.0)]


def test_plans_keep_to_the_obstacles_and_the_motor_of_the_opened_file(server, page, folder):
    session, aside, floor = server.runner.session, hf.Peg(1.2, 0.4, 0.1), hf.Ground(0.0, -3.0)
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, friction=0.0)
    setup = hf.Setup(rope, arm=hf.Arm(length=0.1), pegs=(hf.Peg(9.0, 9.0, 0.03), aside, floor)).dumps()
    (folder / "motor.toml").write_text(setup + "[limits]\nspeed = 4.0\ntorque = 0.3\nangles = [-1.0, 1.5]\n")
    page.ask(open="motor.toml")
    assert session.limits == hf.MotorLimits(speed=4.0, torque=0.3, angles=(-1.0, 1.5))
    page.ask(set={"motor_speed": 6.0})
    server.runner.plan = None
    page.ask(button="plan")
    assert page.until(lambda _: server.runner.plan is not None)
    problem = server.runner.plan.problem
    assert problem.limits == hf.MotorLimits(speed=6.0, torque=0.3, angles=(-1.0, 1.5))
    assert problem.obstacles == (aside, floor)
    planned().to_toml(folder / "cast.toml")
    page.ask(open="cast.toml")
    assert session.limits == planned().problem.limits
    assert session.rope == planned().problem.rope  # not as it was cut to be verified
    assert page.until(lambda scene: scene["plan"])["plan"] == {
        "kind": "cast",
        "success": True,
        "message": "",
        "simulated": True,
    }
    assert page.ask(button="cast") == {}
    page.ask(open="setup.toml")
    assert session.limits.torque == np.inf
    assert "no plan has been made" in page.ask(button="cast")["error"]
    (folder / "wrong.toml").write_text(setup + "[limits]\npace = 4.0\n")
    assert "does not know this key" in page.ask(open="wrong.toml")["error"]
    page.ask(set={"motor_speed": Settings().motor_speed})


def test_a_planned_cast_winds_as_planned(server, page, folder):
    plan, runner, session = planned(), server.runner, server.runner.session
    with runner.news:  # nothing moves on meanwhile
        runner.plan = plan
        runner.act("wind")
        assert session.settings.speed == 0.25
        assert session.t == pytest.approx(plan.outcome.strike_time - 0.5)
        runner.act("pause")
        session._simulate(3.0)
    frame = np.frombuffer(session.frame(), "<f4")
    assert frame[6] == pytest.approx(plan.outcome.turns, abs=0.05)
    assert page.ask(save="motion.csv")["saved"] == "motion.csv"
    assert hf.read_motion(folder / "motion.csv").breaks[-1] == pytest.approx(plan.motion.breaks[-1])
    with runner.news:
        runner.act("cast")
        assert (session.t, session.settings.speed) == (0.0, 1.0)
        runner.change({"arm_angle": 45.0})
        assert (session.activity, session.t) == ("hang", 0.0)
        runner.change({"arm_angle": -90.0})


def test_a_rope_that_cannot_continue_stops_and_reports_why(server, page, monkeypatch):
    def fail(dt):
        raise hf.SimulationError("it diverges", status="diverged", time=1.0)

    session = server.runner.session
    monkeypatch.setattr(session, "advance", fail)
    told = page.until(lambda scene: scene["notice"])
    assert (told["paused"], told["notice"]) == (True, "it diverges")
    monkeypatch.setattr(session, "advance", lambda dt: 1 / 0)
    page.ask(button="hang")
    told = page.until(lambda scene: scene["notice"])
    assert told["notice"].startswith("This is a bug in hyperflex: division by zero")
    monkeypatch.undo()
    page.ask(button="hang")
    page.see(len(page.frames) + 3)


def test_a_connection_that_says_nothing_does_not_keep_the_server(folder):
    running = PlayServer(Folder(folder), Session(Settings().changed(SMALL)))
    with socket.create_connection(("127.0.0.1", running.port)):
        get(running)  # by now it was taken
        ended = threading.Thread(target=running.close, daemon=True)
        ended.start()
        ended.join(PATIENCE / 2)
        assert not ended.is_alive()


def test_closing_ends_a_long_simulation_that_holds_the_session(folder):
    """As that of a plan up to its strike: Ctrl-C on a busy machine once waited for its end."""
    rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=150, friction=1e-4)
    setup = hf.Setup(rope, hf.arm_swings(), hf.Arm(), duration=5e3)
    running = PlayServer(Folder(folder), Session(Settings().changed(SMALL)))

    def skip():
        with running.runner.news, pytest.raises(hf.SimulationError):
            running.runner.session.play(setup, "file", skip=5e3)  # minutes of work

    busy = threading.Thread(target=skip, daemon=True)
    busy.start()
    while running.runner.session.setup is not setup:
        time.sleep(0.01)
    ended = threading.Thread(target=running.close, daemon=True)
    ended.start()
    ended.join(PATIENCE / 2)
    busy.join(PATIENCE / 2)
    assert [ended.is_alive(), busy.is_alive()] == [False, False]
