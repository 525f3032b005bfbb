"""A plain rope, without markers: questions about its video, a file of the answers, and what is made of them."""

import hashlib
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hyperflex import checks, estimate, files, model, vision
from hyperflex.cli import output
from hyperflex.cli.init import BENDING, Answers
from hyperflex.cli.questions import Answer, Dialogue, Question, Way, ask, check_terminal
from hyperflex.errors import FileProblem, InvalidInput

Pixel = tuple[float, float] | None
FORMAT = "hyperflex answers 1"
MEASURES = ("length", "exposure", "at")  # in the file beside the answers to questions
CLICK_STD = 1.0  # px, standard deviation of a pixel that a person reads from a picture
# Standard deviations of what the answers leave open, freed in the fit. Of a camera: its scale as a part of itself, roll
# (held level by eye), rad, readout of a phone's sensor, s. Of a rope: friction, that of the first joint, and drag as
# parts of themselves. Friction and drag over an unknown mass are known by their order of magnitude; a wrong friction,
# above all that of the first joint, would be taken for a readout: both delay the free end
_OPEN_CAMERA = {"scale": 0.02, "roll": 0.03, "readout": 0.01}
_OPEN_ROPE = {"friction": 1.0, "first_joint_friction": 1.0, "drag": 1.0}

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
        "rotated by 5 degrees makes horizontal lengths 0.4 % too small. Scale and roll are estimated too.",
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
        "Length of a rope without markers, m: the command asks for the rest.",
    ] = None
    pivot: Annotated[Pixel, "Pixel of the first joint, u v, of a plain rope or for --bar."] = None
    tip: Annotated[str | None, "Pixel U,V of a plain rope's free end in the first frame; found: by the command."] = None
    size: Annotated[
        str | None,
        "What tells the size of the picture: rope (its own length), U,V,U,V,METRES (two points), the four "
        "corners of an A4 sheet as U,V,..., or ACROSS,DOWN,METRES of a chessboard; all in the swing plane.",
    ] = None
    mass: Annotated[str | None, "Mass of a plain rope, kg, or unknown."] = None
    exposure: Annotated[float | None, "Exposure of a plain rope's video, s. [default: 0.004]"] = None

    def answers(self) -> dict[str, Answer]:
        """Return the answers that options give."""
        return {each.name: each.parse(given) for each in QUESTIONS if (given := getattr(self, each.name)) is not None}

    def scene(
        self,
        picture: "Callable[[float | None], vision.Image]",
        beside: Path,
        readout_direction: str = "down",
        *,
        at: float | None = None,
        rope: Path | None = None,
        camera: Path | None = None,
    ) -> "PlainScene":
        """Return the scene in a picture of a source; asks for answers that neither options nor files give.

        `picture` returns the source's picture `at` a time, s, the first one for None. `beside` is the video: the
        answers are kept in a file beside it, and used until the video or its size changes. Files of a `rope` and of a
        `camera`, whose origin is the pivot if no other one is given, replace answers.
        """
        line, lens = self._known(rope, camera)
        path, image = answers_path(beside), picture(None)
        head = _head(beside, image)
        kept = _read(path, head) if path.exists() else {}
        before = {name: kept.pop(name) for name in MEASURES if name in kept}
        measures = self._measures(before if line is None else before | {"length": line.total_length}, at)
        image = picture(measures["at"]) if "at" in measures else image
        if lens is not None:
            lens.check_size(image.shape[1::-1])
            lens = replace(lens, exposure=measures.get("exposure", lens.exposure))
        if measures.get("at") != before.get("at"):
            kept.pop("tip", None)  # it was elsewhere

        @cache
        def find(u: float, v: float, tip: Pixel, size: float | None) -> "vision.FoundRope":
            return vision.find_rope(image, (u, v), tip=tip, length=size, tone=vision.srgb_tone())

        def scene(answers: Mapping[str, Answer]) -> PlainScene:
            return PlainScene(
                image,
                measures["length"],
                measures.get("exposure", 0.004),
                readout_direction,
                find,
                answers,
                measures.get("at"),
                line,
                lens,
            )

        replaced = [name for name, each in (("size", lens), ("mass", line)) if each is not None]
        questions = [each for each in QUESTIONS if each.name not in replaced]

        def check(name: str, answers: Mapping[str, Answer]) -> None:
            for each in (name, *known) if name == "pivot" else (name,):
                scene(answers).check(each)

        origin = {} if lens is None else {"pivot": lens.project([[0.0, 0.0]])[0].tolist()}
        given = kept | self.answers()
        known = {name: value for name, value in (origin | given).items() if name not in replaced}
        asked = [each for each in questions if each.name not in known]
        check_terminal(asked)
        if "pivot" in known:  # else they are checked with its answer: against the rope that hangs from it
            for name in known:
                scene(known).check(name)
        found = ask(Dialogue(questions, known, lambda question, answers: scene(answers).asked(question), check), image)
        own = {name: value for name, value in found.items() if name in given or name not in origin}
        if (keep := {**measures, **kept, **own}) != {**before, **kept}:
            _keep(path, head, keep, said=bool(asked))
        return scene(found)

    def _measures(self, known: Mapping[str, Any], at: float | None) -> dict[str, float]:
        """Return length, m, and, where given, exposure, s, and time of the picture, s: by options, or `known`."""
        options = {"length": self.length, "exposure": self.exposure, "at": at}
        found = dict(known) | {name: value for name, value in options.items() if value is not None}
        if "length" not in found:
            raise InvalidInput("--length is missing", fix="Give the rope's length, m")
        kinds: dict[str, Any] = {
            "length": {"sign": "positive", "unit": "m"},
            "exposure": {"sign": "nonnegative", "unit": "s"},
            "at": {"unit": "s"},
        }
        return {name: checks.number(f"--{name}", value, **kinds[name]) for name, value in found.items()}

    def _known(self, rope: Path | None, camera: Path | None) -> "tuple[model.Rope | None, vision.Camera | None]":
        """Return what files of a rope and a camera tell in place of answers."""
        for name, other, file in (("size", "camera", camera), ("mass", "rope", rope)):
            if file is not None and getattr(self, name) is not None:
                raise InvalidInput(f"--{name} and --{other} are both given", fix="Omit one of them")
        line = None if rope is None else model.Rope.from_toml(rope)
        if line is not None and self.length and not np.isclose(self.length, line.total_length, rtol=1e-3):  # as a tape
            allowed = f"{line.total_length:g}"
            raise InvalidInput("--length contradicts --rope", got=self.length, allowed=allowed, fix="Omit --length")
        return line, None if camera is None else vision.read_camera(camera)


def answers_path(video: Path) -> Path:
    """Return the file of the answers on a video: beside it."""
    return video.with_name(f"{video.name}.answers.toml")


def _head(video: Path, image: "vision.Image") -> dict[str, Any]:
    """Return what tells the source of answers: the size of its pictures, and the content if it is a file."""
    head: dict[str, Any] = {"format": FORMAT, "image_size": [int(each) for each in image.shape[1::-1]]}
    if video.exists():
        with video.open("rb") as content:
            head["video"] = hashlib.file_digest(content, "sha256").hexdigest()
    return head


def _keep(path: Path, head: Mapping[str, Any], answers: Mapping[str, Any], *, said: bool) -> None:
    """Write a file of answers, and say so if it is to be `said`; where that fails, say which options give them."""
    try:
        files.write_toml(path, {**head, "answers": answers})
        if said:
            output.note(f"the answers are kept in {path}")
    except FileProblem as error:
        options = list[str]()
        for name, value in answers.items():
            words = [value] if isinstance(value, str) else list(map(str, np.atleast_1d(value)))
            options += [f"--{name}", *(words if name == "pivot" else [",".join(words)])]
        output.note(f"the answers are not kept: {error} Give these options next time: {shlex.join(options)}")


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

    length: m. exposure: s. find: returns the rope that hangs from a pixel u, v, ends at another one, and is so many px
    long, if these are not None. answers: by the names of QUESTIONS; what needs one that is missing must not be used.
    at: time of the picture, s, if it is not the first one. known_rope, known_camera: in place of those of the answers.
    """

    image: "vision.Image"
    length: float
    exposure: float
    readout_direction: str
    find: "Callable[..., vision.FoundRope]"
    answers: Mapping[str, Answer]
    at: float | None = None
    known_rope: "model.Rope | None" = None
    known_camera: "vision.Camera | None" = None

    @property
    def by_rope(self) -> bool:
        """Whether the rope's own length tells the size of the picture."""
        return self.known_camera is None and self.answers.get("size", "rope") == "rope"

    @cached_property
    def found(self) -> "vision.FoundRope":
        """The rope in the picture, from the pivot to its free end."""
        pivot, tip, size = self.answers["pivot"], self.answers.get("tip", "found"), None
        end = None if isinstance(tip, str) else tuple(tip)
        if not self.by_rope:
            size = float(np.hypot(*np.diff(self.camera.project([[0.0, 0.0], [0.0, -self.length]]), axis=0)[0]))
        try:
            return self.find(*pivot, end, size)
        except vision.NoRope:
            if size is None:
                raise
            return self.find(*pivot, end, None)  # `check` says by how much its length differs

    @cached_property
    def camera(self) -> "vision.Camera":
        """The camera: level and at a right angle to the swing plane, unless it is known or a chessboard shows it."""
        if self.known_camera is not None:
            return self.known_camera.with_origin(self.answers["pivot"])
        size, (height, width) = self.answers["size"], self.image.shape[:2]
        numbers = [] if isinstance(size, str) else size
        timing: dict[str, Any] = {"exposure": self.exposure, "readout_direction": self.readout_direction}
        if len(numbers) == 3:
            return self._on_board(vision.Camera.pinhole((width, height), **timing), *numbers)
        if len(numbers) == 5:
            if not (apart := self._clicked_apart) >= CLICK_STD:  # NaN, too
                raise InvalidInput("--size: its two points are the same", got=numbers[:4], fix="Give two points")
            scale = apart / checks.number("--size", numbers[4], sign="positive")
        elif len(numbers) == 8:
            corners = np.reshape(numbers, (4, 2))
            sheet = 0.210 * 0.297  # m^2, A4
            around = np.argsort(np.arctan2(*(corners - corners.mean(axis=0)).T))  # clicked in any order
            sides = np.linalg.norm(np.diff(corners[[*around, around[0]]], axis=0), axis=1)
            sides = 0.5 * (sides[:2] + sides[2:])
            if not abs(sides.max() / np.sqrt(2.0) / max(sides.min(), CLICK_STD) - 1.0) <= 0.1:  # clicks and perspective
                got = f"sides of {sides[0]:.0f} and {sides[1]:.0f} px"
                allowed = "sides as 1.41 to 1, seen at a right angle"
                raise InvalidInput("--size: these are not the corners of an A4 sheet", got=got, allowed=allowed)
            scale = float(np.sqrt(sides.prod() / sheet))
        else:
            scale = self.found.length / self.length
        return vision.Camera.facing((width, height), pixels_per_metre=scale, origin=self.answers["pivot"], **timing)

    @property
    def _clicked_apart(self) -> float:
        """Distance of the first two points of the answer on the size, px."""
        return float(np.hypot(*np.subtract(self.answers["size"][:2], self.answers["size"][2:4])))

    def _on_board(self, lens: "vision.Camera", across: float, down: float, square: float) -> "vision.Camera":
        if (view := vision.Board((round(across), round(down)), square).find(self.image)) is None:
            allowed = "a chessboard of so many squares, whole and sharp in the first frame"
            raise InvalidInput("--size: no chessboard was found", got=f"{across:g} by {down:g}", allowed=allowed)
        seen = lens.with_plane(view.points, view.pixels)
        if abs(seen.plane_view.roll) > 90.0:  # a chessboard looks the same upside down
            seen = lens.with_plane(-view.points, view.pixels)
        return seen.with_origin(self.answers["pivot"])

    def asked(self, question: Question) -> Question:
        """Return a question with its default, and the line that it is about."""
        line = list[list[float]]()
        if question.name in ("tip", "size"):
            try:
                line = self.found.curve.round(1).tolist()
            except InvalidInput as error:  # the free end can be clicked
                return question._replace(cost=f"No line is found: {error}")
        return question._replace(default=question.ways[0].word, line=line)

    def check(self, name: str) -> None:
        """Refuse an answer that cannot be right."""
        numbers = self.answers[name] if not isinstance(self.answers[name], str) else []
        pixels = numbers[: {"mass": 0, "size": {5: 4, 8: 8}.get(len(numbers), 0)}.get(name, 2)]
        width, height = self.image.shape[1::-1]
        places = np.reshape(pixels, (-1, 2))
        if not ((places >= -0.5) & (places <= np.array([width, height]) - 0.5)).all():  # NaN, too
            raise InvalidInput(
                f"--{name} is not in the picture", got=numbers, allowed=f"0 to {width - 1} and {height - 1}"
            )
        for each in numbers[len(pixels) :]:
            checks.number(f"--{name}", each, sign="positive")
        if name == "tip" or (name == "pivot" and "tip" not in self.answers):
            try:
                _ = self.found
            except vision.NoRope as error:
                if name == "tip" or error.reason is vision.Reason.NOTHING:  # else the free end can be clicked
                    raise
        sizes = name == ("size" if self.known_camera is None else "tip")
        option = "--size" if self.known_camera is None else "--camera"
        if sizes and not self.length / 10.0 < height / self.camera.pixels_per_metre < 100.0 * self.length:
            got = f"a picture {height / self.camera.pixels_per_metre:.3g} m high, for a rope of {self.length:g} m"
            raise InvalidInput(f"{option} makes an impossible picture", got=got, fix="Give distances in metres")
        if sizes:
            seen = float(np.hypot(*np.diff(self.camera.locate(self.found.curve), axis=0).T).sum())  # m
            if not 0.9 < seen / self.length < 1.1:
                fix = (
                    f"Correct --length or {option}; it looks shorter if its end is hidden or it hangs out of the plane"
                )
                got, allowed = f"{seen:.3g} m in the picture", f"its length, {self.length:g} m, within 10 %"
                raise InvalidInput(f"{option} contradicts the rope's length", got=got, allowed=allowed, fix=fix)

    @cached_property
    def rope(self) -> "model.Rope":
        """The rope to track with: a cable of the paper's density, where its mass is not known, with air drag."""
        if self.known_rope is not None:
            return self.known_rope
        usual, mass = Answers(), self.answers["mass"]
        density = usual.mass / usual.length if isinstance(mass, str) else mass[0] / self.length
        friction = BENDING * density / (usual.mass / usual.length) * usual.links / self.length
        wind = 1.2  # drag coefficient of a cylinder across the wind
        how: dict[str, Any] = {"radius": self.radius, "friction": friction, "drag_coefficient": wind}
        # shorter links, which the curve shows: of longer ones friction would be taken for a readout; above all that of
        # the first joint, which bends the rope over some centimetres
        line = model.with_links(
            model.Rope.uniform(self.length, density * self.length, usual.links, **how), 2 * usual.links
        )
        return model.divided(line, [4, *[1] * (line.n_links - 1)])

    @property
    def radius(self) -> float:
        """Half of the rope's thickness, m, as it looks."""
        return float(0.5 * self.found.look.width / self.camera.pixels_per_metre)

    @property
    def doubts(self) -> dict[str, float]:
        """Standard deviations of what the answers leave open, to be estimated with the motion."""
        clicked = CLICK_STD / self.camera.pixels_per_metre
        found = {"offset_x": clicked, "offset_y": clicked}
        if self.known_camera is None:
            size = self.answers["size"]
            apart = self.found.length if self.by_rope else self._clicked_apart if len(size) > 3 else np.inf
            found |= _OPEN_CAMERA | {"scale": float(np.hypot(_OPEN_CAMERA["scale"], np.sqrt(2.0) * CLICK_STD / apart))}
        return found if self.known_rope else found | _OPEN_ROPE

    def write(self, found: "estimate.VideoTrack", out: Path) -> dict[str, Any]:
        """Write rope and camera as a track found them beside its file; return what a result tells of them.

        A rope that is not known has some half of the links of the tracked one: `identify` takes a fifth of the time.
        """
        rope, camera = (out.with_name(f"{out.stem}-{name}.toml") for name in ("rope", "camera"))
        values = {name: value for name, (value, _) in found.parameters.items()}
        shift = (values["offset_x"], values["offset_y"])
        seen = self.camera.adjusted(1.0 + values.get("scale", 0.0), values.get("roll", 0.0), shift)
        readout = max(seen.readout + values.get("readout", 0.0), 0.0)
        files.rescued(replace(seen, readout=readout).write, camera)
        line = self.known_rope
        if line is None:
            length = self.length * (1.0 + values.get("length", 0.0))
            line = replace(self, length=length, find=lambda *_: self.found).rope
            damping = {name: getattr(line, name) * (1.0 + values.get(name, 0.0)) for name in ("friction", "drag")}
            line = model.with_links(line.replace(**damping), Answers().links)
            line = line.replace(friction=line.friction[-1])
        files.rescued(line.to_toml, rope)
        told = {"rope": rope, "camera": camera, "assumed": self._assumed(found.parameters, line)}
        if found.doubts:
            return told
        free = "friction:shared,inertia:shared,drag:shared,gravity_angle"
        words = ["hyperflex", "identify", out, "--rope", rope, "--free", free, "-o", "identified"]
        return told | {"next": shlex.join(map(str, words))}

    def _assumed(self, found: Mapping[str, tuple[float, float]], line: "model.Rope") -> list[str]:
        """Return what was assumed, with what the fit found of it or what it costs; `line` is the rope as it is now."""
        texts = {
            "roll": ("the camera is level", np.degrees(1.0), ": found {:+.2f} +- {:.2f} degrees"),
            "scale": ("the scale is as answered", 100.0, ": found {:+.2f} +- {:.2f} %"),
            "readout": ("all rows are exposed at once", 1e3, ": found {:+.1f} +- {:.1f} ms from the first to the last"),
            "first_joint_friction": (
                "the first joint resists half as much as the others",
                100.0,
                ": found {:+.0f} +- {:.0f} %",
            ),
            next((name for name in list(found)[::-1] if name.startswith("arc[")), ""): (
                "the free end is where the rope's length ends",
                1e3,
                ": found {:+.1f} +- {:.1f} mm beyond",
            ),
        }
        said = [  # of a rope that hangs still nothing is found
            text + (numbers.format(*(unit * each for each in found[name])) if name in found else "")
            for name, (text, unit, numbers) in texts.items()
            if name in self.doubts or name in found
        ]
        exposed = 1e3 * self.camera.exposure
        said += [
            f"the exposure is {exposed:.3g} ms (--exposure): if it is longer, fast parts are seen less often",
            "levels stand for light as in sRGB: with another tone curve fast parts may count as hidden",
        ]
        if self.known_camera is None:
            said += [
                "the swing plane is at a right angle to the view: 5 degrees make lengths across 0.4 % too small",
                "the lens does not distort: a phone's moves places by less than 1 % of their distance from the middle",
            ]
        if self.known_rope is None and self.answers["mass"] == "unknown":
            said.append(
                f"the rope weighs {line.total_mass:.3g} kg: friction and inertia are true in proportion to its mass"
            )
        return said
