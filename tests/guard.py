"""Find tests that never run: what looks like a test, or helps one, and yet is never called by anything."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef


def modules(root: Path) -> dict[Path, ast.Module]:
    """Return the syntax tree of every Python file below `root`."""
    return {path: ast.parse(path.read_text("utf-8"), str(path)) for path in sorted(root.rglob("*.py"))}


def collected_file(path: Path) -> bool:
    """Whether pytest collects the file (``python_files`` is left at ``test_*.py``)."""
    return path.name.startswith("test_")


def collected_tests(tree: ast.Module) -> list[Function]:
    """Return the functions that pytest would collect from a test file: top level, or methods of a Test class."""
    scopes = [tree, *(d for d in tree.body if isinstance(d, ast.ClassDef) and d.name.startswith("Test"))]
    return [d for s in scopes for d in s.body if isinstance(d, Function) and d.name.startswith("test")]


def dotted(node: ast.AST) -> str:
    """Return "a.b.c" for a name or attribute, also under a call; "" for anything else."""
    if isinstance(node, ast.Call):
        return dotted(node.func)
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def uncollected(path: Path, tree: ast.Module) -> Iterator[str]:
    """Yield what looks like a test but stands where pytest does not look."""
    collected = {id(f) for f in collected_tests(tree)} if collected_file(path) else set()
    for node in ast.walk(tree):
        if isinstance(node, Function) and node.name.startswith("test") and id(node) not in collected:
            yield f"{path}:{node.lineno}: {node.name} is never collected (wrong file, class or nesting)"
        if isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
            if any(isinstance(d, Function) and d.name == "__init__" for d in node.body):
                yield f"{path}:{node.lineno}: {node.name} has an __init__, so pytest passes it by"
            if not any(id(d) in collected for d in node.body):
                yield f"{path}:{node.lineno}: {node.name} holds no test"
        if isinstance(node, ast.Assign) and any(dotted(t).endswith("__test__") for t in node.targets):
            yield f"{path}:{node.lineno}: __test__ switches tests off"


def shadowed(path: Path, tree: ast.Module) -> Iterator[str]:
    """Yield definitions that a later one of the same name replaces."""
    for scope in [tree, *(n for n in ast.walk(tree) if isinstance(n, ast.ClassDef))]:
        names = Counter(d.name for d in scope.body if isinstance(d, Definition) and not d.decorator_list)
        names.update({d.name for d in scope.body if isinstance(d, Definition) and d.decorator_list})
        for name, times in names.items():
            if times > 1:
                yield f"{path}: {name} is defined {times} times, only the last one runs"


def switched_off(path: Path, tree: ast.Module) -> Iterator[str]:
    """Yield marks that skip a test for good, or expect it to fail."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and dotted(node).endswith(("mark.skip", "mark.xfail")):
            yield f"{path}:{node.lineno}: {dotted(node)} switches a test off"


def unused(trees: dict[Path, ast.Module]) -> Iterator[str]:
    """Yield functions of the suite that are neither tests nor hooks and that nothing names: misspelt tests."""
    used: Counter[str] = Counter()
    for tree in trees.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Name | ast.Attribute):
                used[node.id if isinstance(node, ast.Name) else node.attr] += 1
            elif isinstance(node, ast.arg):
                used[node.arg] += 1
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                used[node.value] += 1
    for path, tree in trees.items():
        for node in [d for s in ast.walk(tree) if isinstance(s, ast.Module | ast.ClassDef) for d in s.body]:
            if not isinstance(node, Function) or node.name.startswith(("test", "pytest_", "__")) or used[node.name]:
                continue
            told = ("autouse", "implements", "abstractmethod")  # called by others than the suite
            if not any(word in ast.dump(d) for d in node.decorator_list for word in told):
                yield f"{path}:{node.lineno}: {node.name} is called by nothing (a misspelt test?)"


def checks_something(node: ast.AST, helpers: set[str]) -> bool:
    """Whether the body can fail on purpose: a real assert, pytest.raises and kin, or a helper that does."""
    for part in ast.walk(node):
        if isinstance(part, ast.Assert) and not isinstance(part.test, ast.Constant | ast.Tuple | ast.JoinedStr):
            return True
        if isinstance(part, ast.Call):
            last = dotted(part).rpartition(".")[2]
            if last.startswith("assert_") or last in {"raises", "warns", "fail"} or last in helpers:
                return True
    return False


def asserting_helpers(trees: dict[Path, ast.Module]) -> set[str]:
    """Return the names of the suite's functions that check something, directly or through one another."""
    functions = [n for t in trees.values() for n in ast.walk(t) if isinstance(n, Function)]
    helpers: set[str] = set()
    while more := {f.name for f in functions if f.name not in helpers and checks_something(f, helpers)}:
        helpers |= more
    return helpers


def faults(trees: dict[Path, ast.Module]) -> list[str]:
    """Return one line for each test that never runs, or could never fail."""
    found = list(unused(trees))
    helpers = {h for h in asserting_helpers(trees) if not h.startswith("test")}
    for path, tree in trees.items():
        found += [*uncollected(path, tree), *shadowed(path, tree), *switched_off(path, tree)]
        if collected_file(path):
            found += [
                f"{path}:{test.lineno}: {test.name} checks nothing"
                for test in collected_tests(tree)
                if not checks_something(test, helpers)
            ]
    return found
