"""The report of an identification: a page with parameters, intervals, fit, prediction and residuals."""

from pathlib import Path

import numpy as np

from hyperflex.identification import BAND, Identification, Severity, text
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.report.folder import whole_folder
from hyperflex.report.identification.figures import (
    FittedChannels,
    along_figure,
    fit_figure,
    multiples_figure,
    prediction_figure,
    residual_figure,
    shapes_figure,
)
from hyperflex.report.identification.tables import (
    fit_table,
    lead,
    numbers,
    parameters_table,
    predicted,
    ratios_table,
    recording_table,
    rope_table,
    ties,
)
from hyperflex.report.page import Picture, Section, TextTable, write_page
from hyperflex.report.style import Figure, png
from hyperflex.report.units import amount
from hyperflex.status import Status

LONG = 16  # rows of a table that are shown at once
PAGE = "report.html"


def write_identification(
    directory: str | Path, recording: Recording, found: Identification, guess: Rope | None = None
) -> dict[str, Path]:
    """Write the identified rope (TOML), all figures (JSON) and the page to a folder, see :func:`whole_folder`.

    `recording` is the argument of :func:`hyperflex.identify`, `found` its result; a first guess is shown as well.
    Returns the files ``rope``, ``figures`` and ``page``.
    """
    written = write_found(directory, found)
    return written | identification_page(Path(directory) / PAGE, recording, found, guess)


def write_found(directory: str | Path, found: Identification) -> dict[str, Path]:
    """Write only the rope and the numbers, without drawing, and remove an earlier page; return both files."""
    names = {"rope": "rope.toml", "figures": "identification.json"}
    with whole_folder(directory, [PAGE]) as stage:
        found.to_toml(stage / names["rope"])
        found.to_json(stage / names["figures"])
    return {kind: Path(directory) / name for kind, name in names.items()}


def identification_page(
    path: str | Path, recording: Recording, found: Identification, guess: Rope | None = None
) -> dict[str, Path]:
    """Write the page alone: one HTML file with its figures inside. Arguments as of :func:`write_identification`.

    What was interrupted has tables alone, to end soon. Returns the file ``page``.
    """
    if found.ended is Status.INTERRUPTED:
        when = f"after {len(found.history)} iterations" if found.history else "during its first iteration"
        drawn = [Section("How the fit went", text=(f"It was interrupted {when}; figures were not drawn.",))]
    else:
        drawn = _drawn(FittedChannels(recording, found))
    sections = [
        _assessment(found),
        *_found(found, guess),
        *drawn,
        Section("Recording", table=recording_table(recording, found)),
        Section("How it was fitted", table=fit_table(found)),
        _rope(found),
    ]
    title = f"{recording.name or 'A recording'}, identified"
    write_page(path, title, lead(recording, found), str(found.grade), sections)
    return {"page": Path(path)}


def _drawn(view: FittedChannels) -> list[Section]:
    """Return the sections with the fit's figures."""
    many = len(view.names) > len(view.chosen)
    drawn = [_fit(view, many), _prediction(view), _residuals(view)]
    if many:
        pictures = _pictures((multiples_figure(view), "Every channel: measured, fitted (blue), predicted (red)."))
        folded = f"Show all {len(view.names)} channels"
        drawn.append(Section("All channels", pictures=pictures, folded=folded, anchor="all"))
    return drawn


def _assessment(found: Identification) -> Section:
    every = numbers(found)
    known = sum(np.isfinite(each.std) for each in every)
    tiles = [
        (f"{known} of {len(every)}", "free numbers that this motion determines on their own"),
        (amount(found.residual_rms_all, found.unit), "residual of the fit (rms over all channels)"),
    ]
    if (held := found.held_out) is not None:
        words, note = predicted(found)
        held = held.foreseeable
        tiles.append((words, f"error of predicting {held.ahead:g} s that were not fitted (rms) {note}".rstrip()))
        if np.isfinite(held.inside):
            half = amount(BAND * float(np.sqrt(np.nanmean(held.std**2))), found.unit)
            words = f"of these predictions lie in the band that should contain 95 %, within ±\u00a0{half}"
            tiles.append((f"{100.0 * held.inside:.0f} %", words))
    marks = tuple((each.severity is Severity.NOTE, text(each)) for each in found.findings)
    verdict = found.success, f"{found.grade.capitalize()}."
    return Section("Assessment", verdict=verdict, tiles=tuple(tiles), marks=marks)


def _found(found: Identification, guess: Rope | None) -> list[Section]:
    """Return the parameters, and the ratios if some of them were free."""
    table, ratios, factor = parameters_table(found, guess), ratios_table(found), found.settings["autocorrelation"]
    notes = [
        "std: standard deviation; it, the interval and the guess are in the unit of the value.",
        f"95 % interval: {'from the fit' if found.intervals else 'value plus and minus 1.96 std'}.",
        "They include the errors of the model as far as the assessment states.",
        "Links and markers count from 0: link 0 hangs from the first joint.",
    ]
    if factor > 1.05:  # 1 is white noise
        notes.append(f"They include the correlation of the residuals over {factor:.3g} samples.")
    if not all(np.isfinite(each.std) for each in numbers(found)):
        notes.append("If a value is not determined, the one shown is one of many with the same motion.")
    if tied := ties(found):
        notes.append(f"Correlated errors: {', '.join(tied)}.")
    pictures = _pictures((along_figure(found, guess), "Values along the rope with 95 % intervals."))
    sections = [
        Section("Parameters", pictures=pictures, table=table, notes=tuple(notes), folded=_folded(table, "numbers"))
    ]
    if ratios is not None:
        text = (
            "A free swing determines at most ratios to p1, the first moment of link 0 about its joint. Moments and "
            "inertias include all mass beyond a link, concentrated at its far end."
        )
        sections.append(Section("Ratios", text=(text,), table=ratios, folded=_folded(ratios, "ratios")))
    return sections


def _fit(view: FittedChannels, many: bool) -> Section:
    which = "First, middle and last link" if view.found.unit == "rad" else "Middle and last marker"
    held = "" if view.found.held_out is None else "; red: what was held out"
    some = f"{which}, and the one that fits worst. " if many else ""
    shapes = shapes_figure(view) if view.found.unit == "m" else None
    pictures = _pictures(
        (fit_figure(view), f"{some}Each window is fitted with its own initial state{held}."),
        (shapes, "Markers (rings) and fit (line) at some instants."),
    )
    links = (("all", f"All {len(view.names)} channels"),) if many else ()
    return Section("Fit over data", pictures=pictures, links=links)


def _prediction(view: FittedChannels) -> Section:
    found, held = view.found, view.found.held_out
    title = "Prediction of data that was not fitted"
    if held is None:
        why = "the recording was fitted to its end, or the remainder is too short"
        if found.ended is not None:
            why = f"the fit ended early ({found.ended})"
        return Section(title, text=(f"Nothing was predicted: {why}.",))
    times = "once" if held.starts.size == 1 else f"{held.starts.size} times, one after the other"
    text = (
        f"The data after {view.end:.4g} s were not fitted. The state is estimated from {held.lead:g} s, and the next "
        f"{held.ahead:g} s are predicted without data, {times}."
    )
    caption = (
        "Left: measured and predicted. Right: the error, and the band that should contain 95 % of it. The band is "
        "linearised: covariance of the parameters, uncertainty of the state and noise, with the exact derivatives of "
        "the motion. If the errors are larger than the band, the model is wrong by the difference."
    )
    return Section(title, text=(text,), pictures=_pictures((prediction_figure(view, held), caption)))


def _residuals(view: FittedChannels) -> Section:
    caption = "Residuals over time, and their autocorrelation, with the band that contains that of white noise."
    return Section("Residuals", pictures=_pictures((residual_figure(view), caption)))


def _rope(found: Identification) -> Section:
    table = rope_table(found.rope, found)
    total = f"{found.rope.total_length:.4g} m, {found.rope.total_mass:.4g} kg in all."
    notes = ("* fitted; all other values are those of the guess",)
    return Section("The rope", text=(total,), table=table, notes=notes, folded=_folded(table, "links"))


def _folded(table: TextTable, what: str) -> str:
    """Return the line above a table that is folded because it is long; else nothing."""
    return f"All {len(table.rows)} {what}" if len(table.rows) > LONG else ""


def _pictures(*drawn: tuple["Figure | None", str]) -> tuple[Picture, ...]:
    """Return figures with their captions, without those that there is nothing for."""
    return tuple(Picture(png(figure, dpi="figure"), caption) for figure, caption in drawn if figure is not None)
