"""What hides behind something else, or is hardly off: held by the intervals, and said."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import hyperflex as hf
from hyperflex.identification import Identification, ratios
from hyperflex.identification.diagnosis.grade import grade
from hyperflex.identification.diagnosis.score_tests import ScoreTest

ROPE = hf.Rope(length=[0.4, 0.2], mass=[0.15, 0.05], com=[0.21, 0.09], inertia=[2.2e-3, 2e-4], friction=[4e-4, 5e-5])
GUESS = ROPE.replace(inertia=[1.5e-3, 3e-4], com=[0.2, 0.1], friction=1e-4)
T = np.arange(600) / 100.0


def fitted(rope: hf.Rope, free: Sequence[str] | None, noise: float, drift: float = 0.0) -> Identification:
    """A fit of angles by a clock that goes too slowly, the more so the later."""
    q = hf.simulate(rope, duration=T[-1], t_eval=T, q0=[1.1, -0.4], tol=1e-9).q
    q = q + noise * np.random.default_rng(7).standard_normal(q.shape)
    return hf.identify(hf.Recording(T * (1.0 + drift * T / T[-1]), q), GUESS, free, intervals=None)


def away(found: Identification) -> float:
    """Return how many standard deviations ratios are from the truth, at most."""
    truth = ratios(ROPE)
    parts = [np.abs(found.ratios[k] - truth[k]) / np.maximum(found.ratio_std[k], 1e-9) for k in ("J/p1", "p/p1")]
    return float(np.max(parts))


def test_centres_of_mass_that_are_wrong_show_behind_a_stiffness() -> None:
    found = fitted(ROPE.replace(stiffness=[0.02, 0.01]), None, 1e-3)
    assert found.settings["free"] == ["inertia", "friction", "stiffness", "com"]
    assert away(found) < 3.0


def test_a_clock_that_drifts_is_told_and_in_the_deviations() -> None:
    found = fitted(ROPE, ["inertia", "com", "friction"], 2e-3, drift=0.05)
    assert str(found.grade).startswith("Do not use: the clock drifts")
    assert away(found) < 3.0


def test_lengths_within_what_a_ruler_errs_make_no_result_useless() -> None:
    def graded(scale: float) -> str:
        test = ScoreTest("gravity_scale", 0.9, np.array([scale]), moved=0.03, std=1e-3)
        return str(grade([], ROPE, None, [test], identifiable=False))

    assert (
        graded(0.994)
        == "Usable for ratios: lengths seem 0.6 % off, or times half of that; ratios would move by up to 3 %."
    )
    assert graded(0.98).startswith("Do not use: times or lengths are not as declared")
