"""Findings: what an identification shows beside its values, as data, and their texts."""

import string
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any

import numpy as np

from hyperflex.errors import listed

LINES = 5  # of a short report, the grade's line included
NAMES = 4  # of a list, or numbers of a kind, that are shown in a line
COMPARE = "See whether another model predicts better (compare_models), and check what was declared."


class Severity(IntEnum):
    """What a finding means for the result."""

    NOTE = 0  # information
    LIMIT = 1  # what this motion, or any motion, cannot show
    DOUBT = 2  # something may be wrong or is poorly determined; standard deviations include it
    WRONG = 3  # the result must not be used


class Kind(StrEnum):
    """Kind of a finding, and its text: what was seen | what it means and what to do.

    In a text {x:%} is a part in per cent, {x:most} the same as a limit, {x:m} a length, {x:deg} an angle, {x:list} a
    list of names, numbers or times from one to another, {x:each (%)} a table of names and parts, {x:? words} words
    where x is not empty or 0. Of findings of one severity plain evidence comes first, then causes, then symptoms.
    """

    text: str

    def __new__(cls, value: str, text: str) -> "Kind":
        """Make a kind of its name and its text."""
        made = str.__new__(cls, value)
        made._value_, made.text = value, " ".join(text.split())
        return made

    # What the recording or the rope shows by itself
    MARKERS_SWAPPED = (
        "markers swapped for a time",
        """Markers {first} and {second} are swapped from t = {times:list} s. | In these times the distances fit the
        other order. Swap the two back there.""",
    )
    LOST = (
        "lost samples written as a place",
        """{where}: exactly {place} in up to {part:%} of the frames. | Programs write so what they have
        lost. Write it as a gap (nan, or an empty cell).""",
    )
    WRAPPED = (
        "wrapped angles",
        """The angle of {where} jumps by whole turns, {count} times, first at t = {time:.4g} s. | Angles must not be
        wrapped. Read the file with wrapped=True, or unwrap them (numpy.unwrap).""",
    )
    REPEATED_FRAMES = (
        "repeated frames",
        """{part:%} of the frames repeat the frame before, to the last digit, while the rope moves. | A slower camera
        was stored at a higher rate, or lost frames were filled. Drop the repeated rows and keep the times of the
        others.""",
    )
    HELD_STILL = (
        "held, then released",
        """The rope rests until t = {time:.6g} s and then moves at once. | A hand held or pushed it, unless it is
        driven. Fit what follows: recording.window({time:.6g}, inf), or --start {time:.6g} on the command line.""",
    )
    UNEVEN_FRAMES = (
        "frames at wrong times",
        """Frames are early or late by {part:%} of a frame time or more, while their times are even. | Frames are
        missing and the times count on, or the frame rate varies. Use the time stamps of the frames.""",
    )
    MISSING_FRAMES = (
        "missing frames",
        """The motion skips frames at t = {times:list} s. | Frames are missing there and the times count on. Use the
        time stamps of the frames, or the longest stretch between.""",
    )
    JUMP = (
        "jump of a channel",
        """The {channel} jumps by {size:{unit}} at t = {time:.4g} s and stays there. | A zero or the camera has moved, a
        marker has slipped, or frames are missing there. Use the recording before or after it, or subtract a moved
        zero.""",
    )
    SMOOTHED = (
        "smoothed samples",
        """Samples seem smoothed, as by a moving mean over {width:.2g} s. | Fast motion is weakened, so ratios are off,
        and noise is correlated. Use the tracker's raw positions, or a shorter filter.""",
    )
    PICTURE_SCALE = (
        "different scales along x and y",
        """Lengths at {angle:deg} from +x are about {factor:.3g} times those across. | Pixels are not square, x and y
        are scaled differently, or the camera views the plane from the side. Calibrate the camera.""",
    )
    MARKER_DISTANCES = (
        "marker distances unlike link lengths",
        """The markers lie {measured:list} m apart, the links are {declared:list} m long. | Their scale or the link
        lengths are wrong; the angles do not show it. Measure a length, and check the scale of the markers.""",
    )
    UNLIKE_LENGTHS = (
        "link lengths of different units",
        """Link {longest} is {times:.3g} times as long as link {shortest}. | One of the lengths may be in another unit.
        Give all lengths in m.""",
    )
    NOISE_OVERSTATED = (
        "declared noise too large",
        """The declared noise ({declared:.2g}) is {times:.2g} times as large as the residuals ({left:.2g}). | The
        recording is better than declared. Check the noise's value and unit: it is in the unit of the data.""",
    )
    GRAVITY_ROTATED = (
        "gravity rotated",
        """Gravity is rotated by {angle:deg}. | Axes or zero may not be as declared. Check zero, y_axis and the order
        of the axes.""",
    )
    SPRING_OR_ANGLES = (
        "angles scaled, or a spring",
        """Angles multiplied by {factor:.3g} explain the recording as well as the stiffness that was freed. | The
        stiffness may stand for a wrong scale of the angles, or for smoothed samples. Check the angles' scale in
        radians and the tracker's filter, or name in 'free' what is free.""",
    )
    # Declarations that contradict the data
    CLOCK = (
        "clock or lengths",
        """The fit is better with times multiplied by {clock:.3g}, or lengths divided by {scale:.3g}. | The clock, the
        frame rate or a length is not as declared; ratios move by {moved:most}. Check the frame rate, and measure one
        length again.""",
    )
    DRIFT = (
        "drifting clock",
        """The clock seems to drift by {drift:%} from the first window to the last. | The clock drifts, or something
        else changes over the recording; ratios move by {moved:most}. Check the time stamps, or fit parts of the
        recording separately.""",
    )
    LENGTHS = (
        "lengths",
        """Lengths of the links or of the arm seem {off:%} off. | A drive has its own length and time; an omitted
        resistance can look the same. Measure the lengths again.""",
    )
    ZERO = (
        "zero of the angles",
        """The zero of the angles seems off by {angle:deg}. | The camera is not level, or the zero, axes or their order
        are not as declared. Check the zero and the axes, level the camera, or free 'gravity_angle'.""",
    )
    LINK_ZERO = (
        "zero of one link",
        """The zero of link {link} seems off by {angle:deg}. | Its sensor is mounted or calibrated with an offset. Check
        the zero of that sensor.""",
    )
    ANGLE_SCALE = (
        "scale of the angles",
        """The fit is better with angles multiplied by {factor:.3g}. | The sensor's scale is not as declared; ratios
        move by {moved:most}. Check the sensor's scale in radians.""",
    )
    LINK_LATE = (
        "one link late",
        """The angle of link {link} seems {delay:.3g} s late. | Its sensor has another clock or a filter, or its samples
        came later. Check its time stamps.""",
    )
    RELATIVE = (
        "angles are relative",
        """The data fit as if each angle were measured from the link before. | Angles were declared as absolute. Declare
        angles='relative'.""",
    )
    ABSOLUTE = (
        "angles are absolute",
        """The data fit as if each angle were measured from one fixed direction. | Angles were declared as relative.
        Declare angles='absolute'.""",
    )
    REVERSED = (
        "order from the free end",
        """The data fit as if {what} were counted from the free end. | Their order is not as declared. Reverse the order
        of the columns.""",
    )
    SWAPPED = (
        "two neighbours swapped",
        """The data fit as if {what} {first} and {second} were swapped. | Their order is not as declared. Swap the two
        columns.""",
    )
    SENSE = (
        "sense of one link",
        """The data fit as if the angle of link {link} had the other sign. | Its sensor counts in the other direction.
        Check the sign of that angle.""",
    )
    ZERO_DIRECTION = (
        "zero points elsewhere",
        """The data fit as if an angle of 0 were a link {where}. | The zero is not as declared. Check zero='hanging' or
        'up', and the axes.""",
    )
    DEGREES = (
        "angles are in degrees",
        "The data fit as if angles were in degrees. | They were declared as radians. Declare unit='deg'.",
    )
    RADIANS = (
        "angles are in radians",
        "The data fit as if angles were in radians. | They were declared as degrees. Declare unit='rad'.",
    )
    Y_AXIS = (
        "direction of y",
        """The data fit as if y pointed the other way. | The direction of y is not as declared. Declare y_axis='up' or
        'down'.""",
    )
    AXES_SWAPPED = (
        "x and y swapped",
        """The data fit as if x and y were swapped{down:?, and y pointed the other way}. | The axes are not as declared.
        Check the order of the columns, and the direction of y.""",
    )
    MARKER_SCALE = (
        "scale of the markers",
        """The fit is better with marker positions divided by {factor:.3g}. | The scale of the markers is not as
        declared. Check their unit, and the scale of the picture.""",
    )
    MARKER_PLACES = (
        "places of the markers",
        """The markers seem to be at {places:list} mm along the rope. | arc_lengths or a length are off; ratios move by
        {moved:most}. Measure arc_lengths and lengths again, or free 'arc'.""",
    )
    DELAY = (
        "delay of the motion",
        """The motion of the base seems {delay:.3g} s late in the recording's time. | The clocks of motor and recording
        differ. Free 'delay'.""",
    )
    ARM_LENGTH = (
        "length of the arm",
        """The fit is better with an arm of {length:m}. | The length of the arm is not as declared. Measure the arm
        again.""",
    )
    ARM_INERTIA = (
        "inertia of the arm",
        """The fit is better with an arm inertia of {value:.2g} kg m^2. | The inertia of the arm is not as declared.
        Measure it, or free 'arm_inertia'.""",
    )
    ARM_FRICTION = (
        "friction of the arm",
        """The fit is better with an arm friction of {value:.2g} N m s/rad. | The friction of the arm is not as
        declared. Measure it, or free 'arm_friction'.""",
    )
    MASS_TAPER = (
        "mass changes along the rope",
        """Links at the tip seem {factor:.3g} times as heavy as at the first joint. | The mass is not even along the
        rope; ratios move by {moved:most}. Give the guess such masses, or free 'mass:taper'.""",
    )
    REST_BEND = (
        "bent at rest",
        """The rope seems bent at rest, by {angle:deg} at each joint. | It was taken as straight. Free
        'rest_angle:shared', or give the guess such angles.""",
    )
    HELD = (
        "held value",
        """The fit is better with {name} of {values:list} {unit}. | The held value does not fit; ratios move by
        {moved:most}. Measure it{alike:?, and what removes as much: this motion does not tell them apart}, or free
        {name}.""",
    )
    RESISTANCE = (
        "another resistance",
        """The fit is better with {name} of {values:list} {unit}. | A resistance is of another kind or size, or changes.
        Free {name}.""",
    )
    UNEVEN_RESISTANCE = (
        "resistance differs along the rope",
        """{name} is {factor:.2g} times as large at the {where}. | The resistance differs along the rope. Free
        {words:list}.""",
    )
    LINKS_TOO_LONG = (
        "links too long",
        """The residuals look like those of a rope with more, shorter links (probability {probability:%}). | Values are
        off by up to {moved:%} with so few links. Use more links.""",
    )
    OUTLIERS = (
        "outliers",
        """{part:%} of the residuals are larger than {beyond:.0f} standard deviations of the others, and make
        {squares:%} of the sum of squares. | A few wrong samples dominate the fit. Fit again with
        FitOptions(loss='cauchy') or 'huber', or remove them.""",
    )
    # What the fit looks like
    HANGS_UPWARDS = (
        "gravity holds the rope up",
        """Gravity would hold the rope up: its first moment p1 is negative. | The zero of the angles or the direction
        of y is wrong. Check zero='hanging' or 'up', y_axis='up' or 'down'.""",
    )
    NOT_CONVERGED = (
        "fit not converged",
        """The fit has not converged{ended:? ({ended})}. | Values, ratios and deviations are those of its last step,
        not what the data show. Give a better guess, shorter windows, fewer free parameters, or more time.""",
    )
    NOT_FINISHED = (
        "work not finished",
        """The fit has converged, but work ended early ({ended}). | Other starts, tests, intervals or predictions may be
        missing. Allow more time.""",
    )
    POOR_FIT = (
        "poor fit",
        """{what}: the error of the fit is {rms:{unit}}, the motion within the windows is {motion:{unit}} (rms). | The
        model does not describe this motion. Check units, zero and sense of the recording, link lengths, the motion of
        the base, and the guess.""",
    )
    POOR_TORQUE = (
        "torque does not fit",
        """Torque: the error of the fit is {rms:.3g} N m, the torque varies by {motion:.3g} N m (rms). | Masses,
        inertias and frictions are meaningless until it fits. Check its sign (positive turns the arm to larger angles)
        and its unit, N m.""",
    )
    MASS_FAR = (
        "mass far beyond its link",
        """Link {link} would have its mass {factor:.3g} times as far from its joint as it is long. | Inertia over first
        moment is more than such a link can have: it is longer, or times must be multiplied by {clock:.3g}. Check
        times, frame rate, scale, lengths and the order of the links.""",
    )
    COM_OR_CLOCK = (
        "centre of mass or clock contradicts the guess",
        """Link {link} would have its centre of mass {factor:.3g} times as far from its joint as declared. | com or the
        clock contradicts the guess: com differs, or times must be multiplied by {clock:.3g}; J/p1 is then
        {moved:%} off. Check the frame rate, and measure com, or free 'com'.""",
    )
    LENGTH_OR_CLOCK = (
        "lengths or clock contradict the guess",
        """Links would be {factor:.3g} times as long as declared. | Gravity determines only a combination of lengths
        and times: lengths differ, or times must be multiplied by {clock:.3g}; J/p1 is then {moved:%} off. Check the
        frame rate, and measure one length; if it is poorly known, declare it: FitOptions(length_std=0.2).""",
    )
    PREDICTION_FAILED = (
        "prediction failed",
        """{failed} of {count} predictions of the held-out part failed (from t = {times:list} s). | The identified rope
        cannot be simulated there. Inspect the held-out part, or fit all (train=inf).""",
    )
    PREDICTION_POOR = (
        "poor prediction",
        """The error of predictions of the held-out part is {part:%} of that of a rope at rest. | The model omits an
        effect, or something is not as declared. """
        + COMPARE,
    )
    PREDICTION_OUTSIDE = (
        "prediction outside its band",
        """Only {part:%} of the held-out part is inside its 95 % band: prediction errors are {factor:.2g} times as
        large as stated. | Standard deviations and intervals due to noise and model are multiplied by this factor. The
        model omits an effect, or something is not as declared{free:?: most is explained with }{free}{free:? free}. """
        + COMPARE,
    )
    WINDOWS_DISAGREE = (
        "windows disagree",
        """{label} differs between windows by {times:.2g} times the effect of noise (std {part:%}). | Something changes
        over the recording, or the model omits an effect. Fit parts of the recording separately.""",
    )
    RESISTANCE_CHANGES = (
        "resistance changes with time",
        """{label} differs between windows by {times:.2g} times the effect of noise (std {part:%}). | A resistance
        changes over the recording, or is of another kind. Fit parts of the recording separately, or free another.""",
    )
    NOTHING_KNOWN = (
        "no ratio known",
        """No ratio of moments and inertias is known better than to {limit:%}. | The recording determines too little.
        Record longer or larger swings, or more frames a second.""",
    )
    UNTESTED = (
        "lengths and times untested",
        """This motion tests neither times nor lengths. | If they are wrong by more than declared, moments and inertias
        are too (clock 1 % off: J/p1 2 % off). Check the frame rate and the lengths.""",
    )
    POORLY_DETERMINED = (
        "poorly determined values",
        """Poorly determined: {parts:each (std %)}. | Their standard deviations are large; all other {others} are known
        better. Record longer or larger swings, or fix what you know from elsewhere.""",
    )
    LONE_START = (
        "one start alone",
        """Only one of {starts} starts led to this fit. | It may be a local optimum. Give a better guess, or shorter
        windows.""",
    )
    NOISE_UNDERSTATED = (
        "declared noise too small",
        """Residuals are {times:.3g} times as large as the declared noise. | The noise is larger, or the model omits an
        effect; then parameters may be off by more than their intervals. Check the noise's value and unit, or free
        another resistance.""",
    )
    COLOURED = (
        "correlated residuals",
        """Residuals are correlated, over {samples:.0f} samples. | The noise is correlated in time, or the model omits
        an effect; deviations include other resistances alone. See whether another model leaves less
        (compare_models).""",
    )
    NOT_STATIONARY = (
        "residuals not stationary",
        """No stationary noise explains the residuals. | Standard deviations and intervals may be far too small. See
        whether another model leaves less (compare_models), or use parts of the recording.""",
    )
    FEW_VALUES = (
        "few independent values",
        """The residuals hold about {values:.2g} independent values. | Standard deviations are little more than a guess,
        so 95 % intervals reach {half:.2g} of them to either side, not 2 (Student's t). Record longer, or free fewer
        parameters.""",
    )
    BETTER_OPTIMUM = (
        "better optimum nearby",
        """Near {name} the sum of squares is {gain:.3g} residual variances smaller. | This fit is not the best one. Fit
        again with rope_guess=hyperflex.identification.profile(found, '{name}').better.""",
    )
    PROFILE_GIVEN_UP = (
        "profile given up",
        """The likelihood profile of {name} was not followed to its ends: it took too many fits. | The interval is from
        the standard deviation. Use profile(found, name) to see the curve, or free fewer parameters.""",
    )
    # What the values stand for
    COM_HELD = (
        "masses follow from com",
        """Masses follow from com, held at {com:list} m{default:?, its default of half the length}. | The torque
        determines mass times com alone: a com 1 % larger makes a mass {moved:most} smaller. Find where the link
        balances and give com, or weigh it: free 'com' and hold 'mass'.""",
    )
    ONLY_RATIOS = (
        "no mass known",
        """No mass or inertia is known better than to {limit:%}. | The torque determines too little of them. Use ratios
        alone, or record larger torques and swings.""",
    )
    TORQUE_SCALE = (
        "proportional to the torque",
        """Masses, inertias and frictions are proportional to the torque as measured. | A torque 1 % too large makes
        them 1 % too large; standard deviations include torque_std. Check its scale with a known weight.""",
    )
    HELD_SCALE = (
        "proportional to held masses",
        """Masses, inertias and frictions are proportional to the held masses and centres of mass. | No motion tests
        these{moved:? (1 % of a centre of mass moves ratios by {moved:most})}. Use ratios alone, or weigh the links
        and find where each balances.""",
    )
    COMMON_FACTOR = (
        "unknown common factor",
        """Masses, inertias and frictions share a factor that no free swing shows. | Ratios are known. Use ratios
        alone, or weigh the links and hold 'mass' and 'com'.""",
    )
    UNDETECTABLE = (
        "lengths and times tested together only",
        """Times and lengths are tested against each other only. | With a clock 1 % off and all lengths 2 % off a rope
        moves in exactly the same way, and J/p1 is 2 % off. Check the frame rate, or one length.""",
    )
    FRICTION_MODEL = (
        "friction depends on the model",
        """Friction would change by {part:most} with {name} free as well. | The fitted friction stands for all that
        damps the motion, air included, at the amplitudes seen{included:?; standard deviations include this change}.
        Free both if the recording determines both.""",
    )
    WINDOWS_LEFT_OUT = (
        "windows left out",
        """{part:%} of the windows were not used. | They have too few samples, or the rope could not be simulated from
        their first states. Check gaps and outliers of the recording.""",
    )
    IDENTIFIABLE = "all identifiable", "All free parameters are identifiable, given those that were held."
    COMBINATION = (
        "unknown combination",
        """{count} combination(s) of {names:list} cannot be known. | They act alike in this motion; the values shown are
        one choice of many. Ratios that are not known either: {lost:list}. Fix what you can measure otherwise, such as
        'mass' and 'com', or record another motion.""",
    )
    NO_EFFECT = (
        "no effect in this motion",
        """{names:list} cannot be known. | They have no effect in this motion; the values shown are meaningless. Fix
        them, or record a motion in which they act.""",
    )
    AT_ZERO = (
        "went to zero",
        """{names:list} went to 0, the least allowed. | The data show no sign of it. Fix it at 0, unless you know
        otherwise.""",
    )
    NOT_ESTIMATED = (
        "no standard deviations",
        """The fit ended before standard deviations and intervals were computed. | The
        accuracy of the values is unknown. Allow more time.""",
    )
    CHOSEN = (
        "free by default",
        """Free by default: {usual:list}. | Added because the recording shows it: {added:each (% of the residuals'
        squares)}.{rivals:? As much is explained by }{rivals}{rivals:?, and ratios are others then: one of the two is
        not as declared.} Name what is free to choose otherwise.""",
    )
    HELD_VALUES = (
        "held values",
        """Held as given: {names:list}. | Their standard deviation of 0 is not an accuracy. Free what you do not
        know.""",
    )


KINDS = list(Kind)
FIRST_CAUSE, FIRST_SYMPTOM = KINDS.index(Kind.CLOCK), KINDS.index(Kind.HANGS_UPWARDS)


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    kind, severity : Kind, Severity
    values : dict
        Numbers, SI units, and names, by what they are.
    gain : float
        Part of the residuals' sum of squares that it explains; 0 where that is not known.
    """

    kind: Kind
    severity: Severity = Severity.DOUBT
    values: dict[str, Any] = field(default_factory=dict)
    gain: float = 0.0

    def __str__(self) -> str:
        return text(self)

    @property
    def table(self) -> dict[str, Any]:
        """The finding as plain data, for JSON and TOML."""
        return {"kind": self.kind.value, "severity": self.severity.name.lower(), "gain": self.gain} | {
            "values": self.values
        }


class Grade(StrEnum):
    """What a result may be used for; of ratios alone where masses, inertias and frictions share a factor."""

    USABLE = "usable"
    RATIOS = "usable for ratios"
    DO_NOT_USE = "do not use"


# Of these findings one says that only ratios are known
SCALES = (Kind.HELD_SCALE, Kind.COMMON_FACTOR, Kind.COM_HELD, Kind.ONLY_RATIOS)


def grade(findings: Iterable[Finding]) -> Grade:
    """Return the grade that follows from findings."""
    findings = list(findings)
    if any(each.severity is Severity.WRONG for each in findings):
        return Grade.DO_NOT_USE
    scaled = any(each.kind in SCALES and each.severity > Severity.NOTE for each in findings)
    return Grade.RATIOS if scaled else Grade.USABLE


def ordered(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings, the most severe first, then by rank; what a short fit has confirmed first, then by gain."""

    def order(finding: Finding) -> tuple[float, ...]:
        rank = bisect_right((FIRST_CAUSE, FIRST_SYMPTOM), KINDS.index(finding.kind))
        return -finding.severity, rank, "before" not in finding.values, -finding.gain

    return tuple(sorted(findings, key=order))


class _Formatter(string.Formatter):
    """Fills a text with SI values in units for people."""

    def format_field(self, value: Any, spec: str) -> str:
        """Return a value as its specification says."""
        if spec == "%":
            return percent(value)
        if spec == "most":
            return "less than 0.001 %" if value < 1e-5 else "up to " * (value <= 10.0) + percent(value)
        if spec == "deg":
            return f"{np.degrees(value):.3g} degrees"
        if spec in ("m", "rad"):
            return f"{1e3 * value:.3g} mm" if spec == "m" and abs(value) < 1.0 else f"{value:.3g} {spec}"
        if spec.startswith("?"):
            return spec[1:] if value else ""
        if spec.startswith("each"):
            value, spec = [name + spec[4:].replace("%", percent(part)) for name, part in value.items()], "list"
        if spec == "list":
            value = [" to ".join(f"{end:.4g}" for end in each) if isinstance(each, list) else each for each in value]
            shown = [f"{each:.4g}" if isinstance(each, float) else str(each) for each in value]
            return listed(shown, NAMES) or "none"
        said = str(super().format_field(value, spec))
        return f"{float(said):.0f}" if "e+0" in said else said  # 110, not 1.1e+02


def percent(part: float) -> str:
    """Return a part in per cent: two digits, and at most 1000 %, beyond which a number says nothing."""
    return "1000 % and more" if part > 10.0 else f"{float(f'{100.0 * part:.2g}'):g} %"


def text(finding: Finding) -> str:
    """Return a finding as one line: what was seen, what it means, what to do."""
    seen, _, rest = _Formatter().vformat(finding.kind.text, (), finding.values).partition(" | ")
    if finding.gain > 0.0 and "left" not in finding.values:
        seen += f" This removes {percent(finding.gain)} of the residuals' sum of squares{_others(finding)}."
    if "before" in finding.values:
        seen += " With this change a short fit leaves {left:%} of the motion unexplained, as declared {before:%}."
        seen = _Formatter().vformat(seen, (), finding.values)
    maybe = "Possible: " if finding.severity is Severity.DOUBT and finding.gain > 0.0 else ""
    return f"{maybe}{seen} {rest}".rstrip()


def _others(finding: Finding) -> str:
    """Return what had to be free as well, and what explains as much."""
    along, alike = finding.values.get("freed_with", ()), finding.values.get("alike", {})
    words = f" with {', '.join(along)} free as well" if along else ""
    others = ", ".join(f"{name} ({value:.3g})" if np.isfinite(value) else name for name, value in alike.items())
    return words + (f"; these remove as much: {others}" if alike else "")


def report(grade: Grade, findings: Sequence[Finding], *, full: bool = False) -> str:
    """Return the grade and one line for each finding; at most LINES lines unless `full`, notes only then."""
    lines = [text(each) for each in findings if full or each.severity > Severity.NOTE]
    if len(lines) >= LINES and not full:
        lines[LINES - 2 :] = [f"and {len(lines) - LINES + 2} more: report(full=True)"]
    return "\n  ".join([f"{grade.capitalize()}.", *lines])
