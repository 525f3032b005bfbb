"""Rules of the project that no linter knows: documented names, light imports, few parameters, one-way imports."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

import hyperflex
from tests.names import code_names

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "hyperflex"
SOURCES = sorted(PACKAGE.rglob("*.py"))
HEAVY = {"xarray", "pandas", "matplotlib", "PIL", "h5netcdf", "h5py", "rich", "typer", "jinja2", "cv2", "av"}
HEAVY |= {
    "gymnasium",
    "scipy.linalg",
    "scipy.sparse",
    "scipy.optimize",
    "scipy.interpolate",
}  # of scipy itself numba loads the shell
PRIVATE = re.compile(
    r"/(work|farm|root|home|Users)/\w|/tmp/\w|files[.]pythonhosted|pypi[.]org/simple|registry[.]npmjs|deb[.]debian"
)


def loaded_by(code: str) -> set[str]:
    """Return which heavy packages a fresh interpreter has loaded after running `code`."""
    ask = f"{code}\nimport sys; print(*sorted(set({sorted(HEAVY)!r}) & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def documented(obj: object) -> set[str]:
    """Return the names under Parameters (of a class also under Attributes) in a numpydoc docstring."""
    text = inspect.cleandoc(obj.__doc__ or "")
    titles = "(?:Other )?Parameters|Attributes" if inspect.isclass(obj) else "(?:Other )?Parameters"
    sections = re.findall(rf"^(?:{titles})\n-{{3,}}\n(.*?)(?=^\S[^\n]*\n-{{3,}}\n|\Z)", text, re.M | re.S)
    entries = re.findall(r"^(\S.*?)(?: : .*)?$", "\n".join(sections), re.M)
    return {name.strip(" *") for entry in entries for name in re.sub(r"\(.*?\)", "", entry).split(",")}


def undocumented(name: str, obj: object) -> list[str]:
    """Return the undocumented arguments; a method may name them in a separate sentence."""
    text = (obj.__doc__ or "") if "." in name else ""
    return sorted(a for a in arguments(obj) - documented(obj) if not re.search(rf"\b{a}\b", text))


def arguments(obj: object) -> set[str]:
    """Return the parameters of a function, or of a class's constructor; a protocol has none."""
    if getattr(obj, "_is_protocol", False):
        return set()
    return {name for name in inspect.signature(obj).parameters if name not in {"self", "cls"}}


def public_callables() -> dict[str, object]:
    """Return every public function and class, and every public method of those classes."""
    found: dict[str, object] = {}
    for name in hyperflex.__all__:
        obj = getattr(hyperflex, name)
        plain = inspect.isclass(obj) and issubclass(obj, BaseException) and "__init__" not in vars(obj)
        if callable(obj) and not plain:  # a plain exception takes a message, as all do
            found[name] = obj
        if inspect.isclass(obj) and not issubclass(obj, BaseException):
            members = inspect.getmembers_static(obj, lambda m: isinstance(m, classmethod | staticmethod) or callable(m))
            found |= {f"{name}.{m}": getattr(obj, m) for m, _ in members if not m.startswith("_")}
    return found


def tracked() -> list[Path]:
    """Return the files under version control (in a tree without one: everything that is source)."""
    run = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if run.returncode == 0:
        return [ROOT / name for name in run.stdout.decode().split("\0") if name]
    return [p for top in ("src", "tests", "docs") for p in (ROOT / top).rglob("*") if p.is_file()]


def test_every_argument_of_a_public_callable_is_documented():
    missing = {name: undocumented(name, obj) for name, obj in public_callables().items()}
    assert {name: names for name, names in missing.items() if names} == {}


def test_building_a_rope_and_a_motion_loads_nothing_heavy():
    code = "import hyperflex as hf; hf.Rope.uniform(2.0, 0.1, n_links=5, friction=0.0); hf.arm_swings(); hf.simulate"
    assert loaded_by(code) == set()


def test_tracked_files_name_no_machine_and_no_registry():
    found = []
    for path in tracked():
        for number, line in enumerate(path.read_bytes().decode("utf-8", "ignore").splitlines(), 1):
            if path.is_file() and PRIVATE.search(line) and path.suffix not in {".png", ".gif", ".nc", ".mp4"}:
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert found == []


def imports_of(path: Path) -> set[str]:
    """Return the modules that a module imports, also where only a type checker looks."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def test_imports_have_no_circle():
    """Packages' ``__init__`` files, which only export names, are omitted."""
    modules = {".".join(p.relative_to(ROOT / "src").with_suffix("").parts): p for p in SOURCES if p.stem != "__init__"}
    graph = {name: imports_of(path) & modules.keys() for name, path in modules.items()}
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as circle:
        pytest.fail(f"imports go in a circle: {' -> '.join(circle.args[1])}")


def test_packages_offer_what_can_be_loaded_and_no_module_hides_it():
    """``import package.name`` binds the module to the name under which the package offers something else."""
    for path in SOURCES:
        if path.name == "__init__.py":
            package = importlib.import_module(".".join(path.parent.relative_to(ROOT / "src").parts))
            offered = set(getattr(package, "__all__", ()))
            assert {name for name in offered if not hasattr(package, name)} == set(), path
            modules = {
                each.stem for each in path.parent.iterdir() if each.suffix == ".py" or (each / "__init__.py").exists()
            }
            assert offered & modules == set(), path


def test_every_dependency_is_pinned_once():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = list(project["dependencies"])
    for extra in re.findall(r"\w+", extras["dev"][0].partition("[")[2]):  # what make installs
        wanted += extras[extra]
    pins = re.findall(r"^([\w.-]+)==\S+$", (ROOT / "constraints.txt").read_text("utf-8"), re.M)
    names = [re.sub(r"[-_.]+", "-", pin).lower() for pin in pins]
    assert len(names) == len(set(names))
    needed = {re.split(r"[\[<>=!~ ;]", entry)[0].lower() for entry in wanted} - {"hyperflex"}
    assert needed <= set(names), needed - set(names)


def cross_room_imports(path: Path, source: str) -> list[str]:
    """Return a module's imports from inside another package; only `core` may be imported below its ``__init__``."""
    home, package = path.relative_to(PACKAGE).parts[0], "hyperflex."
    modules = [node.module or "" for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
    inner = [m.removeprefix(package).split(".") for m in modules if m.startswith(package) and m.count(".") > 1]
    return [".".join(parts) for parts in inner if parts[0] not in {home, "core"}]


def test_other_rooms_are_entered_by_their_init():
    others = [path for path in SOURCES if path != PACKAGE / "__init__.py"]  # which lists where each public name is
    found = {path.relative_to(PACKAGE).as_posix(): cross_room_imports(path, path.read_text("utf-8")) for path in others}
    assert {name: inside for name, inside in found.items() if inside} == {}


def test_public_functions_take_at_most_ten_parameters():
    functions = {name: obj for name, obj in public_callables().items() if not inspect.isclass(obj)}  # which has fields
    assert {name: len(arguments(obj)) for name, obj in functions.items() if len(arguments(obj)) > 10} == {}


def stale_names(source: str, known: set[str]) -> list[str]:
    """Return what docstrings put between double backticks, or refer to, that is no name of the code."""
    quoted = re.findall(r"``([A-Za-z]\w*[A-Za-z0-9](?:\.\w+)*)(?:\([^`]*\))?``", source)
    quoted += re.findall(r":(?:func|class|mod|meth|data|attr):`~?([\w.]+)`", source)
    return sorted({name for name in quoted if not set(name.split(".")) <= known})


def test_docstrings_name_what_is_there():
    known = code_names() | {p.stem for p in SOURCES} | {p.parent.name for p in SOURCES}
    known |= {"vdivpd", "numba", "njit"}  # an instruction; numba's decorator
    known |= {"link_length", "link_mass"}  # keys that are put together from two words
    found = {p.relative_to(PACKAGE).as_posix(): stale_names(p.read_text("utf-8"), known) for p in SOURCES}
    assert {name: stale for name, stale in found.items() if stale} == {}
    assert stale_names('"""See :func:`no_such_name` and ``simulate``."""', known) == ["no_such_name"]


def types_of(annotation: object) -> set[type]:
    """Return the classes of this package in a type hint."""
    own = {annotation} if inspect.isclass(annotation) and annotation.__module__.startswith("hyperflex") else set()
    return own.union(*(types_of(part) for part in get_args(annotation)))


def test_types_that_public_calls_take_and_return_are_public():
    """Each is offered by `hyperflex` itself or by its room, as ``hyperflex.planning.CastOutcome`` is."""
    hidden: dict[str, list[str]] = {}
    for name, obj in public_callables().items():
        for kind in set().union(*(types_of(hint) for hint in hints_of(obj).values())):
            room = importlib.import_module(".".join(kind.__module__.split(".")[:2]))
            if room.__name__ == "hyperflex.core":  # what kernels are given, by Rope.chain and the like
                continue
            if kind.__name__ not in hyperflex.__all__ and getattr(room, kind.__name__, None) is not kind:
                hidden.setdefault(f"{kind.__module__}.{kind.__name__}", []).append(name)
    assert hidden == {}


def hints_of(obj: object) -> dict[str, Any]:
    """Return type hints without names that only type checkers import."""
    try:
        return get_type_hints(obj)
    except NameError:
        return {}
