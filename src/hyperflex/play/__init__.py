"""A live page in the browser to swing a rope, plan and cast."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.play.controls import Settings
    from hyperflex.play.folder import Folder, read_opened
    from hyperflex.play.server import PlayServer
    from hyperflex.play.session import Session

__getattr__, __dir__, __all__ = attach(__name__, __file__)
