"""A free length: of a uniform link centre of mass and inertia go with it, so that the fitted rope can be cut again."""

from typing import Any

import numpy as np
import pytest

from hyperflex import Rope, identify
from hyperflex.identification import FitOptions
from hyperflex.identification.model import Parameters, parse
from hyperflex.model import divided
from tests.identification.twins import recorded

GUESS = Rope.uniform(length=0.6, mass=0.09, n_links=3, radius=0.02, friction=2e-4)
LAWS = ["length", "length[1]", "length:shared", "length:factor", "length:taper"]


def freed(rope: Rope, *free: str) -> Parameters:
    return Parameters(rope, parse(rope, free))


def test_a_longer_cylinder_is_a_cylinder():
    """The reference is the formula that a rope's own inertia comes from: m (3 r^2 + l^2) / 12."""
    parameters = freed(GUESS, "length")
    new = np.array([0.25, 0.2, 0.11])
    found = parameters.rope(np.log(new))
    made = Rope(length=new, mass=GUESS.mass, radius=0.02, friction=2e-4)
    np.testing.assert_allclose(found.com, made.com, rtol=1e-14)
    np.testing.assert_allclose(found.inertia, made.inertia, rtol=1e-12)
    assert parameters.rope(np.log(GUESS.length)).inertia[1] == pytest.approx(GUESS.inertia[1], rel=1e-14)


def test_what_is_free_itself_stays_and_a_mass_keeps_its_part_of_the_length():
    com, inertia = GUESS.com * [1.0, 1.0, 1.1], GUESS.inertia
    rope = GUESS.replace(com=com)
    x = np.log(1.2 * GUESS.length)
    found = freed(rope, "length", "com[0]", "inertia[1]").rope(np.concatenate([x, [com[0] / 0.2], [0.0]]))
    np.testing.assert_allclose(found.com, [com[0], 1.2 * com[1], 1.2 * com[2]], rtol=1e-14)
    assert (found.inertia[[0, 2]] > 1.3 * inertia[[0, 2]]).all()
    assert found.inertia[1] == 0.0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("others", [(), ("com[1]",), ("inertia:factor",), ("com", "mass")])
def test_parts_are_derivatives_of_the_rope(law, others):
    parameters = freed(GUESS, law, *others)
    x, h = parameters.start + 0.1, 1e-6
    for k, part in parameters.parts(x):
        step = h * np.eye(len(parameters))[k]
        up, down = parameters.rope(x + step), parameters.rope(x - step)
        for name in ("length", "com", "inertia", "mass"):
            by = (getattr(up, name) - getattr(down, name)) / (2.0 * h)
            # rounding of 1e-16 over 2e-6, of values below 1; the third derivative adds 1e-12
            np.testing.assert_allclose(
                part.get(name, np.zeros(3)), by, atol=1e-9 * getattr(up, name).max(), err_msg=name
            )


def test_a_rope_of_fitted_length_can_be_cut():
    """A twin 4 % longer than the guess, seen by its angles for 2 s."""
    true = Rope.uniform(length=0.624, mass=0.09, n_links=3, radius=0.02, friction=3e-4)
    recording = recorded(true, [0.9, 0.6, 1.2], np.arange(121) / 60.0, 1e-3)
    free: list[str] = ["length:factor", "friction:factor"]
    whole: dict[str, Any] = {"window": np.inf, "train": np.inf, "intervals": None}
    found = identify(recording, GUESS, free, options=FitOptions(clock_std=0.0, **whole))
    assert found.success
    factor, std = float(found.values["length:factor"]), float(found.std["length:factor"])
    assert abs(factor - 1.04) < 4.0 * std < 0.004  # held centres of mass leave it 3 % away
    clock = identify(recording, GUESS, free, options=FitOptions(clock_std=0.005, **whole)).std["length:factor"]
    assert (
        0.008 < float(clock) / factor <= 0.01
    )  # twice clock_std: times x a and lengths x a^2 give nearly the same motion
    assert divided(found.rope, 2).n_links == 6
    np.testing.assert_allclose(found.rope.inertia, true.inertia, rtol=0.01)
