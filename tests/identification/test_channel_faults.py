"""Faults that a fit's residuals show: a zero that moves or is off, a link that is late, smoothed samples."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.identification import Kind
from tests.identification.twins import QUICK

T = np.arange(600) / 60.0
NOISE = {"angles": 3e-3, "markers": 1e-3}  # rad, m
CHANNEL_FAULTS = (Kind.JUMP, Kind.LINK_ZERO, Kind.LINK_LATE, Kind.SMOOTHED)
each_draw = pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])


def rope(n, **more):
    properties = {"length": [0.3, 0.25], "mass": [0.1, 0.06], "com": [0.14, 0.13], "inertia": [8e-4, 3.5e-4]}
    return hf.Rope(**{name: values[:n] for name, values in properties.items()}, friction=3e-4, **more)


def swing(n, kind="angles", late=0.0, seed=0, amplitude=1.0, **more):
    """Return channels of n links from 0.5 and 0.8 rad; those of the last link are as late as given, s."""

    def at(t):
        q0 = amplitude * np.array([0.5, 0.8])[:n]
        run = hf.simulate(rope(n, **more), duration=float(t[-1]), t_eval=t, q0=q0, tol=1e-8)
        return run.q if kind == "angles" else run.joints.reshape(len(t), -1)

    data = at(T + 0.1)
    if late:
        data = np.column_stack([data[:, :-1], at(T + 0.1 - late)[:, -1]])
    return data + NOISE[kind] * np.random.default_rng(seed).standard_normal(data.shape)


def identified(n, data, kind="angles", **more):
    guess = rope(n).replace(friction=1e-3, inertia=1.2 * rope(n).inertia)
    return hf.identify(hf.Recording(T, data, kind=kind), guess, options=QUICK, **more)


def moved(data, column, size):
    return data + size * (np.arange(len(data)) >= 250)[:, None] * (np.arange(data.shape[1]) == column)


@pytest.mark.parametrize(
    ("n", "kind", "column", "name"),
    [
        pytest.param(1, "angles", 0, "angle of link 0", marks=pytest.mark.nightly),
        (2, "angles", 1, "angle of link 1"),
        (1, "markers", 2, "x of marker 1"),
        pytest.param(2, "markers", 4, "x of marker 2", marks=pytest.mark.nightly),
    ],
)
def test_a_zero_that_moves_by_five_deviations_is_named(n, kind, column, name):
    """Far less than single samples show; its size is found to the noise of 600 samples, and less than a frame off."""
    size = 5.0 * NOISE[kind]
    data = moved(swing(n, kind), column, size)
    assert hf.Recording(T, data, kind=kind).check() == []
    first = identified(n, data, kind).findings[0]
    assert first.kind is Kind.JUMP
    assert first.values["channel"] == name
    assert first.values["size"] == pytest.approx(size, rel=0.15)
    assert first.values["time"] == pytest.approx(T[250], abs=0.05)


def test_a_link_10_ms_late_is_named_first():
    found = identified(2, swing(2, late=0.01))
    first = found.findings[0]
    assert first.kind is Kind.LINK_LATE
    assert first.values["link"] == 1
    assert first.values["delay"] == pytest.approx(0.01, rel=0.1)
    assert "late" in found.report().splitlines()[1]


def test_a_zero_of_one_link_that_is_off_is_named_first():
    first = identified(2, swing(2) + np.array([0.0, 0.03])).findings[0]
    assert first.kind is Kind.LINK_ZERO
    assert first.values["link"] == 1
    assert first.values["angle"] == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("kind", ["angles", pytest.param("markers", marks=pytest.mark.nightly)])
def test_smoothed_samples_are_named_first_and_free_no_spring(kind):
    """A mean over 9 frames; springs that the guess has not explain as much, and moved J/p1 by 8 % when freed for it."""
    data = swing(2, kind)
    smooth = np.stack([np.convolve(column, np.full(9, 1.0 / 9.0), "same") for column in data.T], axis=1)[4:-4]
    guess = rope(2).replace(friction=1e-3, inertia=1.2 * rope(2).inertia)
    found = hf.identify(hf.Recording(T[4:-4], smooth, kind=kind), guess, options=QUICK)
    first = found.findings[0]
    assert first.kind is Kind.SMOOTHED
    assert first.values["width"] == pytest.approx(9.0 / 60.0, rel=0.1)
    np.testing.assert_allclose(found.ratios["J/p1"], hf.identification.ratios(rope(2))["J/p1"], rtol=0.02)


def test_a_spring_is_no_smoothing():
    assert not identified(2, swing(2, stiffness=[2e-3, 8e-3])).has(Kind.SMOOTHED)


@each_draw
@pytest.mark.parametrize(
    ("kind", "omitted"),
    [
        ("angles", {}),
        ("markers", {"drag": 0.02}),
        ("angles", {"dry_friction": 2e-4}),
        *(
            pytest.param(kind, omitted, marks=pytest.mark.nightly)
            for kind, omitted in (("markers", {}), ("angles", {"drag": 0.02}), ("markers", {"dry_friction": 2e-4}))
        ),
    ],
)
def test_right_recordings_and_errors_of_the_model_are_no_fault_of_a_channel(kind, omitted, seed):
    found = identified(2, swing(2, kind, seed=seed, **omitted), kind, free=["inertia", "friction"])
    assert not any(map(found.has, CHANNEL_FAULTS))


@each_draw
def test_a_marker_that_errs_along_its_link_is_no_jump(seed):
    """y of a marker barely rotates a link in a small swing: its pattern is that of the fit, not of noisy angles."""
    data = swing(1, "markers", seed=seed, amplitude=0.3)
    assert not any(map(identified(1, data, "markers").has, CHANNEL_FAULTS))
