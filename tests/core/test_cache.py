"""Where compiled kernels are kept: what an edit makes stale, and a cache that is not as it should be."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from hyperflex.core import cache, jit

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

LEAF = "from hyperflex.core.jit import kernel\n\nSCALE = 2.0\n\n\n@kernel\ndef scaled(x):\n    return SCALE * x\n"
CALLER = (
    "from hyperflex.core.jit import kernel\nfrom hyperflex.core.part.leaf import scaled\n\n\n"
    "@kernel\ndef shifted(x):\n    return scaled(x) + 1.0\n"
)
APART = "from hyperflex.core.jit import kernel\n\n\n@kernel\ndef squared(x):\n    return x * x\n"
ASK = """
import sys
from hyperflex.core import apart, caller
from hyperflex.core.part import leaf
print(caller.shifted(3.0), apart.squared(3.0), leaf.scaled(3.0))
for each in (caller.shifted, apart.squared, leaf.scaled):
    print(each.py_func.__name__, sum(each.stats.cache_misses.values()), file=sys.stderr)
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A small package with the real decorator: `caller` uses `part.leaf`, `apart` uses neither."""
    core = tmp_path / "hyperflex" / "core"
    (core / "part").mkdir(parents=True)
    for folder in (core.parent, core, core / "part"):
        (folder / "__init__.py").write_text("")
    for module in (cache, jit):
        shutil.copy(str(module.__file__), core)
    (core / "caller.py").write_text(CALLER)
    (core / "apart.py").write_text(APART)
    (core / "part" / "leaf.py").write_text(LEAF)
    return core


def run(package: Path, root: Path) -> tuple[list[float], set[str]]:
    """Return the results, and which kernels were compiled, of a fresh process with the cache at `root`."""
    found = {"PYTHONPATH": str(package.parents[1]), "HYPERFLEX_CACHE_DIR": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", ASK], check=False, env=os.environ | found, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    counts = [line.split() for line in done.stderr.splitlines() if len(line.split()) == 2]
    return [float(x) for x in done.stdout.split()], {name for name, misses in counts if int(misses)}


def test_an_edit_recompiles_what_depends_on_it_and_nothing_else(package: Path, tmp_path: Path) -> None:
    root, leaf = tmp_path / "cache", package / "part" / "leaf.py"
    assert run(package, root) == ([7.0, 9.0, 6.0], {"shifted", "squared", "scaled"})
    assert run(package, root) == ([7.0, 9.0, 6.0], set())
    leaf.write_text(LEAF.replace("2.0", "5.0"))
    assert run(package, root) == ([16.0, 9.0, 15.0], {"shifted", "scaled"})
    (package / "apart.py").write_text(APART.replace("x * x", "x * x * x"))
    assert run(package, root) == ([16.0, 27.0, 15.0], {"squared"})
    leaf.write_text(LEAF)  # another checkout with the sources of before: both share the cache
    assert run(package, root) == ([7.0, 27.0, 6.0], set())


@pytest.mark.parametrize(
    "line",
    [
        "from hyperflex.core.part import leaf",
        "from hyperflex.core.part.leaf import scaled",
        "import hyperflex.core.part.leaf as leaf",
        "from .part import leaf",
        "from .part.leaf import scaled",
        "from hyperflex.core.tangent.dense_output import scaled",
    ],
)
def test_every_way_to_import_a_module_is_followed(package: Path, line: str) -> None:
    (package / "between.py").write_text("from .part.leaf import scaled\n")
    (package / "caller.py").write_text(line + "\n")
    hashes = []
    for text in (LEAF, LEAF.replace("2.0", "5.0")):
        (package / "part" / "leaf.py").write_text(text)
        cache._source.cache_clear()
        hashes.append([cache.source_hash(f"hyperflex.core.{name}", package.parents[1]) for name in ("caller", "apart")])
    assert hashes[0][0] != hashes[1][0]
    assert hashes[0][1] == hashes[1][1]
