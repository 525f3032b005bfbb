"""``hyperflex simulate``: a set-up in, a trajectory out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.interruption import deferred

if TYPE_CHECKING:
    from hyperflex.model import Setup
    from hyperflex.trajectory import Trajectory


def simulate(
    setup: Annotated[Path, typer.Argument(help="TOML file with rope, arm, motion and duration.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="NetCDF file to write, .nc.")],
    duration: Annotated[float | None, typer.Option(help="Simulated time, s, in place of the file's.")] = None,
    horizon: Annotated[
        float | None,
        typer.Option(help="Tell, too, until when an error of tol made on the way stays below this, m (some 20 runs)."),
    ] = None,
    time_budget: Annotated[
        float | None,
        typer.Option(help="Processor time, s; inf: any. [default: half an hour, which is judged after ten seconds]"),
    ] = None,
    json: output.Json = False,
) -> None:
    """Simulate a set-up and write the motion to NetCDF.

    After Ctrl-C, what has been simulated is in a file of its own, cast-interrupted.nc.
    """
    import numpy as np

    from hyperflex.model import Setup
    from hyperflex.simulation import INTERRUPTED, file_size
    from hyperflex.simulation import simulate as run

    output.check_destination(out, ".nc", [setup])
    if horizon is not None:
        checks.number("--horizon", horizon, sign="positive", unit="m")
    wanted = Setup.from_toml(setup)
    files.check_space(out, file_size(wanted, wanted.duration if duration is None else duration))
    trajectory = output.partial_of(lambda: run(wanted, duration=duration, time_budget=time_budget, progress=True))
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
        trust = {} if horizon is None else _trust(wanted, duration, horizon)
    result |= trust
    x, y = trajectory.tip[-1]
    output.show(
        result,
        f"Simulated {trajectory.q.shape[1]} links from {trajectory.t[0]:g} to {trajectory.t[-1]:g} s",
        [
            ("tip at the end", f"({x:.4f}, {y:.4f}) m"),
            ("greatest |x| of the tip", f"{result['greatest_x_m']:.4f} m"),
            ("greatest motor torque", f"{result['greatest_torque_Nm']:.4g} N m"),
            ("energy error", f"{result['energy_error_J']:.2g} J of {worked:.3g} J moved"),
            *([("trusted", _told(trust))] if trust else []),
            ("written", f"{out} ({trajectory.t.size} samples); hyperflex view {out} plays it"),
        ],
        as_json=json,
    )


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
