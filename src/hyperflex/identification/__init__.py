"""Identification: from a recording and a first guess to a rope with uncertainties."""

from __future__ import annotations

from hyperflex.identification._correlogram import correlogram
from hyperflex.identification._identify import identify
from hyperflex.identification._parameters import lumped
from hyperflex.identification._prediction import BAND, HeldOut
from hyperflex.identification._result import Identification
from hyperflex.identification._uncertainty import ratios

__all__ = ["BAND", "HeldOut", "Identification", "correlogram", "identify", "lumped", "ratios"]
