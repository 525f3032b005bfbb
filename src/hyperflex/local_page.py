"""Pages for browsers of this machine: where they listen, and who may ask for them."""

import os
from collections.abc import Collection
from urllib.parse import urlsplit

from hyperflex.errors import InvalidInput

HOST = "127.0.0.1"  # this machine alone


def own_names(port: int) -> set[str]:
    """Return the names, with the port, by which this machine asks for a page of its own."""
    return {f"{name}:{port}" for name in (HOST, "localhost")}


def address(port: int, host: str = HOST) -> str:
    """Return what to open in the browser for a server that listens at `host`."""
    return f"http://{HOST if host == '0.0.0.0' else host}:{port}/"


def may_ask(host: str | None, origin: str | None, names: Collection[str]) -> bool:
    """Whether Host and Origin of a request (None: it has none) are of `names`: no page from elsewhere may ask."""
    return host in names and (origin is None or urlsplit(origin).netloc in names)


def cannot_listen(port: int, error: OSError | OverflowError, host: str = HOST) -> InvalidInput:
    """Return the error of a place that cannot be listened at, to be raised."""
    code = error.errno or 0 if isinstance(error, OSError) else 0
    why = os.strerror(code).lower() if code > 0 else "the host is not known" if code else "there is no such port"
    allowed = "an address of this machine, and a free port up to 65535, or 0 for any"
    return InvalidInput(f"no page can be shown there: {why}", got=f"{host}, port {port}", allowed=allowed)
