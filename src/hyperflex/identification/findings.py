"""Findings: what an identification shows beside its values, as data. Their texts are in texts.py."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any


class Severity(IntEnum):
    """What a finding means for the result."""

    NOTE = 0  # information
    LIMIT = 1  # what this motion, or any motion, cannot show
    DOUBT = 2  # something may be wrong or is poorly determined; standard deviations include it
    WRONG = 3  # the result must not be used


class Rank(IntEnum):
    """Which findings of one severity come first: plain evidence, causes (the greatest gain first), symptoms."""

    EVIDENCE = 0
    CAUSE = 1
    SYMPTOM = 2


class Kind(StrEnum):
    """Kind of a finding, with its rank."""

    rank: Rank

    def __new__(cls, value: str, rank: Rank) -> "Kind":
        """Make a kind of its name and its rank."""
        made = str.__new__(cls, value)
        made._value_, made.rank = value, rank
        return made

    # What the recording or the rope shows by itself
    MARKERS_SWAPPED = "markers swapped for a time", Rank.EVIDENCE
    PICTURE_SCALE = "different scales along x and y", Rank.EVIDENCE
    MARKER_DISTANCES = "marker distances unlike link lengths", Rank.EVIDENCE
    UNLIKE_LENGTHS = "link lengths of different units", Rank.EVIDENCE
    NOISE_OVERSTATED = "declared noise too large", Rank.EVIDENCE
    UNEXPLAINED = "residuals larger than noise", Rank.EVIDENCE
    SPRING_OR_ANGLES = "angles scaled, or a spring", Rank.EVIDENCE
    # Declarations that contradict the data
    CLOCK = "clock or lengths", Rank.CAUSE
    DRIFT = "drifting clock", Rank.CAUSE
    LENGTHS = "lengths", Rank.CAUSE
    ZERO = "zero of the angles", Rank.CAUSE
    LINK_ZERO = "zero of one link", Rank.CAUSE
    ANGLE_SCALE = "scale of the angles", Rank.CAUSE
    RELATIVE = "angles are relative", Rank.CAUSE
    ABSOLUTE = "angles are absolute", Rank.CAUSE
    REVERSED = "order from the free end", Rank.CAUSE
    SWAPPED = "two neighbours swapped", Rank.CAUSE
    SENSE = "sense of one link", Rank.CAUSE
    ZERO_DIRECTION = "zero points elsewhere", Rank.CAUSE
    DEGREES = "angles are in degrees", Rank.CAUSE
    RADIANS = "angles are in radians", Rank.CAUSE
    Y_AXIS = "direction of y", Rank.CAUSE
    AXES_SWAPPED = "x and y swapped", Rank.CAUSE
    MARKER_SCALE = "scale of the markers", Rank.CAUSE
    MARKER_PLACES = "places of the markers", Rank.CAUSE
    DELAY = "delay of the motion", Rank.CAUSE
    ARM_LENGTH = "length of the arm", Rank.CAUSE
    ARM_INERTIA = "inertia of the arm", Rank.CAUSE
    ARM_FRICTION = "friction of the arm", Rank.CAUSE
    MASS_TAPER = "mass changes along the rope", Rank.CAUSE
    REST_BEND = "bent at rest", Rank.CAUSE
    HELD = "held value", Rank.CAUSE
    RESISTANCE = "another resistance", Rank.CAUSE
    UNEVEN_RESISTANCE = "resistance differs along the rope", Rank.CAUSE
    LINKS_TOO_LONG = "links too long", Rank.CAUSE
    # What the fit looks like
    HANGS_UPWARDS = "gravity holds the rope up", Rank.SYMPTOM
    NOT_CONVERGED = "fit not converged", Rank.SYMPTOM
    POOR_FIT = "poor fit", Rank.SYMPTOM
    POOR_TORQUE = "torque does not fit", Rank.SYMPTOM
    MASS_FAR = "mass far beyond its link", Rank.SYMPTOM
    PREDICTION_FAILED = "prediction failed", Rank.SYMPTOM
    PREDICTION_POOR = "poor prediction", Rank.SYMPTOM
    PREDICTION_OUTSIDE = "prediction outside its band", Rank.SYMPTOM
    WINDOWS_DISAGREE = "windows disagree", Rank.SYMPTOM
    RESISTANCE_CHANGES = "resistance changes with time", Rank.SYMPTOM
    NOTHING_KNOWN = "no ratio known", Rank.SYMPTOM
    GRAVITY_ROTATED = "gravity rotated", Rank.SYMPTOM
    UNTESTED = "lengths and times untested", Rank.SYMPTOM
    POORLY_DETERMINED = "poorly determined values", Rank.SYMPTOM
    LONE_START = "one start alone", Rank.SYMPTOM
    NOISE_UNDERSTATED = "declared noise too small", Rank.SYMPTOM
    COLOURED = "correlated residuals", Rank.SYMPTOM
    NOT_STATIONARY = "residuals not stationary", Rank.SYMPTOM
    FEW_VALUES = "few independent values", Rank.SYMPTOM
    BETTER_OPTIMUM = "better optimum nearby", Rank.SYMPTOM
    PROFILE_GIVEN_UP = "profile given up", Rank.SYMPTOM
    # What the values stand for
    TORQUE_SCALE = "proportional to the torque", Rank.SYMPTOM
    HELD_SCALE = "proportional to held masses", Rank.SYMPTOM
    COMMON_FACTOR = "unknown common factor", Rank.SYMPTOM
    UNDETECTABLE = "lengths and times tested together only", Rank.SYMPTOM
    FRICTION_MODEL = "friction depends on the model", Rank.SYMPTOM
    WINDOWS_LEFT_OUT = "windows left out", Rank.SYMPTOM
    IDENTIFIABLE = "all identifiable", Rank.SYMPTOM
    COMBINATION = "unknown combination", Rank.SYMPTOM
    NO_EFFECT = "no effect in this motion", Rank.SYMPTOM
    AT_ZERO = "went to zero", Rank.SYMPTOM
    NOT_ESTIMATED = "no standard deviations", Rank.SYMPTOM
    CHOSEN = "free by default", Rank.SYMPTOM
    HELD_VALUES = "held values", Rank.SYMPTOM


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


SCALES = (Kind.HELD_SCALE, Kind.COMMON_FACTOR)  # of these findings one says that only ratios are known


def grade(findings: Iterable[Finding]) -> Grade:
    """Return the grade that follows from findings."""
    findings = list(findings)
    if any(each.severity is Severity.WRONG for each in findings):
        return Grade.DO_NOT_USE
    return Grade.RATIOS if any(each.kind in SCALES for each in findings) else Grade.USABLE


def ordered(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings, the most severe first, then by rank; what a short fit has confirmed first, then by gain."""
    return tuple(
        sorted(findings, key=lambda each: (-each.severity, each.kind.rank, "before" not in each.values, -each.gain))
    )
