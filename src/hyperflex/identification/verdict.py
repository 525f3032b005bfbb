"""The verdict of a fit in sentences: what is known, what is not, and what looks wrong."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.ending import CONVERGED, INTERRUPTED, OUT_OF_TIME
from hyperflex.identification.fit.loss import NORMAL, Loss
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.model.parameters import Parameters
from hyperflex.identification.model.scale import common_factor, in_common_factor
from hyperflex.identification.sentences import About, Sentence
from hyperflex.identification.uncertainty.covariance import TOUCHED, Information
from hyperflex.identification.uncertainty.whiteness import CHANCE
from hyperflex.model import Rope
from hyperflex.recording import Recording

CORRELATED = 10.0  # samples
LEAST_FREEDOM = 2.0  # independent values; a variance from fewer has no std
COLOURED = Sentence(
    "The residuals are not white: the measuring noise is coloured, or the model leaves something out. The deviations "
    "and intervals allow for the first, and for other laws of the joints and of the air, not for more.",
    About.COLOURED,
)
ALL_KNOWN = Sentence("All free parameters can be known from this motion, given those that were held.", About.ALL_KNOWN)
ALL_ACT = (
    "Each free parameter acts in this motion in a way of its own, given those that were held; how far the values can "
    "be trusted, the other sentences say."
)
FIRST_MOMENT = Sentence(
    "In ratios p1 is the first moment of link 0 about its joint, kg m, with all mass beyond it at its far end.",
    About.MEANING,
)
OUTLYING = 6.0  # times the median deviation: a distance that a lost marker makes
UNEVEN = 0.03  # relative difference of two scales; as the distances of markers
SWAPPED = 0.2  # logarithm of a distance over a length: far beyond UNEVEN, and less than swaps of links of a rope make
INTERVALS = 3  # that are named, for a line
BEYOND, MANY = 5.0, 20  # standard errors, and distances at least
LENGTHS_AGREE = 0.03  # markers are glued on and tracked to about this part of a link
UNEXPLAINED = 4.0  # times the declared noise's variance: twice as much is no slip of whoever declared it


def verdict(parameters: Parameters, information: Information, spreads: dict[str, Array]) -> list[str]:
    """Return in words what is identifiable; `spreads` (n,) are standard deviations of the ratios."""
    if not information.estimated:
        return ["It ended before deviations and intervals were worked out: there are none."]
    return [*_unknown(parameters, information, spreads), *_at_zero(parameters, information), *_first_moment(spreads)]


def not_converged(message: str) -> str:
    """Return a warning where a fit did not converge."""
    if message == CONVERGED:
        return ""
    how, advice = message, "Give a better guess, shorter windows or fewer free parameters."
    if message == INTERRUPTED:
        advice = "Let it run to its end."
    elif message == OUT_OF_TIME:
        how = "out of time"
        advice = "Give a better guess, shorter windows or fewer free parameters, or a longer time budget."
    return f"The fit is {how}: its values, ratios and deviations are where it stood, not what the data say. {advice}"


def consistent(words: list[str]) -> list[str]:
    """Return the sentences that are not empty; beside a warning none says that all can be known."""
    words = [text for text in words if text]
    if len([text for text in words if text != FIRST_MOMENT]) == 1:
        return words
    return [ALL_ACT if text == ALL_KNOWN else text for text in words]


def not_noise(correlation: float, whiteness: float = 1.0) -> str:
    """Return a warning for an autocorrelation time (samples), or a p-value of a whiteness test, beyond chance."""
    if correlation <= CORRELATED:
        return "" if whiteness >= CHANCE else COLOURED
    return Sentence(
        f"The residuals are no noise (they hang together over {correlation:.0f} samples) but errors of the model: it "
        "leaves something out. Standard deviations and intervals hold what other laws of the joints and of the air "
        "would change, not what is none of these.",
        About.COLOURED,
    )


def noise_not_modelled(agrees: bool, freedom: float) -> str:
    """Return a warning where no autoregression agrees with the residuals, or their degrees of freedom are few."""
    if not agrees:
        return (
            "No stationary noise would leave such residuals: standard deviations and intervals take them as they are, "
            "though the fit has absorbed part of them, and may be far too small."
        )
    if freedom < LEAST_FREEDOM:
        return (
            f"What the fit has left is worth about {freedom:.2g} independent values: standard deviations and intervals "
            "are hardly more than a guess. Record longer, or free fewer parameters."
        )
    return ""


def too_large(variance: float, freedom: float) -> str:
    """Return a warning where the `variance` of residuals over the declared noise's fails a chi-squared test."""
    from scipy.special import gammaincc

    if gammaincc(0.5 * freedom, 0.5 * freedom * variance) >= CHANCE:
        return ""
    return (
        f"The residuals are {np.sqrt(variance):.3g} times as large as the declared noise: it is larger than that, or "
        "the model leaves something out, and parameters may be biased by more than their intervals say."
    )


def unexplained(variance: float) -> str:
    """Return a doubt where the `variance` of residuals is several times the declared noise's, and no cause is found."""
    if variance <= UNEXPLAINED:
        return ""
    return (
        f"the fit leaves {np.sqrt(variance):.2g} times as much as the declared noise, and nothing that was tested "
        "explains it: more noise is there, or the model leaves something out, and ratios may be off by more than their "
        "intervals say. Check the noise's value and unit, and whether another model predicts better (compare_models)."
    )


def too_small(windows: Sequence[Window], residuals: Array, loss: Loss) -> str:
    """Return a warning where residuals (m, C), rad or m, are far smaller than the declared noise."""
    rms, _, noise = _sizes(windows, residuals, 0, loss)
    declared, left = np.sqrt(np.mean(noise**2)), np.sqrt(np.mean(rms**2))
    if left > QUIET * declared:
        return ""
    return (
        f"the declared noise ({declared:.2g}) is {declared / max(left, 1e-300):.2g} times as large as what the fit "
        f"leaves ({left:.2g}). Check its value and unit: it is in the unit of the data."
    )


def other_lengths(recording: Recording, rope: Rope) -> str:
    """Return a warning where the distances of the markers are not the link lengths that the rope was given."""
    if recording.kind != "markers":
        return ""
    measured = recording.link_lengths()
    if (np.abs(measured / rope.length - 1.0) <= LENGTHS_AGREE).all():
        return ""
    lengths = ", ".join(f"{seen:.4g} for {given:.4g}" for seen, given in zip(measured, rope.length, strict=True))
    return f"the markers lie {lengths} m apart: check their scale, or the link lengths. The angles do not show it."


def swapped(recording: Recording, rope: Rope) -> str:
    """Return that neighbouring markers are swapped in a part of the frames: there the lengths fit the other order."""
    if recording.kind != "markers" or rope.n_links < 2:
        return ""
    places = recording.data.reshape(recording.t.size, -1, 2)

    def off(order: list[int]) -> Array:
        apart = np.hypot(*np.diff(places[:, order], axis=1).T).T
        return np.asarray(np.abs(np.log(np.maximum(apart, 1e-12) / rope.length)).max(axis=1))

    usual = list(range(rope.n_links + 1))
    fits = off(usual)
    for k in range(rope.n_links):
        order = [*usual[:k], k + 1, k, *usual[k + 2 :]]
        there = (fits > SWAPPED) & (off(order) < UNEVEN)
        if there.sum() >= MANY:
            before = np.cumsum(fits <= SWAPPED)[there]  # frames in order, which part one interval from the next
            parts = [recording.t[there][before == count][[0, -1]] for count in np.unique(before)]
            times = " and ".join(f"from t = {begin:.4g} to {end:.4g} s" for begin, end in parts[:INTERVALS])
            more = f" and {len(parts) - INTERVALS} times more" if len(parts) > INTERVALS else ""
            return f"markers {k} and {k + 1} are swapped {times}{more}: swap them back there."
    return ""


def uneven_scale(recording: Recording) -> str:
    """Return a warning where links are longer in one direction of the picture than across it.

    With theta the direction of a link in the picture, log d = c + p cos(2 theta) + q sin(2 theta) to first order, with
    the same p and q for all links; exp(2 hypot(p, q)) is the ratio of the scales.
    """
    if recording.kind != "markers":
        return ""
    places = recording.data.reshape(recording.t.size, -1, 2)
    along = np.diff(places, axis=1)
    distance, double = np.hypot(*along.T).T, 2.0 * np.arctan2(along[..., 1], along[..., 0])
    rows = []
    for d, turn in zip(distance.T, double.T, strict=True):
        there = ~np.isnan(d) & (d > 0.0)
        if there.sum() < MANY:
            continue
        off = np.log(d[there] / np.median(d[there]))
        typical = np.abs(off) <= OUTLYING * max(float(np.median(np.abs(off))), 1e-12)
        columns = np.column_stack([off, np.cos(turn[there]), np.sin(turn[there])])[typical]
        rows.append(columns - columns.mean(axis=0))
    if not rows:
        return ""
    table = np.vstack(rows)
    matrix, off = table[:, 1:], table[:, 0]
    inverse = np.linalg.pinv(matrix.T @ matrix, rcond=1e-6, hermitian=True)
    step = inverse @ (matrix.T @ off)
    variance = float(np.sum((off - matrix @ step) ** 2)) / table.shape[0]
    size, explained = float(np.hypot(*step)), float(np.sum((matrix @ step) ** 2))
    seen = np.sqrt(explained / table.shape[0]) > 0.1 * UNEVEN  # else links turn too little to tell
    if np.expm1(2.0 * size) <= UNEVEN or explained <= BEYOND**2 * variance or not seen:
        return ""
    direction = 0.5 * np.degrees(np.arctan2(step[1], step[0]))
    return (
        f"the markers' distances change as the links turn: lengths at {direction:.0f} degrees from +x are about "
        f"{np.exp(2.0 * size):.3g} times those across. Pixels that are not square, x and y scaled differently, or a "
        "camera that looks at the plane from the side make that: calibrate it."
    )


def _first_moment(spreads: dict[str, Array]) -> list[str]:
    """Return what p1 is, or nothing where no ratio was fitted; `spreads` (n,) are standard deviations of the ratios."""
    if not any(np.any(each > 0.0) for each in spreads.values()):
        return []
    return [FIRST_MOMENT]


def held_words(held: Sequence[str]) -> str:
    """Return that what was held has no standard deviation, or nothing."""
    if not held:
        return ""
    return f"Held as given, so a standard deviation of 0 is no accuracy: {', '.join(held)}."


def _unknown(parameters: Parameters, information: Information, spreads: dict[str, Array]) -> list[str]:
    """Return what cannot be known: a common factor, parameters that do not act, and those that act alike."""
    unknown = information.unknown
    if unknown.shape[1] == 0:
        return [ALL_KNOWN]
    common = common_factor(parameters, information.x, unknown)
    others = unknown if common is None else unknown - np.outer(common, common @ unknown)
    idle = np.sqrt((others**2).sum(axis=1)) > 1.0 - TOUCHED
    shares = np.sqrt((unknown**2).sum(axis=1))
    grows = in_common_factor(parameters, information.x, unknown)
    idle &= ~grows
    free = zip(parameters.all, (shares > TOUCHED) | grows, idle, strict=True)
    names = ", ".join(dict.fromkeys(p.name for p, touched, alone in free if touched and not alone))
    count = unknown.shape[1] - int(idle.sum())
    said = [_together(names, count, spreads, common is not None)] if count else []
    if lost := [label for label, alone in zip(parameters.labels, idle, strict=True) if alone]:
        said.append(
            f"{', '.join(lost)} cannot be known: what does not act in this motion has values that mean nothing. Leave "
            "such names out of free, or record a motion in which they act."
        )
    return said


def _together(names: str, count: int, spreads: dict[str, Array], common: bool) -> str:
    """Return what to say of `count` directions in which several parameters cannot be told apart."""
    lost = [name for name, std in spreads.items() if np.isinf(std).any()]
    known = f"Not even these ratios are known: {', '.join(lost)}." if lost else "The ratios over p1 are known."
    if common:
        what = "One common factor" if count == 1 else f"{count} combinations"
        return (
            f"{what} of {names} cannot be known from this motion (no known force or torque acts); their values are one "
            f"choice of many that move alike. {known} To fix the values, weigh the links and leave mass and com out of "
            "free."
        )
    what = "One combination" if count == 1 else f"{count} combinations"
    return (
        f"{what} of {names} cannot be known: these parameters act alike in this motion and cannot be told apart; their "
        f"values are one choice of many. {known} To fix the values, leave out of free what you can measure otherwise, "
        "or record a motion in which they act differently."
    )


def _at_zero(parameters: Parameters, information: Information) -> list[str]:
    """Return what went to 0."""
    values = parameters.values(parameters.rounded(information.x))
    none = [
        each.label
        for each, value in zip(parameters.all, values, strict=True)
        if each.form == "nonnegative" and value == 0.0
    ]
    return [f"{', '.join(none)} went to 0, the least allowed: the data show none of it."] if none else []


POOR = 0.05  # part of the motion that may stay unexplained: fits of real pendulums that are right leave 0.1 to 1 %
WHITE_POOR = 0.2  # part of the motion, where what stays is white, so that it is noise
TORQUE_POOR = (
    0.2  # part of a torque that may stay unexplained: torque sensors, and currents in place of them, are not better
)
QUIET = 0.5  # times the declared noise: what stays below shows that less noise was there
NOISY = 1.5  # times the declared noise: what stays below is as good as the recording, however little moves


def poor_fit(windows: Sequence[Window], residuals: Array, unit: str, loss: Loss, *, white: bool = False) -> str:
    """Return a warning where residuals (m, C), rad or m, NaN in gaps, are a large part of the motion.

    `white` residuals are measuring noise, of which more is allowed, and as much as was declared; declared noise
    excuses residuals that are not white as far as that, too.
    """
    rms, spread, noise = _sizes(windows, residuals, 0, loss)
    worst = int(np.argmax(np.where(rms > NOISY * noise * white, rms / np.maximum(spread, 1e-12), 0.0)))
    excused = NOISY * noise[worst]
    allowed = max(WHITE_POOR * spread[worst], excused)
    if not white:
        allowed = max(POOR * spread[worst], min(excused, WHITE_POOR * spread[worst]))
    if rms[worst] <= allowed:
        return ""
    what = f"link {worst}" if unit == "rad" else f"marker {worst // 2}"
    return (
        f"The fit is poor: {what} is {rms[worst]:.3g} {unit} off, and moves by {spread[worst]:.3g} {unit} (rms) within "
        "the windows. Check the recording's units, zero and sense, the link lengths, the base's motion and the guess."
    )


def poor_torque(windows: Sequence[Window], residuals: Array | None, loss: Loss) -> str:
    """Return a warning where torque residuals (m,), N m, are a large part of the torque."""
    if residuals is None:
        return ""
    (rms,), (spread,), (noise,) = _sizes(windows, residuals[:, None], windows[0].y.shape[1] - 1, loss)
    if rms <= max(TORQUE_POOR * spread, NOISY * noise):
        return ""
    return (
        f"The torque does not fit: it is {rms:.3g} N m off, and moves by {spread:.3g} N m (rms) within the windows. "
        "Check its sign (positive turns the arm the way in which its angle grows) and its unit, N m; until it fits, "
        "masses, inertias and frictions mean nothing."
    )


def _sizes(windows: Sequence[Window], residuals: Array, first: int, loss: Loss) -> tuple[Array, Array, Array]:
    """Return rms (C,) of residuals (medians under a robust loss), motion and declared noise, channels from `first`."""
    part = slice(first, first + residuals.shape[1])
    known = [np.where(w.weight > 0.0, w.y, np.nan)[:, part] for w in windows]
    weights = np.concatenate([w.weight for w in windows])[:, part]
    with np.errstate(divide="ignore"):
        noise = np.sqrt(np.nanmean(np.where(weights > 0.0, 1.0 / weights**2, np.nan), axis=0))
    noise = np.where(((weights == 0.0) | (weights == 1.0)).all(axis=0), 0.0, noise)  # not declared
    spread = np.sqrt(np.mean([np.nanvar(y, axis=0) for y in known], axis=0))
    if loss.name == "squares":
        return np.sqrt(np.nanmean(residuals**2, axis=0)), spread, noise
    return NORMAL * np.nanmedian(np.abs(residuals), axis=0), spread, noise
