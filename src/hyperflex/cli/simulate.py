"""``hyperflex simulate``: a set-up in, a trajectory out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import numpy as np
import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.interruption import deferred

if TYPE_CHECKING:
    from hyperflex.model import Peg, Setup
    from hyperflex.trajectory import Trajectory

WATCH = 2.0  # s, of a rope's slip on a peg


def simulate(
    setup: Annotated[Path, typer.Argument(help="TOML file with rope, arm, motion and duration.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="NetCDF file to write, .nc.")],
    duration: Annotated[float | None, typer.Option(help="Simulated time, s, in place of the file's.")] = None,
    horizon: Annotated[
        float | None,
        typer.Option(help="Tell, too, until when an error of tol made on the way stays below this, m (some 20 runs)."),
    ] = None,
    tug: Annotated[
        bool,
        typer.Option("--tug", help="Pull at a rope that lies on a peg at the end, and tell what it holds."),
    ] = False,
    time_budget: Annotated[
        float | None,
        typer.Option(help="Processor time, s; inf: any. [default: half an hour, which is judged after ten seconds]"),
    ] = None,
    json: output.Json = False,
) -> None:
    """Simulate a set-up and write the motion to NetCDF.

    Of each round peg it tells the rope's turns at the end, the angle that it covers, and how far it slipped on it in
    the last 2 s.

    After Ctrl-C, what has been simulated is in a file of its own, cast-interrupted.nc.
    """
    from hyperflex.model import Setup
    from hyperflex.simulation import INTERRUPTED, file_size
    from hyperflex.simulation import simulate as run

    output.check_destination(out, ".nc", [setup])
    if horizon is not None:
        checks.number("--horizon", horizon, sign="positive", unit="m")
    simulated = Setup.from_toml(setup)
    files.check_space(out, file_size(simulated, simulated.duration if duration is None else duration))
    trajectory = output.partial_of(lambda: run(simulated, duration=duration, time_budget=time_budget, progress=True))
    if trajectory.status == INTERRUPTED:
        _leave(trajectory, output.partial_path(out), json)
    with deferred():  # what has taken long is written first
        files.rescued(trajectory.to_netcdf, out)
    worked = float(np.ptp(trajectory.motor_work) + np.ptp(trajectory.kinetic_energy + trajectory.potential_energy))
    result = {
        "output": out,
        "status": trajectory.status,
        "links": trajectory.q.shape[1],
        "samples": trajectory.t.size,
        "start_s": trajectory.t[0],
        "end_s": trajectory.t[-1],
        "tip_m": trajectory.tip[-1],
        "greatest_x_m": np.abs(trajectory.tip[:, 0]).max(),
        "greatest_torque_Nm": np.abs(trajectory.motor_torque).max(),
        "energy_error_J": np.abs(trajectory.energy_error).max(),
        "energy_moved_J": worked,
    }
    with output.keeping({"run": out}, "until when it can be trusted", result, as_json=json):
        trust = {} if horizon is None else _trust(simulated, duration, horizon)
    result |= trust
    with output.keeping({"run": out}, "how the rope lies on the pegs", result, as_json=json):
        result["pegs"] = [_wound(trajectory, peg, tug) for peg in trajectory.setup.round_pegs]
    x, y = trajectory.tip[-1]
    still = simulated.arm is None and not np.ptp(trajectory.tip, axis=0).any()
    output.show(
        result,
        f"Simulated {trajectory.q.shape[1]} links from {trajectory.t[0]:g} to {trajectory.t[-1]:g} s",
        [
            ("tip at the end", f"({x:.4f}, {y:.4f}) m"),
            ("greatest |x| of the tip", f"{result['greatest_x_m']:.4f} m"),
            ("greatest motor torque", f"{result['greatest_torque_Nm']:.4g} N m"),
            ("energy error", f"{result['energy_error_J']:.2g} J of {worked:.3g} J moved"),
            *((f"peg at ({peg['x_m']:g}, {peg['y_m']:g}) m", _told_of(peg)) for peg in result["pegs"]),
            *([("trusted", _told(trust))] if trust else []),
            *([("motion", "none: the rope hangs from a point at rest; give [arm] and [motion]")] if still else []),
            ("written", f"{out} ({trajectory.t.size} samples); hyperflex view plays it, hyperflex plot draws it"),
        ],
        as_json=json,
    )


def _wound(run: "Trajectory", peg: "Peg", tug: bool) -> dict[str, Any]:
    """Return how the rope lies on a peg at the end of a run, and on demand what it holds."""
    from hyperflex import winding

    measured = winding.measure_winding(run, peg)
    found = {
        "x_m": peg.x,
        "y_m": peg.y,
        "turns": measured.turns[-1],
        "covered_rad": measured.contact[-1],
        "slip_m": winding.rope_slip(run, peg, since=max(run.t[0], run.t[-1] - WATCH))[-1],
        "tension_N": measured.before[-1],
    }
    if tug and np.isfinite(measured.before[-1]):
        pulled = winding.tug_test(run, peg)
        found |= {"hold_N": pulled.hold, "tug_slipped": pulled.slipped}
    return found


def _told_of(peg: dict[str, Any]) -> str:
    turns = f"{peg['turns']:.2f} turns"
    if np.isnan(peg["tension_N"]):
        return f"{turns}; the rope does not touch it at the end"
    slip = peg["slip_m"]
    on = f"slipped {1e3 * abs(slip):.1f} mm" if np.isfinite(slip) else "came to lie on it, or let go,"
    words = f"{turns}, {np.degrees(peg['covered_rad']):.0f} degrees covered, {on} in the last {WATCH:g} s"
    if "hold_N" not in peg:
        return words
    return f"{words}; holds {'' if peg['tug_slipped'] else 'at least '}{peg['hold_N']:.2g} N"


def _leave(part: "Trajectory", out: Path, as_json: bool) -> NoReturn:
    """Write what Ctrl-C has left of a run, if it had begun, and exit."""
    if not part.t.size:
        raise KeyboardInterrupt
    files.rescued(part.to_netcdf, out)
    left = {"output": out, "status": part.status, "samples": part.t.size, "end_s": part.state.t}
    message = f"Interrupted at t = {part.state.t:.6g} s; what was simulated until then is in {out}."
    raise typer.Exit(output.interrupted(message, left, as_json=as_json))


def _trust(setup: "Setup", duration: float | None, allowed: float) -> dict[str, Any]:
    """Until when an error of the set-up's tol stays below `allowed`, m."""
    from hyperflex.simulation import predictability

    found = predictability(setup, duration=duration)
    end = found.horizon(allowed)
    return {
        "allowed_m": allowed,
        "horizon_s": min(end, found.t[-1]),
        "trusted_to_the_end": end > found.t[-1],
        "lyapunov_exponent_per_s": found.exponent(),
    }


def _told(trust: dict[str, Any]) -> str:
    until = "to the end" if trust["trusted_to_the_end"] else f"until {trust['horizon_s']:.3g} s"
    return f"{until}: so long an error of tol stays below {trust['allowed_m']:g} m"
