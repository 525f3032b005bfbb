"""What an identification gives back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.files import PathLike
from hyperflex.identification.ending import Ended
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.intervals import Interval
from hyperflex.model import Rope

MANY = 8  # numbers of a kind that are printed


@dataclass(frozen=True, eq=False)
class Identification(Ended):
    """An identified rope, and how far it can be trusted.

    Attributes
    ----------
    rope : Rope
        The guess with the free parameters at their fitted values.
    values, sd : dict of str to ndarray
        By the names in ``free``, SI units: per-link properties (n,), others single. The standard deviation is 0 where
        a link's value was held, and inf where this motion cannot tell it.
    ratios, ratio_sd : dict of str to ndarray (n,)
        ``J/p1``, ``p/p1``, ``c/p1`` and, where fitted, ``dry/p1``, ``k/p1``: what a motion without known forces can
        tell (p_i = m_i a_i + l_i m_beyond, J_i = inertia_i + m_i a_i^2 + l_i^2 m_beyond; p1 is that of link 0).
    intervals : dict of str to Interval
        Of each of `parameters`, and of the ratios of each link (``J/p1[0]``): low, high, how it was found, and what
        either end is; 95 %. Empty where none were asked for.
    verdict : tuple of str
        In words: what can be known, what cannot, and what looks wrong.
    identifiable : bool
        Whether all free parameters can be known.
    residual_rms : (C,) rad or m
        Fit error of each channel (each link's angle, or each marker's x and y) over all windows.
    residual_t (m,), residuals (m, C) : s, rad or m
        Measured less fitted channels at the fitted samples; NaN in gaps.
    held_out : HeldOut or None
        Prediction of the part that was not fitted.
    parameters : tuple of str
        Names of the P single free numbers, e.g. ``friction[1]``.
    covariance : (P, P)
        Of these, in SI units; along directions that cannot be known it is 0 (the values are held there).
    singular_values : (P,)
        Of the scaled information, largest first.
    settings : dict
        Window length (s), number of windows and of those left out, decimation step, time fitted (s), autocorrelation
        time of the residuals (samples), seconds taken; how the fit was set up: words in ``free``, loss, base, and
        `arc_lengths` and `origin` if given, and the delay that the fit started from (s), if it was free.
    message : str
        ``converged``, ``not converged`` or ``interrupted`` (Ctrl-C; the best so far).
    unit : str
        Of what was fitted: ``rad`` or ``m``.
    history : tuple of dict
        Round by round: window length, stage (of how many stages), round, cost, gain, damping.
    torque_residuals : (m,) N m, or None
        Measured less fitted motor torque, where it was measured; NaN in gaps.

    Notes
    -----
    Standard deviations allow for robust losses and for residuals that hang together in time (see
    ``_uncertainty.judge``), intervals for bounds and skewness as well. Errors of the model itself are in neither.
    """

    rope: Rope
    values: dict[str, Array]
    sd: dict[str, Array]
    ratios: dict[str, Array]
    ratio_sd: dict[str, Array]
    intervals: dict[str, Interval]
    verdict: tuple[str, ...]
    identifiable: bool
    residual_rms: Array
    residual_t: Array
    residuals: Array
    held_out: HeldOut | None
    parameters: tuple[str, ...]
    covariance: Array
    singular_values: Array
    settings: dict[str, Any]
    message: str
    unit: str
    history: tuple[dict[str, float], ...]
    torque_residuals: Array | None = None
    _basis: Basis | None = field(default=None, init=False, repr=False)

    def resting_on(self, basis: Basis) -> Self:
        """Keep the fit itself, `basis`, for further questions; return this same result."""
        object.__setattr__(self, "_basis", basis)
        return self

    @property
    def residual_rms_all(self) -> float:
        """Fit error over all channels and windows together, rad or m."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))

    @property
    def torque_rms(self) -> float | None:
        """Fit error of the motor torque, N m; None where it was not measured."""
        return None if self.torque_residuals is None else float(np.sqrt(np.nanmean(self.torque_residuals**2)))

    def summary(self) -> dict[str, Any]:
        """Return the figures as plain numbers and lists; what cannot be known (inf) is None."""
        alike = ("identifiable", "unit", "values", "sd", "ratios", "ratio_sd", "parameters", "covariance")
        result: dict[str, Any] = self.ending() | {name: getattr(self, name) for name in alike}
        result["intervals"] = {
            name: {"low": each.low, "high": each.high, "kind": each.kind} for name, each in self.intervals.items()
        }
        result |= {"residual_rms": self.residual_rms, "residual_rms_all": self.residual_rms_all}
        if self.torque_residuals is not None:
            result["torque_rms"] = self.torque_rms
        if self.held_out is not None:
            held = self.held_out
            result["held_out"] = {"lead": held.lead, "ahead": held.ahead, "predictions": held.starts.size}
            result["held_out"] |= {"rms": held.rms, "window_rms": held.window_rms, "inside_band": held.inside}
        result |= {"verdict": self.verdict, "settings": self.settings, "rope": self.rope.table()}
        return dict(files.plain(result))

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def to_toml(self, path: PathLike) -> None:
        """Write the rope to `path`, readable by ``Rope.from_toml``, with the figures in ``[identification]``."""
        content = {name: value for name, value in self.summary().items() if name != "rope"}
        files.write_toml(path, {"rope": self.rope.table(), "identification": _without_none(content)})

    def __str__(self) -> str:
        told = (f"{k} {_short(v)}" for k, v in self.settings.items() if not isinstance(v, list))
        lines = [f"Identification {self.message}: " + ", ".join(told)]
        for title, value, spread in (("value", self.values, self.sd), ("ratio", self.ratios, self.ratio_sd)):
            for name, numbers in value.items():
                if said := _told(np.atleast_1d(numbers), np.atleast_1d(spread[name])):
                    lines.append(f"  {title} {name:<13} {said}")
        ranges = [(name, self.intervals[name]) for name in self.parameters if name in self.intervals]
        lines += [f"  {100 * each.level:g} % {name:<13} {each}" for name, each in ranges[:MANY]]
        if len(ranges) > MANY:
            lines.append(f"  and {len(ranges) - MANY} more in intervals")
        lines.append(f"  fit error, m{self.unit}       {_few([f'{1e3 * x:.2f}' for x in self.residual_rms])}")
        if self.torque_rms is not None:
            lines.append(f"  torque error, mN m     {1e3 * self.torque_rms:.3f}")
        if self.held_out is not None:
            lines.append(
                f"  prediction error over {self.held_out.ahead:g} s, m{self.unit}  "
                + _few([f"{1e3 * x:.2f}" for x in self.held_out.rms])
            )
        return "\n".join([*lines, *(f"  {text}" for text in self.verdict)])


def _told(values: Array, spreads: Array) -> str:
    """Return values (n,) with their deviations; those that were held are left out, what all links share stands once."""
    pairs = [f"{x:.5g} ± {s:.2g}" for x, s in zip(values, spreads, strict=True)]
    free = np.flatnonzero(spreads)
    if len(pairs) > 1 and len(set(pairs)) == 1:
        return f"{pairs[0]} each" if free.size else ""
    if free.size < len(pairs):
        return _few([f"[{k}] {pairs[k]}" for k in free])
    return _few(pairs)


def _few(words: list[str]) -> str:
    """Return words side by side; of many the first ones."""
    more = f"  and {len(words) - MANY} more" if len(words) > MANY else ""
    return "  ".join(words[:MANY]) + more


def _without_none(content: Any) -> Any:
    """Return nested tables with None as the word "unknown", which TOML can hold."""
    if isinstance(content, dict):
        return {key: _without_none(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_without_none(value) for value in content]
    return "unknown" if content is None else content


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
