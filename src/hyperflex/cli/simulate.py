"""``hyperflex simulate``: a set-up in, a trajectory out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperflex.cli import output


def simulate(
    setup: Annotated[Path, typer.Argument(help="TOML file with rope, arm, motion and duration.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="NetCDF file to write, .nc.")],
    duration: Annotated[float | None, typer.Option(help="Simulated time, s, in place of the file's.")] = None,
    json: output.Json = False,
) -> None:
    """Simulate a set-up and write the motion to NetCDF."""
    import numpy as np

    from hyperflex.model import Setup
    from hyperflex.simulation import simulate as run

    output.check_destination(out, ".nc", [setup])
    trajectory = run(Setup.from_toml(setup), duration=duration, progress=output.watched(json))
    trajectory.to_netcdf(out)
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
    if json:
        output.print_json(result)
        return
    x, y = trajectory.tip[-1]
    output.print_pairs(
        f"Simulated {trajectory.q.shape[1]} links from {trajectory.t[0]:g} to {trajectory.t[-1]:g} s",
        [
            ("tip at the end", f"({x:.4f}, {y:.4f}) m"),
            ("greatest |x| of the tip", f"{result['greatest_x_m']:.4f} m"),
            ("greatest motor torque", f"{result['greatest_torque_Nm']:.4g} N m"),
            ("energy error", f"{result['energy_error_J']:.2g} J of {worked:.3g} J moved"),
            ("written", f"{out} ({trajectory.t.size} samples)"),
        ],
    )
