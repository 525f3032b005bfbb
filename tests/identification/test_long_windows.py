"""Windows as long as the motion can be predicted: whole recordings of regular swings, short ones of chaotic motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hyperflex as hf
from hyperflex.identification import Kind
from tests.identification.twins import recorded

G, LENGTH, MASS = 9.81, 0.9, 0.05
EXACT = hf.FitOptions(length_std=0.0, clock_std=1e-4)


def string(seconds: float, drag: float = 0.0, clock: float = 1.0, swing: float = 0.35) -> hf.Recording:
    """A point mass on a string, filmed at 30 frames/s with 1 mm of noise; scipy integrates its equation (a twin)."""
    t = np.arange(0.0, seconds, 1.0 / 30.0)
    inertia, viscous = MASS * LENGTH**2, 1e-4

    def slope(_: float, y: np.ndarray) -> list[float]:
        torque = -viscous * y[1] - drag * y[1] * abs(y[1])
        return [y[1], torque / inertia - G / LENGTH * np.sin(y[0])]

    angle = solve_ivp(slope, (0.0, t[-1]), [swing, 0.0], t_eval=t, rtol=1e-10, atol=1e-12, method="DOP853").y[0]
    places = np.column_stack([0.0 * t, 0.0 * t, LENGTH * np.sin(angle), -LENGTH * np.cos(angle)])
    noise = 1e-3 * np.random.default_rng(int(seconds)).standard_normal(places.shape)
    return hf.Recording(clock * t, places + noise, kind="markers")


GUESS = hf.Rope(length=[LENGTH], mass=[MASS], com=[LENGTH], inertia=[1e-5], friction=[3e-4])


@pytest.mark.parametrize("seconds", [1, 2, 5, 20, pytest.param(140, marks=pytest.mark.nightly)])
def test_a_regular_swing_is_one_window_and_its_ratio_is_right(seconds):
    """J/p1 of a point mass is the string's length."""
    found = hf.identify(string(seconds), GUESS, options=EXACT)
    assert found.grade == "usable for ratios"
    assert found.settings["windows"] == 1
    assert LENGTH in found.intervals["J/p1[0]"]
    assert 1e-4 in found.intervals["friction[0]"]


def test_a_swing_that_is_small_beside_its_noise_is_one_window():
    """White residuals of a tenth of the motion are noise: short windows would leave J/p1 known ten times worse."""
    found = hf.identify(string(20, swing=0.016), GUESS, options=EXACT)
    assert found.settings["windows"] == 1
    assert LENGTH in found.intervals["J/p1[0]"]
    noise, seconds = np.sqrt(2.0) * 1e-3 / LENGTH, found.settings["fitted_to"]
    rate = np.sqrt(24.0 / (30.0 * seconds)) * noise / 0.016 / seconds  # rad/s, of a tone (Rife and Boorstyn 1974)
    least = 2.0 * rate / np.sqrt(G / LENGTH) * LENGTH
    assert found.ratio_std["J/p1"][0] == pytest.approx(least, rel=0.1)  # 16 s are no whole number of periods


def test_places_tell_more_than_directions_from_marker_to_marker():
    """These have the noise of both ends. On the first joint a marker has no motion that its noise is a part of."""
    exact, markers = hf.FitOptions(length_std=0.0, clock_std=0.0), string(5)
    setups = (hf.RecordingSetup(), hf.RecordingSetup(arc_lengths=[0.0, LENGTH]))
    both = [hf.identify(markers, GUESS, ["inertia", "friction"], setup=each, options=exact) for each in setups]
    directions, places = (each.ratio_std["J/p1"][0] for each in both)
    assert directions / places == pytest.approx(np.sqrt(2.0), rel=0.1)  # 5 s tell their own noise to 4 %
    assert [each.grade for each in both] == ["usable for ratios"] * 2
    assert LENGTH in both[1].intervals["J/p1[0]"]


@pytest.mark.nightly
def test_a_decay_that_depends_on_the_amplitude_is_distinguished_from_viscous_friction():
    """Drag is freed since the data require it, and J/p1 is as narrow as without."""
    found = hf.identify(string(140, drag=4e-4), GUESS, options=EXACT)
    assert found.settings["free"] == ["inertia", "friction", "drag"]
    assert LENGTH in found.intervals["J/p1[0]"]
    assert 1e-4 in found.intervals["friction[0]"]


def test_windows_of_a_tumbling_pendulum_stay_short():
    """Errors grow exponentially: joined windows would fit amplified noise (simulated)."""
    rope = hf.Rope(length=[0.2, 0.2], mass=[0.1, 0.1], com=[0.1, 0.1], inertia=[5e-4, 5e-4], friction=[1e-5, 1e-5])
    recording = recorded(rope, [2.6, 2.9], np.arange(600) / 100.0, 2e-3)
    found = hf.identify(recording, rope.replace(friction=3e-5), ["inertia", "com", "friction"])
    assert found.settings["window"] < 2.0
    truth = hf.identification.ratios(rope)["J/p1"]
    assert all(value in found.intervals[f"J/p1[{k}]"] for k, value in enumerate(truth))


def test_a_clock_that_is_off_makes_a_string_too_long():
    """Its length is known, and so is gravity: J/p1 beyond it is a mistake, and not a property of the string."""
    found = hf.identify(string(10, clock=1.0 / 0.93), GUESS, options=EXACT)
    assert found.grade == "do not use"
    assert found.findings[0].kind is Kind.MASS_FAR
    assert found.findings[0].values["clock"] == pytest.approx(0.93, abs=2e-3)


def test_the_length_of_a_string_follows_from_its_swing():
    """The mass stays at the end of a string of another length."""
    guess = GUESS.replace(length=[1.05 * LENGTH], com=[1.05 * LENGTH])
    setup = hf.RecordingSetup(arc_lengths=[LENGTH], origin=(0.0, 0.0))
    whole = string(20)
    recording = hf.Recording(whole.t, whole.data[:, 2:], kind="markers")
    found = hf.identify(recording, guess, ["length", "friction"], setup=setup, options=EXACT)
    assert LENGTH in found.intervals["length[0]"]
    assert found.std["length"][0] < 1e-3 * LENGTH


def test_ctrl_c_while_windows_are_joined_is_not_finished():
    """The fit of short windows has converged by then: the result states that it was interrupted."""

    def stop(entry):
        if entry["window"] > 5.0:
            raise KeyboardInterrupt

    with pytest.raises(hf.errors.Interrupted) as caught:
        hf.identify(string(20), GUESS, options=EXACT, progress=stop)
    assert caught.value.partial.status == "interrupted"
    assert not caught.value.partial.success
