"""Write the tree in ARCHITECTURE.md from the first sentences of the modules: ``python docs/generate_map.py``."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "hyperflex"
MAP = ROOT / "ARCHITECTURE.md"
BLOCK = re.compile(r"(?<=```\nsrc/hyperflex/\n).*?(?=```)", re.S)
WIDTH = 32  # of the names


def tree() -> str:
    """Return a line for each module, with the first sentence of its docstring; what is imported comes before."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    layers = [re.sub(r"[() ]", "", layer).split("|") for layer in contracts[0]["layers"]]
    order = {name: number for number, names in enumerate(reversed(layers)) for name in names}

    def place(path: Path) -> tuple[int, bool, str]:
        return (order[path.stem] if path.parent == PACKAGE else 0, path.is_dir(), path.name)

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

    first = f"{'  __init__.py'.ljust(WIDTH - 1)} {sentence(PACKAGE / '__init__.py')}"
    return "\n".join([first, *lines(PACKAGE, 1)]) + "\n"


def sentence(path: Path) -> str:
    """Return the first paragraph of a module's docstring in one line, without the stop."""
    text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


if __name__ == "__main__":
    from hyperflex import files

    files.write_text(MAP, BLOCK.sub(lambda _: tree(), MAP.read_text("utf-8")))
