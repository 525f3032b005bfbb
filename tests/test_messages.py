"""The grammar of error messages: the mistake, the value, the allowed values, the remedy; each part is a sentence."""

import pickle

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import checks, errors
from hyperflex.errors import InvalidInput, located
from hyperflex.status import Status
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=2, radius=0.002, friction=1e-3)


def test_a_message_is_joined_of_its_parts():
    error = InvalidInput("mass is negative", got=-1.0, allowed="numbers >= 0", fix="Weigh it again")
    assert str(error) == "mass is negative: got -1.0. Allowed: numbers >= 0. Weigh it again."
    assert str(InvalidInput("mass is negative")) == "mass is negative."
    assert str(InvalidInput("nothing moves", got=0.0, fix="Is it on?")) == "nothing moves: got 0.0. Is it on?"
    assert str(InvalidInput("two", allowed="x.", fix="Do so.")) == "two. Allowed: x. Do so."  # no double full stop
    with pytest.raises(InvalidInput, match=r"^rope\.toml: two: got 1\. Allowed: one\.$"), located("rope.toml"):
        raise InvalidInput("two", got=1, allowed="one")
    assert str(InvalidInput("two", allowed="x0, y0, ..")) == "two. Allowed: x0, y0, .."
    refuses("Perhaps 'tol' is meant", checks.keys, "a set-up", ["tolerance"], ["tol", "torque"])
    long = str(InvalidInput("name " * 9000, got="a" * 9000, allowed="b" * 9000, fix="c" * 9000 + " and look"))
    assert len(long) < 2000
    assert long.endswith("c and look.")


@pytest.mark.parametrize(
    ("call", "advice"),
    [
        (
            lambda: hf.simulate(ROPE, hf.arm_swings(), arm=0.2, duration=0.1),
            r"arm is no Arm: got 0\.2.*hyperflex\.Arm\(0\.2\)",
        ),
        (
            lambda: hf.simulate(ROPE, np.zeros(9), arm=hf.Arm(), duration=0.1),
            r"motion is no Motion.*sampled_motion\(t, angle\)",
        ),
        (lambda: hf.Rope(1.0, 0.06), r"how many links.*Rope\.uniform"),
        (lambda: hf.Rope.uniform(1.0, 0.06, 30.5, friction=0.0), r"n_links is not a usable count: got 30\.5"),
        (lambda: hf.identify(ROPE, hf.Recording(np.arange(9.0), np.zeros((9, 2)))), "A Rope is given: check the order"),
        (lambda: hf.Peg(0.5, -0.5, 0.04, friction=0.3), r"Peg\(\) does not know.*'friction'.*It belongs in mu="),
        (lambda: hf.Ground(0.0, -1.0, friction=0.3), "It belongs in mu="),
    ],
)
def test_the_error_for_a_wrong_type_states_how_to_make_the_right_one(call, advice):
    refuses(advice, call)


def test_what_is_plainly_meant_is_taken():
    """One angle for all links, of a run, a batch and a rope that is cut near a peg; 30.0 links."""
    assert hf.Rope.uniform(1.0, 0.06, 30.0, friction=0.0) == hf.Rope.uniform(1.0, 0.06, 30, friction=0.0)
    every, peg = np.full(2, 0.5), [hf.Peg(0.0, -0.8, 0.02)]
    for obstacles in ([], peg):
        one, other = (hf.simulate(ROPE, duration=0.1, q0=q0, pegs=obstacles) for q0 in (0.5, every))
        np.testing.assert_array_equal(one.q, other.q)
        assert one.q.shape[1] > 2 or not obstacles
    batch = hf.simulate_batch([ROPE] * 2, duration=0.1, q0=0.5)
    np.testing.assert_array_equal(batch.tip, hf.simulate_batch([ROPE] * 2, duration=0.1, q0=every).tip)


@pytest.mark.parametrize(
    "error",
    [
        errors.SimulationError("too small", status=Status.STEP_TOO_SMALL, time=0.3),
        InvalidInput("mass is negative", got=-1.0, allowed="numbers >= 0", fix="Weigh it again"),
        *(
            kind("what was wrong")
            for kind in errors.HyperflexError.__subclasses__()
            if kind.__init__ is Exception.__init__
        ),
        errors.FileProblem("no space"),
        errors.MissingPackage("no package"),
    ],
    ids=lambda each: type(each).__name__,
)
def test_errors_come_back_from_another_process_as_they_were(error):
    """An error that cannot be unpickled breaks the pool of processes in which it is raised."""
    back = pickle.loads(pickle.dumps(error))
    assert (type(back), str(back), vars(back)) == (type(error), str(error), vars(error))
    assert pickle.loads(pickle.dumps(errors.Interrupted(lambda: 3))).partial == 3
