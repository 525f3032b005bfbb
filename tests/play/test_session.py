"""The rope of the page: it moves like a run of `simulate`, accepts settings, and refuses impossible ones."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.play.controls import CROSSING, FIXED, PUMPING, Settings
from hyperflex.play.session import MOST_MOVES, MOST_RECORDED, NUMBERS, Session
from hyperflex.status import Status
from tests.refusals import fails, refuses

DT = 1.0 / 60.0
FREE = {"links": 12, "target_solid": 0}


def numbers_of(frame: bytes) -> dict[str, float]:
    return dict(zip(NUMBERS, np.frombuffer(frame, "<f4").tolist(), strict=False))


def points_of(frame: bytes) -> np.ndarray:
    return np.frombuffer(frame, "<f4")[len(NUMBERS) :].reshape(-1, 2)


def run_for(session: Session, seconds: float) -> bytes:
    for _ in range(round(seconds / DT)):
        frame = session.advance(DT)
    return frame


def test_swinging_is_the_papers_motion_and_the_run_is_what_was_shown():
    session = Session(Settings().changed(FREE))
    session.swing()
    frame = run_for(session, 4.0)
    cast = hf.simulate(session.rope, hf.arm_swings(), arm=session.arm, duration=session.t, t_eval=[session.t])
    np.testing.assert_allclose(points_of(frame)[1:], cast.joints[0], atol=1e-4)
    np.testing.assert_allclose(points_of(frame)[0], 0.0, atol=1e-6)
    shown = numbers_of(frame)
    assert shown["t"] == pytest.approx(4.0, abs=1e-5)
    assert math.radians(shown["arm_angle"]) == pytest.approx(cast.arm_angle[0], abs=1e-5)
    assert shown["x"] == pytest.approx(cast.tip[0, 0], abs=1e-4)
    assert shown["tip_speed"] == pytest.approx(np.hypot(*cast.tip_velocity[0]), abs=1e-3)
    run = session.recorded().run()
    np.testing.assert_allclose(run.joints[-1], points_of(frame)[1:], atol=1e-4)
    assert run.t[[0, -1]].tolist() == pytest.approx([0.0, 4.0])


def test_the_tension_of_a_hanging_rope_is_its_weight():
    assert numbers_of(Session().advance(DT))["tension"] == pytest.approx(0.125 * 9.81, rel=1e-3)


def test_timings_count_from_the_next_half_turn_on_and_the_arm_goes_where_it_is_sent():
    session = Session(Settings().changed(FREE))
    session.swing()
    run_for(session, 0.3)
    session.change({"t_move": 1.0, "t_rest": 0.2})
    run_for(session, 1.0)
    starts = session.setup.motion.breaks  # the half turn that was begun took 0.73 s, the next begins 0.2 s after it
    assert starts[[2, 3, 5]].tolist() == pytest.approx([0.73, 0.93, 1.93])
    session.change({"arm_angle": 30.0})
    assert session.activity == "hang"
    assert numbers_of(run_for(session, 2.0))["arm_angle"] == pytest.approx(30.0)
    session.swing()
    run_for(session, 1.1)  # the half turn, and half of the rest
    assert session.setup.motion.angle([session.t])[0] == pytest.approx(-0.5 * math.pi)


def test_half_turns_begin_as_a_rule_says():
    reached = {}
    for rule in (CROSSING, PUMPING):
        session = Session(Settings().changed({**FREE, "rule": rule}))
        session.swing()
        run_for(session, 9.0)
        run = session.recorded().run()
        reached[rule] = np.abs(run.tip[:, 0]).max()
        if rule == CROSSING:
            # each half turn has two ramps, and a rest before it
            starts = np.array(session.setup.motion.breaks)[:-1:3][1:]
            x = np.interp(starts[starts < session.t], run.t, run.tip[:, 0])
            assert x.size >= 3
            np.testing.assert_allclose(x, 0.0, atol=0.08)  # m: it moves at up to 4 m/s, the samples are 10 ms apart
    assert reached[PUMPING] > 1.2 * reached[CROSSING]
    session.change({"rule": FIXED, "t_rest": 0.2})
    run_for(session, 1.0)
    assert session.settings.rule == FIXED


def test_a_peg_is_put_where_it_is_dragged_but_not_into_the_rope():
    session = Session(Settings().changed({"links": 12}))
    run_for(session, 0.1)
    session.change({"target_x": 0.5, "target_y": -1.2})
    assert (session.setup.pegs[0].x, session.setup.pegs[0].y) == (0.5, -1.2)
    kept, setup = session.settings, session.setup
    refuses("inside an obstacle", session.change, {"target_x": -0.105, "target_y": -1.0})
    assert (session.settings, session.setup) == (kept, setup)
    run = session.recorded()
    assert run.begin is not None
    refuses("nothing has moved", run.run)
    session.advance(DT)
    assert session.recorded().run().t[0] == pytest.approx(0.1)
    session.change({"target_solid": 0})
    assert session.setup.pegs == ()
    assert session.scene()["targets"] == [[0.5, -1.2]]
    assert session.scene()["rope"].startswith("rope, ")


def test_the_tension_of_a_single_step_is_not_shown(monkeypatch):
    session = Session(Settings().changed(FREE))
    run_for(session, 0.1)
    monkeypatch.setattr("hyperflex.play.session.rope_tension", lambda run: np.array([[3e4]]))  # like one near a peg
    assert numbers_of(session.advance(DT))["tension"] == pytest.approx(0.125 * 9.81, rel=1e-3)


def test_another_rope_begins_again_and_an_impossible_one_changes_nothing():
    session = Session()
    session.swing()
    run_for(session, 0.5)
    session.change({"length": 1.0, "links": 8})
    assert (session.t, session.activity, session.setup.rope.n_links) == (0.0, "swing", 8)
    before = session.scene()
    with pytest.raises(InvalidInput):  # thicker than it is long
        session.change({"length": 0.2, "links": 200, "target_x": -0.105, "target_y": -0.1})
    assert session.scene() == before


def test_a_set_up_is_played_to_its_end_and_on_and_its_peg_is_the_target():
    rope = hf.Rope.uniform(length=1.0, mass=0.05, n_links=6, friction=1e-3)
    motion, arm, peg = hf.arm_moves([0.0, 1.0], [0.1], [0.4]), hf.Arm(length=0.2), hf.Peg(0.7, -0.3, 0.05, 0.4)
    setup = hf.Setup(rope, motion, arm, duration=0.5, pegs=(peg, hf.Ground(0.0, -1.8)))
    session = Session()
    session.play(setup, "file", skip=0.25)
    assert session.t == pytest.approx(0.25)
    frame = run_for(session, 0.5)
    assert numbers_of(frame)["arm_angle"] == pytest.approx(math.degrees(1.0))
    assert (session.settings.target_x, session.settings.target_friction) == (0.7, 0.4)
    session.change({"target_x": 0.75})
    assert [type(each).__name__ for each in session.setup.pegs] == ["Peg", "Ground"]
    session.hang()
    assert (session.rope, session.arm) == (rope, arm)
    assert [type(each).__name__ for each in session.setup.pegs] == ["Peg", "Ground"]
    shown = session.settings
    assert [shown.length, shown.mass, shown.links, shown.friction, shown.arm_length] == pytest.approx(
        [1.0, 0.05, 6, 1e-3, 0.2]
    )
    session.change({"length": 1.5})
    assert session.arm == arm
    assert session.obstacles == setup.pegs[1:]  # what is planned with
    refuses("starts inside an obstacle", session.change, {"length": 2.5})
    assert session.rope.total_length == 1.5


def test_a_frame_that_takes_too_long_is_given_up(monkeypatch):
    session = Session(Settings().changed(FREE))
    session.swing()

    def slow(*_, time_budget, **__):
        raise SimulationError(f"over {time_budget}", status=Status.OUT_OF_TIME, time=0.0)

    with monkeypatch.context() as patched:
        patched.setattr("hyperflex.play.session.simulate", slow)
        fails(SimulationError, r"The next frame takes more than 1 s of work\. Hang the rope anew", session.advance, DT)
    assert run_for(session, 0.1)


def test_hours_of_swinging_keep_a_bounded_memory():
    session = Session(Settings().changed({"links": 4, "t_move": 0.2, "t_rest": 0.0, "target_solid": 0}))
    session.swing()
    for _ in range(700):
        session.advance(0.2)
    assert session.t == pytest.approx(140.0)
    assert session.setup.motion.breaks.size <= 3 * MOST_MOVES
    assert session.recorded().duration <= MOST_RECORDED
    session.recorded().run()


def test_a_control_changes_the_opened_rope_and_nothing_else_of_it():
    """A tapered cord of 1 m with stiffness, a tip weight and other gravity: properties that are not set stay, or
    scale."""
    cord = hf.Rope(
        length=[0.2, 0.3, 0.5],
        mass=[0.03, 0.02, 0.01],
        friction=[1e-3, 2e-3, 3e-3],
        stiffness=1e-3,
        tip_mass=0.02,
        gravity=(0.0, -3.7),
        radius=0.002,
        name="cord",
    )
    arm = hf.Arm(length=0.2, mass=0.1, com=0.1)
    session = Session()
    session.play(hf.Setup(cord, arm=arm), "file")
    assert (session.rope, session.arm) == (cord, arm)
    session.change({"length": 2.0, "mass": 0.16})
    longer = cord.replace(
        length=2.0 * cord.length,
        com=2.0 * cord.com,
        mass=2.0 * cord.mass,
        tip_mass=0.04,
        inertia=8.0 * cord.inertia,
        name="cord, changed",
    )
    np.testing.assert_allclose(session.rope.inertia, longer.inertia, rtol=1e-12)
    assert session.rope.replace(inertia=longer.inertia, mass=longer.mass, tip_mass=0.04) == longer
    assert session.scene()["rope"] == "cord, changed, 2 m, 160 g, 3 links"
    session.change({"length": 1.0, "mass": cord.total_mass})
    assert session.rope == cord
    session.change({"friction": 0.004, "arm_length": 0.3})
    assert session.rope == cord.replace(friction=0.004, name="cord, changed")
    assert session.arm == hf.Arm(length=0.3, mass=0.1, com=0.1)
    session.change({"links": 20})
    assert session.rope.n_links == 20
    assert session.rope.total_mass == pytest.approx(cord.total_mass)
    assert (session.rope.tip_mass, session.rope.gravity.tolist()) == (0.02, [0.0, -3.7])
    session.hang()
    assert session.setup.rope == session.rope
