"""The server of the lab's page: quick requests are answered at once, slow ones by one worker.

Quick are shapes of a loaded run and the trial of parameters: at most 100 ms. Loading, checks,
diagnoses, fits and steps go through one queue, so that they cannot change a session at the same
time. After each change every page is notified. Pinned by tests/lab/test_lab_server.py.
"""

from __future__ import annotations

import contextlib
import importlib
import queue
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Self

from softmap_edge.errors import LabError, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.files.printable import one_line
from softmap_edge.files.refusals import refusal
from softmap_edge.lab.messages import (
    LONGEST,
    BadRequest,
    Request,
    binary,
    read_request,
    text,
)
from softmap_edge.lab.session import Session
from softmap_edge.lab.views import frames_of, shape_of, tried
from softmap_edge.web.server import Server, Site

if TYPE_CHECKING:
    from websockets.sync.server import ServerConnection

PORT = 8766
MOST_PAGES = 4  # pages connected at a time
MOST_WAITING = 16  # slow requests that wait
FOLDER = "lab/page"
SERVED = {"/": "lab.html"} | {
    f"/{name}": name
    for name in ("lab.css", "lab.js", "link.js", "scene.js", "plots.js", "where.js", "steps.js")
}
QUICK = ("state", "shape", "try", "library", "diagnosis")
CHANGING = ("check", "diagnose", "accept", "accept_diagnosis", "undo", "redo")


class LabServer:
    """A server of one session; a context manager. `url` is the link to open.

    Args:
        session: the session.
        port: 0 for any free port.

    Raises:
        LabError: the port is not available.
    """

    def __init__(self, session: Session, port: int = PORT) -> None:
        self._session = session
        self._pages: dict[ServerConnection, threading.Lock] = {}
        self._lock = threading.Lock()
        self._jobs: queue.Queue[tuple[ServerConnection, Request] | None] = queue.Queue(MOST_WAITING)
        self._busy = ""
        site = Site(
            FOLDER,
            SERVED,
            socket="/lab",
            longest=LONGEST,
            token_within=5.0,
            most_unauthenticated=16,
            error=LabError,
            port_option="give another --port",
        )
        self._server = Server(
            site, port, "127.0.0.1", self._serve, lambda: len(self._pages) >= MOST_PAGES
        )
        self.url, self.port = self._server.url, self._server.port
        self._worker = threading.Thread(target=self._work, name="lab", daemon=True)

    def __enter__(self) -> Self:
        self._server.start()
        self._worker.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._server.stop()
        with contextlib.suppress(queue.Full):
            self._jobs.put_nowait(None)
        self._worker.join(1.0)  # a diagnosis cannot be interrupted; its thread ends with us

    # --- connections ----------------------------------------------------------------------

    def _serve(self, connection: ServerConnection) -> None:
        with self._lock:
            room = len(self._pages) < MOST_PAGES
            if room:
                self._pages[connection] = threading.Lock()
        if not room:
            connection.close(1013, "too many pages are open; close one")
            return
        try:
            for message in connection:
                try:
                    request = read_request(message)
                except BadRequest as fault:
                    self._send(connection, text({"re": fault.id, "error": str(fault)}))
                    continue
                if request.do in QUICK:
                    self._answer(connection, request)
                    continue
                try:
                    self._jobs.put_nowait((connection, request))
                except queue.Full:
                    why = f"{MOST_WAITING} requests wait already; try again when they are done"
                    self._send(connection, text({"re": request.id, "error": why}))
        finally:
            with self._lock:
                self._pages.pop(connection, None)

    def _send(self, connection: ServerConnection, message: str | bytes) -> None:
        closed = importlib.import_module("websockets.exceptions").ConnectionClosed
        lock = self._pages.get(connection)
        if lock is not None:
            with lock, contextlib.suppress(closed, OSError):
                connection.send(message)

    def _notify(self, event: Document) -> None:
        with self._lock:
            pages = list(self._pages)
        for page in pages:
            self._send(page, text(event))

    # --- work -------------------------------------------------------------------------------

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            connection, request = job
            if request.do in CHANGING:
                self._busy = request.do
                self._notify({"event": "busy", "do": request.do})
            self._answer(connection, request)
            self._busy = ""
            if request.do in CHANGING:
                self._notify({"event": "changed", "state": self._state()})

    def _answer(self, connection: ServerConnection, request: Request) -> None:
        try:
            message = self._answered(request)
        except (SoftmapError, OSError) as fault:
            why = refusal(fault) if isinstance(fault, OSError) else str(fault)
            message = text({"re": request.id, "error": one_line(why)})
        except Exception as fault:  # a fault of ours must not end the worker
            why = f"{request.do} failed: {type(fault).__name__}: {one_line(str(fault))[:200]}"
            message = text({"re": request.id, "error": why})
        self._send(connection, message)

    def _state(self) -> Document:
        return self._session.document() | {"busy": self._busy}

    def _answered(self, request: Request) -> str | bytes:
        """Return the answer to a request."""
        session, re = self._session, {"re": request.id}
        match request.do:
            case "run":
                header, arrays = frames_of(*session.view(request.run))
                return binary(re | header, arrays)
            case "shape":
                return binary(dict(re), shape_of(*session.seen(request.run), request.frame))
            case "try":
                model = session.with_effects(request.effects, request.params)
                error, arrays = tried(model, session.seen(request.run)[0], request.frame)
                return binary(re | {"rms_mm": error}, arrays)
            case do if do in CHANGING:
                self._change(request)
                return text(re | {"done": do})
            case do:
                return text(re | {do: self._document(request)})

    def _document(self, request: Request) -> object:
        """Return what a request asks for, as JSON; the session stays as it is."""
        session = self._session
        match request.do:
            case "state":
                return self._state()
            case "library":
                return session.library()
            case "diagnosis":
                return session.diagnosis()
            case "comparison":
                return session.comparison(request.run)
            case "fit":
                return session.fit(request.effects, request.params)
            case "experiments":
                return session.experiments(
                    lambda share: self._notify({"event": "simulating", "share": share})
                )
        raise LabError(f"there is no request '{request.do}'")

    def _change(self, request: Request) -> None:
        """Change the session, as one of `CHANGING`."""
        session = self._session
        match request.do:
            case "check":
                session.check()
            case "diagnose":
                session.diagnose(lambda line: self._notify({"event": "progress", "line": line}))
            case "accept":
                session.accept(request.effects, request.params)
            case "accept_diagnosis":
                session.accept_diagnosis()
            case "undo":
                session.undo()
            case "redo":
                session.redo()
