"""``hyperflex init``: a commented set-up file from questions or options."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.errors import InvalidInput

BENDING = 2e-5  # N m^2 s/rad, friction of a joint times the length it stands for: of the source paper's cable
MOTIONS = {
    "swings": """\
[motion]  # of the arm
kind = "swings"  # half a turn and back, again and again
t_move = 0.73  # s, of half a turn
t_rest = 0.53  # s, between two of them
""",
    "move": """\
[motion]  # of the arm
kind = "move"
start = 0.0  # rad
end = 1.57  # rad
duration = 0.5  # s
profile = "minimum-jerk"  # or "bang-bang", "ramp"
""",
    "hold": "# No [motion] table: the arm stands still, hanging down.\n",
}
SETUP = """\
# A set-up: hyperflex simulate {name} -o {stem}.nc
# SI units and radians. An angle is 0 where a link hangs down, and grows towards +x; x is to the right, y up.

duration = {duration!r}  # s
{start}
[rope]
n_links = {links}  # equal rigid links; more follow sharper bends, and cost more time
total_length = {length!r}  # m
total_mass = {mass!r}  # kg
radius = {radius!r}  # m
friction = {friction!r}  # N m s/rad, viscous, of each joint: a guess, which hyperflex identify improves
# dry_friction = 1e-5  # N m, of each joint
# stiffness = 1e-4  # N m/rad, of each joint
# drag = 0.0036  # kg/m^2, of air: 0.5 x 1.2 kg/m^3 x 1.2 x diameter
# tip_mass = 0.01  # kg

[arm]  # on the motor's shaft, which is at (0, 0)
length = {arm!r}  # m, from the shaft to where the rope hangs

{motion}
{pegs}"""
PEGS = """\
[pegs]  # round obstacles; arrays for several, x = [0.8, 1.0]
x = {x!r}  # m
y = {y!r}  # m
radius = {radius!r}  # m
mu = 0.3  # Coulomb friction between rope and peg
"""
NO_PEGS = "# [pegs]  # round obstacles\n# x = 0.8\n# y = -0.6\n# radius = 0.03\n# mu = 0.3\n"
LIFTED = "q0 = [{q0}]  # rad, the links' angles at the start; without it the rope hangs at rest\n"


def init(
    out: Annotated[Path, typer.Argument(help="TOML file to write; one that is there already is left alone.")] = Path(
        "setup.toml"
    ),
    length: Annotated[float | None, typer.Option(help="Of the rope, m. [default: 2.0]")] = None,
    mass: Annotated[float | None, typer.Option(help="Of the rope, kg. [default: 0.125]")] = None,
    radius: Annotated[float | None, typer.Option(help="Of the rope, half its thickness, m. [default: 0.0025]")] = None,
    links: Annotated[int | None, typer.Option(help="Links that it is cut into. [default: 20]")] = None,
    arm: Annotated[float | None, typer.Option(help="Length of the arm, m. [default: 0.105]")] = None,
    motion: Annotated[str | None, typer.Option(help="Of the arm: swings, move or hold. [default: swings]")] = None,
    peg: Annotated[
        tuple[float, float, float] | None, typer.Option(help="A round peg: X Y RADIUS, m. [default: none]")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated time, s. [default: 10.0]")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing: what is not given has its default.")] = False,
    json: output.Json = False,
) -> None:
    """Write a set-up file with comments, to be edited and simulated.

    On a terminal it asks for what is not given; elsewhere that has its default.
    """
    output.check_destination(out, ".toml", [])
    if out.exists():
        raise InvalidInput(f"{out} is there already", allowed="a new file", fix="Give another name, or remove it first")
    quiet = yes or json or not (sys.stdin.isatty() and sys.stdout.isatty())
    given = {"length": length, "mass": mass, "radius": radius, "links": links, "arm": arm, "motion": motion}
    answers = {name: _answer(name, value, quiet) for name, value in (given | {"duration": duration}).items()}
    for name, value in zip(("X", "Y", "RADIUS"), peg or (), strict=False):
        checks.number(f"{name} of --peg", value, sign="positive" if name == "RADIUS" else "any", unit="m")
    text = _text(out, answers, peg)
    _check(text)
    files.write_text(out, text)
    output.show(
        {"output": out, **answers, "peg": peg},
        f"Wrote {out}",
        [("look at it", f"its comments say what can be changed ({out})"), ("then", _next(out))],
        as_json=json,
    )


QUESTIONS: dict[str, tuple[str, Any]] = {
    "length": ("Length of the rope, m", 2.0),
    "mass": ("Mass of the rope, kg", 0.125),
    "radius": ("Radius of the rope (half its thickness), m", 0.0025),
    "links": ("Links that it is cut into", 20),
    "arm": ("Length of the arm, m", 0.105),
    "motion": (f"Motion of the arm ({', '.join(MOTIONS)})", "swings"),
    "duration": ("Simulated time, s", 10.0),
}


def _answer(name: str, given: Any, quiet: bool) -> Any:
    """Return what was given, else the answer to a question, or where none may be asked its default; checked."""
    words, default = QUESTIONS[name]
    value = given
    if value is None:
        value = default if quiet else typer.prompt(words, default=default, type=type(default))
    option = f"--{name}"
    if name == "motion":
        return checks.choice(option, value, tuple(MOTIONS))
    if name == "links":
        return checks.count(option, value, most=1000)
    unit = {"mass": "kg", "duration": "s"}.get(name, "m")
    return checks.number(option, value, sign="nonnegative" if name == "radius" else "positive", unit=unit)


def _text(out: Path, answers: dict[str, Any], peg: tuple[float, float, float] | None) -> str:
    """Return the set-up with its comments; a rope under an arm that stands still begins lifted, so that it moves."""
    still = answers["motion"] == "hold"
    given = answers | {"motion": MOTIONS[answers["motion"]], "name": out.name, "stem": out.stem}
    given["friction"] = float(f"{BENDING * answers['links'] / answers['length']:.3g}")
    given["start"] = LIFTED.format(q0=", ".join(["0.5"] * answers["links"])) if still else ""
    given["pegs"] = NO_PEGS if peg is None else PEGS.format(x=peg[0], y=peg[1], radius=peg[2])
    return "".join(_aligned(line) for line in SETUP.format(**given).splitlines(keepends=True))


def _aligned(line: str) -> str:
    """Return a line with its comment in the column of all comments."""
    value, gap, comment = line.partition("  # ")
    return f"{value:<28}# {comment}" if gap else line


def _check(text: str) -> None:
    """Refuse answers that do not fit each other, before anything is written."""
    from hyperflex.model import Setup
    from hyperflex.simulation import check_outside

    check_outside(Setup.loads(text))


def _next(out: Path) -> str:
    run = out.with_suffix(".nc")
    return f"hyperflex simulate {out} -o {run} and hyperflex view {run}, or live: hyperflex play {out}"
