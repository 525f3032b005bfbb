"""A page in the browser to swing, cast and look, live; it needs ``pip install 'hyperflex[viewer]'``."""

import importlib.util
from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.play.controls import CONTROLS, Control, Settings
    from hyperflex.play.folder import Folder
    from hyperflex.play.runner import Runner
    from hyperflex.play.server import PlayServer
    from hyperflex.play.session import Session

if importlib.util.find_spec("websockets") is None:
    raise ImportError("hyperflex.play needs websockets: pip install 'hyperflex[viewer]'")
__getattr__, __dir__, __all__ = attach(__name__, __file__)
