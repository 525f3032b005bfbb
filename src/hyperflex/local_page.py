"""Pages for browsers of this machine: where they listen, and who may ask for them."""

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


def cannot_listen(port: int, reason: str) -> InvalidInput:
    """Return the error of a port that cannot be listened at, to be raised."""
    return InvalidInput("no page can be shown at this port", got=port, allowed="a free one, or 0 for any", fix=reason)
