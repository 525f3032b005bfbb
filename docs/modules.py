"""MkDocs hook: the page on all modules, made from the first sentences of their docstrings while the site is built."""

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "hyperflex"
WIDTH = 36  # characters of the names' column


def on_files(files: Any, config: Any) -> Any:
    """Add the page to the site's files."""
    from mkdocs.structure.files import File

    text = f"# Modules\n\nWhat a module imports stands above it.\n\n```text\nsrc/hyperflex/\n{tree()}```\n"
    files.append(File.generated(config, "modules.md", content=text))
    return files


def tree() -> str:
    """Return a line for each module, with the first sentence of its docstring; what is imported comes before."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    layers = [re.sub(r"[() ]", "", layer).split("|") for layer in contracts[0]["layers"]]
    order = {name: number for number, names in enumerate(reversed(layers)) for name in names}

    def place(path: Path) -> tuple[int, bool, str]:
        return (order.get(path.stem, 0) if path.parent == PACKAGE else 0, path.is_dir(), path.name)

    def lines(folder: Path, depth: int) -> list[str]:
        inside = [p for p in folder.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()]
        found = []
        for path in sorted((p for p in inside if p.name != "__init__.py"), key=place):
            name = f"{'  ' * depth}{path.name}{'/' if path.is_dir() else ''}"
            source = path / "__init__.py" if path.is_dir() else path
            found.append(f"{name.ljust(WIDTH - 1)} {sentence(source)}")
            if path.is_dir():
                found += lines(path, depth + 1)
        return found

    return "\n".join(lines(PACKAGE, 1)) + "\n"


def sentence(path: Path) -> str:
    """Return the first paragraph of a module's docstring in one line, without the full stop."""
    text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")
