"""Comparison of a recording with a simulation of the rope identified from it, with its uncertainty."""

import contextlib
from pathlib import Path

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate import MovingHorizon, Observations, smooth
from hyperflex.model import Rope
from hyperflex.planning import RopePosterior
from hyperflex.recording import Recording, read_recording
from hyperflex.report import Dots, Line, Overlay, Plot, player_html
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

LEAD = 0.5  # s at the beginning, from which the state is estimated
DRAWN = 20  # ropes of the posterior


def comparison_page(recording: Path, rope: Path) -> str:
    """Return a player of the simulated rope, the measured markers, and ropes sampled from the posterior.

    The initial state is estimated from the first LEAD seconds (:func:`hyperflex.estimate.smooth`); the rest is
    prediction. Each sampled rope has its own state and, if the file contains their covariance, parameters.

    Parameters
    ----------
    recording : Path
        Angles of the rope's links, or markers at its joints, the first at the fixed pivot.
    rope : Path
        TOML file of the rope, as identify writes it.

    Raises
    ------
    FileProblem, InvalidInput
        If a file cannot be read, or they do not fit each other.
    """
    read = read_recording(recording)
    posterior = RopePosterior.from_toml(rope)
    known = Rope.from_toml(rope) if posterior is None else posterior.rope
    t, places = _joints(read, known)
    mean, covariance = _state(known, t, places)
    times = t[t <= 20.0]  # s, so that the page is made in some seconds
    run = _simulated(known, mean, times)
    rng, others = np.random.default_rng(0), []
    for state in rng.multivariate_normal(mean, covariance, DRAWN, check_valid="ignore", method="eigh"):
        drawn = known if posterior is None else posterior.sample(rng)
        with contextlib.suppress(SimulationError):
            others.append(_simulated(drawn, state, times))
    off = np.hypot(*(run.joints[:, 1:] - places[: times.size, 1:]).T)
    lines = tuple(Line(f"joint {k + 1}", off[k]) for k in (0, len(off) - 1)[: len(off)])
    unsure = "state alone" if posterior is None else "state and parameters"
    words = f"simulated from the first {min(LEAD, t[-1]):g} s on; rings: measured; thin: {DRAWN} draws of {unsure}"
    overlay = Overlay(
        note=lambda _: words,
        dots=Dots(times, places[: times.size]),
        ropes=tuple(others),
        plots=(Plot("simulated less measured", "m", lines),),
    )
    return player_html(run, title=f"{recording.name} and {rope.name}", overlay=overlay)


def _joints(read: Recording, rope: Rope) -> tuple[Array, Array]:
    """Return times (T,), s, from 0 on, and places of the joints (T, n + 1, 2), m, from the pivot; NaN in gaps."""
    if read.n_links != rope.n_links:
        raise InvalidInput(
            "recording and rope have different numbers of links", got=[read.n_links, rope.n_links], allowed="the same"
        )
    if read.kind == "angles":
        places = rope.joints(read.data, np.zeros((read.t.size, 2)))
    else:
        places = read.data.reshape(read.t.size, -1, 2)
        places = places - np.nanmean(places[:, :1], axis=0)
    return read.t - read.t[0], places


def _state(rope: Rope, t: Array, places: Array) -> tuple[Array, Array]:
    """Return the state (2 n,) at the beginning, and its covariance (2 n, 2 n)."""
    rows = np.flatnonzero(t <= LEAD)
    rows = rows[:: max(1, rows.size // 120)]
    seen = [Observations(float(t[k]), places[k, 1:], std=2e-3) for k in rows]  # m: corrected by the residuals
    first = smooth(MovingHorizon(rope, rope.link_ends), seen).states[0]
    known = np.zeros((2 * rope.n_links,) * 2) if first.covariance is None else first.covariance
    return np.concatenate([first.q, first.qd]), known


def _simulated(rope: Rope, state: Array, times: Array) -> Trajectory:
    n = rope.n_links
    return simulate(rope, duration=float(times[-1]), q0=state[:n], qd0=state[n:], t_eval=times)
