"""A page for a browser on this machine that shows pictures as they come (MJPEG)."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

from hyperflex.local_page import HOST, address, cannot_listen, may_ask, own_names
from hyperflex.vision import Image

_WAIT = 1.0  # s between two checks whether the page is closed
_PAGE = (
    b'<!doctype html><meta charset="utf-8"><title>hyperflex watch</title>'
    b'<body style="margin:0;background:#222"><img src="stream" alt="the rope" style="max-width:100%;display:block">'
)


class PicturePage:
    """Serves the newest picture to browsers on this machine.

    Parameters
    ----------
    port : int
        0: any that is free; see `address`.

    Attributes
    ----------
    address : str
        What to open in the browser.

    Raises
    ------
    InvalidInput
        If the port is taken, or not allowed.

    Notes
    -----
    It listens on 127.0.0.1 and answers requests for that name alone, so that no page from elsewhere reaches it through
    the browser. Call :meth:`show` only while the page is `watched`: it encodes the picture.
    """

    def __init__(self, port: int = 0) -> None:
        self._condition = threading.Condition()
        self._jpeg, self._number, self._closed, self._watching = b"", 0, False, 0
        page = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.0"

            def do_GET(self) -> None:
                page._answer(self)

            def log_message(self, *_: Any) -> None:
                """Do not print requests."""

        try:
            self._server = ThreadingHTTPServer((HOST, port), Handler)
        except (OSError, OverflowError) as error:
            raise cannot_listen(port, error) from None
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        self.address = address(self.port)
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._server.shutdown()
        self._server.server_close()

    @property
    def watched(self) -> bool:
        """Whether a browser shows the page."""
        return self._watching > 0

    def show(self, image: Image) -> None:
        """Make a picture (height, width, 3), uint8, blue, green, red, the newest."""
        import cv2

        ok, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])
        if not ok:
            return
        with self._condition:
            self._jpeg, self._number = coded.tobytes(), self._number + 1
            self._condition.notify_all()

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        if not may_ask(request.headers.get("Host"), request.headers.get("Origin"), own_names(self.port)):
            request.send_error(403)
        elif request.path == "/":
            request.send_response(200)
            request.send_header("Content-Type", "text/html; charset=utf-8")
            request.end_headers()
            request.wfile.write(_PAGE)
        elif request.path == "/stream":
            self._stream(request)
        else:
            request.send_error(404)

    def _stream(self, request: BaseHTTPRequestHandler) -> None:
        """Send pictures until the browser or the page closes."""
        request.send_response(200)
        request.send_header("Content-Type", "multipart/x-mixed-replace; boundary=picture")
        request.send_header("Cache-Control", "no-store")
        request.end_headers()
        with self._condition:
            self._watching += 1
        last = 0
        try:
            while True:
                with self._condition:
                    if self._number == last:
                        self._condition.wait(_WAIT)
                    if self._closed:
                        return
                    last, coded = self._number, self._jpeg
                if coded:
                    head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(coded)}\r\n\r\n"
                    request.wfile.write(head.encode() + coded + b"\r\n")
        except OSError:  # the browser went away
            return
        finally:
            with self._condition:
                self._watching -= 1
