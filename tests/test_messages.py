"""The grammar of error messages: what was wrong, the value got, what is allowed, what to do; each part a sentence."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperflex.errors import InvalidInput, located

SOURCE = Path(__file__).parents[1] / "src" / "hyperflex"
WHOLE = ("FileProblem", "MissingPackage")  # errors whose messages are written whole


def calls(*names: str) -> Iterator[tuple[str, ast.Call]]:
    """Yield where each error of these classes is made."""
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in names:
                yield f"{path.relative_to(SOURCE)}:{node.lineno}", node


def literal(node: ast.expr) -> str:
    """Return a text with {} for what is filled in; empty where it is made elsewhere."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return ""


def test_a_message_is_joined_of_its_parts():
    error = InvalidInput("mass is negative", got=-1.0, allowed="numbers >= 0", fix="Weigh it again")
    assert str(error) == "mass is negative: got -1.0. Allowed: numbers >= 0. Weigh it again."
    assert str(InvalidInput("mass is negative")) == "mass is negative."
    assert str(InvalidInput("two", allowed="x.", fix="Do so.")) == "two. Allowed: x. Do so."  # no double full stop
    with pytest.raises(InvalidInput, match=r"^rope\.toml: two: got 1\. Allowed: one\.$"), located("rope.toml"):
        raise InvalidInput("two", got=1, allowed="one")
    long = str(InvalidInput("name " * 9000, got="a" * 9000, allowed="b" * 9000, fix="c" * 9000 + " and look"))
    assert len(long) < 2000
    assert long.endswith("c and look.")


def test_parts_of_messages_have_no_full_stop_and_advice_is_a_sentence():
    wrong = []
    made = list(calls("InvalidInput"))
    assert len(made) > 400
    for where, node in made:
        parts = {each.arg: literal(each.value) for each in node.keywords} | {"what": literal(node.args[0])}
        for name, text in parts.items():
            ends = text.endswith(".") and not text.endswith("..")
            if ends or text != text.strip() or (name == "fix" and text[:1].islower()):
                wrong.append((where, name, text))
    assert not wrong


def test_whole_messages_are_sentences():
    texts = [(where, literal(node.args[0])) for where, node in calls(*WHOLE) if node.args]
    assert [each for each in texts if each[1][:1].islower() or (each[1] and each[1][-1] not in ".}4")] == []
