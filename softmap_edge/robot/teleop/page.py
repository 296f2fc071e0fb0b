"""The browser page: camera image, hand, finger and guard state; keyboard, mouse and enable key.

The page is served by `softmap_edge.web.server`. Anyone with the link can drive. One page drives at
a time, others watch; its key lapses as in `keys.HeldKey`.

Nothing is queued: a page receives the newest state after it has drawn the previous one. The page
echoes the number of each state, so the server knows the maximum age of a message, even if the
network delays all of them equally (`_Link`). A message that may be older than MAX_AGE does not hold
the enable key. Pinned by tests/robot/test_teleop_page.py.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import TeleopError
from softmap_edge.files.atomic import Document, finite
from softmap_edge.robot.teleop.keys import PRIORITY, Controls, HeldKey, Source, Wish
from softmap_edge.web.server import Server, Site

if TYPE_CHECKING:
    from websockets.sync.server import ServerConnection

Floats = NDArray[np.float64]
View = Callable[[], tuple[Document, Floats | None, tuple[int, NDArray[np.uint8]] | None]]

PORT = 8765
STATE_INTERVAL = 1 / 30  # s between two states sent to a page
MOST_PAGES = 8  # pages connected at a time
LONGEST = 2048  # bytes of a message from a page
MOST_UNAUTHENTICATED = 16  # connections without a token at a time; more are closed at once
TOKEN_WITHIN = 5.0  # s within which a connection must present its token
MAX_AGE = 0.25  # s: an older message does not hold the key
ECHOES = 64  # echoed states from which the offset of a page's clock is estimated
JPEG = 70  # JPEG quality, of 100: 25 kB per frame
FOLDER = "robot/teleop"
SERVED = {
    "/": "page.html",
    "/page.js": "page.js",
    "/page_drawing.js": "page_drawing.js",
    "/page.css": "page.css",
}
PICTURE, POINTS = 1, 2  # kinds of binary messages: kind, number, then a JPEG or float32 (N, 3) mm


class Page:
    """A server of the page, and an input (`keys.Input`); a context manager.

    `url` is the link to open.

    Args:
        port: 0 for any free port
        host: address to listen at
        source: input that drives at first

    Raises:
        TeleopError: websockets is missing, or the address is not available.
    """

    name = "the page"

    def __init__(self, port: int = PORT, host: str = "127.0.0.1", source: Source = "knob") -> None:
        self._source: Source = source
        self._key = HeldKey()
        self._wish = Wish()
        self._knob = (0.0, 0.0)
        self._rest = (0.0, 0.0)
        self._driver: object | None = None
        self._pages: set[object] = set()
        self._lock = threading.Lock()
        self._hello: Document = {}
        self._view: View | None = None
        self._encoded: tuple[int, bytes] = (-1, b"")
        site = Site(
            FOLDER,
            SERVED,
            socket="/drive",
            longest=LONGEST,
            token_within=TOKEN_WITHIN,
            most_unauthenticated=MOST_UNAUTHENTICATED,
            error=TeleopError,
            port_option="give another --page",
            without=", or give --page none",
        )
        self._server = Server(site, port, host, self._serve, lambda: len(self._pages) >= MOST_PAGES)
        self.port, self.url = self._server.port, self._server.url

    def __enter__(self) -> Self:
        self._server.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._server.stop()

    # --- called by the driving thread ------------------------------------------------------

    def shows(self, hello: Document, view: View) -> None:
        """Set what a page receives on connection, and the source of later states.

        The source returns the state, the points and a picture.
        """
        self._hello, self._view = hello, view

    def controls(self, now: float) -> Controls:
        """Return the controls in the newest message of the driving page."""
        return Controls(self._key.held(now), self._knob, self._source)

    def asked(self) -> str | None:
        """Return the request of a page."""
        return self._wish.take()

    def rest(self, knob: tuple[float, float]) -> None:
        """Take the position of the finger; pages receive it."""
        self._rest = knob

    # --- connections --------------------------------------------------------------------

    def _serve(self, connection: ServerConnection) -> None:
        """Process the messages of a page; another thread sends to it."""
        with self._lock:
            room = len(self._pages) < MOST_PAGES  # several may have connected at once
            if room:
                self._pages.add(connection)
        if not room:
            connection.close(1013, "too many pages are open; close one")
            return
        self._sit(connection)
        link = _Link()
        writer = threading.Thread(target=self._write, args=(connection, link), daemon=True)
        writer.start()
        try:
            for message in connection:
                now = time.monotonic()
                document = _read(message)
                if document is None or not link.heard(document["shown"], document["t"], now):
                    connection.close(1008, "not understood")
                    break
                # requests that any page may make
                if self._driver is connection or document.get("do") in ("stop", "emergency"):
                    self._hear(document, now, link.age)
                elif document.get("do") == "take":
                    self._sit(connection)
        finally:
            self._stand(connection)

    def _hear(self, document: Document, now: float, age: float) -> None:
        wish = document.get("do")
        if wish in PRIORITY:
            self._wish.ask(wish)
        if (
            wish in ("stop", "emergency") or age > MAX_AGE
        ):  # requests in an old message do not count
            return
        self._source, self._knob = document["source"], document["knob"]
        self._key.say(document["held"], now - age)

    def _sit(self, connection: ServerConnection) -> None:
        """Make this connection the driver if there is none."""
        with self._lock:
            if self._driver is None:
                self._driver, self._key = connection, HeldKey()

    def _stand(self, connection: ServerConnection) -> None:
        with self._lock:
            self._pages.discard(connection)
            if self._driver is connection:
                self._driver, self._key = None, HeldKey()

    # --- sending to pages -------------------------------------------------------------------

    def _write(self, connection: ServerConnection, link: _Link) -> None:
        closed = importlib.import_module("websockets.exceptions").ConnectionClosed
        with contextlib.suppress(closed, OSError):
            connection.send(json.dumps({"hello": self._hello}))
            number, drawn = -1, None
            while connection in self._pages:
                begin = time.monotonic()
                # the page has drawn the previous state
                if self._view is not None and link.shown >= link.sent:
                    state, points, picture = self._view()
                    sent = link.sent + 1
                    seat = _seat(self._driver, connection)
                    state |= {
                        "number": sent,
                        "seat": seat,
                        "knob": self._rest,
                        "pages": len(self._pages),
                    }
                    state["slow_ms"] = (
                        round(1e3 * link.age) if MAX_AGE < link.age < math.inf else None
                    )
                    if points is not None and points is not drawn:
                        drawn = points
                        connection.send(
                            struct.pack("<II", POINTS, sent) + points.astype("<f4").tobytes()
                        )
                    if picture is not None and picture[0] != number:
                        number = picture[0]
                        connection.send(struct.pack("<II", PICTURE, sent) + self._jpeg(*picture))
                    link.sends(time.monotonic())
                    connection.send(json.dumps(state, allow_nan=False))
                time.sleep(max(0.002, begin + STATE_INTERVAL - time.monotonic()))

    def _jpeg(self, number: int, picture: NDArray[np.uint8]) -> bytes:
        """Return a picture as JPEG, encoded once for all pages."""
        with self._lock:
            if self._encoded[0] != number:
                cv2 = importlib.import_module("cv2")
                made, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG])
                self._encoded = (number, data.tobytes() if made else b"")
            return self._encoded[1]


class _Link:
    """The greatest possible age of a page's messages, however long the delay.

    The page echoes the number of each state, and the echo comes after the state was sent. That
    bounds the offset between the page's clock and ours. So a constant delay of 3 s is detected as
    well, which differences between messages cannot show.
    """

    def __init__(self) -> None:
        self.sent, self.shown = 0, 0  # numbers of states: last sent, last echoed
        self.age = math.inf  # s: greatest possible age of the last message
        self._when = 0.0
        # s: least offset of our clock from the page's
        self._behind: deque[float] = deque(maxlen=ECHOES)

    def sends(self, now: float) -> None:
        """Note that the next state is sent; only one is in transit."""
        self._when = now
        self.sent += 1

    def heard(self, shown: int, t: float, now: float) -> bool:
        """Note a message at `t` s of the page's clock; False if it echoes a state never sent."""
        if shown > self.sent:
            return False
        if shown > self.shown:
            self._behind.append(self._when - t)
            self.shown = shown
        self.age = max(0.0, now - t - max(self._behind, default=-math.inf))
        return True


def _seat(driver: object | None, page: object) -> str:
    """Return whether a page drives (`mine`), may drive (`free`), or another one does (`taken`)."""
    if driver is page:
        return "mine"
    return "free" if driver is None else "taken"


def _read(message: str | bytes) -> Document | None:
    """Return a valid message of a page: `{t, held, source, knob, shown, do?}`; else None."""
    try:
        if not isinstance(message, str):
            return None
        document = json.loads(message, parse_constant=lambda name: math.nan)
        knob, t = document["knob"], document["t"]
        numbers = [t, *knob]
        if len(knob) != 2 or not all(map(finite, numbers)):
            return None
        if (
            abs(t) > 1e12
            or type(document["held"]) is not bool
            or document["source"] not in ("hand", "knob")
        ):
            return None
        if type(document["shown"]) is not int or not 0 <= document["shown"] < 1 << 53:
            return None
        if document.get("do") not in (None, "take", "stop", "emergency", "acknowledge"):
            return None
        x, y = (min(max(float(at), -1.0), 1.0) for at in knob)
        known: Document = document
        return known | {"knob": (x, y), "t": float(t)}
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None
