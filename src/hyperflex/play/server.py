"""The server of the page: HTTP for the page itself, a websocket for frames and commands."""

import asyncio
import contextlib
import json
import threading
import traceback
import weakref
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hyperflex import checks
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.local_page import HOST, address, cannot_listen, may_ask, own_names
from hyperflex.play.controls import CONTROLS
from hyperflex.play.folder import Folder
from hyperflex.play.runner import Runner
from hyperflex.play.session import NUMBERS, Session
from hyperflex.report import render

_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; "
    "frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)


class PlayServer:
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
        for each in allow:
            if urlsplit(f"//{each}").netloc != each:
                fix = "Leave out http:// and what follows the port"
                raise InvalidInput("allow is no host", got=each, allowed="host:port, as in robot.lan:8080", fix=fix)
        self.folder, self._news = folder, set[asyncio.Event]()
        self._place, self._allow = (host, port), set(allow)
        self._loop, self._end = asyncio.new_event_loop(), asyncio.Event()
        self._problem: OSError | OverflowError | None = None
        self._ready = threading.Event()
        self.port, self.runner = 0, Runner(session or Session(), self._notify)
        self._thread = threading.Thread(target=self._serve, name="hyperflex play server", daemon=True)
        self._thread.start()
        self._ready.wait(30.0)
        if self._problem:
            self.close()
            raise cannot_listen(port, self._problem, host)
        self._allow |= own_names(self.port)
        self.address = address(self.port, host)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End server, session and planning."""
        with contextlib.suppress(RuntimeError):  # the loop is over
            self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()
        self.runner.close()

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the server ends, or for a time, s."""
        self._thread.join(seconds)

    def _serve(self) -> None:
        try:
            self._loop.run_until_complete(self._listen())
        finally:
            self._ready.set()
            self._loop.close()

    async def _listen(self) -> None:
        host, port = self._place
        connections = weakref.WeakSet[ServerConnection]()

        class Connection(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                connections.add(self)

        try:
            server = await serve(
                self._talk,
                host,
                port,
                process_request=self._answer,
                create_connection=Connection,
                open_timeout=120.0,  # s, in which a page of a saved run is made
                compression=None,
                max_size=1 << 16,  # bytes of a message to the server
            )
        except (OSError, OverflowError) as error:
            self._problem = error
            return
        self.port = int(next(iter(server.sockets)).getsockname()[1])
        self._ready.set()
        await self._end.wait()
        server.close()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), 1.0)
        for connection in connections:  # browsers open some and send nothing
            connection.transport.abort()
        left = asyncio.all_tasks() - {asyncio.current_task()}
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)

    def _notify(self) -> None:
        """Wake all senders; called from the runner's thread."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        for each in self._news:
            each.set()

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a page; None lets a websocket be opened."""
        if not may_ask(request.headers.get("Host"), request.headers.get("Origin"), self._allow):
            return _response(HTTPStatus.FORBIDDEN, "Pages of this address, or from there, are not answered.", "plain")
        url = urlsplit(request.path)
        if url.path == "/socket":
            return None
        if url.path == "/":
            return _response(HTTPStatus.OK, page())
        if url.path == "/view":
            try:
                name, rope = (parse_qs(url.query).get(each, [""])[0] for each in ("name", "rope"))
                return _response(HTTPStatus.OK, await asyncio.to_thread(self.folder.page, name, rope))
            except HyperflexError as error:
                return _response(HTTPStatus.NOT_FOUND, str(error), "plain")
        return _response(HTTPStatus.NOT_FOUND, "There is no such page.", "plain")

    async def _talk(self, connection: ServerConnection) -> None:
        """Send frames to a page, and carry out its commands, until one of both closes the connection."""
        news = asyncio.Event()
        news.set()
        self._news.add(news)
        self.runner.watched = True
        sender = asyncio.create_task(self._send(connection, news))
        try:
            with contextlib.suppress(ConnectionClosed):
                async for message in connection:
                    await connection.send(json.dumps(await self._obey(message)))
        finally:
            sender.cancel()
            self._news.discard(news)
            self.runner.watched = bool(self._news)

    async def _send(self, connection: ServerConnection, news: asyncio.Event) -> None:
        """Send the newest scene and frame whenever the last ones were sent: a slow page gets fewer."""
        version: tuple[int, int] | None = None
        number = -1
        with contextlib.suppress(ConnectionClosed):
            while True:
                await news.wait()
                news.clear()
                if self._version() != version:
                    version, scene = await self._call(lambda: (self._version(), self.runner.scene()))
                    await connection.send(json.dumps({"scene": scene}))
                if self.runner.number != number:
                    number = self.runner.number
                    await connection.send(self.runner.frame)

    def _version(self) -> tuple[int, int]:
        return self.runner.version, self.runner.session.version

    async def _call(self, action: Any) -> Any:
        return await asyncio.wrap_future(self.runner.call(action))

    async def _obey(self, message: str | bytes) -> dict[str, Any]:
        """Carry out the command of a message; return the answer, with its number."""
        number: object = None
        try:
            command = checks.mapping("the message", json.loads(message))
            number = command.get("id")
            return {"id": number, **await self._do(command)}
        except (HyperflexError, ValueError, RecursionError) as error:
            return {"id": number, "error": str(error)}
        except Exception as error:  # noqa: BLE001 last resort: the connection is to stay
            traceback.print_exc()
            return {"id": number, "error": f"This is a bug in hyperflex: {error}"}

    async def _do(self, command: Any) -> dict[str, Any]:
        """Carry out a command: ``button``, values to ``set``, a file to ``open`` or ``save``, or ``files`` to list."""
        session, runner = self.runner.session, self.runner
        if "set" in command:
            values = checks.mapping("set", command["set"])
            await self._call(lambda: runner.change(values))
        elif "button" in command:
            await self._call(lambda: runner.act(str(command["button"])))
        elif "open" in command:
            name = checks.text("open", command["open"])
            opened = await asyncio.to_thread(lambda: (self.folder.setup(name), self.folder.limits(name)))
            await self._call(lambda: runner.open(*opened))
        elif "save" in command:
            recorded, plan = await self._call(lambda: (session.recorded(), runner.plan))
            name = checks.text("save", command["save"])
            return {"saved": await asyncio.to_thread(self.folder.save, name, recorded, plan)}
        elif "files" in command:
            return {"files": await asyncio.to_thread(self.folder.names)}
        else:
            raise InvalidInput(
                "the message has no command", got=list(command), allowed="set, button, open, save, files"
            )
        return {}


def page() -> str:
    """Return the page: one HTML document that requires only the websocket."""
    groups: dict[str, list[tuple[str, dict[str, object]]]] = {}
    for name, each in CONTROLS.items():
        groups.setdefault(each.group, []).append((name, each._asdict()))
    return render("play.html", room="hyperflex.play", groups=groups, numbers=NUMBERS)


def _response(status: HTTPStatus, text: str, kind: str = "html") -> Response:
    body = text.encode()
    headers = {
        "Content-Type": f"text/{kind}; charset=utf-8",
        "Content-Length": str(len(body)),
        "Content-Security-Policy": _SECURITY,
        "Cache-Control": "no-store",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Connection": "close",
    }
    return Response(status.value, status.phrase, Headers(headers), body)
