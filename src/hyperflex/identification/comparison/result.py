"""Result of a comparison of models: each candidate's figures and the preferred one."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import extras, files
from hyperflex.files import PathLike
from hyperflex.identification.comparison.evidence import SUPPORT, probability
from hyperflex.identification.result import Identification
from hyperflex.status import Status

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False)
class FittedModel:
    """One candidate and its evidence.

    Attributes
    ----------
    name, free : str, tuple of str
        Its name, and what was free.
    links, parameters : int
        Numbers of links, and of free parameters that can be known.
    identification : Identification or None
        None where the fit failed.
    reason : str
        Why it failed, or why it cannot be compared; empty if all went well.
    bic : float or None
        Bayesian information criterion; None where other samples were fitted than in the rest.
    fit_rms, held_out_rms : float, rad or m
        Error of the fit, and of the prediction of the part held out (inf: it failed, or nothing was held out).
    whiteness : float
        p-value of the residuals' autocorrelation under white noise.
    """

    name: str
    free: tuple[str, ...]
    links: int
    identification: Identification | None = None
    reason: str = ""
    parameters: int = 0
    bic: float | None = None
    fit_rms: float = float("inf")
    held_out_rms: float = float("inf")
    whiteness: float = float("nan")


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Models of a rope compared by :func:`hyperflex.compare_models`; ``print`` shows the table and why.

    Attributes
    ----------
    models : tuple of FittedModel
        In the order in which they were given, those that failed included.
    preferred, recommendation : str or None, str
        Name of the model that the evidence prefers, None if none could be fitted; and why, in words.
    unit : str
        Of the errors: ``rad`` or ``m``.
    interrupted : bool
        Whether Ctrl-C came before all candidates were fitted.
    """

    models: tuple[FittedModel, ...]
    preferred: str | None
    recommendation: str
    unit: str
    interrupted: bool = False

    def __getitem__(self, name: str) -> FittedModel:
        for model in self.models:
            if model.name == name:
                return model
        raise KeyError(name)

    @property
    def status(self) -> Status:
        """SUCCESS if all candidates were tried and one is preferred."""
        if self.interrupted:
            return Status.INTERRUPTED
        return Status.FAILED if self.best is None else Status.SUCCESS

    @property
    def success(self) -> bool:
        """Whether all candidates were tried and one is preferred."""
        return self.status is Status.SUCCESS

    @property
    def message(self) -> str:
        """Why the comparison failed; empty on success."""
        return "" if self.success else f"{self.status}: {self.recommendation}"

    @property
    def best(self) -> Identification | None:
        """The identification of the preferred model."""
        return None if self.preferred is None else self[self.preferred].identification

    @property
    def dataset(self) -> "xr.Dataset":
        """The table as an ``xarray.Dataset`` over the dimension model; NaN for missing values."""
        extras.require(("xarray",), "xarray", "Datasets")
        import xarray as xr

        columns: dict[str, Any] = {}
        for name, unit, about in (
            ("links", "1", "number of links"),
            ("parameters", "1", "identifiable free parameters"),
            ("bic", "1", "Bayesian information criterion, smaller is better"),
            ("fit_rms", self.unit, "error of the fit"),
            ("held_out_rms", self.unit, "error of predicting the held-out part"),
            ("whiteness", "1", "probability of residuals as autocorrelated as these under white noise"),
        ):
            values = [getattr(model, name) for model in self.models]
            numbers = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
            columns[name] = ("model", numbers, {"units": unit, "long_name": about})
        names = [model.name for model in self.models]
        return xr.Dataset(columns, {"model": names}, {"preferred": self.preferred or ""})

    def summary(self) -> dict[str, Any]:
        """Return the table, the preference and the texts as plain numbers, lists and strings; None for no number."""
        names = ("name", "links", "parameters", "bic", "fit_rms", "held_out_rms", "whiteness", "reason")
        table = [{name: getattr(m, name) for name in (*names, "free")} for m in self.models]
        result: dict[str, Any] = {"success": self.success, "status": self.status, "message": self.message}
        result |= {"preferred": self.preferred, "unit": self.unit}
        return dict(files.plain(result | {"recommendation": self.recommendation, "models": table}))

    def to_json(self, path: PathLike) -> None:
        """Write :meth:`summary` to `path` as JSON, wholly or not at all; FileProblem when it cannot be written."""
        files.write_json(path, self.summary())

    def __str__(self) -> str:
        wide = max([5, *(len(model.name) for model in self.models)])
        least = min((m.bic for m in self.models if m.bic is not None), default=0.0)
        head = f"{'model':<{wide}}  links  parameters  BIC over best  fit, m{self.unit}  held out, m{self.unit}  white"
        lines = [f"Models compared ({self.status})", f"  {head}"]
        lines += [f"  {_row(model, wide, least, len(self.unit))}" for model in self.models]
        return "\n".join([*lines, f"  {self.recommendation}"])


def _row(model: FittedModel, wide: int, least: float, unit: int) -> str:
    start = f"{model.name:<{wide}}  {model.links:5d}"
    if model.identification is None:
        return f"{start}  failed: {model.reason}"
    above = "-" if model.bic is None else f"{model.bic - least:.1f}"
    white = f"{'yes' if model.whiteness >= SUPPORT.coloured else 'no'} ({probability(model.whiteness)})"
    held = f"{1e3 * model.held_out_rms:.3f}" if np.isfinite(model.held_out_rms) else "-"
    fit = f"{1e3 * model.fit_rms:.3f}"
    mark = f"  {model.reason}" if model.reason else ""
    return f"{start}  {model.parameters:10d}  {above:>13}  {fit:>{6 + unit}}  {held:>{11 + unit}}  {white}{mark}"
