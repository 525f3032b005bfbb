"""Questions about a picture: in a page that is clicked, in a terminal, and without anybody who could answer."""

import os
import subprocess
import sys
from http.client import HTTPConnection

import numpy as np
import pytest

from hyperflex.cli.questions import Dialogue, Question, QuestionPage, Way
from hyperflex.errors import InvalidInput

QUESTIONS = (
    Question("pivot", "Where does it hang from?", "Little.", (Way("the pixel", 1),)),
    Question(
        "size", "What tells the size?", "Much.", (Way("the rope", word="rope"), Way("two points", 2, ("metres",)))
    ),
)
LINE = [[60.0, 20.0], [70.0, 200.0], [90.0, 300.0]]


def prepared(question, answers):
    return question._replace(default="rope", line=LINE) if question.name == "size" else question


def inside(name, answers):
    if name == "pivot" and answers["pivot"][0] > 640.0:
        raise InvalidInput("--pivot is not in the picture", got=answers["pivot"])


@pytest.fixture
def dialogue():
    return Dialogue(QUESTIONS, {}, prepared, inside)


@pytest.fixture
def image():
    rng = np.random.default_rng(0)
    return rng.integers(90, 110, (360, 640, 3), dtype=np.uint8)


def test_each_answer_has_a_form_of_its_question(dialogue):
    assert dialogue.take("there") == "--pivot does not answer: Where does it hang from?: got 'there'. Allowed: u,v."
    assert "not in the picture" in dialogue.take("700 20")
    assert dialogue.take("60 20", "size") == ""  # of another question: it is not open
    assert dialogue.question.name == "pivot"
    assert dialogue.take("60, 20") == ""
    assert "Allowed: rope or u,v,u,v,metres" in dialogue.take("1,2,3")
    assert dialogue.take("") == ""  # the default
    assert dialogue.answers == {"pivot": [60.0, 20.0], "size": "rope"}
    assert dialogue.state() == {"done": True}


def test_the_page_asks_and_is_clicked(browser, dialogue, image, tmp_path):
    with QuestionPage(dialogue, image) as page:
        browser.open(page.address)
        wait(browser, "image.complete && question.name === 'pivot'")
        assert browser.evaluate("document.getElementById('next').disabled")
        click(browser, 60.0, 20.0)
        browser.evaluate("document.getElementById('next').click()")
        wait(browser, "question.name === 'size'")
        assert dialogue.answers["pivot"] == pytest.approx([60.0, 20.0], abs=1.2)
        browser.evaluate("document.querySelectorAll('#ways input')[1].click()")
        click(browser, 100.0, 50.0)
        click(browser, 100.0, 150.0)
        browser.evaluate("{ const input = inputs()[0]; input.value = 0.5; input.oninput(); }")
        browser.screenshot(tmp_path / "size.png")
        browser.evaluate("document.getElementById('next').click()")
        wait(browser, "question.done")
        assert dialogue.answers["size"] == pytest.approx([100.0, 50.0, 100.0, 150.0, 0.5], abs=1.2)
        assert browser.complaints == []
        assert all(each.startswith((page.address, "data:")) for each in browser.requests)


def test_the_page_shows_answers_of_the_terminal_and_refusals(browser, dialogue, image):
    with QuestionPage(dialogue, image) as page:
        browser.open(page.address)
        wait(browser, "question.name === 'pivot'")
        browser.evaluate("ask({ name: 'pivot', answer: '900,3' })")
        wait(browser, "document.getElementById('wrong').textContent.includes('not in the picture')")
        dialogue.take("60 20")
        wait(browser, "question.name === 'size'")


def test_a_post_that_is_no_answer_changes_nothing(dialogue, image):
    with QuestionPage(dialogue, image) as page:
        for body, status in (("{", 200), ("[1]", 200), ("x" * 5000, 413)):
            connection = HTTPConnection("127.0.0.1", page.port, timeout=10.0)
            connection.request("POST", "/question", body)
            assert connection.getresponse().status == status
    assert dialogue.answers == {}


TERMINAL = """
import numpy as np
from tests.cli.test_questions import QUESTIONS, inside, prepared
from hyperflex.cli.questions import Dialogue, ask
print(ask(Dialogue(QUESTIONS, {}, prepared, inside), np.zeros((36, 64, 3), np.uint8)))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_terminal_is_required():
    import pty

    master, slave = pty.openpty()
    environment = {**os.environ, "BROWSER": "true"}
    with subprocess.Popen(
        [sys.executable, "-c", TERMINAL], stdin=slave, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as program:
        os.write(master, b"nowhere\n60 20\n\n")
        out, err = program.communicate(timeout=60.0)
    os.close(master)
    os.close(slave)
    assert program.returncode == 0
    assert out.decode().split("\n")[0] == "{'pivot': [60.0, 20.0], 'size': 'rope'}"
    assert "click in the picture at http://127.0.0.1:" in err.decode()
    assert "got 'nowhere'" in err.decode()


def wait(browser, what):
    look = f"new Promise((done) => {{ const look = () => {what} ? done(true) : setTimeout(look, 20); look(); }})"
    assert browser.evaluate(look)


def click(browser, u, v):
    x, y = browser.evaluate(
        "(() => { const box = picture.getBoundingClientRect(), scale = box.width / picture.width;"
        f" return [box.left + ({u} + .5) * scale, box.top + ({v} + .5) * scale]; }})()"
    )
    browser.drag(x, y, x, y)
