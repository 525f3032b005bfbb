"""Settings of an identification: recording, fit, fixed values, versions."""

import platform
from importlib.metadata import version

import numpy as np

from hyperflex.identification import Identification
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.report.identification.parameters import numbers, present
from hyperflex.report.page import TextTable
from hyperflex.report.units import readable_unit

_PACKAGES = ("hyperflex", "numpy", "numba")
_LOSS = {
    "squares": "squares",
    "huber": "Huber: large residuals have less weight than their squares",
    "cauchy": "Cauchy: gross outliers have little weight",
}


def recording_table(recording: Recording, found: Identification) -> TextTable:
    """Return the table of the recording."""
    joints = recording.kind == "markers" and "arc_lengths" not in found.settings
    steps = np.diff(recording.t)
    usual = float(np.median(steps))
    even = (
        ""
        if np.allclose(steps, usual, rtol=0.01)
        else f", uneven: {1e3 * steps.min():.4g} to {1e3 * steps.max():.4g} ms"
    )
    share = 100.0 * recording.gaps / recording.data.size
    rows = [
        ("recording", recording.name or "without a name"),
        ("source", recording.source or "not declared"),
        ("contents", f"{_kind(recording)}: {recording.convention}"),
        *([("markers at", "the joints, the first at the pivot")] if joints else []),
        ("samples", f"{recording.t.size}, every {1e3 * usual:.4g} ms ({1.0 / usual:.4g} a second){even}"),
        ("time", f"{recording.t[0]:.6g} to {recording.t[-1]:.6g} s"),
        ("gaps", f"{recording.gaps} missing values ({share:.2g} %)" if recording.gaps else "none"),
        ("noise of a sample", _noise(recording)),
    ]
    return TextTable(("what", "value"), tuple(rows))


def _kind(recording: Recording) -> str:
    if recording.kind == "markers":
        return f"{recording.data.shape[1] // 2} markers"
    return f"angles of {recording.n_links} link{'s' if recording.n_links > 1 else ''}"


def _noise(recording: Recording) -> str:
    if recording.noise is None:
        return "not given: all samples have equal weight"
    low, high = float(recording.noise.min()), float(recording.noise.max())
    unit = readable_unit("rad" if recording.kind == "angles" else "m", high)
    span = f"{low / unit.size:.3g}" if low == high else f"{low / unit.size:.3g} to {high / unit.size:.3g}"
    return f"{span} {unit.name}, as declared"


def fit_table(found: Identification) -> TextTable:
    """Return the table of the fit's settings."""
    done = found.settings
    free = {each.name for each in numbers(found)}
    rope = found.rope
    fixed = {name.replace("_", " "): there for name, there in present(rope).items() if name not in free}
    held, none = ([name for name, there in fixed.items() if there is whether] for whether in (True, False))
    left = f"; {done['left_out']} omitted for lack of data" if done["left_out"] else ""
    picked = f", every {done['decimation']}th sample" if done["decimation"] > 1 else ""
    rows = [
        ("free", ", ".join(_described(word) for word in done["free"])),
        ("fixed", ", ".join(held) or "nothing"),
        ("zero", ", ".join(none) or "nothing"),
        ("tip mass", f"{rope.tip_mass:.4g} kg" + (" (fitted)" if "tip_mass" in free else "")),
        ("gravity", f"({rope.gravity[0]:.4g}, {rope.gravity[1]:.4g}) m/s²"),
        ("first joint", str(done["base"])),
        *_markers(found),
        ("fitted time", f"{done['fitted_from']:.6g} to {done['fitted_to']:.6g} s"),
        ("windows", f"{done['windows']} of {done['window']:.4g} s, each with its own initial state{left}{picked}"),
        ("loss", _LOSS[done["loss"]]),
        ("ended", f"{found.status}, after {len(found.history)} rounds and {done['seconds']:.2g} s"),
        ("versions", ", ".join([*(f"{name} {version(name)}" for name in _PACKAGES), _python()])),
    ]
    return TextTable(("what", "value"), tuple(rows))


def _markers(found: Identification) -> list[tuple[str, str]]:
    done, rows = found.settings, []
    if "arc_lengths" in done:
        rows.append(("markers at", ", ".join(f"{arc:.4g}" for arc in done["arc_lengths"]) + " m along the rope"))
        given = done.get("origin")
        rows.append(("origin", "fitted as well" if given is None else f"({given[0]:.4g}, {given[1]:.4g}) m, as given"))
    return rows


def _python() -> str:
    return f"Python {platform.python_version()} on {platform.system()}, {platform.machine()}"


def _described(word: str) -> str:
    """Return an entry of ``free`` as text."""
    name, _, law = word.partition(":")
    name, _, place = name.partition("[")
    whose = {"shared": " (one value for all links)", "factor": " (one factor for all links)"}
    laws = whose | {"taper": " (its growth along the rope)", "inner": " (one value for all links but the first)"}
    where = f" of {'marker' if name == 'arc' else 'link'} {place[:-1]}" if place else ""
    return name.replace("_", " ") + where + laws.get(law, "")


def lead(recording: Recording, found: Identification, rope: Rope) -> str:
    """Return a sentence on the recording and the free parameters."""
    words = ", ".join(_described(word) for word in found.settings["free"])
    links = "one link" if rope.n_links == 1 else f"{rope.n_links} links"
    return (
        f"Identified from {recording.duration:.4g} s of {_kind(recording)} ({recording.t.size} samples), for a rope of "
        f"{links}: {words}. All other values are those of the first guess."
    )
