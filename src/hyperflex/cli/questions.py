"""Questions about a picture, one at a time: in the terminal, or in a page of the browser where it can be clicked."""

import contextlib
import json
import os
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperflex.cli import output
from hyperflex.errors import InvalidInput
from hyperflex.local_page import LocalServer, send, send_head

if TYPE_CHECKING:
    from hyperflex.vision import Image

Answer = str | list[float]  # a word, or numbers


class Way(NamedTuple):
    """A way to answer: `word`, or pixels that are clicked and then numbers of these names, with commas."""

    text: str
    clicks: int = 0
    numbers: tuple[str, ...] = ()
    word: str = ""

    @property
    def example(self) -> str:
        """What is typed."""
        return self.word or ",".join([*self.clicks * ["u", "v"], *self.numbers])


class Question(NamedTuple):
    """A question: its name in a file and as an option, and the ways to answer it.

    cost: what a wrong answer, or the default, costs. default: the answer of who types nothing; empty: there is none.
    line: pixels of a line to draw with it.
    """

    name: str
    text: str
    cost: str
    ways: tuple[Way, ...]
    default: str = ""
    line: Sequence[Sequence[float]] = ()

    @property
    def option(self) -> str:
        """The option that answers it, with what it takes."""
        return f"--{self.name} {' or '.join(each.example for each in self.ways)}"

    def parse(self, given: object) -> Answer:
        """Return the answer in a text, or in numbers, of a form that one of the ways has."""
        text = (
            given if isinstance(given, str) else ",".join(map(str, given if isinstance(given, Sequence) else [given]))
        )
        if text in (each.word for each in self.ways if each.word):
            return text
        try:
            found = [float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            found = []
        if len(found) not in {2 * each.clicks + len(each.numbers) for each in self.ways if not each.word}:
            raise InvalidInput(
                f"--{self.name} does not answer: {self.text}", got=text, allowed=self.option.partition(" ")[2]
            )
        return found


class Dialogue:
    """Open questions about a picture; answers come from the terminal or the page, in any thread.

    Parameters
    ----------
    questions : sequence of Question
    answers : mapping
        Answers that are known, by the questions' names.
    prepare : callable
        Returns a question, with default and line, by the answers so far.
    check : callable
        Raises InvalidInput if an answer cannot be used; called with the question's name and all answers.

    Attributes
    ----------
    open : list of Question
        Those without an answer; the first one is asked, with what `prepare` adds: `question`.
    """

    def __init__(
        self,
        questions: Sequence[Question],
        answers: Mapping[str, Answer],
        prepare: Callable[[Question, Mapping[str, Answer]], Question],
        check: Callable[[str, Mapping[str, Answer]], None],
    ) -> None:
        self.answers = dict(answers)
        self.open = [each for each in questions if each.name not in self.answers]
        self._count, self._prepare, self._check, self._lock = len(self.open), prepare, check, threading.Lock()
        self.question = self._next()

    def _next(self) -> Question | None:
        return self._prepare(self.open[0], self.answers) if self.open else None

    def take(self, text: str, name: str | None = None) -> str:
        """Answer the open question, of this name if one is given; return what is wrong, empty if nothing is."""
        with self._lock:
            question = self.question
            if question is None or name not in (None, question.name):
                return ""
            try:
                answers = self.answers | {question.name: question.parse(text.strip() or question.default)}
                self._check(question.name, answers)
            except InvalidInput as error:
                return str(error)
            self.answers = answers
            del self.open[0]
            self.question = self._next()
            return ""

    def state(self) -> dict[str, Any]:
        """Return the open question for the page."""
        question, number = self.question, self._count - len(self.open) + 1
        if question is None:
            return {"done": True}
        ways = [each._asdict() for each in question.ways]
        return {**question._asdict(), "ways": ways, "number": number, "count": self._count}


class QuestionPage(LocalServer):
    """A page on this machine that shows a picture and asks the questions of a dialogue about it."""

    def __init__(self, dialogue: Dialogue, image: "Image") -> None:
        import cv2

        super().__init__()
        self.dialogue, self._png = dialogue, cv2.imencode(".png", image)[1].tobytes()
        self.start()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer with the page, its picture or the open question, which a POST answers before."""
        from hyperflex.report import render

        size = request.headers.get("Content-Length", "")
        if request.command == "POST" and not (size.isdecimal() and int(size) <= 4096):
            request.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        elif request.path == "/":
            send(request, render("questions.html", room="hyperflex.cli"), "text/html")
        elif request.path == "/picture":
            send_head(request, "image/png")
            request.wfile.write(self._png)
        elif request.path == "/question":
            wrong = ""
            if request.command == "POST":
                with contextlib.suppress(ValueError, AttributeError):
                    given = json.loads(request.rfile.read(int(size)))
                    wrong = self.dialogue.take(str(given.get("answer", "")), str(given.get("name", "")))
            send(request, json.dumps({**self.dialogue.state(), "wrong": wrong}), "application/json")
        else:
            request.send_error(HTTPStatus.NOT_FOUND)


def check_terminal(questions: Sequence[Question]) -> None:
    """Refuse to ask questions that nobody can answer: standard input is no terminal, or the output is JSON."""
    if questions and (output.as_json() or not sys.stdin.isatty()):
        options = "; ".join(each.option for each in questions)
        fix = f"Run the command once in a terminal, without --json: it asks. Or give {options}"
        raise InvalidInput("answers about the video are missing", got=[each.name for each in questions], fix=fix)


def ask(dialogue: Dialogue, image: "Image") -> Mapping[str, Answer]:
    """Return all answers: in the terminal and in a page at once, whichever comes first."""
    if dialogue.question is None:
        return dialogue.answers
    with QuestionPage(dialogue, image) as page:
        output.note(f"answer here, or click in the picture at {page.address}")
        if sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
            with contextlib.suppress(webbrowser.Error):  # without a screen it would be one of texts, in this terminal
                webbrowser.open(page.address)
        threading.Thread(target=_typed, args=(dialogue,), daemon=True).start()
        asked: Question | None = None
        while (question := dialogue.question) is not None:
            if question is not asked:
                asked = question
                ways = "".join(f"\n  {each.example}: {each.text}" for each in question.ways)
                default = f"\n  [Enter: {question.default}]" if question.default else ""
                output.note(f"{question.text} {question.cost}{ways}{default}")
            time.sleep(0.1)
        time.sleep(0.5)  # in which the page gets to know that it is done
    return dialogue.answers


def _typed(dialogue: Dialogue) -> None:
    """Take answers that are typed. The descriptor is read itself: a stream that waits would block the program's end."""
    while dialogue.question is not None and (typed := os.read(sys.stdin.fileno(), 4096)):
        if wrong := dialogue.take(typed.decode(errors="replace")):
            output.note(wrong)
