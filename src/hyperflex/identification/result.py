"""The result of an identification."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.errors import LISTED, InvalidInput, listed
from hyperflex.files import PathLike
from hyperflex.identification.declarations.score_tests import ScoreTest
from hyperflex.identification.findings import Finding, Grade, Kind, Severity, grade, percent, report, text
from hyperflex.identification.prediction import HeldOut
from hyperflex.identification.uncertainty.covariance import Basis, Interval
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.status import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = (  # of a summary
    *("grade", "success", "status", "message", "identifiable", "unit", "values", "std", "model_std", "ratios"),
    *("ratio_std", "ratio_model_std", "held", "parameters", "covariance", "length_covariance", "residual_rms"),
    *("residual_rms_all", "settings"),
)
# of settings
UNITS = dict.fromkeys(("window", "delay_from", "fitted_from", "fitted_to"), " s") | {"autocorrelation": " samples"}
LARGE = 0.3  # part of a standard deviation from which the model's is printed


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """An identified rope, and how far it can be trusted.

    Attributes
    ----------
    rope : Rope
        The guess with the free parameters at their fitted values. Its gravity keeps the direction of the guess:
        `gravity_angle`, the roll of the camera, is only in `values`.
    values, std : dict of str to ndarray
        By the names in ``free``, SI units: per-link properties (n,), others single. The standard deviation is 0 where
        a link's value was held, and inf where it is not identifiable.
    ratios, ratio_std : dict of str to ndarray (n,)
        ``J/p1``, ``p/p1``, ``c/p1`` and of other resistances, identifiable without known forces
        (p_i = m_i a_i + l_i m_beyond, J_i = inertia_i + m_i a_i^2 + l_i^2 m_beyond; p1 is that of link 0).
    model_std, ratio_model_std : dict of str to ndarray
        The part of `std` and `ratio_std` that is not due to noise: the changes of the values if omitted laws of joints
        and air that the data require were included, lengths, times and torques were wrong by `length_std`, `clock_std`
        and `torque_std`, and links that are too long were shorter.
    intervals : dict of str to Interval
        95 % intervals of each of `parameters` and of each link's ratios (``J/p1[0]``). Empty if none were requested.
    findings : tuple of Finding
        Results of the tests of data, declarations and model, the most severe first; the grade follows from them, and
        :meth:`report` makes text from them.
    score_tests : tuple of ScoreTest
        Tests of fixed values and declarations, the greatest gain first. Empty if the fit did not converge.
    residual_rms : (C,) rad or m
        Fit error of each channel (each link's angle, or each marker's x and y) over all windows.
    residual_t (m,), residuals, fitted (m, C) : s, rad or m
        Measured less fitted channels, and fitted ones, at the fitted samples; NaN in gaps.
    held_out : HeldOut or None
        Prediction of the part that was not fitted.
    starts : (P,)
        Values from which `parameters` were fitted, SI units.
    parameters, covariance : tuple of str, (P, P)
        Names of the P single free numbers, e.g. ``friction[1]``; their covariance, SI units, with all errors in `std`
        (its diagonal is the square of `std`, where that is finite), 0 along unknown directions.
    length_covariance : (P + 1,)
        Covariance of `parameters` with the error of a factor on all lengths, and that error's variance: `covariance`
        includes the effect of the lengths' error, so a sampled rope needs its sampled length too.
    singular_values : (P,)
        Of the scaled information, largest first.
    settings : dict
        Window length (s), number of windows and of omitted ones, samples in a value (``decimation``), time fitted (s),
        autocorrelation time of the residuals (samples), seconds taken; ``free``, loss, base, ``noise_declared``, and
        where given `arc_lengths`, `origin` and the delay that the fit started from (s).
    converged : bool
        Whether the fit converged.
    ended : Status or None
        OUT_OF_TIME or INTERRUPTED if the work was cut short. Otherwise `status` is SUCCESS if the fit converged and its
        grade is not "do not use".
    unit : str
        ``rad`` or ``m``.
    history : tuple of dict
        Round by round: window length, stage (of how many stages), round, cost, gain, damping; `start` where it is
        another start's.
    torque_residuals : (m,) N m, or None
        Measured less fitted motor torque; NaN in gaps.
    _basis : Basis or None
        The fit itself, see `basis`.

    Notes
    -----
    Standard deviations allow for robust losses and autocorrelated residuals (see ``estimate_covariance``), intervals
    also for bounds and skewness. Both include, as `model_std`, errors of declarations, and those errors of the model
    that score tests find, but no others.
    """

    rope: Rope
    values: dict[str, Array]
    std: dict[str, Array]
    ratios: dict[str, Array]
    ratio_std: dict[str, Array]
    model_std: dict[str, Array]
    ratio_model_std: dict[str, Array]
    intervals: dict[str, Interval]
    findings: tuple[Finding, ...]
    score_tests: tuple[ScoreTest, ...]
    residual_rms: Array
    residual_t: Array
    residuals: Array
    fitted: Array
    held_out: HeldOut | None
    starts: Array
    parameters: tuple[str, ...]
    covariance: Array
    length_covariance: Array
    singular_values: Array
    settings: dict[str, Any]
    converged: bool
    ended: Status | None
    unit: str
    history: tuple[dict[str, float], ...]
    torque_residuals: Array | None = None
    _basis: Basis | None = field(default=None, repr=False)

    @property
    def grade(self) -> Grade:
        """What it may be used for."""
        return grade(self.findings)

    @property
    def status(self) -> Status:
        """How it ended."""
        if self.ended is not None:
            return self.ended
        return Status.SUCCESS if self.converged and self.grade is not Grade.DO_NOT_USE else Status.FAILED

    @property
    def success(self) -> bool:
        """Whether the fit converged and may be used."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why it failed, and what to do; empty on success."""
        if self.success:
            return ""
        why = (each for each in self.findings if each.severity is Severity.WRONG or each.kind is Kind.NOT_FINISHED)
        return text(next(why, self.findings[0]))

    @property
    def identifiable(self) -> bool:
        """Whether all free parameters can be known."""
        return self.has(Kind.IDENTIFIABLE)

    def has(self, *kinds: Kind) -> bool:
        """Return whether there is a finding of one of these kinds."""
        return any(each.kind in kinds for each in self.findings)

    def report(self, *, full: bool = False) -> str:
        """Return the grade, and a line for each finding; five lines at most unless `full`."""
        return report(self.grade, self.findings, full=full)

    @property
    def basis(self) -> Basis:
        """The fit itself, for profiles; raises InvalidInput for a result read from a file."""
        if self._basis is None:
            raise InvalidInput("this result no longer has its fit", fix="Run identify again, in this session")
        if not self._basis.information.estimated:
            raise InvalidInput("this fit was interrupted before its deviations were found", fix="Run identify again")
        return self._basis

    @property
    def held(self) -> tuple[str, ...]:
        """Names of fixed entries of `values` and `ratios`, with the link if only some are: their `std` is no error."""
        said: list[str] = []
        for std in (self.std, self.ratio_std):
            for name, each in std.items():
                links = np.flatnonzero(np.atleast_1d(each) == 0.0)
                links = links[links > 0] if name == "p/p1" else links  # that of link 0 is 1 by definition
                whole = links.size == each.size - (name == "p/p1")
                if links.size:
                    said += [name] if whole else [f"{name}[{k}]" for k in links]
        return tuple(said)

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
        result = {name: getattr(self, name) for name in SHOWN} | {
            "grade": self.grade.value,
            "status": self.status.value,
        }
        result["findings"] = [each.table for each in self.findings]
        ranges = self.intervals.items()
        result["intervals"] = {name: {"low": r.low, "high": r.high, "kind": r.kind} for name, r in ranges}
        if self.torque_residuals is not None:
            result["torque_rms"] = self.torque_rms
        if (held := self.held_out) is not None:
            result["held_out"] = {"lead": held.lead, "ahead": held.ahead, "predictions": held.starts.size}
            result["held_out"] |= {"rms": held.rms, "window_rms": held.window_rms, "inside_band": held.inside}
            result["held_out"] |= {"foreseeable_part": held.foreseen, "foreseeable_error": held.error}
        result["score_tests"] = {
            each.name: {"gain": each.gain, "values": each.values, "refitted": each.refitted}
            for each in self.score_tests
        }
        return dict(files.plain(result | {"rope": self.rope.table()}))

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def to_toml(self, path: PathLike) -> None:
        """Write the rope to `path`, readable by ``Rope.from_toml``, with the figures in ``[identification]``."""
        content = {name: value for name, value in self.summary().items() if name != "rope"}
        files.write_toml(path, {"rope": self.rope.table(), "identification": _without_none(content)})

    def __repr__(self) -> str:
        return f"Identification({self.grade}, {self.status}, {', '.join(self.values)} of {self.rope!r})"

    def plot(self, recording: Recording, ax: "Axes | None" = None) -> "Figure":
        """Draw measurement, fit and held-out prediction over time: return a Matplotlib figure.

        Parameters
        ----------
        recording : Recording
            The one that was identified from.
        ax : matplotlib.axes.Axes, optional
            Axes for the channel that fits worst; by default a new figure shows the most informative ones.
        """
        from hyperflex.report import FittedChannels, fit_figure

        return fit_figure(FittedChannels(recording, self), ax)

    def _repr_html_(self) -> str:
        from hyperflex.report import identification_html

        return identification_html(self)

    def __str__(self) -> str:
        settings = {k: f"{v:.4g}{UNITS.get(k, '')}" if isinstance(v, float) else v for k, v in self.settings.items()}
        said = ", ".join(f"{k} {v}" for k, v in settings.items() if not isinstance(v, list))
        lines = [self.report(), f"Identification, {self.status}: {said}"]
        kinds = (
            ("value", self.values, self.std, self.model_std),
            ("ratio", self.ratios, self.ratio_std, self.ratio_model_std),
        )
        for title, value, spread, model in kinds:
            for name, numbers in value.items():
                if said := _with_std(*(np.atleast_1d(each) for each in (numbers, spread[name], model[name]))):
                    lines.append(f"  {title} {name:<13} {said}")
        ranges = [(name, self.intervals[name]) for name in self.parameters if name in self.intervals]
        ranges = [(name, each) for name, each in ranges if each.kind != "unknown"]
        lines += [f"  {100 * each.level:g} % {name:<13} {each}" for name, each in ranges[:LISTED]]
        if len(ranges) > LISTED:
            lines.append(f"  and {len(ranges) - LISTED} more in intervals")
        lines.append(f"  fit error, m{self.unit}       {listed([f'{1e3 * x:.2f}' for x in self.residual_rms])}")
        if self.torque_rms is not None:
            lines.append(f"  torque error, mN m     {1e3 * self.torque_rms:.3f}")
        if (held := self.held_out) is not None:
            errors = listed([f"{1e3 * x:.2f}" for x in held.rms])
            seen = f"; {1e3 * held.error:.2f} in the foreseeable {percent(held.foreseen)}" * (held.foreseen < 1.0)
            lines.append(f"  prediction error over {held.ahead:g} s, m{self.unit}  {errors}{seen}")
        return "\n".join(lines)


def _with_std(values: Array, spreads: Array, models: Array) -> str:
    """Return values (n,) with their deviations, and the model's part of these where it is large.

    Those that were held are left out, what all links share stands once.
    """
    pairs = [
        f"{x:.5g} (std {s:.2g}{f', of the model {m:.2g}' if m > LARGE * s else ''})"
        for x, s, m in zip(values, spreads, models, strict=True)
    ]
    free = np.flatnonzero(spreads)
    if len(pairs) > 1 and len(set(pairs)) == 1:
        return f"{pairs[0]} each" if free.size else ""
    if free.size < len(pairs):
        return listed([f"[{k}] {pairs[k]}" for k in free])
    return listed(pairs)


def _without_none(content: Any) -> Any:
    """Return nested tables with None as the word "unknown", which TOML can hold."""
    if isinstance(content, dict):
        return {key: _without_none(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_without_none(value) for value in content]
    return "unknown" if content is None else content
