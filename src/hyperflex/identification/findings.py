"""Findings: what an identification shows beside its values, as data. Their texts are in texts.py."""

from bisect import bisect_right
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


class Kind(StrEnum):
    """Kind of a finding. Of findings of one severity plain evidence comes first, then causes, then symptoms."""

    # What the recording or the rope shows by itself
    MARKERS_SWAPPED = "markers swapped for a time"
    PICTURE_SCALE = "different scales along x and y"
    MARKER_DISTANCES = "marker distances unlike link lengths"
    UNLIKE_LENGTHS = "link lengths of different units"
    NOISE_OVERSTATED = "declared noise too large"
    UNEXPLAINED = "residuals larger than noise"
    SPRING_OR_ANGLES = "angles scaled, or a spring"
    # Declarations that contradict the data
    CLOCK = "clock or lengths"
    DRIFT = "drifting clock"
    LENGTHS = "lengths"
    ZERO = "zero of the angles"
    LINK_ZERO = "zero of one link"
    ANGLE_SCALE = "scale of the angles"
    RELATIVE = "angles are relative"
    ABSOLUTE = "angles are absolute"
    REVERSED = "order from the free end"
    SWAPPED = "two neighbours swapped"
    SENSE = "sense of one link"
    ZERO_DIRECTION = "zero points elsewhere"
    DEGREES = "angles are in degrees"
    RADIANS = "angles are in radians"
    Y_AXIS = "direction of y"
    AXES_SWAPPED = "x and y swapped"
    MARKER_SCALE = "scale of the markers"
    MARKER_PLACES = "places of the markers"
    DELAY = "delay of the motion"
    ARM_LENGTH = "length of the arm"
    ARM_INERTIA = "inertia of the arm"
    ARM_FRICTION = "friction of the arm"
    MASS_TAPER = "mass changes along the rope"
    REST_BEND = "bent at rest"
    HELD = "held value"
    RESISTANCE = "another resistance"
    UNEVEN_RESISTANCE = "resistance differs along the rope"
    LINKS_TOO_LONG = "links too long"
    # What the fit looks like
    HANGS_UPWARDS = "gravity holds the rope up"
    NOT_CONVERGED = "fit not converged"
    POOR_FIT = "poor fit"
    POOR_TORQUE = "torque does not fit"
    MASS_FAR = "mass far beyond its link"
    PREDICTION_FAILED = "prediction failed"
    PREDICTION_POOR = "poor prediction"
    PREDICTION_OUTSIDE = "prediction outside its band"
    WINDOWS_DISAGREE = "windows disagree"
    RESISTANCE_CHANGES = "resistance changes with time"
    NOTHING_KNOWN = "no ratio known"
    GRAVITY_ROTATED = "gravity rotated"
    UNTESTED = "lengths and times untested"
    POORLY_DETERMINED = "poorly determined values"
    LONE_START = "one start alone"
    NOISE_UNDERSTATED = "declared noise too small"
    COLOURED = "correlated residuals"
    NOT_STATIONARY = "residuals not stationary"
    FEW_VALUES = "few independent values"
    BETTER_OPTIMUM = "better optimum nearby"
    PROFILE_GIVEN_UP = "profile given up"
    # What the values stand for
    TORQUE_SCALE = "proportional to the torque"
    HELD_SCALE = "proportional to held masses"
    COMMON_FACTOR = "unknown common factor"
    UNDETECTABLE = "lengths and times tested together only"
    FRICTION_MODEL = "friction depends on the model"
    WINDOWS_LEFT_OUT = "windows left out"
    IDENTIFIABLE = "all identifiable"
    COMBINATION = "unknown combination"
    NO_EFFECT = "no effect in this motion"
    AT_ZERO = "went to zero"
    NOT_ESTIMATED = "no standard deviations"
    CHOSEN = "free by default"
    HELD_VALUES = "held values"


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

    def order(finding: Finding) -> tuple[float, ...]:
        rank = bisect_right((FIRST_CAUSE, FIRST_SYMPTOM), KINDS.index(finding.kind))
        return -finding.severity, rank, "before" not in finding.values, -finding.gain

    return tuple(sorted(findings, key=order))
