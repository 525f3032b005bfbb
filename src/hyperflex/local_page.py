"""Pages for browsers of this machine: a server, and who may ask it."""

import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Collection
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self
from urllib.parse import urlsplit

from hyperflex.errors import InvalidInput

HOST = "127.0.0.1"  # this machine alone
OPEN = 1.0  # s between two checks whether a page that gets nothing is still open
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src 'self' data:; connect-src 'self'; frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; "
    "form-action 'none'",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class LocalServer(ABC):
    """Answers browsers, each request in its own thread, until it is closed. Subclasses answer; `start` begins it.

    Parameters
    ----------
    port : int
        0 selects a free port; see `address`.
    host : str
        Address to listen at.
    allow : collection of str
        Hosts, as ``name:port``, accepted in requests in addition to this machine's own names.

    Attributes
    ----------
    address : str
        Address to open in the browser.
    closed : threading.Event

    Raises
    ------
    InvalidInput
        If the server cannot listen there, or `allow` contains more than host names.

    Notes
    -----
    Host and Origin of a request must be own or allowed names, so that no page from elsewhere reaches the server through
    the browser.
    """

    def __init__(self, port: int = 0, host: str = HOST, allow: Collection[str] = ()) -> None:
        for each in allow:
            if _authority(f"//{each}") != each:
                raise InvalidInput(
                    "allow is no host",
                    got=each,
                    allowed="host:port, as in robot.lan:8080",
                    fix="Omit http:// and everything after the port",
                )
        page = self

        class Handler(BaseHTTPRequestHandler):
            timeout = 30.0  # s, after which a connection that sends or takes nothing is closed

            def do_GET(self) -> None:
                hosts, origins = (self.headers.get_all(name, []) for name in ("Host", "Origin"))
                asked = [*hosts, *map(_authority, origins)]
                if len(hosts) != 1 or len(origins) > 1 or not page._names.issuperset(asked):
                    self.send_error(HTTPStatus.FORBIDDEN)
                elif _authority(self.path) is None:
                    self.send_error(HTTPStatus.BAD_REQUEST)
                else:
                    page.answer(self)

            do_POST = do_GET

            def log_message(self, *_: Any) -> None:
                """Do not print requests."""

        try:
            self._server = _Server((host, port), Handler)
        except (OSError, OverflowError) as error:
            why = str(error.strerror).lower() if isinstance(error, OSError) else "there is no such port"
            raise InvalidInput(
                f"no page can be shown there: {why}",
                got=f"{host}, port {port}",
                allowed="an address of this machine, and a free port up to 65535, or 0 for any",
            ) from None
        self.port = int(self._server.server_address[1])
        self.address = f"http://{HOST if host == '0.0.0.0' else host}:{self.port}/"
        self._names = {*allow, f"{HOST}:{self.port}", f"localhost:{self.port}"}
        self.closed = threading.Event()
        self._thread = threading.Thread(target=self._server.serve_forever, name="hyperflex page", daemon=True)

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    @abstractmethod
    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer a request that is permitted."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the server."""
        self.closed.set()
        self._server.shutdown()
        self._server.server_close()

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the server ends, or for a time, s."""
        self._thread.join(seconds)


class _Server(ThreadingHTTPServer):
    """A server that says nothing of browsers that went away, and does not wait for them."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print an error as a bug, unless the connection was lost."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


def _authority(url: str) -> str | None:
    """Return host and port of a URL, as ``name:port``; None if it is no URL."""
    try:
        return urlsplit(url).netloc
    except ValueError:
        return None


def send_head(request: BaseHTTPRequestHandler, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
    """Send the head of an answer whose content, of a media type, follows until the connection is closed."""
    request.send_response(status)
    for name, value in (_HEADERS | {"Content-Type": kind}).items():
        request.send_header(name, value)
    request.end_headers()


def send(request: BaseHTTPRequestHandler, text: str, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
    """Answer with a text of a media type."""
    send_head(request, f"{kind}; charset=utf-8", status)
    request.wfile.write(text.encode())
