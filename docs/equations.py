"""MkDocs hook: turn the pages' LaTeX into MathML while they are built, so that they need no script and no network."""

import html
import re

from latex2mathml.converter import convert

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.S)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.S)
TAG = re.compile(r"\\tag\{(.*?)\}")


def _inline(match: re.Match[str]) -> str:
    return convert(html.unescape(match[1]))


def _block(match: re.Match[str]) -> str:
    latex = html.unescape(match[1])
    tag = TAG.search(latex)
    math = convert(TAG.sub("", latex).strip(), display="block")
    if not tag:
        return f'<div class="equation">{math}</div>'
    anchor = "eq-" + tag[1].lower().replace(".", "-")
    return f'<div class="equation" id="{anchor}">{math}<span class="number">({tag[1]})</span></div>'


def on_page_content(content: str, **_: object) -> str:
    """Replace every equation that arithmatex marked."""
    return INLINE.sub(_inline, BLOCK.sub(_block, content))
