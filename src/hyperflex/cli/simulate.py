"""``hyperflex simulate``: a set-up in, a trajectory out."""

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from hyperflex import checks, files, model, simulation
from hyperflex.checks import ByName
from hyperflex.cli import output
from hyperflex.cli.command import check_destination
from hyperflex.errors import SimulationError
from hyperflex.interruption import deferred
from hyperflex.status import Status

if TYPE_CHECKING:
    from hyperflex.trajectory import Trajectory

_WATCH = 2.0  # s, over which a rope's slip on a peg is measured


def simulate(
    setup: Annotated[Path, typer.Argument(help="TOML file with rope, arm, motion and duration.")],
    out: Annotated[Path, "NetCDF file to write, .nc."],
    duration: Annotated[float | None, "Simulated time, s. [default: the file's, else 10]"] = None,
    horizon: Annotated[
        float | None, "Error up to which the run counts as predictable", "m", "1 % of the rope's length"
    ] = None,
    tug: Annotated[bool, "Pull at a rope that lies on a peg at the end, and report its holding force."] = False,
    tilt: Annotated[
        float | None,
        "Angle of the rope out of the plane at the start, rad: report how far to the side it is.",
    ] = None,
    extrapolate: Annotated[
        bool,
        "Also estimate the limit of many short links and its error, in free flight.",
    ] = False,
    time_budget: Annotated[
        float | None, "Time for the run, s, without compiling; inf: no limit. [default: 1800]"
    ] = None,
) -> None:
    """Simulate a set-up and write the motion to NetCDF.

    The set-up is simulated again with a tenth of the tolerance; the report states until when both runs agree.

    For each round peg it reports the rope's turns at the end, the angle that it covers, and how far it slipped in the
    last 2 s.

    After Ctrl-C, or if the time runs out (exit code 3), the simulated part is in a separate file, such as
    cast-interrupted.nc.
    """
    check_destination(out, ".nc", [setup])
    simulated = model.Setup.from_toml(setup)
    if tilt is not None:
        checks.number("--tilt", tilt, unit="rad")
        simulation.refuse_rope(simulated.rope)
    if duration is None and "duration" not in files.read_toml(setup):
        output.note(f"no duration is given, so {simulated.duration:g} s are simulated; give --duration for another")
    files.check_space(out, simulation.file_size(simulated, simulated.duration if duration is None else duration))
    how: ByName = {"duration": duration, "time_budget": time_budget, "extrapolate": extrapolate}
    how |= {"progress": True, "throw": False}
    found, _ = output.run(lambda: simulation.simulate(simulated, **how))
    stopped = found.status == Status.INTERRUPTED
    if not found.success and not (found.t.size and (stopped or found.status == Status.OUT_OF_TIME)):
        raise KeyboardInterrupt if stopped else SimulationError(found.message, status=found.status, time=found.state.t)
    kept = out if found.success else output.partial_path(out)
    with deferred():  # what has taken long is written first
        files.rescued(found.to_netcdf, kept)
    if not found.success:
        text = f"{found.status.capitalize()} at t = {found.state.t:.6g} s; the part that was simulated is in {kept}."
        part = {
            "output": kept,
            "status": found.status,
            "samples": found.t.size,
            "end_s": found.state.t,
            "message": text,
        }
        if stopped:
            output.show(part, interrupted=text)
        output.show(part, text, code=output.ExitCode.NOT_CONVERGED)
    result: ByName = {
        "output": out,
        "status": found.status,
        "links": found.q.shape[1],
        "samples": found.t.size,
        "start_s": found.t[0],
        "end_s": found.t[-1],
        "tip_m": found.tip[-1],
        "greatest_x_m": np.abs(found.tip[:, 0]).max(),
        "greatest_torque_Nm": np.abs(found.motor_torque).max(),
        "energy_error_J": np.abs(found.energy_error).max(),
        "energy_moved_J": float(np.ptp(found.motor_work) + np.ptp(found.kinetic_energy + found.potential_energy)),
    }
    if found.limit is not None and found.limit_error is not None:
        result |= {"limit_tip_m": found.limit[-1, -1], "limit_error_m": found.limit_error.max()}
    elif extrapolate:
        output.note(found.message)
    missing = "how long it can be trusted, and how the rope lies on the pegs"
    with output.keeping({"run": out}, missing, result), output.spinner() as progress:
        progress("simulating again with a tenth of the tolerance")
        result |= _trust(found, horizon)
        if tilt is not None:
            result["sideways"] = _aside(found, tilt)
        result["pegs"] = [_wound(found, peg, tug) for peg in found.setup.round_pegs]
    more = [(f"peg at ({peg['x_m']:g}, {peg['y_m']:g}) m", _winding(peg)) for peg in result["pegs"]]
    if simulated.arm is None and not np.ptp(found.tip, axis=0).any():
        more.append(("motion", "none: the rope hangs from a point at rest; give [arm] and [motion]"))
    more.append(("next", f"hyperflex view {out} plays it, hyperflex plot {out} draws it"))
    output.show(result, output.rows("Simulated", result, *more))


def _aside(run: "Trajectory", tilt: float) -> ByName:
    """Return how far to the side of its plane the rope of a run is, until it touches an obstacle."""
    found = simulation.sideways(run, tilt=tilt)
    return {
        "tilt_rad": tilt,
        "touch_s": found.touch,
        "most_m": np.abs(found.joints).max(),
        "last_m": abs(found.tip[-1]),
        "error_m": found.error,
        "warning": found.warning() or None,
    }


def _wound(run: "Trajectory", peg: "model.Peg", tug: bool) -> ByName:
    """Return how the rope lies on a peg at the end of a run, and with a tug what it holds."""
    from hyperflex import winding

    measured = winding.measure_winding(run, peg)
    found = {
        "x_m": peg.x,
        "y_m": peg.y,
        "turns": measured.turns[-1],
        "covered_rad": measured.contact[-1],
        "slip_m": winding.rope_slip(run, peg, since=max(run.t[0], run.t[-1] - _WATCH))[-1],
        "tension_N": measured.before[-1],
    }
    if tug and np.isfinite(measured.before[-1]):
        pulled = winding.tug_test(run, peg)
        found |= {"hold_N": pulled.hold, "tug_slipped": pulled.slipped}
    return found


def _winding(peg: ByName) -> str:
    turns = f"{peg['turns']:.2f} turns"
    if np.isnan(peg["tension_N"]):
        return f"{turns}; the rope does not touch it at the end"
    slip = peg["slip_m"]
    on = f"slipped {1e3 * abs(slip):.1f} mm" if np.isfinite(slip) else "came to lie on it, or let go,"
    covered = f"{np.degrees(peg['covered_rad']):.0f} degrees covered" if peg["covered_rad"] else "touched at one point"
    text = f"{turns}, {covered}, {on} in the last {_WATCH:g} s"
    if "hold_N" not in peg:
        return text
    return f"{text}; holds {'' if peg['tug_slipped'] else 'at least '}{peg['hold_N']:.2g} N"


def _trust(run: "Trajectory", allowed: float | None) -> ByName:
    """Return until when a run with a tenth of the tolerance differs by less than `allowed`, m; warn if not to the end.

    By default as ``Trajectory.predictable_until``.
    """
    if text := run.warning(allowed):
        warnings.warn(text, stacklevel=1)
    until = run.agrees_until(allowed)
    return {
        "horizon_s": min(until, run.t[-1]),
        "trusted_to_the_end": until == math.inf,
        "error_estimate_m": run.error_estimate.max(),
    }
