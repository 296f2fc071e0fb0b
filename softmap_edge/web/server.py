"""One server for the pages of this package: static files, and WebSocket connections with a token.

`websockets` (BSD) serves both; its threaded server needs no event loop. The link carries a random
token in its fragment (`#`), which browsers never send to a server. Every connection must present
it; only the static files are served without it. The Host header must be an address or localhost, so
DNS-rebinding requests are rejected. The Origin header must be this page. Connections that do not
authenticate in time are closed, and their number is limited. Pinned by tests/web/test_server.py.
"""

from __future__ import annotations

import hmac
import importlib
import ipaddress
import logging
import secrets
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from softmap_edge.errors import SoftmapError

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import ServerConnection

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
KINDS = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
}


@dataclass(frozen=True)
class Site:
    """A page: its files, its socket, its limits, and the words of its errors.

    Attributes:
        folder: folder of the files, relative to the package
        served: file name by path, such as `{"/": "page.html"}`
        socket: path of the WebSocket
        longest: bytes of a message from a page
        token_within: s within which a connection must present its token
        most_unauthenticated: connections without a token at a time; more are closed at once
        error: raised if the page cannot be served
        port_option: advice for a port that is not available
        without: what to do without websockets, besides installing it
    """

    folder: str
    served: Mapping[str, str]
    socket: str
    longest: int
    token_within: float
    most_unauthenticated: int
    error: type[SoftmapError]
    port_option: str
    without: str = ""


class Server:
    """Serve a `Site`: its files to all, its socket to those who have the link.

    `url` is the link to open.

    Args:
        site: the page.
        port: 0 for any free port.
        host: address to listen at.
        serve: called with each connection, in a thread of its own, until it returns.
        full: whether no further page may connect.

    Raises:
        SoftmapError: `site.error`: websockets is missing, or the address is not available.
    """

    def __init__(
        self,
        site: Site,
        port: int,
        host: str,
        serve: Callable[[ServerConnection], None],
        full: Callable[[], bool],
    ) -> None:
        if not 0 <= port <= 65535:
            raise site.error(f"page: port {port}; ports are 1 to 65535, 0 takes any that is free")
        try:
            server = importlib.import_module("websockets.sync.server")
        except ImportError:
            raise site.error(
                f"page: websockets is not installed; run pip install websockets{site.without}"
            ) from None
        self._site, self._full = site, full
        self._token = secrets.token_urlsafe(24)
        opening = threading.BoundedSemaphore(site.most_unauthenticated)
        quiet = logging.getLogger("softmap_edge.web.server")
        quiet.setLevel(logging.CRITICAL)  # a disconnected page is not worth a log entry
        try:
            self._server = server.serve(
                serve,
                host,
                port,
                process_request=self._request,
                create_connection=_door(server.ServerConnection, opening),
                open_timeout=site.token_within,
                max_size=site.longest,
                max_queue=4,
                compression=None,
                server_header=None,
                ping_interval=5,
                ping_timeout=5,
                close_timeout=1,
                logger=quiet,
            )
        except OSError as fault:
            raise site.error(
                f"page: {host}:{port} cannot be used ({fault.strerror}); {site.port_option}"
            ) from None
        self.port = int(self._server.socket.getsockname()[1])
        shown = f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self.port}/#{self._token}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)

    def start(self) -> None:
        """Accept connections, in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """Close the port."""
        self._server.shutdown()
        self._thread.join(3.0)

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Serve a file, reject the request, or return None to accept a connection."""
        host = request.headers.get_all("Host")
        if len(host) != 1 or not _ours(host[0], self.port):
            return _answer(
                connection,
                421,
                b"this page is served under an address or localhost, not under this name\n",
            )
        try:
            path = urlsplit(request.path)
        except ValueError:
            return _answer(connection, 404, b"there is no such page\n")
        if path.path != self._site.socket:
            if path.path not in self._site.served or path.query:
                return _answer(connection, 404, b"there is no such page\n")
            name = self._site.served[path.path]
            body = files("softmap_edge").joinpath(self._site.folder, name).read_bytes()
            return _answer(connection, 200, body, KINDS[name.rpartition(".")[2]], host[0])
        if request.headers.get_all("Origin") != [f"http://{host[0]}"]:
            return _answer(connection, 403, b"only the page itself may connect: wrong Origin\n")
        token = parse_qs(path.query).get("token", [""])[-1]
        if not hmac.compare_digest(token.encode(), self._token.encode()):
            return _answer(connection, 403, b"wrong token; open the link that was printed\n")
        if self._full():
            return _answer(connection, 503, b"too many pages are open; close one\n")
        return None


def _door(connection: Any, opening: threading.BoundedSemaphore) -> Callable[..., object]:
    """Return the connection class for websockets, which limits connections without a token."""

    class Door(connection):  # type: ignore[misc]
        def handshake(self, *how: object, **named: object) -> None:
            try:
                super().handshake(*how, **named)
            finally:
                opening.release()

    def made(*how: object, **named: object) -> object:
        if not opening.acquire(blocking=False):
            # websockets closes the socket
            raise ConnectionRefusedError("too many connections are being opened")
        try:
            return Door(*how, **named)
        except BaseException:
            opening.release()
            raise

    return made


def _ours(host: str, port: int) -> bool:
    """Return whether a Host header is an address or localhost (no DNS rebinding)."""
    name, _, stated = host.rpartition(":")
    if stated != str(port):
        return False
    if name == "localhost":
        return True
    try:
        ipaddress.ip_address(name[1:-1] if name.startswith("[") and name.endswith("]") else name)
    except ValueError:
        return False
    return True


def _answer(
    connection: ServerConnection,
    status: int,
    body: bytes,
    kind: str = "text/plain",
    host: str = "",
) -> Response:
    response = connection.respond(status, "")
    response.body = body
    for name in ("Content-Type", "Content-Length"):
        del response.headers[name]
    response.headers["Content-Type"] = kind
    response.headers["Content-Length"] = str(len(body))
    connect = f"'self' ws://{host}" if host else "'self'"
    response.headers["Content-Security-Policy"] = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    for name, value in HEADERS.items():
        response.headers[name] = value
    return response
