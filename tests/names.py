"""The names that the sources use."""

import functools
import io
import re
import tokenize
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "src" / "hyperflex"


@functools.cache
def code_names() -> frozenset[str]:
    """Return every name in the sources' code, also as a whole string: words in comments and docstrings do not count."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for token in tokenize.generate_tokens(io.StringIO(path.read_text("utf-8")).readline):
            if token.type == tokenize.NAME:
                found.add(token.string)
            elif token.type == tokenize.STRING and re.fullmatch(r"[\"']\w+[\"']", token.string):
                found.add(token.string[1:-1])
    return frozenset(found)
