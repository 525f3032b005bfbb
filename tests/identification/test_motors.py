"""Measured torque that drives the joints: constants, scales, and the results of a motor on a pendulum.

The twins' data come from equations in closed form (tests/reference/motors.py), not from the model that is fitted.
"""

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_splrep

import hyperflex as hf
from hyperflex.identification import FitOptions, Identification, Kind, RecordingSetup
from hyperflex.identification.model import lumped
from tests.identification.twins import WHOLE_QUICK
from tests.reference.motors import Pendulum, single
from tests.refusals import refuses

NOISE, RATE, TIME = 2e-3, 100.0, 6.0  # rad, 1/s, s
KT, WRONG = 0.05, 1.1  # N m/A, and by what factor it is declared wrong
ONE = single(0.5, 0.6, 0.42, 0.012, viscous=0.02)
TWO = Pendulum((0.3, 0.25), (0.3, 0.2), (0.16, 0.12), (2e-3, 1e-3), (4e-3, 2e-3))
DRY = single(0.5, 0.6, 0.42, 0.012, viscous=0.02, dry=0.05)
SIZES = {1: (2.1, 0.0), 2: (0.45, 0.15)}  # N m, of the motors' torques
EXACT: dict[str, Any] = {"length_std": 0.0, "clock_std": 0.0, "train": np.inf}


def recorded(pendulum: Pendulum, links: int, seed: int) -> tuple[hf.Recording, np.ndarray]:
    """Return noisy angles and the motors' currents, A, of a draw: sums of three sines each."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(TIME * RATE)) / RATE
    waves = [np.sin(2.0 * np.pi * rng.uniform(0.3, 1.5, 3) * t[:, None] + rng.uniform(0.0, 6.3, 3)) for _ in range(2)]
    torque = np.stack([size * wave.mean(axis=1) for size, wave in zip(SIZES[links], waves, strict=True)], axis=1)
    start = np.where(np.arange(2) < links, rng.uniform(-0.5, 0.5, 2), 0.0)
    y = pendulum.run(t, lambda s: np.array([np.interp(s, t, each) for each in torque.T]), start, np.zeros(2), 2e-3)
    q = y[:, :links] + NOISE * rng.standard_normal((t.size, links))
    return hf.Recording(t, q, noise=NOISE), torque[:, :links] / KT


def guess_of(pendulum: Pendulum, links: int, mass: float = 1.3) -> hf.Rope:
    own = {name: np.array(getattr(pendulum, name)[:links]) for name in ("length", "mass", "com", "inertia")}
    return hf.Rope(**own | {"mass": mass * own["mass"], "inertia": 1.5 * own["inertia"]}, friction=[0.01] * links)


def truth_of(pendulum: Pendulum, links: int) -> dict[str, float]:
    names = {"mass": "mass", "inertia": "inertia", "friction": "viscous", "dry_friction": "dry"}
    known = {f"{name}[{k}]": getattr(pendulum, own)[k] for name, own in names.items() for k in range(links)}
    return known | {f"torque_constant[{k}]": KT for k in range(links)}


def fit(pendulum: Pendulum, links: int, seed: int, free: list[str] | None, **more: Any) -> Identification:
    """Identify a draw whose torque constant is declared 10 % too large, and known to 10 %."""
    recording, current = recorded(pendulum, links, seed)
    setup = RecordingSetup(torque=current, torque_constant=WRONG * KT)
    options = FitOptions(**{**EXACT, "torque_std": 0.1, **more})
    known = free is not None and "mass" not in free
    return hf.identify(recording, guess_of(pendulum, links, 1.0 if known else 1.3), free, setup=setup, options=options)


def inside(found: Identification, truth: dict[str, float]) -> dict[str, bool]:
    return {name: truth[name] in each for name, each in found.intervals.items() if name in truth}


SCALED, KNOWN = ["mass", "inertia", "friction"], ["inertia", "friction", "torque_constant"]


@pytest.mark.parametrize(("pendulum", "links"), [(ONE, 1), (TWO, 2)])
def test_a_wrong_constant_moves_all_masses_and_is_in_their_intervals(pendulum, links):
    found = fit(pendulum, links, 0, SCALED)
    truth = truth_of(pendulum, links)
    assert found.success
    assert all(inside(found, truth).values())
    np.testing.assert_allclose(found.rope.mass, WRONG * np.array(pendulum.mass[:links]), rtol=0.01)
    assert found.std["mass"] == pytest.approx(0.1 * found.rope.mass, rel=0.05)
    p, inertia = lumped(guess_of(pendulum, links, 1.0).replace(inertia=pendulum.inertia[:links]))
    assert found.ratios["J/p1"][0] == pytest.approx(inertia[0] / p[0], abs=4.0 * found.ratio_std["J/p1"][0])


def test_what_is_known_of_the_constant_is_a_prior():
    """With free masses and a free constant only the prior determines the scale: for two motors by their mean."""
    one, two = (fit(each, n, 1, [*SCALED, "torque_constant"]) for each, n in ((ONE, 1), (TWO, 2)))
    assert one.values["torque_constant"] == pytest.approx([WRONG * KT], rel=0.01)
    assert one.std["torque_constant"] == pytest.approx(0.1 * one.values["torque_constant"], rel=0.05)
    assert two.std["torque_constant"] == pytest.approx(0.1 / np.sqrt(2.0) * two.values["torque_constant"], rel=0.05)
    assert all(inside(one, truth_of(ONE, 1)).values())
    assert all(inside(two, truth_of(TWO, 2)).values())


@pytest.mark.parametrize(("pendulum", "links"), [(ONE, 1), (TWO, 2)])
def test_a_known_mass_tells_the_constant(pendulum, links):
    found = fit(pendulum, links, 2, KNOWN)
    assert found.values["torque_constant"] == pytest.approx([KT] * links, rel=0.004)
    assert (found.std["torque_constant"] < 0.002 * KT).all()


@pytest.mark.nightly
@pytest.mark.parametrize(("pendulum", "links"), [(ONE, 1), (TWO, 2)])
@pytest.mark.parametrize("free", [SCALED, KNOWN])
def test_intervals_contain_the_truth(pendulum, links, free):
    """20 draws: of a right 95 % interval fewer than 16 have a chance of 0.3 %."""
    counts: dict[str, int] = {}
    for seed in range(20):
        found = fit(pendulum, links, 100 + seed, free, intervals="covariance")
        for name, there in inside(found, truth_of(pendulum, links)).items():
            counts[name] = counts.get(name, 0) + there
    assert min(counts.values()) >= 16, counts


def test_dry_friction_of_the_drive_is_found():
    """By default masses are free with a torque, and the score test frees the dry friction."""
    found = fit(DRY, 1, 3, None, torque_std=0.02)
    assert "dry_friction" in found.settings["free"]
    assert found.rope.dry_friction[0] / found.rope.mass[0] == pytest.approx(0.05 / 0.6, rel=0.03)


def test_gaps_in_the_torque_and_a_late_torque():
    recording, current = recorded(ONE, 1, 4)
    late = np.interp(recording.t + 0.03, recording.t, current[:, 0])
    late[100:103] = np.nan
    setup = RecordingSetup(torque=KT * late)
    found = hf.identify(recording, guess_of(ONE, 1), [*SCALED, "delay"], setup=setup, options=FitOptions(**EXACT))
    assert float(found.values["delay"]) == pytest.approx(0.03, abs=1e-3)
    assert found.rope.mass[0] == pytest.approx(0.6, rel=0.02)


def test_refused():
    recording, current = recorded(TWO, 2, 0)
    refuses("torque_joints do not fit", RecordingSetup, torque=current, torque_joints=[0, 0])
    refuses("torque_joints do not fit", RecordingSetup, torque=current[:, 0], torque_joints=[0, 1])
    refuses(r"torque_constant\[0\] cannot be used", RecordingSetup, torque=current, torque_constant=-1.0)
    refuses("that of the arm's motor", RecordingSetup, hf.hold_arm(0.0), hf.Arm(0.1), torque=current)
    refuses("without the arm", RecordingSetup, hf.hold_arm(0.0), torque=current[:, 0])
    guess, beyond = guess_of(TWO, 2), RecordingSetup(torque=current[:, 0], torque_joints=[2])
    refuses("a joint that the rope does not have", hf.identify, recording, guess, ["friction"], setup=beyond)
    exact = FitOptions(torque_std=0.0)
    how: dict[str, Any] = {"setup": RecordingSetup(torque=current), "options": exact}
    refuses("torque_constant is free, but torque_std is 0", hf.identify, recording, guess, ["torque_constant"], **how)
    refuses("no torque is measured", hf.identify, recording, guess, ["torque_constant"])
    empty = RecordingSetup(torque=np.full(recording.t.size, np.nan))
    refuses("only gaps", hf.identify, recording, guess, ["friction"], setup=empty)


@pytest.mark.nightly
def test_the_rotor_of_an_inner_motor_is_taken_off_its_torque():
    """A rotor of known inertia turns with the joint: what accelerates it does not reach the links."""
    rotor = 1.5e-3  # kg m^2, as the gear reflects it: half of the second link's own about its joint
    turning = TWO._replace(rotor=(0.0, rotor))
    recording, current = recorded(turning, 2, 6)
    t, torque = recording.t, KT * current
    joint = make_splrep(t, np.diff(recording.data, axis=1)[:, 0], k=5, s=2.0 * t.size * NOISE**2)
    guess, options = guess_of(TWO, 2, 1.0), FitOptions(**EXACT, intervals="covariance")
    net = torque - np.outer(joint(t, 2), [0.0, rotor])
    found, plain = (
        hf.identify(recording, guess, SCALED, setup=RecordingSetup(torque=each), options=options)
        for each in (net, torque)
    )
    own = found.rope.inertia + found.rope.mass * found.rope.com**2
    about = np.array([i + m * a**2 for i, m, a in zip(TWO.inertia, TWO.mass, TWO.com, strict=True)])
    np.testing.assert_allclose(own, about, rtol=0.03)  # of the accelerations, which are off by some percent
    assert plain.rope.inertia[1] + plain.rope.mass[1] * plain.rope.com[1] ** 2 > 1.2 * about[1]


@pytest.mark.parametrize("given", [True, False])
def test_a_default_com_that_scales_the_mass_is_reported_and_leaves_ratios(given: bool) -> None:
    """A mass of 0.6 kg at 0.42 m seems 1.008 kg at the default of 0.25 m: the torque determines their product."""
    recording, current = recorded(ONE, 1, 3)
    guess = hf.Rope(length=[0.5], mass=[0.5], com=[0.42] if given else None, friction=0.02)
    options = WHOLE_QUICK
    found = hf.identify(recording, guess, setup=RecordingSetup(torque=KT * current), options=options)
    assert found.rope.mass[0] * found.rope.com[0] == pytest.approx(0.6 * 0.42, rel=1e-2)
    assert found.grade == ("usable" if given else "usable for ratios")
    (com,) = [each for each in found.findings if each.kind is Kind.COM_HELD]
    assert com.values["moved"] == pytest.approx(1.0 - 1.0 / 1.01)
    assert ("held at 0.25 m, its default of half the length" in found.report()) == (not given)


def test_what_few_samples_leave_open_is_not_usable() -> None:
    """0.4 s of a slow torque: mass 0.5 +- 0.3 kg, J/p1 1.1 +- 0.8 m."""
    recording, current = recorded(ONE, 1, 3)
    few = hf.Recording(recording.t[:40], recording.data[:40])
    guess, setup = hf.Rope(length=[0.5], mass=[0.6], friction=0.02), RecordingSetup(torque=KT * current[:40])
    found = hf.identify(few, guess, setup=setup, options=WHOLE_QUICK)
    assert found.findings[0].kind is Kind.NOTHING_KNOWN
