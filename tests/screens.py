"""Pictures of pages, compared with those that were looked at: what browser tests share."""

import os
from pathlib import Path

import numpy as np
from PIL import Image

from tests.browser import Browser

MOST = 0.02  # part of the pixels that may differ
DIFFERENT = 32  # of 255, in any colour: more than what smoothing of edges and letters makes of a half pixel
FOLDER = Path(__file__).parent / "screens"
ACCEPT = "HYPERFLEX_ACCEPT_SCREENS"


def compare(browser: Browser, name: str, seen: Path) -> None:
    """Compare the content of the window with ``screens/<name>.png``; it is saved at `seen`.

    With $HYPERFLEX_ACCEPT_SCREENS set it replaces the file, to be checked.
    """
    browser.screenshot(seen)
    with Image.open(seen) as picture:
        small = picture.convert("RGB").reduce(2)
    small.save(seen)
    known = FOLDER / f"{name}.png"
    if os.environ.get(ACCEPT):
        FOLDER.mkdir(exist_ok=True)
        small.quantize(128).save(known, optimize=True)
    with Image.open(known) as picture:
        wanted = picture.convert("RGB")
    assert small.size == wanted.size
    far = np.abs(np.asarray(small, int) - np.asarray(wanted, int)).max(axis=-1) > DIFFERENT
    part = float(far.mean())
    assert part <= MOST, f"{part:.1%} of the pixels differ from {known}: look at {seen}; {ACCEPT}=1 accepts it"
