"""Representation of results in notebooks: short text, a table, and a run as a player; plans in a picture."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hyperflex.identification import Identification
from hyperflex.model import LINK_PROPERTIES, PROPERTIES, Rope
from hyperflex.report.cast import CastReport
from hyperflex.report.identification.tables import parameters_table, present
from hyperflex.report.page import TextTable, render
from hyperflex.report.plan import Plan, PlanReport
from hyperflex.report.player import FRAME_RATE, player_html
from hyperflex.report.style import Axes, Figure
from hyperflex.report.tip import InsertReport, WhipReport
from hyperflex.report.units import readable_unit
from hyperflex.trajectory import Trajectory


def rope_html(rope: Rope) -> str:
    """Return a rope as a table of its links' properties."""
    rows = []
    for name in (each.name for each in LINK_PROPERTIES if present(rope)[each.name]):
        values, unit = getattr(rope, name), readable_unit(name, getattr(rope, name))
        low, high = values.min() / unit.size, values.max() / unit.size
        span = f"{low:.4g}" if np.isclose(low, high, rtol=1e-9) else f"{low:.4g} to {high:.4g}"
        rows.append((name, PROPERTIES[name].words, span + unit.after))
    return _shown(repr(rope), table=TextTable(("of each link", "what it is", "value"), tuple(rows)))


def run_html(run: Trajectory) -> str:
    """Return a run as a player; a run of one sample as text."""
    sentences = tuple(each for each in (run.message, run.warning()) if each)
    return _shown(repr(run), sentences, document=_player(run))


def identification_html(found: Identification) -> str:
    """Return an identification's grade, parameters and findings."""
    sentences = tuple(found.report(full=True).splitlines())
    return _shown(repr(found), sentences, parameters_table(found, None))


def plan_html(plan: Plan) -> str:
    """Return a plan's result, key figures and verified run."""
    report = _report_of(plan)
    document = "" if plan.run is None else _player(plan.run, **report.film())
    return _shown(report.title, (report.verdict, *report.advice), TextTable(("", ""), report.tiles), document)


def plan_figure(plan: Plan, ax: "Axes | None" = None) -> "Figure":
    """Draw the rope of a plan's verified run at many instants about its event, into given axes or a new figure."""
    plan.required(plan.run, "run")
    return _report_of(plan).strobe_of_event(ax)


def _report_of(plan: Plan) -> PlanReport[Any]:
    kinds: dict[str, type[PlanReport[Any]]] = {"cast": CastReport, "whip": WhipReport, "insert": InsertReport}
    return kinds[plan.kind](plan)


def _player(run: Trajectory, **options: object) -> str:
    if run.t.size < 2:
        return ""
    frame_rate = min(FRAME_RATE, 600.0 / float(np.ptp(run.t)))  # a notebook's file keeps the frames: 600 at most
    return player_html(run, **{"autoplay": False, "frame_rate": frame_rate, **options})  # type: ignore[arg-type]


def _shown(title: str, sentences: Sequence[str] = (), table: TextTable | None = None, document: str = "") -> str:
    return render("notebook.html", title=title, sentences=sentences, table=table, document=document)
