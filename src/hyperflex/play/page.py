"""The page itself: one HTML document with its script and style, which asks for nothing but the websocket."""

from hyperflex.play.controls import CONTROLS
from hyperflex.play.session import NUMBERS
from hyperflex.report import render


def page() -> str:
    """Return the page."""
    groups: dict[str, list[tuple[str, dict[str, object]]]] = {}
    for name, each in CONTROLS.items():
        groups.setdefault(each.group, []).append((name, each._asdict()))
    return render("play.html", room="hyperflex.play", groups=groups, numbers=NUMBERS)
