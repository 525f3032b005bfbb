"""A page for a browser on this machine that shows pictures as they come (MJPEG)."""

import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler

from hyperflex.local_page import OPEN, LocalServer, send, send_head
from hyperflex.vision import Image

_PAGE = (
    '<!doctype html><meta charset="utf-8"><title>hyperflex watch</title>'
    '<body style="margin:0;background:#222"><img src="stream" alt="the rope" style="max-width:100%;display:block">'
)


class PicturePage(LocalServer):
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
    Call :meth:`show` only while the page is `watched`: it encodes the picture.
    """

    def __init__(self, port: int = 0) -> None:
        super().__init__(port)
        self._condition = threading.Condition()
        self._jpeg, self._number, self._watching = b"", 0, 0
        self.start()

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

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer with the page or the stream of its pictures."""
        if request.path == "/":
            send(request, _PAGE, "text/html")
        elif request.path != "/stream":
            request.send_error(HTTPStatus.NOT_FOUND)
        else:
            with self._condition:
                self._watching += 1
            try:
                self._stream(request)
            finally:
                with self._condition:
                    self._watching -= 1

    def _stream(self, request: BaseHTTPRequestHandler) -> None:
        """Send pictures until the browser or the page closes."""
        send_head(request, "multipart/x-mixed-replace; boundary=picture")
        last = 0
        while not self.closed.is_set():
            with self._condition:
                if self._number == last:
                    self._condition.wait(OPEN)
                last, coded = self._number, self._jpeg
            if coded:
                head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(coded)}\r\n\r\n"
                request.wfile.write(head.encode() + coded + b"\r\n")
