"""``hyperflex init``: a commented set-up file from questions or options."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex import checks, files, model, options, simulation
from hyperflex.cli import output
from hyperflex.cli.command import Given, check_destination
from hyperflex.cli.output import Rows
from hyperflex.errors import InvalidInput
from hyperflex.options import option, options_of

BENDING = 2e-5  # N m^2 s/rad, friction of a joint times the length of a link, of the source paper's cable
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
    "hold": "# No [motion] table: the arm is at rest and hangs down.\n",
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
[[pegs]]  # a round obstacle; one such table for each
x = {x!r}  # m
y = {y!r}  # m
radius = {radius!r}  # m
mu = 0.3  # Coulomb friction between rope and peg
"""
NO_PEGS = "# [[pegs]]  # a round obstacle\n# x = 0.8\n# y = -0.6\n# radius = 0.03\n# mu = 0.3\n"
LIFTED = "q0 = [{q0}]  # rad, the links' angles at the start; without it the rope hangs at rest\n"


@dataclass(frozen=True)
class Answers:
    """What the set-up file is made from."""

    length: float = option(2.0, "length of the rope", "m", sign="positive")
    mass: float = option(0.125, "mass of the rope", "kg", sign="positive")
    radius: float = option(0.0025, "radius of the rope, half its thickness", "m", sign="nonnegative")
    links: int = option(20, "number of links of the rope")
    arm: float = option(0.105, "length of the arm", "m", sign="positive")
    motion: str = option("swings", f"motion of the arm: {', '.join(MOTIONS)}")
    duration: float = option(10.0, "simulated time", "s", sign="positive")

    def __post_init__(self) -> None:
        options.check(self, "")
        checks.count("links", self.links, most=1000)
        checks.choice("motion", self.motion, tuple(MOTIONS))


def init(
    out: Annotated[Path, typer.Argument(help="TOML file to write; an existing file is not replaced.")] = Path(
        "setup.toml"
    ),
    *,
    given: Annotated[Given, Answers],
    peg: Annotated[tuple[float, float, float] | None, "A round peg: X Y RADIUS, m. [default: none]"] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing: use defaults for missing options.")] = False,
) -> None:
    """Write a set-up file with comments, to be edited and simulated.

    On a terminal the command asks for options that are not given; elsewhere it uses their defaults.
    """
    check_destination(out, ".toml", [])
    if out.exists():
        raise InvalidInput(f"{out} exists already", allowed="a new file", fix="Give another name, or remove it first")
    Answers(**given)  # refuses what is wrong before it asks for more
    if not (yes or output.as_json()) and sys.stdin.isatty() and sys.stdout.isatty():
        for each in options_of(Answers):
            if each.name not in given:
                unit = f", {each.metadata['unit']}" if each.metadata["unit"] else ""
                text = f"{each.metadata['help'].capitalize()}{unit}"
                given |= {each.name: typer.prompt(text, default=each.default, type=type(each.default))}
    answers = Answers(**given)
    text = _text(out, answers, None if peg is None else model.Peg(*peg))
    simulation.check_outside(model.Setup.loads(text))  # refuses answers that do not fit each other
    files.write_text(out, text)
    run = out.with_suffix(".nc")
    following = f"hyperflex simulate {out} -o {run} and hyperflex view {run}, or live: hyperflex play {out}"
    rows = [("comments in it", "say what can be changed"), ("next", following)]
    output.show({"output": out, **asdict(answers), "peg": peg}, Rows(f"Wrote {out}", rows))


def _text(out: Path, answers: Answers, peg: "model.Peg | None") -> str:
    """Return the set-up with its comments; under an arm at rest the rope begins lifted, so that it moves."""
    values: dict[str, Any] = asdict(answers) | {"name": out.name, "stem": out.stem, "motion": MOTIONS[answers.motion]}
    values["friction"] = float(f"{BENDING * answers.links / answers.length:.3g}")
    values["start"] = LIFTED.format(q0=", ".join(["0.5"] * answers.links)) if answers.motion == "hold" else ""
    values["pegs"] = NO_PEGS if peg is None else PEGS.format(**asdict(peg))
    return "".join(_aligned(line) for line in SETUP.format(**values).splitlines(keepends=True))


def _aligned(line: str) -> str:
    """Return a line with its comment in the column of all comments."""
    value, gap, comment = line.partition("  # ")
    return f"{value:<28}# {comment}" if gap else line
