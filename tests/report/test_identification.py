"""The report of an identification: consistent with the fit, complete in one file, and clear about unknown values."""

import dataclasses
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.identification import BAND, Identification
from hyperflex.recording import Recording
from hyperflex.report.identification import page as identification
from hyperflex.report.identification.figures import FittedChannels, correlations, prediction_figure
from hyperflex.report.identification.page import identification_page, write_identification
from hyperflex.report.identification.tables import described, numbers, parameters_table, predicted, ratios_table, ties
from hyperflex.report.units import rounded
from hyperflex.status import Status
from tests.report.conftest import GUESS

Case = tuple[Recording, Identification]


@pytest.fixture(scope="module")
def markers() -> Case:
    """Three markers on six links, all samples fitted; the first joint is off the camera's origin."""
    rope = hf.Rope.uniform(length=0.6, mass=0.1, n_links=6, friction=2e-4)
    t = np.arange(60) * 0.03
    run = hf.simulate(rope, duration=t[-1], t_eval=t, q0=np.full(6, 0.8))
    places = run.joints[:, [2, 4, 6]] + np.array([0.05, -0.02])
    data = places.reshape(t.size, -1) + np.random.default_rng(2).normal(0.0, 1e-3, (t.size, 6))
    data[20:23, 2:4] = np.nan
    recording = Recording(t, data, kind="markers", noise=1e-3)
    guess = rope.replace(friction=4e-4)
    return recording, hf.identify(
        recording,
        guess,
        ["friction"],
        setup=hf.RecordingSetup(arc_lengths=[0.2, 0.4, 0.6]),
        options=hf.FitOptions(train=np.inf),
    )


def page(tmp_path: Any, case: Case, guess: hf.Rope | None = None) -> str:
    identification_page(tmp_path / "page.html", *case, guess)
    return (tmp_path / "page.html").read_text("utf-8")


@pytest.fixture
def unseen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn up, but not turned into pixels: what takes long, and is seen in other tests."""
    monkeypatch.setattr(identification, "png", lambda figure, dpi: b"\x89PNG")


def changed(found: Identification, **values: Any) -> Identification:
    return dataclasses.replace(found, **({"intervals": {}} | values))


# ---- the page


def test_a_page_is_one_file_with_all_its_parts(tmp_path, swing):
    text = page(tmp_path, swing, GUESS)
    assert re.findall(r'(?:src|href)="(?!data:|#)', text) == []
    assert text.count("data:image/png;base64,") == 3  # fit, prediction, residuals
    titles = re.findall(r"<h2>(.*?)</h2>", text)
    assert titles[:3] == ["Assessment", "Parameters", "Ratios"]
    assert len(titles) == 9
    assert "two &lt;links&gt;, identified" in text
    assert '<span class="badge">usable for ratios</span>' in text


@pytest.mark.usefixtures("unseen")
def test_a_page_says_on_top_what_cannot_be_known(tmp_path, swing):
    text = page(tmp_path, swing)
    verdict = text[text.index("<h2>Assessment") : text.index("<h2>Parameters")]
    assert "<b>0 of 6</b>" in verdict
    assert "share a factor that no free swing shows" in verdict
    table = text[text.index("<h2>Parameters") : text.index("<h2>Ratios")]
    assert table.count("<td>cannot be known</td>") == 6
    assert all(np.isnan([each.low, each.high]).all() for each in numbers(swing[1]))


def test_many_channels_are_shown_by_a_few_and_all_of_them_elsewhere(tmp_path, markers):
    text = page(tmp_path, markers)
    assert '<a href="#all">All 6 channels</a>' in text
    assert '<section id="all">' in text
    assert text.count("data:image/png;base64,") == 5  # along the rope, fit, shapes, residuals, all channels
    assert "Nothing was predicted" in text
    assert "0.2, 0.4, 0.6 m along the rope" in text


@pytest.mark.usefixtures("unseen")
def test_an_interrupted_fit_reports_it(tmp_path, swing):
    recording, found = swing
    cut = changed(found, ended=Status.INTERRUPTED, history=(), held_out=None)
    text = page(tmp_path, (recording, cut))
    assert "interrupted during its first iteration; figures were not drawn" in text
    assert 'class="verdict warn"' in text
    assert "data:image/png" not in text
    late = changed(found, ended=Status.OUT_OF_TIME, history=(), held_out=None)
    text = page(tmp_path, (recording, late))
    assert "Nothing was predicted: the fit ended early (out of time)" in text


@pytest.mark.usefixtures("unseen")
def test_predictions_that_failed_are_drawn_as_failed(tmp_path, swing):
    recording, found = swing
    held = found.held_out
    window_rms = held.window_rms.copy()
    window_rms[0] = np.inf
    lost = held.t <= held.starts[0] + held.ahead
    predicted, std = held.predicted.copy(), held.std.copy()
    predicted[lost], std[lost] = np.inf, np.nan
    rms = np.full(2, np.inf)
    failed = dataclasses.replace(held, rms=rms, window_rms=window_rms, predicted=predicted, std=std)
    text = page(tmp_path, (recording, changed(found, held_out=failed)))
    assert "<b>failed</b>" in text
    titles = [axis.get_title("left") for axis in prediction_figure(FittedChannels(recording, found), failed).axes]
    assert titles[1] == "measured minus predicted: failed where dark"


def test_the_errors_of_the_predictable_and_of_all_predicted_samples_are_named_everywhere(tmp_path, swing):
    """0.1 rad where predictions are foreseeable, 0.7 rad in the other half, whose band is wide: 0.5 rad in all."""
    recording, found = swing
    held = found.held_out
    late = held.t > held.starts[held.began] + 0.5 * held.ahead
    error, std = np.where(late, 0.7, 0.1)[:, None], np.where(late, 1e3, 1e-3)[:, None]
    shown, std = held.measured + error, np.broadcast_to(std, held.measured.shape)
    rms = np.full(2, np.sqrt(np.mean(error**2)))
    doubtful = changed(found, held_out=dataclasses.replace(held, rms=rms, predicted=shown, std=std))
    assert doubtful.held_out.error == pytest.approx(0.1)
    assert doubtful.held_out.error_of_all == pytest.approx(0.5, rel=0.01)  # half of the samples, except one
    told = doubtful.summary()["held_out"]
    assert (told["foreseeable_error"], told["rms"][0]) == pytest.approx((0.1, rms[0]))
    assert told["foreseeable_part"] == pytest.approx(0.5, abs=0.03)
    assert f"{1e3 * rms[0]:.2f}, {1e3 * rms[1]:.2f}; 100.00 in the foreseeable 5" in str(doubtful)
    value, note = predicted(doubtful)
    words = f"{value} {note}".replace("\N{NO-BREAK SPACE}", " ")
    assert words.startswith("100 mrad in the foreseeable 5")
    assert words.endswith(" mrad in all")
    assert note in page(tmp_path, (recording, doubtful))


@pytest.mark.usefixtures("unseen")
def test_rope_and_figures_stand_before_the_page_is_drawn(tmp_path, swing, monkeypatch):
    recording, found = swing
    written = write_identification(tmp_path / "new" / "out", recording, found, GUESS)
    names = ["identification.json", "report.html", "rope.toml"]
    assert sorted(path.name for path in (tmp_path / "new" / "out").iterdir()) == names
    assert hf.Rope.from_toml(written["rope"]) == found.rope
    content = files.read_toml(written["rope"])["identification"]
    assert content["held_out"]["inside_band"] == pytest.approx(found.held_out.inside)
    assert (content["unit"], content["settings"]["free"]) == ("rad", ["inertia", "com", "friction"])

    def broken(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(identification, "residual_figure", broken)
    with pytest.raises(KeyboardInterrupt):
        write_identification(tmp_path / "new" / "out", recording, found)
    left = sorted(path.name for path in (tmp_path / "new" / "out").iterdir())
    assert left == ["identification.json", "rope.toml"]  # and no page of an earlier fit with them


# ---- tables


def test_parameters_are_reported_with_unit_deviation_interval_and_guess(markers):
    found = changed(markers[1])
    table = parameters_table(found, hf.Rope.uniform(length=0.6, mass=0.1, n_links=6, friction=4e-4))
    rows = {row[0]: row for row in table.rows}
    value, std = found.values["friction"][0], found.std["friction"][0]
    _, words, told, spread, interval, guess = rows["friction[0]"]
    number, unit = told.split("\u00a0", 1)
    assert words == "viscous friction, link 0"
    assert unit in ("µN\u00a0m\u00a0s/rad", "mN\u00a0m\u00a0s/rad")
    size = {"µ": 1e-6, "m": 1e-3}[unit[0]]
    # Rounded to the second digit of the standard deviation.
    assert float(number) * size == pytest.approx(value, abs=0.05 * std)
    assert float(spread) * size == pytest.approx(std, rel=0.05)
    low, high = (float(end) * size for end in interval.split(" to "))
    assert high == pytest.approx(value + 1.96 * std, abs=0.1 * std)
    assert low == pytest.approx(max(value - 1.96 * std, 0.0), abs=0.1 * std)
    assert float(guess) * size == pytest.approx(4e-4)


def test_intervals_of_the_identification_itself_come_first(markers):
    found = changed(markers[1])
    given = {
        "friction[3]": SimpleNamespace(low=1e-4, high=9e-4),
        "friction[4]": SimpleNamespace(low=1e-4, high=np.inf),
        "c/p1[3]": SimpleNamespace(low=0.25, high=0.75),
    }
    object.__setattr__(found, "intervals", given)
    object.__setattr__(found, "std", found.std | {"friction": np.full(6, 1e-5)})
    object.__setattr__(found, "ratio_std", {"c/p1": np.full(6, 0.01)})
    object.__setattr__(found, "ratios", {"c/p1": np.linspace(0.3, 0.6, 6)})
    (number,) = [each for each in numbers(found) if each.label == "friction[3]"]
    assert (number.low, number.high) == (1e-4, 9e-4)
    rows = {row[0]: row for row in parameters_table(found, None).rows}
    assert rows["friction[4]"][4] in ("100 or more", "0.100 or more")  # in µN or mN
    assert [row[4] for row in ratios_table(found).rows if row[1] == "3"] == ["0.250 to 0.750"]


def test_laws_along_the_rope_are_reported_as_factors(markers):
    found = changed(
        markers[1],
        parameters=("friction:shared", "stiffness:factor", "mass:taper"),
        starts=np.array([3e-4, 1.0, 0.0]),
        values={"friction": np.full(6, 2e-4), "stiffness:factor": np.array(1.5), "mass:taper": np.array(0.1)},
        std={"friction": np.full(6, 1e-5), "stiffness:factor": np.array(0.1), "mass:taper": np.array(0.2)},
    )
    shared, factor, taper = numbers(found)
    assert "of each link alike" in described(shared.label)
    assert (factor.value, factor.std) == (1.5, 0.1)
    assert "at the tip over that at the first joint" in described(taper.label)
    assert taper.value == pytest.approx(np.exp(0.1))
    assert (shared.start, factor.start, taper.start) == (3e-4, 1.0, 1.0)
    assert (taper.low, taper.high) == pytest.approx((np.exp(0.1 - BAND * 0.2), np.exp(0.1 + BAND * 0.2)))


def test_what_errs_together_is_named(swing):
    found = changed(
        swing[1],
        parameters=("friction[0]", "friction[1]", "inertia[0]"),
        starts=np.ones(3),
        covariance=np.array([[4.0, 3.96, 0.0], [3.96, 4.0, 1.0], [0.0, 1.0, 9.0]]),
        std={"friction": np.array([2.0, 2.0]), "inertia": np.array([3.0, 0.0])},
    )
    assert ties(found) == ("friction[0] and friction[1] (+0.990)",)
    lost = changed(found, std={"friction": np.array([np.inf, 2.0]), "inertia": np.array([3.0, 0.0])})
    assert ties(lost) == ()


def test_ratios_omit_fixed_values_and_join_equal_ones(swing, markers):
    table = ratios_table(swing[1])
    free = ["J/p1[0]", "J/p1[1]", "p/p1[1]", "c/p1[0]", "c/p1[1]"]
    assert [f"{name}[{link}]" for name, link, *_ in table.rows] == free
    alike = changed(markers[1], ratios={"c/p1": np.full(6, 0.1)}, ratio_std={"c/p1": np.full(6, 0.01)})
    (row,) = ratios_table(alike).rows
    assert row[:5] == ("c/p1", "each", "0.100\u00a0m/s", "0.010", "0.080 to 0.120")
    wide = changed(alike, ratio_std={"c/p1": np.full(6, 0.1)})
    assert ratios_table(wide).rows[0][4] == "0 to 0.30"
    held = changed(markers[1], ratio_std={name: np.zeros(6) for name in markers[1].ratios})
    assert ratios_table(held) is None


# ---- figures


def test_measured_and_fitted_stand_side_by_side(swing, markers):
    for recording, found in (swing, markers):
        view = FittedChannels(recording, found)
        rows = [int(np.flatnonzero(view.t == time)[0]) for time in view.fit_t]
        known = ~np.isnan(found.residuals)
        np.testing.assert_allclose((view.measured[rows] - view.fitted)[known], found.residuals[known], atol=1e-15)
    assert FittedChannels(*swing).names == ("link 0", "link 1")
    assert FittedChannels(*markers).names[3] == "marker 1, y"


def test_the_worst_window_is_the_one_with_a_bump(swing):
    recording, found = swing
    residuals = found.residuals.copy()
    inside = (found.residual_t > 3.0) & (found.residual_t < 3.1)
    residuals[inside, 1] += 0.5
    number, start, end = FittedChannels(recording, changed(found, residuals=residuals)).worst_window(1)
    assert start <= 3.0
    assert end >= 3.1
    assert end - start <= found.settings["window"]
    assert number == np.floor(start / found.settings["window"] + 1e-9)


def test_the_band_of_a_prediction_is_as_wide_as_the_fit_expects(swing):
    recording, found = swing
    figure = prediction_figure(FittedChannels(recording, found), found.held_out)
    bands = figure.axes[1].collections
    assert len(bands) == found.held_out.starts.size
    first = found.held_out.t <= found.held_out.starts[0] + found.held_out.ahead + 1e-9
    height = bands[0].get_paths()[0].vertices[:, 1].max()
    assert height == pytest.approx(1e3 * BAND * found.held_out.std[first, 0].max())


# ---- autocorrelation


def test_correlation_of_a_known_process_also_with_gaps():
    rng = np.random.default_rng(4)
    noise, values = rng.normal(size=20000), np.zeros(20000)
    for k in range(1, values.size):
        values[k] = 0.8 * values[k - 1] + noise[k]
    values[rng.random(values.size) < 0.2] = np.nan
    correlation, band = correlations(values)
    # AR(1): 0.8^k; std of an estimate about sqrt((1 + 0.64) / (1 - 0.64) / 13000) = 0.02.
    np.testing.assert_allclose(correlation[:5], 0.8 ** np.arange(1, 6), atol=0.06)
    np.testing.assert_allclose(band[0], 1.96 / np.sqrt(0.64 * values.size), rtol=0.05)


def test_a_value_of_0_is_a_plain_0():
    assert [rounded(0.0, std) for std in (3e-8, 0.2, np.inf)] == ["0"] * 3
    assert rounded(0.31, 0.2) == "0.31"
