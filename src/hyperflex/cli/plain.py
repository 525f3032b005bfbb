"""A plain rope, without markers: questions about its video, a file of the answers, and what is made of them."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from hyperflex import checks, files
from hyperflex.cli import output
from hyperflex.cli.init import BENDING, Answers
from hyperflex.cli.questions import Answer, Dialogue, Question, Way, ask, check_terminal
from hyperflex.errors import InvalidInput

if TYPE_CHECKING:
    from hyperflex.estimate import VideoTrack
    from hyperflex.model import Rope
    from hyperflex.vision import Camera, FoundRope, Image

Pixel = tuple[float, float] | None
FORMAT = "hyperflex answers 1"
MEASURES = ("length", "exposure")  # in the file beside the answers to questions
CLICKED = 1.0  # px, standard deviation of a pixel that a person reads from a picture
# Standard deviations of what the answers leave open, freed in the fit: scale, friction, that of the first joint, and
# drag as parts of themselves, roll of a camera that is held level by eye, rad, readout of a phone's sensor, s. Friction
# and drag over an unknown mass are known by their order of magnitude; a wrong friction, above all that of the first
# joint, would be taken for a readout: both delay the free end
_OPEN = {
    "scale": 0.02,
    "roll": 0.03,
    "readout": 0.01,
    "friction": 1.0,
    "first_joint_friction": 1.0,
    "drag": 1.0,
}

QUESTIONS = (
    Question(
        "pivot",
        "Where does the rope hang from?",
        "The point that stays at rest. A pixel or two do not matter: its place is estimated too.",
        (Way("the pixel of that point", 1),),
    ),
    Question(
        "tip",
        "Where is the rope's free end?",
        "The line in the picture must follow the rope up to there.",
        (Way("where the line ends", word="found"), Way("the pixel of the free end", 1)),
    ),
    Question(
        "size",
        "What tells the size of the picture?",
        "The camera is taken as level, at a right angle to the swing plane and without distortion: a plane that is "
        "turned by 5 degrees costs 0.4 % of all lengths across. Scale and roll are estimated too.",
        (
            Way("the rope's own length", word="rope"),
            Way("two points in the swing plane, and their distance", 2, ("distance in m",)),
            Way("the four corners of an A4 sheet in the swing plane", 4),
            Way("a chessboard in the swing plane", 0, ("squares across", "squares down", "side of a square in m")),
        ),
    ),
    Question(
        "mass",
        "What does the rope weigh?",
        "A free swing shows friction and inertia only in proportion to the mass; the motion needs no mass.",
        (Way("not known", word="unknown"), Way("its mass", 0, ("kg",))),
    ),
)


@dataclass(frozen=True, kw_only=True)
class Plain:
    """Options on a plain rope; what is missing is asked for, and kept in a file beside the video."""

    length: Annotated[
        float | None,
        typer.Option(help="Length of a rope without markers, m: the command asks for the rest."),
    ] = None
    pivot: Annotated[Pixel, typer.Option(help="Pixel of the first joint, u v, of a plain rope or for --bar.")] = None
    tip: Annotated[
        str | None, typer.Option(help="Pixel U,V of a plain rope's free end in the first frame; found: by the command.")
    ] = None
    size: Annotated[
        str | None,
        typer.Option(
            help="What tells the size of the picture: rope (its own length), U,V,U,V,METRES (two points), the four "
            "corners of an A4 sheet as U,V,..., or ACROSS,DOWN,METRES of a chessboard; all in the swing plane."
        ),
    ] = None
    mass: Annotated[str | None, typer.Option(help="Mass of a plain rope, kg, or unknown.")] = None
    exposure: Annotated[float | None, typer.Option(help="Exposure of a plain rope's video, s. [default: 0.004]")] = None

    def answers(self) -> dict[str, Answer]:
        """Return the answers that options give."""
        return {each.name: each.parse(given) for each in QUESTIONS if (given := getattr(self, each.name)) is not None}

    def scene(self, image: "Image", beside: Path, readout_direction: str = "down") -> "PlainScene":
        """Return the scene in the first picture of a source; asks for answers that neither options nor a file give.

        `beside` is the video: the answers are kept in a file beside it, and used until the video or its size changes.
        """
        path = answers_path(beside)
        head: dict[str, Any] = {"format": FORMAT, "image_size": [int(each) for each in image.shape[1::-1]]}
        if beside.exists():
            with beside.open("rb") as video:
                head["video"] = hashlib.file_digest(video, "sha256").hexdigest()
        kept = _read(path, head) if path.exists() else {}
        before = {name: kept.pop(name) for name in MEASURES if name in kept}
        given = {name: value for name in MEASURES if (value := getattr(self, name)) is not None}
        measures = {"exposure": 0.004} | before | given
        if "length" not in measures:
            raise InvalidInput("--length is missing", fix="Give the rope's length, m")
        length = checks.number("--length", measures["length"], sign="positive", unit="m")
        exposure = checks.number("--exposure", measures["exposure"], sign="nonnegative", unit="s")

        @cache
        def find(u: float, v: float, size: float | None) -> "FoundRope":
            from hyperflex.vision import find_rope, srgb_tone

            return find_rope(image, (u, v), length=size, tone=srgb_tone())

        scene = partial(PlainScene, image, length, exposure, readout_direction, find)

        def prepare(question: Question, answers: Mapping[str, Answer]) -> Question:
            line = scene(answers).found.curve.round(1).tolist() if question.name in ("tip", "size") else ()
            return question._replace(default=question.ways[0].word, line=line)

        def check(name: str, answers: Mapping[str, Answer]) -> None:
            for each in (name, *known) if name == "pivot" else (name,):
                scene(answers).check(each)
            if name == "pivot":  # where no rope hangs from it, another one may be clicked
                _ = scene(answers).found

        known = kept | self.answers()
        check_terminal([each for each in QUESTIONS if each.name not in known])
        if "pivot" in known:  # else they are checked with its answer: against the rope that hangs from it
            for name in known:
                scene(known).check(name)
        answers = ask(Dialogue(QUESTIONS, known, prepare, check), image)
        if (answers, measures) != (kept, before):
            files.write_toml(path, head | {"answers": {**measures, **answers}})
        return scene(answers)


def answers_path(video: Path) -> Path:
    """Return the file of the answers on a video: beside it."""
    return video.with_suffix(".answers.toml")


def _read(path: Path, head: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answers of a file; none, with a note, if it is of a video with another head."""
    content = files.read_toml(path)
    table = content.get("answers")
    if content.get("format") != FORMAT or not isinstance(table, dict):
        raise InvalidInput(
            f"{path} contains no answers on a video", got=sorted(content), fix="Remove it to be asked again"
        )
    if any(content.get(name) != each for name, each in head.items()):
        output.note(f"{path} is about another video: its answers are not used")
        return {}
    checks.keys(f"{path}: [answers]", table, (*MEASURES, *(each.name for each in QUESTIONS)))
    known = {each.name: each.parse(table[each.name]) for each in QUESTIONS if each.name in table}
    return known | {name: table[name] for name in MEASURES if name in table}


@dataclass(frozen=True, eq=False)
class PlainScene:
    """What the first picture and the answers tell: the rope's line and look, camera, rope and tracking task.

    length: m. exposure: s. find: returns the rope that hangs from a pixel u, v, and is so many px long, if that is not
    None. answers: by the names of QUESTIONS; what needs one that is missing must not be used.
    """

    image: "Image"
    length: float
    exposure: float
    readout_direction: str
    find: "Callable[..., FoundRope]"
    answers: Mapping[str, Answer]

    @cached_property
    def found(self) -> "FoundRope":
        """The rope in the picture, from the pivot to its free end."""
        from hyperflex.vision import NoRope

        pivot, tip, size = self.answers["pivot"], self.answers.get("tip", "found"), None
        if not isinstance(self.answers.get("size", "rope"), str):
            size = float(np.hypot(*np.diff(self.camera.project([[0.0, 0.0], [0.0, -self.length]]), axis=0)[0]))
        try:
            found = self.find(*pivot, size)
        except NoRope:
            if size is None:
                raise
            found = self.find(*pivot, None)  # `check` says by how much its length differs
        if isinstance(tip, str):
            return found
        away = np.hypot(*(found.curve - tip).T)
        if away.min() > found.look.width + 10.0 * CLICKED:
            allowed = f"a pixel of the rope that is seen, which ends at {found.curve[-1].round().tolist()}"
            raise InvalidInput("--tip is not on the rope", got=tip, allowed=allowed)
        return replace(found, curve=found.curve[: int(away.argmin()) + 1])

    @cached_property
    def camera(self) -> "Camera":
        """The camera: level and at a right angle to the swing plane, unless a chessboard shows its pose."""
        from hyperflex.vision import Camera

        size, (height, width) = self.answers["size"], self.image.shape[:2]
        numbers = [] if isinstance(size, str) else size
        timing: dict[str, Any] = {"exposure": self.exposure, "readout_direction": self.readout_direction}
        if len(numbers) == 3:
            return self._on_board(Camera.pinhole((width, height), **timing), *numbers)
        if len(numbers) == 5:
            scale = float(np.hypot(*np.subtract(numbers[:2], numbers[2:4])))
            scale /= checks.number("--size", numbers[4], sign="positive")
        elif len(numbers) == 8:
            corners = np.reshape(numbers, (4, 2))
            sheet = 0.210 * 0.297  # m^2, A4
            around = np.argsort(np.arctan2(*(corners - corners.mean(axis=0)).T))  # clicked in any order
            sides = np.linalg.norm(np.diff(corners[[*around, around[0]]], axis=0), axis=1)
            sides = 0.5 * (sides[:2] + sides[2:])
            if abs(sides.max() / np.sqrt(2.0) / max(sides.min(), CLICKED) - 1.0) > 0.1:  # clicks and perspective
                got = f"sides of {sides[0]:.0f} and {sides[1]:.0f} px"
                allowed = "sides as 1.41 to 1, seen at a right angle"
                raise InvalidInput("--size: these are not the corners of an A4 sheet", got=got, allowed=allowed)
            scale = float(np.sqrt(sides.prod() / sheet))
        else:
            scale = self.found.length / self.length
        return Camera.facing((width, height), pixels_per_metre=scale, origin=self.answers["pivot"], **timing)

    def _on_board(self, lens: "Camera", across: float, down: float, square: float) -> "Camera":
        from hyperflex.vision import Board

        if (view := Board((round(across), round(down)), square).find(self.image)) is None:
            allowed = "a chessboard of so many squares, whole and sharp in the first frame"
            raise InvalidInput("--size: no chessboard was found", got=f"{across:g} by {down:g}", allowed=allowed)
        seen = lens.with_plane(view.points, view.pixels)
        if abs(seen.plane_view.roll) > 90.0:  # a chessboard looks the same upside down
            seen = lens.with_plane(-view.points, view.pixels)
        return seen.with_origin(self.answers["pivot"])

    def check(self, name: str) -> None:
        """Refuse an answer that cannot be right."""
        numbers = self.answers[name] if not isinstance(self.answers[name], str) else []
        pixels = numbers[: {"mass": 0, "size": {5: 4, 8: 8}.get(len(numbers), 0)}.get(name, 2)]
        width, height = self.image.shape[1::-1]
        outside = (np.reshape(pixels, (-1, 2)) < -0.5) | (np.reshape(pixels, (-1, 2)) > np.array([width, height]) - 0.5)
        if outside.any():
            raise InvalidInput(
                f"--{name} is not in the picture", got=numbers, allowed=f"0 to {width - 1} and {height - 1}"
            )
        for each in numbers[len(pixels) :]:
            checks.number(f"--{name}", each, sign="positive")
        if name == "tip" and numbers:
            _ = self.found
        if name == "size" and not self.length / 10.0 < height / self.camera.pixels_per_metre < 100.0 * self.length:
            got = f"a picture {height / self.camera.pixels_per_metre:.3g} m high, for a rope of {self.length:g} m"
            raise InvalidInput("--size makes an impossible picture", got=got, fix="Give distances in metres")
        if name == "size":
            seen = float(np.hypot(*np.diff(self.camera.locate(self.found.curve), axis=0).T).sum())  # m
            if not 0.9 < seen / self.length < 1.1:
                fix = "Correct --length or --size; it looks shorter if its end is hidden or it hangs out of the plane"
                got, allowed = f"{seen:.3g} m in the picture", f"its length, {self.length:g} m, within 10 %"
                raise InvalidInput("--size contradicts the rope's length", got=got, allowed=allowed, fix=fix)

    @cached_property
    def rope(self) -> "Rope":
        """The rope to track with: a cable of the paper's density, where its mass is not known, with air drag."""
        from hyperflex.model import Rope, divided, with_links

        usual, mass = Answers(), self.answers["mass"]
        density = usual.mass / usual.length if isinstance(mass, str) else mass[0] / self.length
        friction = BENDING * density / (usual.mass / usual.length) * usual.links / self.length
        radius = 0.5 * self.found.look.width / self.camera.pixels_per_metre
        wind = 1.2  # drag coefficient of a cylinder across the wind
        how: dict[str, Any] = {"radius": radius, "friction": friction, "drag_coefficient": wind}
        # shorter links, which the curve shows: of longer ones friction would be taken for a readout; above all that of
        # the first joint, which bends the rope over some centimetres
        line = with_links(Rope.uniform(self.length, density * self.length, usual.links, **how), 2 * usual.links)
        return divided(line, [4, *[1] * (line.n_links - 1)])

    @property
    def doubts(self) -> dict[str, float]:
        """Standard deviations of what the answers leave open, to be estimated with the motion."""
        clicked = CLICKED / self.camera.pixels_per_metre
        return _OPEN | {"offset_x": clicked, "offset_y": clicked}

    def write(self, found: "VideoTrack", out: Path) -> dict[str, Any]:
        """Write rope and camera as a track found them beside its file; return what a result tells of them.

        The rope has some half of the links of the tracked one: `identify` takes a fifth of the time.
        """
        from hyperflex.model import with_links

        rope, camera = (out.with_name(f"{out.stem}-{name}.toml") for name in ("rope", "camera"))
        values = {name: value for name, (value, _) in found.parameters.items()}
        shift = (values["offset_x"], values["offset_y"])
        seen = self.camera.adjusted(1.0 + values["scale"], values["roll"], shift)
        files.rescued(replace(seen, readout=max(values["readout"], 0.0)).write, camera)
        length = self.length * (1.0 + values.get("length", 0.0))
        line = replace(self, length=length, find=lambda *_: self.found).rope
        damping = {name: getattr(line, name) * (1.0 + values[name]) for name in ("friction", "drag")}
        coarse = with_links(line.replace(**damping), Answers().links)
        files.rescued(coarse.replace(friction=coarse.friction[-1]).to_toml, rope)
        free = "friction:shared,inertia:shared,drag:shared,gravity_angle"
        following = f"hyperflex identify {out} --rope {rope} --free {free} -o identified"
        return {"rope": rope, "camera": camera, "assumed": self._assumed(found.parameters), "next": following}

    def _assumed(self, found: Mapping[str, tuple[float, float]]) -> list[str]:
        """Return what was assumed, with what the fit found of it or what it costs."""
        roll, wide = np.degrees(found["roll"])
        scale, std = (100.0 * each for each in found["scale"])
        readout, late = (1e3 * each for each in found["readout"])
        first, free = (100.0 * each for each in found["first_joint_friction"])
        said = [
            f"the camera is level: found {roll:+.2f} +- {wide:.2f} degrees",
            f"the scale is as answered: found {scale:+.2f} +- {std:.2f} %",
            f"all rows are exposed at once: found {readout:+.1f} +- {late:.1f} ms from the first to the last",
            f"the first joint resists half as much as the others: found {first:+.0f} +- {free:.0f} %",
            "the swing plane is at a right angle to the view: 5 degrees make lengths across 0.4 % too small",
            "levels stand for light as in sRGB: with another tone curve fast parts may count as hidden",
            "the lens does not distort: a phone's moves places by less than 1 % of their distance from the middle",
        ]
        if self.answers["mass"] == "unknown":
            mass = self.rope.total_mass
            said.append(f"the rope weighs {mass:.3g} kg: friction and inertia are true in proportion to its mass")
        return said
