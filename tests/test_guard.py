"""No test of this suite is one that never runs or cannot fail."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
OTHERS = ("autouse", "implements", "abstractmethod")  # decorated so, a function is called by others than the suite
Function = ast.FunctionDef | ast.AsyncFunctionDef
Trees = dict[str, ast.Module]


def dotted(node: ast.AST) -> str:
    """Return "a.b.c" for a name or attribute, also under a call; "" for anything else."""
    if isinstance(node, ast.Call):
        return dotted(node.func)
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


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


def never_run(trees: Trees) -> Iterator[str]:
    """Yield tests where pytest does not look, those switched off, and functions that nothing names."""
    used: Counter[str] = Counter()
    for path, tree in trees.items():
        collected = tree.body if Path(path).name.startswith("test_") else []
        for node in ast.walk(tree):
            if isinstance(node, ast.Name | ast.Attribute):
                used[node.id if isinstance(node, ast.Name) else node.attr] += 1
            elif isinstance(node, ast.arg):
                used[node.arg] += 1
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                used[node.value] += 1
            if isinstance(node, ast.Attribute) and dotted(node).endswith(("mark.skip", "mark.xfail", ".__test__")):
                yield f"{path}:{node.lineno}: {dotted(node)} switches a test off"
            named = isinstance(node, Function | ast.ClassDef) and node.name.lower().startswith("test")
            if named and node not in collected:
                yield f"{path}:{node.lineno}: {node.name} is never collected (wrong file, class or nesting)"
    for path, tree in trees.items():
        for node in [d for s in ast.walk(tree) if isinstance(s, ast.Module | ast.ClassDef) for d in s.body]:
            if not isinstance(node, Function) or node.name.startswith(("test", "pytest_", "__")) or used[node.name]:
                continue
            if not any(word in ast.dump(each) for each in node.decorator_list for word in OTHERS):
                yield f"{path}:{node.lineno}: {node.name} is called by nothing (a misspelt test?)"


def faults(trees: Trees) -> list[str]:
    """Return one line for each test that never runs, or could never fail."""
    functions = [n for t in trees.values() for n in ast.walk(t) if isinstance(n, Function)]
    helpers: set[str] = set()
    while more := {f.name for f in functions if f.name not in helpers and checks_something(f, helpers)}:
        helpers |= more
    helpers = {name for name in helpers if not name.startswith("test")}
    tests = [(path, each) for path, tree in trees.items() for each in tree.body if isinstance(each, Function)]
    idle = [
        (path, each) for path, each in tests if each.name.startswith("test") and not checks_something(each, helpers)
    ]
    return [*never_run(trees), *(f"{path}:{each.lineno}: {each.name} checks nothing" for path, each in idle)]


def test_every_test_of_the_suite_can_run_and_can_fail():
    assert faults({str(path): ast.parse(path.read_text("utf-8")) for path in sorted(HERE.rglob("*.py"))}) == []
