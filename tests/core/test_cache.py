"""Where compiled kernels are kept: what an edit makes stale, and a cache that is not as it should be."""

import itertools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from hyperflex.core import cache, compiler, jit

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


ALL = ([7.0, 9.0, 6.0], {"shifted", "squared", "scaled"})
NONE = (ALL[0], set())


def written(folder: Path) -> Path:
    """A small package with the real decorator: `caller` uses `part.leaf`, `apart` uses neither."""
    core = folder / "hyperflex" / "core"
    (core / "part").mkdir(parents=True)
    for folder in (core.parent, core, core / "part"):
        (folder / "__init__.py").write_text("")
    for module in (cache, compiler, jit):
        shutil.copy(str(module.__file__), core)
    (core / "caller.py").write_text(CALLER)
    (core / "apart.py").write_text(APART)
    (core / "part" / "leaf.py").write_text(LEAF)
    return core


@pytest.fixture
def package(tmp_path: Path) -> Path:
    return written(tmp_path)


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cache that a first process fills; the keys of kernels do not depend on where their package is."""
    folder = tmp_path_factory.mktemp("filled")
    assert run(written(folder), folder / "cache") == ALL
    return folder / "cache"


@pytest.fixture
def root(tmp_path: Path, filled: Path) -> Path:
    """A copy of the filled cache."""
    return Path(shutil.copytree(filled, tmp_path / "cache"))


def start(package: Path, root: Path, code: str = ASK) -> subprocess.Popen[str]:
    """Start a fresh process with the cache at `root`."""
    found = {"PYTHONPATH": str(package.parents[1]), "HYPERFLEX_CACHE_DIR": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", code], env=os.environ | found, stdout=pipe, stderr=pipe, text=True)


def end(process: subprocess.Popen[str]) -> tuple[list[float], set[str], list[str]]:
    """Return the results of a process, which kernels it compiled, and what else it said."""
    out, err = process.communicate()
    assert process.returncode == 0, err
    counts = [line.split() for line in err.splitlines() if len(line.split()) == 2]
    said = [line for line in err.splitlines() if line.startswith("hyperflex: ") and "compiling" not in line]
    return [float(x) for x in out.split()], {name for name, misses in counts if int(misses)}, said


def run(package: Path, root: Path, code: str = ASK) -> tuple[list[float], set[str]]:
    """Return the results, and which kernels were compiled, of a process that says nothing else."""
    numbers, compiled, said = end(start(package, root, code))
    assert said == []
    return numbers, compiled


@pytest.mark.nightly
def test_an_edit_recompiles_also_what_calls_the_edited_kernel(package, root):
    leaf = package / "part" / "leaf.py"
    assert run(package, root) == NONE
    leaf.write_text(LEAF.replace("2.0", "5.0"))
    assert run(package, root) == ([16.0, 9.0, 15.0], {"shifted", "squared", "scaled"})
    leaf.write_text(LEAF)  # another checkout with the sources of before: both share the cache
    assert run(package, root) == NONE


@pytest.mark.nightly
def test_what_is_reported_on_compiling_goes_by_what_is_there(package, tmp_path):
    def told():
        err = start(package, tmp_path / "cache").communicate()[1]
        return [line for line in err.splitlines() if line.startswith("hyperflex: compiling")]

    [first] = told()
    assert "for a first simulation" in first
    for file in (tmp_path / "cache").rglob("*squared-*.nbc"):
        file.unlink()
    [one] = told()
    assert "2 of the 3 loaded were compiled before" in one
    assert "first simulation" not in one
    assert told() == []


FULL = """
import errno, os
from pathlib import Path
def full(*_): raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
Path.replace = full
"""


def test_a_bit_that_flipped_anywhere_and_a_file_of_another_kernel_are_noticed(package, root):
    wrong, right = (next(root.rglob(f"*.{name}-door*.nbc")) for name in ("squared", "scaled"))
    other = wrong.read_bytes()
    places = itertools.cycle([0.0, 0.001, 0.005, 0.5, 1.0])  # in the checksum, the key, what was compiled
    for file, place in zip(sorted(root.rglob("*.nbc")), places, strict=False):
        content = bytearray(file.read_bytes())
        content[int(place * (len(content) - 1))] ^= 1 << 3
        file.write_bytes(content)
    right.write_bytes(other)
    numbers, compiled, said = end(start(package, root))
    assert (numbers, compiled) == ALL
    assert len(said) == 1


READ_ONLY = """
import errno, os
made, low = os.mkdir, os.open
def mkdir(path, *given, **named):
    if "cache" in str(path) and not os.path.isdir(path): raise OSError(errno.EROFS, os.strerror(errno.EROFS))
    return made(path, *given, **named)
def low_open(path, flags, *given, **named):
    if "cache" in str(path) and flags & (os.O_WRONLY | os.O_RDWR): raise OSError(errno.EROFS, os.strerror(errno.EROFS))
    return low(path, flags, *given, **named)
os.mkdir, os.open = mkdir, low_open
"""


@pytest.mark.nightly
def test_a_filled_cache_on_a_read_only_disk_is_used(package, root, tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    assert run(package, root, READ_ONLY + ASK) == NONE
    for file in root.rglob("*scaled-*.nbc"):
        file.unlink()
    numbers, compiled, said = end(start(package, root, READ_ONLY + ASK))
    assert numbers == ALL[0]
    assert "scaled" in compiled
    assert len(said) == 1
    assert "Read-only file system" in said[0]
    assert list(temporary.iterdir()) == []


def test_a_cache_that_is_removed_at_work_is_made_again(package, root):
    remove = f"import shutil; shutil.rmtree({str(root)!r})"
    lines = ASK.replace("\nprint", f"\ncaller.shifted(3.0); {remove}\nprint", 1)
    assert run(package, root, lines) == (ALL[0], {"squared", "scaled"})
    assert run(package, root) == (ALL[0], {"shifted"})


@pytest.mark.parametrize("what", ["a file where a folder should be", "full"])
def test_where_nothing_can_be_kept_it_is_reported_once(package, tmp_path, what):
    root = tmp_path / "cache"
    if what == "full":
        root.mkdir()
    else:
        root.write_text("not a folder")
    numbers, compiled, said = end(start(package, root, FULL + ASK if what == "full" else ASK))
    assert (numbers, compiled) == ALL
    assert len(said) == 1
    assert "HYPERFLEX_CACHE_DIR" in said[0]
    assert list(tmp_path.rglob("*.part")) == []


@pytest.mark.nightly
def test_several_processes_may_fill_one_cache(package, tmp_path):
    root = tmp_path / "cache"
    for process in [start(package, root) for _ in range(4)]:
        assert end(process)[0] == ALL[0]
    assert run(package, root) == NONE


def test_importing_makes_no_folder(tmp_path):
    code = "import hyperflex, hyperflex.simulation, hyperflex.planning, hyperflex.identification"
    found = {"HYPERFLEX_CACHE_DIR": str(tmp_path / "cache")}
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | found)
    assert list(tmp_path.iterdir()) == []


def test_a_home_is_written_out_and_a_relative_cache_folder_is_none(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("HYPERFLEX_CACHE_DIR", "~/kernels")
    assert cache.folder() == tmp_path / "kernels"
    monkeypatch.delenv("HYPERFLEX_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", "caches")  # the XDG specification: relative paths are to be ignored
    assert cache.folder() == tmp_path / ".cache" / "hyperflex"


def test_a_user_without_a_home_compiles_each_time(monkeypatch, capsys, tmp_path):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("HYPERFLEX_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    cache._complain.cache_clear()
    cache.save("scaled", "key", b"code")
    assert "no home folder" in capsys.readouterr().err
    assert cache.load("scaled", "key") is None
    cache._complain.cache_clear()
