"""Documents and docstrings are true: their Python runs as shown, and their links are valid."""

import doctest
import importlib
import os
import pkgutil
import re
import shlex
import subprocess
import sys
import warnings
from dataclasses import fields
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.main import get_command

import hyperflex
from hyperflex.cli.app import app
from hyperflex.core import status
from hyperflex.model import Arm, Setup
from hyperflex.model.obstacles import KINDS
from hyperflex.model.rope import TOTALS
from hyperflex.model.setup import PLANNING
from hyperflex.motion.profiles import MOTIONS
from hyperflex.planning import MotorLimits, TipTarget
from hyperflex.report import save_png
from hyperflex.simulation.rollouts import status_of
from hyperflex.status import Status
from tests.names import code_names

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
GENERATED = ("cli.md", "modules.md", "wrong-input.md")  # pages that exist in the built site alone
MODULES = sorted(m.name for m in pkgutil.walk_packages(hyperflex.__path__, "hyperflex."))


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def python_blocks(page: Path) -> list[str]:
    """Return the Python of a page's fenced blocks, in order."""
    return re.findall(r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


@pytest.mark.parametrize("page", [p for p in PAGES if python_blocks(p)], ids=named)
@pytest.mark.nightly
def test_python_of_a_page_runs_as_it_stands(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    for block in python_blocks(page):
        exec(compile(block, named(page), "exec"), scope)
    assert "hf" in scope, "each page's Python starts with import hyperflex as hf"


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_local_links_of_a_page_lead_somewhere(page):
    targets = re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", page.read_text("utf-8"))
    made = {ROOT / "docs" / name for name in GENERATED}
    assert [t for t in targets if not (page.parent / t).exists() and (page.parent / t).resolve() not in made] == []


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of doctest itself, under numba's wrappers
        result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.failed == 0


def commands(page: Path) -> list[str]:
    """Return the commands that a page shows, in its blocks and with options in its lines."""
    text = page.read_text("utf-8").replace("\\\n", " ")
    blocks = "\n".join(re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S))
    return re.findall(r"^(?:\$ )?hyperflex (\w.*)", blocks, re.M) + re.findall(r"`hyperflex (\w[^`]* [^`]*)`", text)


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=named)
def test_commands_of_a_page_have_options_that_exist(page):
    group = get_command(app)
    for words in commands(page):
        given = shlex.split(words.removesuffix("..."), comments=True)
        _, command, given = group.resolve_command(None, given)
        parser = command.make_parser(command.context_class(command))
        assert parser.parse_args(given)[1] == [], words  # refuses an option that does not exist


def test_equations_that_the_code_names_are_in_the_models_page():
    tags = re.findall(r"\\tag\{(M\.\d+)\}", (ROOT / "docs" / "models.md").read_text("utf-8"))
    known = set(tags)
    assert len(known) == len(tags)
    sources = "\n".join(path.read_text("utf-8") for path in (ROOT / "src").rglob("*.py"))
    named_there = set(re.findall(r"\(?(M\.\d+)\b", sources))
    assert named_there
    assert named_there <= known


@pytest.mark.nightly
def test_site_builds_and_needs_no_network(tmp_path):
    run = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    for page in tmp_path.rglob("*.html"):
        text = page.read_text("utf-8")
        assert "arithmatex" not in text, f"{page.name}: LaTeX that was not converted"
        assert not re.search(r"<m[ion]>(&amp;|&|\\\w*)</m[ion]>", text), f"{page.name}: LaTeX within MathML"
        assert not re.search(r'<(script|img|link|iframe)[^>]*(src|href)="?(https?:)?//', text), page.name


def test_python_reference_has_every_public_name_once():
    pages = "\n".join(page.read_text("utf-8") for page in (ROOT / "docs" / "api").glob("*.md"))
    named_there = re.findall(r"^::: hyperflex\.([\w.]+)$", pages, re.M)
    assert sorted(n for n in named_there if "." not in n) == sorted(set(hyperflex.__all__) - {"__version__"})
    for name in named_there:
        *room, last = name.split(".")
        assert last in importlib.import_module(".".join(["hyperflex", *room])).__all__, name


def rows_of(page: str, key: str) -> str:
    """Return the rows of a page's tables that begin with `key`."""
    return "\n".join(re.findall(rf"^\| `{re.escape(key)}` \|.*$", page, re.M))


def test_page_on_files_names_every_table_and_key_of_a_set_up():
    page = (ROOT / "docs" / "how-to" / "files.md").read_text("utf-8")
    words = set(re.findall(r"`(\w+)`", page)) | set(re.findall(r"\[(\w+)\]", page))
    keys = {each.name for kind in (Setup, Arm, MotorLimits, TipTarget) for each in fields(kind)}
    keys |= {"walls", "grounds", *PLANNING, "n_links", *signature(hyperflex.Rope).parameters}
    keys |= {f"{whole}_{name}" for whole in ("total", "link") for name in TOTALS}
    assert keys - words == {"control", "control_rate"}  # which cannot be written
    for kind, (maker, *_) in MOTIONS.items():
        row = rows_of(page, f'"{kind}"') or page
        assert {name for name in signature(maker).parameters if f"`{name}`" not in row} == set(), kind
    for table, obstacle in KINDS.items():
        row = rows_of(page, f"[[{table}]]")
        assert {each.name for each in fields(obstacle) if f"`{each.name}`" not in row} == set(), table


def test_set_ups_on_the_page_on_files_can_be_read():
    page = (ROOT / "docs" / "how-to" / "files.md").read_text("utf-8")
    first, *others = re.findall(r"^```toml\n(.*?)^```", page, re.M | re.S)
    for other in others:
        setup = Setup.loads(other if "[rope]" in other else first + other)
        assert ("[[pegs]]" in other) == bool(setup.pegs)


def test_page_on_accuracy_has_a_row_for_every_status_of_a_run():
    page = (ROOT / "docs" / "how-to" / "accuracy.md").read_text("utf-8")
    table = page[page.index("| status | what happened") :].split("\n\n")[0]
    ends = {status_of(code) for code in status.NAMES if code != status.RUNNING}  # a run never ends as running
    found = set(re.findall(r"^\| `([^`]+)` \|", table, re.M))
    assert found == {*ends, Status.OUT_OF_TIME, Status.INTERRUPTED} - {Status.SUCCESS}


def test_the_picture_of_readme_is_what_its_program_draws(tmp_path, monkeypatch):
    """All but the smoothing of edges, which differs between versions of Matplotlib."""
    monkeypatch.chdir(tmp_path)
    (program,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    made = {}
    exec(program, made)
    save_png(made["again"].plot(), tmp_path / "drawn.png", dpi=100)  # as docs/draw.py does
    pictures = [Image.open(path) for path in (tmp_path / "drawn.png", ROOT / "docs" / "images" / "cast.png")]
    one, other = (np.asarray(each.convert("L").reduce(4), int) for each in pictures)
    assert one.shape == other.shape
    assert (np.abs(one - other) > 25).mean() < 0.01


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", "ARCHITECTURE.md"])
def test_front_pages_use_names_of_the_code(page):
    quoted = re.findall(r"`(\w+)(?:\([^`]*\))?`", (ROOT / page).read_text("utf-8"))
    known = code_names() | {part for module in MODULES for part in module.split(".")}
    assert {name for name in quoted if "_" in name} - known == set()


def glossary_names() -> set[str]:
    """Return the names in the column "code" of the glossary."""
    rows = re.findall(r"^\|[^|]*\|([^|]*)\|", (ROOT / "docs" / "glossary.md").read_text("utf-8"), re.M)
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)}


@pytest.mark.parametrize("room", ["", ".sensors", ".estimate", ".vision", ".control", ".hardware"])
def test_every_public_name_is_in_the_glossary(room):
    names = {name for name in importlib.import_module(f"hyperflex{room}").__all__ if not name.isupper()}
    assert names - glossary_names() - {"__version__"} == set()


def test_every_name_in_the_glossary_is_in_the_code():
    assert glossary_names() - code_names() == set()
