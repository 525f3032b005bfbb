"""The grammar of error messages: what was wrong, the value got, what is allowed, what to do; each part a sentence."""

import pytest

from hyperflex import checks
from hyperflex.errors import InvalidInput, located


def test_a_message_is_joined_of_its_parts():
    error = InvalidInput("mass is negative", got=-1.0, allowed="numbers >= 0", fix="Weigh it again")
    assert str(error) == "mass is negative: got -1.0. Allowed: numbers >= 0. Weigh it again."
    assert str(InvalidInput("mass is negative")) == "mass is negative."
    assert str(InvalidInput("nothing moves", got=0.0, fix="Is it on?")) == "nothing moves: got 0.0. Is it on?"
    assert str(InvalidInput("two", allowed="x.", fix="Do so.")) == "two. Allowed: x. Do so."  # no double full stop
    with pytest.raises(InvalidInput, match=r"^rope\.toml: two: got 1\. Allowed: one\.$"), located("rope.toml"):
        raise InvalidInput("two", got=1, allowed="one")
    assert str(InvalidInput("two", allowed="x0, y0, ..")) == "two. Allowed: x0, y0, .."
    with pytest.raises(InvalidInput, match="Perhaps 'tol' is meant"):
        checks.keys("a set-up", ["tolerance"], ["tol", "torque"])
    long = str(InvalidInput("name " * 9000, got="a" * 9000, allowed="b" * 9000, fix="c" * 9000 + " and look"))
    assert len(long) < 2000
    assert long.endswith("c and look.")
