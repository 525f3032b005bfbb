"""The documentation's site: what its hook and its extension of Griffe make of docstrings."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

griffe = pytest.importorskip("griffe")
DOCS = Path(__file__).parents[1] / "docs"
MODULE = '''
def plan(rope: Rope, arm: Arm, *, length: float = 0.01, friction: float = 0.2, side: int | None = None, **others: int):
    """Plan.

    Parameters
    ----------
    rope, arm : Rope, Arm
    length, friction : float
        Of both.
    side : {-1, 1}, optional
    **others
        More.
    """
'''


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_parameters_of_one_line_have_types_and_defaults_of_their_own(tmp_path):
    (tmp_path / "planner.py").write_text(MODULE)
    extensions = griffe.load_extensions(load("signatures").Signatures())
    loader = griffe.GriffeLoader(search_paths=[tmp_path], extensions=extensions, docstring_parser="numpy")
    (_, listed) = loader.load("planner")["plan"].docstring.parsed
    assert [(each.name, str(each.annotation), each.default) for each in listed.value] == [
        ("rope", "Rope", None),
        ("arm", "Arm", None),
        ("length", "float", "0.01"),
        ("friction", "float", "0.2"),
        ("side", "(-1, 1)", "None"),
        ("**others", "int", None),
    ]


def test_pages_lose_roles_and_empty_dashes_and_keep_options_whole():
    made = load("roles").on_page_content
    assert made(":func:<code>~hyperflex.plan_cast</code>") == "<code>plan_cast</code>"
    assert (
        made('<b>rope</b> –\n <div class="doc-md-description">\n </div>')
        == '<b>rope</b><div class="doc-md-description">\n </div>'
    )
    assert made("<code>hyperflex cast --time-budget 1e-3</code>") == (
        '<code>hyperflex cast <span class="option">--time-budget</span> <span class="option">1e-3</span></code>'
    )
    assert made("<pre><span></span><code>--json</code></pre>") == "<pre><span></span><code>--json</code></pre>"
