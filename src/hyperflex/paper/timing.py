"""Timing control by the tip's phase (paper section IV.B): runs, Fig. 13 and claim C5."""

from functools import cache

import numpy as np

from hyperflex.control import CrossingRule, SwingModel, TrueState, run_closed_loop
from hyperflex.paper.casting import (
    PORTRAIT,
    RADIUS,
    READINGS,
    T_MOVE,
    TIME_CONSTANT,
    TOP,
    WINDOW,
    Cast,
    Reading,
    cable,
    casting_arm,
    columns,
    windows_table,
)
from hyperflex.paper.part import Claim, Item, Part, Table
from hyperflex.report import BLUE, GREEN, GREY, RED, Figure, Section, legend, new_figure
from hyperflex.simulation import simulate

LEADS = (0.0, 0.10, 0.20, 0.30)  # s, t_b: how long before the tip crosses x = 0 the arm starts
DURATION = 20.0  # s
RATE = 200  # samples per second
TOL = 1e-6  # m
_COLOUR = dict(zip(LEADS, (BLUE, GREEN, RED, GREY), strict=True))
_DASH = dict(zip(LEADS, ("-", ":", "-.", (0, (6.0, 1.5, 1.5, 1.5, 1.5, 1.5))), strict=True))  # as in the paper
_SHOWN = 5.0  # s of the portraits: later turns hide each other


@cache
def timed(reading: Reading, lead: float) -> Cast:
    """Return a run of the paper's timing control; the same one is simulated only once in a process.

    The crossing, `lead` (t_b, s) before which the arm starts, is predicted exactly, by the model that is simulated.
    """
    rope, arm = cable(reading.friction), casting_arm()
    model = SwingModel(rope, arm, T_MOVE, path=reading.path)
    swung = run_closed_loop(TrueState(rope, arm, tol=TOL), CrossingRule(model, lead), model, duration=DURATION)
    t = np.linspace(0.0, DURATION, round(DURATION * RATE) + 1)
    run = simulate(rope, swung.motion, arm=arm, duration=DURATION, t_eval=t, tol=TOL)
    return Cast(reading, f"{100 * lead:.0f}", f"t_b = {lead:.2f} s", run, swung.starts)


def _runs() -> list[Cast]:
    return [timed(reading, lead) for reading in READINGS for lead in LEADS]


def _fig13() -> Table:
    return Table(
        columns(_runs(), PORTRAIT | RADIUS | {"moving_{key}_{label}": lambda each: each.moving}),
        title="tip under the timing control",
        units="t in s; x, cxd (c times the velocity) and r in m; moving is 1 while the arm moves; the last number "
        "of a name is t_b in 0.01 s",
        parameters=f"t_a = {T_MOVE} s, c = {TIME_CONSTANT['success']} s",
    )


def _draw_fig13() -> "Figure":
    """Draw phase portraits and the course of r for the four t_b, in each reading."""
    middle = np.arange(0.5 * WINDOW, DURATION, WINDOW)
    with new_figure(12.0, 6.6, f"Timing control, simulated (Fig. 13); above: the first {_SHOWN:g} s") as figure:
        axes = figure.subplots(2, len(READINGS), sharey="row", height_ratios=(1.6, 1.0))
        for (above, below), reading in zip(axes.T, READINGS, strict=True):
            for lead in LEADS:
                run, shown = timed(reading, lead), slice(round(_SHOWN * RATE) + 1)
                style = {"color": _COLOUR[lead], "ls": _DASH[lead]}
                above.plot(run.spiral.x[shown], run.spiral.scaled_velocity[shown], zorder=3.0 - lead, **style)
                below.plot(middle, run.levels, marker="o", label=run.words, **style)
            above.set(xlim=(-TOP, TOP), ylim=(-TOP, TOP), aspect="equal", xlabel="x, m")
            above.set_title(reading.title.replace(", ", ",\n"), fontsize=8.5)
            below.set(xlabel="time, s", xlim=(0.0, DURATION), ylim=(0.0, TOP))
        axes[0, 0].set_ylabel("c dx/dt, m   (c = 0.40 s)")
        axes[1, 0].set_ylabel(f"median of r in {WINDOW:g} s, m")
        legend(figure, axes[1, 0])
    return figure


def largest_in_the_end(reading: Reading) -> Claim:
    """C5: of the paper's four t_b, 0 ends with the largest r.

    Measured: the median of r in the last 2.5 s for t_b = 0 over the greatest of the other three. Notes the order of
    the four in the first window, halfway and in the end, and how often 0.20 s leads on the way, as in the paper.
    """
    levels = np.array([timed(reading, lead).levels for lead in LEADS])
    orders = np.argsort(-levels, axis=0).T
    half = len(orders) // 2 - 1
    first, middle, last = (
        ", ".join(f"{LEADS[j]:.1f} ({levels[j, k]:.2f} m)" for j in orders[k]) for k in (0, half, -1)
    )
    ahead = np.count_nonzero(orders[:-1, 0] == LEADS.index(0.2))
    note = (
        f"r by t_b, first window: {first}; {WINDOW * half:g}-{WINDOW * (half + 1):g} s: {middle}; end: {last}; "
        f"0.20 s leads in {ahead} of {len(orders) - 1} windows on the way"
    )
    ratio = float(levels[0, -1] / levels[1:, -1].max())
    return Claim("C5", "t_b = 0 ends with the largest r: over the next largest", reading, ratio, 1.0, note)


def _sections() -> list[Section]:
    table = windows_table(_runs(), lambda each: each.levels, WINDOW)
    return [Section("Radius under the timing control", text=(f"Median of r in each {WINDOW:g} s, m.",), table=table)]


_CAPTION = (
    f"Above: the tip's phase portrait in the first {_SHOWN:g} s, cut off at {TOP:g} m where the tip cracks like "
    f"a whip (the CSV file is not). Below: the median of r in {WINDOW:g} s. In the paper t_b = 0 is largest in "
    "the end and 0.20 s most efficient on the way; claim C5 says what it is here."
)
PART = Part(
    title="Timing control by the tip's phase",
    lead=(
        "Timing control: each half turn of the arm starts t_b before the tip crosses x = 0 (section IV.B), the "
        "crossing predicted exactly, by the model that is simulated."
    ),
    message="simulating the timing control",
    items={"fig13": Item(_fig13, _draw_fig13, _CAPTION)},
    measures={largest_in_the_end: READINGS},
    sections=_sections,
)
