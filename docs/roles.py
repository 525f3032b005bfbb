"""MkDocs hook: roles of docstrings become names, empty descriptions lose their dash, options stay in one line."""

import re

ROLE = re.compile(r":(?:class|func|meth|mod|attr|exc|data):<code>~?(?:[\w.]*\.)?(\w+)</code>")

CODE, OPTION = re.compile(r"(?<!</span>)<code>([^<]*)</code>"), re.compile(r"(?<![\w-])(--?[a-z][\w-]*|\de-\d)")
EMPTY = re.compile(r"\s+–\s+(?=<div class=\"doc-md-description\">\s*</div>)")


def on_page_content(html: str, **_: object) -> str:
    """Replace every role by the last part of the name that it points to; take dashes away that nothing follows.

    Options of the command line are kept from being broken at their dashes.
    """
    html = EMPTY.sub("", ROLE.sub(r"<code>\1</code>", html))
    return CODE.sub(lambda each: f"<code>{OPTION.sub(_unbroken, each[1])}</code>", html)


def _unbroken(option: re.Match[str]) -> str:
    return f'<span class="option">{option[1]}</span>'
