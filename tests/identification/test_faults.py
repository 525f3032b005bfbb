"""Faults that samples show by themselves: found before a fit, never where a recording is right, never repaired."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.identification import Kind, Severity
from tests.identification.twins import QUICK
from tests.refusals import refuses

LENGTHS = np.array([0.3, 0.2])
SWING, TUMBLE = ([0.6, 0.4], [0.0, 0.0]), ([2.6, 2.0], [3.0, -5.0])


def recorded(rate=60.0, start=SWING, kind="angles", noise=1e-3, duration=10.0, n=2):
    """A point-mass pendulum of n links, by the simulator, with noise (m)."""
    t = np.arange(round(duration * rate)) / rate
    rope = hf.Rope(LENGTHS[:n], [0.1, 0.1][:n], com=LENGTHS[:n], inertia=1e-7, friction=2e-5)
    q0, qd0 = (each[:n] for each in start)
    q = hf.simulate(rope, duration=float(t[-1]), t_eval=t, q0=q0, qd0=qd0, tol=1e-7).q
    if kind == "angles":
        return hf.Recording(t, noisy(q, noise / LENGTHS.mean()))
    places = np.stack([rope.joints(row, np.zeros(2)) for row in q]).reshape(t.size, -1)
    places[:, 2:] = noisy(places[:, 2:], noise)
    return hf.Recording(t, places, kind="markers")


def noisy(values, size):
    return values + size * np.random.default_rng(0).standard_normal(values.shape)


def spoiled(recording, data=None, t=None):
    return hf.Recording(recording.t if t is None else t, recording.data if data is None else data, kind=recording.kind)


@pytest.mark.parametrize("kind", ["angles", "markers"])
@pytest.mark.parametrize("start", [SWING, TUMBLE], ids=["swing", "tumble"])
@pytest.mark.parametrize("rate", [30.0, 200.0])
def test_right_recordings_have_no_faults(kind, start, rate):
    """Noise, outliers, gaps, coarse sensors and a pivot that is exactly at the origin are none."""
    right = recorded(rate, start, kind)
    random = np.random.default_rng(1)
    outliers = right.data + np.where(random.random(right.data.shape) < 0.03, random.normal(0.0, 0.3), 0.0)
    gaps = np.where(random.random(right.data.shape) < 0.3, np.nan, right.data)
    coarse = np.round(right.data, 2)
    for data in (right.data, outliers, gaps, coarse):
        assert [str(each) for each in spoiled(right, data).check()] == []


@pytest.mark.parametrize("step", [1, 5, 20])
def test_real_recordings_have_no_faults(data_dir, step):
    names = ("triple/Triple", "single/Single")
    real = [hf.read_recording(data_dir / f"multiarm_{each}PendulumDataForParameterEstimation.mat") for each in names]
    for run in ("run06", "run16"):
        path = data_dir / "ibm_double_pendulum" / f"{run}_500Hz.csv"
        markers = hf.read_recording(path, time_unit="s", unit="m", y_axis="up")
        real += [markers, markers.angles()]
    assert [each.decimate(step).check() for each in real] == [[]] * 6


def held_before(right, seconds, lifted=0.0):
    """The recording with a hand before it, which trembles by 1 mm, and may lift the rope from where it hangs."""
    random, step = np.random.default_rng(5), float(right.t[1] - right.t[0])
    before = -np.arange(round(seconds / step), 0, -1) * step
    scale = 1.0 if right.kind == "markers" else LENGTHS.sum()
    tremor = 1e-3 / scale * (np.sin(50.0 * before) + 4.0 * before + random.standard_normal(before.size))
    rest = right.data[0] + np.where(np.ptp(right.data, axis=0) > 0.0, tremor[:, None], 0.0)
    part = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, round(lifted / step)))[:, None]
    hanging = np.median(right.data, axis=0)
    data = np.concatenate([hanging + part * (rest[0] - hanging), rest, right.data])
    return hf.Recording(np.arange(len(data)) * step, data, kind=right.kind)


@pytest.mark.parametrize("start", [SWING, TUMBLE], ids=["swing", "tumble"])
@pytest.mark.parametrize("kind", ["angles", "markers"])
@pytest.mark.parametrize("lifted", [0.0, 0.8])
def test_a_rope_that_was_held_is_named_with_the_time_of_its_release(start, kind, lifted):
    recording = held_before(recorded(60.0, start, kind), 1.0, lifted)
    (found,) = recording.check()
    assert found.kind is Kind.HELD_STILL
    time = found.values["time"]
    assert lifted + 1.0 - 0.05 < time < lifted + 1.0 + 0.2  # the last time at which it has barely moved
    assert f"recording.window({time:.6g}, inf)" in str(found)
    assert recording.window(time, np.inf).check() == []


def test_what_a_hand_did_is_all_that_is_reported():
    guess = hf.Rope(LENGTHS, 0.1, com=LENGTHS, inertia=1e-5, friction=1e-4)
    held = held_before(recorded(duration=4.0), 1.0)
    found = hf.identify(held, guess)
    assert [each.kind for each in found.findings if each.severity > Severity.NOTE] == [Kind.HELD_STILL]
    after = hf.identify(held.window(found.findings[0].values["time"], np.inf), guess)
    assert after.success


def test_a_rope_that_is_driven_may_rest_before_it_moves():
    t, arm = np.arange(300) / 60.0, hf.Arm(length=0.1)
    motion = hf.sampled_motion(t, np.where(t < 3.0, 0.0, 0.5 - 0.5 * np.cos(6.0 * (t - 3.0))))
    rope = hf.Rope(LENGTHS, 0.1, friction=1e-4)
    run = hf.simulate(rope, motion, arm=arm, duration=float(t[-1]), t_eval=t)
    recording = hf.Recording(t, noisy(run.q, 1e-3))
    assert [each.kind for each in recording.check()] == [Kind.HELD_STILL]  # which does not determine a drive
    setup = hf.RecordingSetup(motion=motion, arm=arm)
    found = hf.identify(recording, rope, ["inertia", "friction"], setup=setup, options=QUICK)
    assert not found.has(Kind.HELD_STILL)


def lost(data, columns, where=None):
    data = data.copy()
    data[np.random.default_rng(2).random(len(data)) < 0.05 if where is None else where, columns] = 0.0
    return data


def moved(data, column, size):
    data = data.copy()
    data[len(data) // 2 :, column] += size
    return data


MARKERS, ANGLES, FAST = recorded(kind="markers"), recorded(), recorded(200.0, noise=2e-4)
KEPT = np.flatnonzero(np.arange(2000) % 100 > 0)
STRETCH = np.delete(np.arange(600), slice(240, 258))
SLOW = recorded(50.0, ([0.9, 0.6], [0.0, 0.0]), noise=5e-4)
KEPT_SLOW = np.flatnonzero(np.arange(SLOW.t.size) % 25 > 0)
AGAIN = np.arange(SLOW.t.size) - (np.arange(SLOW.t.size) % 50 == 0)
AGAIN[0] = 0
FILMED = recorded(30.0, ([0.4], [0.0]), "markers", duration=12.0, n=1)
BURST = np.delete(np.arange(FILMED.t.size), slice(150, 170))
HOOKED = noisy(FILMED.data, 1e-3) + np.where(FILMED.t[:, None] > 5.0, [0.03, 0.0, 0.03, 0.0], 0.0)
HALF_LOST = np.random.default_rng(3).random(600) < 0.55
HALF = np.sort(np.random.default_rng(0).permutation(600)[:300])


@pytest.mark.parametrize(
    "recording",
    [
        spoiled(ANGLES, ANGLES.data[HALF], ANGLES.t[HALF]),
        recorded(start=([np.pi - 0.05] * 2, [0.0, 0.0])),
        hf.Recording(np.arange(2000) / 100.0, noisy(np.zeros((2000, 1)), 3e-3)),
    ],
    ids=["uneven times are no missing frames", "a fall from near the top is no release", "nor is noise alone"],
)
def test_what_is_no_fault(recording):
    assert recording.check() == []


def test_a_hook_that_is_knocked_is_not_lost():
    data = MARKERS.data.copy()
    data[:, :2], data[200:230, 0] = 0.0, 0.005
    assert Kind.LOST not in [each.kind for each in spoiled(MARKERS, data).check()]


@pytest.mark.parametrize(
    ("recording", "kind", "said"),
    [
        (spoiled(MARKERS, lost(MARKERS.data, slice(4, 6))), Kind.LOST, "Marker 2: exactly (0, 0) in"),
        (spoiled(ANGLES, lost(ANGLES.data, 1)), Kind.LOST, "Link 1: exactly 0 rad in"),
        (spoiled(MARKERS, lost(MARKERS.data, slice(4, 6), slice(-60, None))), Kind.LOST, "(0, 0) in up to 10 %"),
        (spoiled(MARKERS, lost(MARKERS.data, slice(4, 6), slice(60))), Kind.LOST, "(0, 0) in up to 10 %"),
        (spoiled(MARKERS, lost(MARKERS.data, slice(4, 6), HALF_LOST)), Kind.LOST, "Marker 2: exactly (0, 0) in"),
        (spoiled(MARKERS, np.repeat(MARKERS.data[::2], 2, axis=0)), Kind.REPEATED_FRAMES, "50 % of the frames"),
        (spoiled(MARKERS, np.repeat(MARKERS.data[::4], 4, axis=0)), Kind.REPEATED_FRAMES, "74 % of the frames"),
        (spoiled(ANGLES, np.repeat(ANGLES.data[::3], 3, axis=0)), Kind.REPEATED_FRAMES, "% of the frames repeat"),
        (spoiled(ANGLES, (8.0 * ANGLES.data) % (2.0 * np.pi)), Kind.WRAPPED, "angle of link 0 jumps by whole turns"),
        (spoiled(MARKERS, MARKERS.data[HALF], MARKERS.t[:300]), Kind.UNEVEN_FRAMES, "early or late"),
        (spoiled(ANGLES, ANGLES.data[HALF], ANGLES.t[:300]), Kind.UNEVEN_FRAMES, "early or late"),
        # 25 standard deviations of the noise
        (spoiled(FAST, moved(FAST.data, 1, 0.02)), Kind.JUMP, "The angle of link 1 jumps by 0.0191 rad at t = 4.995 s"),
        (spoiled(MARKERS, moved(MARKERS.data, 4, 0.02)), Kind.JUMP, "The x of marker 2 jumps by"),
        (spoiled(FAST, FAST.data[KEPT], FAST.t[: KEPT.size]), Kind.MISSING_FRAMES, "skips frames at t = 1.48"),
        # 0.3 s of a swing of 1.5 s, which continues differently
        (spoiled(ANGLES, ANGLES.data[STRETCH], ANGLES.t[: STRETCH.size]), Kind.MISSING_FRAMES, "at t = 3.983 s"),
        (spoiled(MARKERS, MARKERS.data[STRETCH], ANGLES.t[: STRETCH.size]), Kind.MISSING_FRAMES, "at t = 3.983 s"),
        (spoiled(FILMED, FILMED.data[BURST], FILMED.t[: BURST.size]), Kind.MISSING_FRAMES, "at t = 4.967 s"),
        (spoiled(FILMED, HOOKED), Kind.JUMP, "The x of all markers jumps by"),
        (spoiled(SLOW, SLOW.data[KEPT_SLOW], SLOW.t[: KEPT_SLOW.size]), Kind.MISSING_FRAMES, "skips frames at t ="),
        (spoiled(SLOW, SLOW.data[AGAIN]), Kind.REPEATED_FRAMES, "of the frames repeat the frame before"),
    ],
)
def test_faults_are_found(recording, kind, said):
    before = recording.data.copy()
    (found,) = recording.check() if kind is not Kind.WRAPPED else recording.check()[:1]
    assert found.kind is kind
    assert said in str(found)
    assert (recording.data == before).all()


def test_wrapped_angles_are_refused_at_once():
    wrapped = spoiled(ANGLES, (5.0 * ANGLES.data + np.pi) % (2.0 * np.pi) - np.pi)
    refuses(r"jumps by whole turns.*wrapped=True", hf.identify, wrapped, hf.Rope(LENGTHS, 0.1))


SINGLE = hf.Rope(LENGTHS[:1], [0.1], com=LENGTHS[:1], inertia=1e-5, friction=1e-4)


def test_faults_come_first_in_a_report():
    right = recorded(n=1, kind="markers", duration=5.0)
    found = hf.identify(spoiled(right, lost(right.data, slice(2, 4))), SINGLE)
    assert found.findings[0].kind is Kind.LOST
    assert "exactly (0, 0)" in found.report().splitlines()[1]


def test_a_fault_that_spoils_the_fit_is_all_that_is_reported():
    """What else seems wrong follows from it; nothing is tested, and no other cause is searched for."""
    right = recorded(kind="markers", duration=3.0)
    found = hf.identify(spoiled(right, lost(right.data, slice(2, 6))), hf.Rope(LENGTHS, 0.1, friction=1e-4))
    assert [each.kind for each in found.findings if each.severity > Severity.NOTE] == [Kind.LOST]
    assert found.score_tests == ()


def test_outliers_are_named_and_bring_no_doubt_under_a_robust_loss():
    right = recorded(n=1, duration=5.0)
    random = np.random.default_rng(4)
    data = right.data + np.where(random.random(right.data.shape) < 0.04, random.normal(0.0, 0.2, right.data.shape), 0.0)
    found = hf.identify(spoiled(right, data), SINGLE)
    named = next(each for each in found.findings if each.kind is Kind.OUTLIERS)
    assert "loss='cauchy'" in str(named)
    assert 0.01 < named.values["part"] < 0.05  # of 4 %, some are small
    assert not hf.identify(spoiled(right, data), SINGLE, options=hf.FitOptions(loss="cauchy")).has(Kind.OUTLIERS)
    assert not hf.identify(right, SINGLE).has(Kind.OUTLIERS)


def test_y_that_points_down_is_no_reversed_order():
    """For one link both rotate the picture by half a turn; the marker at rest is the pivot."""
    right = recorded(n=1, kind="markers", duration=5.0)
    found = hf.identify(spoiled(right, right.data * [1.0, -1.0, 1.0, -1.0]), SINGLE)
    assert found.findings[0].kind is Kind.Y_AXIS


@pytest.mark.parametrize(("first", "said"), [(0.0, "held at both ends"), (0.05, "where the rope hangs")])
def test_a_last_marker_at_rest(first, said):
    t = np.arange(300) / 60.0
    wave = np.column_stack([np.sin(5.0 * t), np.cos(7.0 * t)])
    ends = np.array([0.0, 0.0]), np.array([0.5, 0.0])
    places = np.column_stack([ends[0] + first * wave, [0.25, -0.1] + 0.05 * wave, ends[1] + 0.0 * wave])
    refuses(said, hf.identify, hf.Recording(t, places, kind="markers"), hf.Rope([0.27, 0.27], 0.1))
