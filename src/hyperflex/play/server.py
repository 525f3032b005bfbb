"""The server of the page: the page itself, a stream of frames and scenes to it, and its commands."""

import base64
import json
import traceback
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import parse_qs, urlsplit

from hyperflex import checks
from hyperflex.checks import ByName
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.local_page import HOST, OPEN, LocalServer, send, send_head
from hyperflex.play.controls import CONTROLS
from hyperflex.play.folder import Folder
from hyperflex.play.runner import Runner
from hyperflex.play.session import NUMBERS, Session
from hyperflex.report import render


class PlayServer(LocalServer):
    """Serves the page from a separate thread until it is closed.

    Parameters
    ----------
    folder : Folder
        What the page may read from and write to.
    session : Session, optional
    port : int
        0 selects a free port; see `address`.
    host : str
        Address to listen at.
    allow : sequence of str
        Hosts, as ``name:port``, accepted in requests in addition to this machine's own names.

    Attributes
    ----------
    address : str
        Address to open in the browser.

    Raises
    ------
    InvalidInput
        If the server cannot listen there, or `allow` contains more than host names.
    """

    def __init__(
        self,
        folder: Folder,
        session: Session | None = None,
        *,
        port: int = 0,
        host: str = HOST,
        allow: Sequence[str] = (),
    ) -> None:
        super().__init__(port, host, allow)
        self.folder, self.runner = folder, Runner(session or Session())
        self.start()

    def close(self) -> None:
        """End server, session and planning."""
        super().close()
        self.runner.close()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer with a page, a page of the folder, the stream, or the result of a command."""
        url, size = urlsplit(request.path), request.headers.get("Content-Length", "")
        if request.command == "POST" and size.isdecimal() and int(size) <= 1 << 16:  # bytes
            send(request, json.dumps(self._obey(request.rfile.read(int(size)))), "application/json")
        elif request.command == "POST":
            request.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        elif url.path == "/":
            send(request, page(), "text/html")
        elif url.path == "/stream":
            self._stream(request)
        elif url.path == "/view":
            try:
                name, rope = (parse_qs(url.query).get(each, [""])[0] for each in ("name", "rope"))
                send(request, self.folder.page(name, rope), "text/html")
            except HyperflexError as error:
                send(request, str(error), "text/plain", HTTPStatus.NOT_FOUND)
        else:
            request.send_error(HTTPStatus.NOT_FOUND)

    def _stream(self, request: BaseHTTPRequestHandler) -> None:
        """Send the newest scene and frame whenever the last ones were sent: a slow page gets fewer."""
        runner, version, number = self.runner, -1, -1
        with runner.news:
            runner.watchers += 1
        try:
            send_head(request, "text/event-stream")
            while not self.closed.is_set():
                events = ":\n\n"  # a comment: writing it fails once the page is closed
                with runner.news:
                    if (runner.version, runner.number) == (version, number):
                        runner.news.wait(OPEN)
                    if runner.version != version:
                        events += f"data: {json.dumps(runner.scene())}\n\n"
                    if runner.number != number:
                        events += f"event: frame\ndata: {base64.b64encode(runner.frame).decode('ascii')}\n\n"
                    version, number = runner.version, runner.number
                request.wfile.write(events.encode())
        finally:
            with runner.news:
                runner.watchers -= 1

    def _obey(self, message: bytes) -> ByName:
        """Execute the command of a message; return the answer."""
        try:
            return self._do(checks.mapping("the message", json.loads(message)))
        except (HyperflexError, ValueError, RecursionError) as error:
            return {"error": str(error)}
        except Exception as error:  # noqa: BLE001 last resort: the page must stay usable
            traceback.print_exc()
            return {"error": f"This is a bug in hyperflex: {error}"}

    def _do(self, command: Any) -> ByName:
        """Execute a command: ``button``, values to ``set``, a file to ``open`` or ``save``, or ``files`` to list."""
        runner = self.runner
        match command:
            case {"files": _}:
                return {"files": self.folder.names()}
            case {"save": name}:
                with runner.news:
                    recorded, plan = runner.session.recorded(), runner.plan
                return {"saved": self.folder.save(checks.text("save", name), recorded, plan)}
            case {"open": name}:
                runner.open(self.folder.opened(checks.text("open", name)))
            case {"set": values}:
                runner.change(checks.mapping("set", values))
            case {"button": name}:
                runner.act(str(name))
            case _:
                raise InvalidInput(
                    "the message has no command", got=list(command), allowed="set, button, open, save, files"
                )
        return {}


def page() -> str:
    """Return the page: one HTML document that needs no other file."""
    groups: dict[str, list[tuple[str, dict[str, object]]]] = {}
    for name, each in CONTROLS.items():
        groups.setdefault(each.group, []).append((name, each._asdict()))
    return render("play.html", room="hyperflex.play", groups=groups, numbers=NUMBERS)
