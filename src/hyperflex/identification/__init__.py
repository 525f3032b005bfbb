"""Identification: from a recording and a first guess to a rope with uncertainties."""

from __future__ import annotations

from hyperflex.identification._bootstrap import Bootstrap, bootstrap
from hyperflex.identification._identify import identify
from hyperflex.identification._intervals import Interval
from hyperflex.identification._parameters import lumped
from hyperflex.identification._prediction import HeldOut
from hyperflex.identification._profile import Profile, profile
from hyperflex.identification._result import Identification
from hyperflex.identification._uncertainty import ratios

__all__ = [
    "Bootstrap",
    "HeldOut",
    "Identification",
    "Interval",
    "Profile",
    "bootstrap",
    "identify",
    "lumped",
    "profile",
    "ratios",
]
