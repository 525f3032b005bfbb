"""MkDocs hook: docstrings name other objects by Sphinx's roles; on the pages the name alone stays."""

from __future__ import annotations

import re

ROLE = re.compile(r":(?:class|func|meth|mod|attr|exc|data):<code>~?(?:[\w.]*\.)?(\w+)</code>")


def on_page_content(html: str, **_: object) -> str:
    """Replace every role by the last part of the name that it points to."""
    return ROLE.sub(r"<code>\1</code>", html)
