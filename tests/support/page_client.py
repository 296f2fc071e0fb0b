"""Shared by tests of teleoperation's page: a page that is served, a plain client, a network that
is slow.
"""

import http.client
import json
import queue
import socket
import threading
import time
from contextlib import contextmanager, suppress

from softmap_edge.robot.teleop.page import Page

PATIENT = 20.0  # s: a busy machine
STATE = {"t": 1.0, "level": "ready", "said": "Ready"}


@contextmanager
def served():
    """Give a page that shows one state."""
    with Page(0) as page:
        page.shows({"schema": "softmap.teleop.page/1"}, lambda: (dict(STATE), None, None))
        yield page


def link(page, token=None, **headers):
    """Return what `connect` takes for this page."""
    here = f"127.0.0.1:{page.port}"
    token = page.url.partition("#")[2] if token is None else token
    headers = {"Origin": f"http://{here}"} | headers
    return {
        "uri": f"ws://{here}/drive?token={token}",
        "additional_headers": headers,
        "max_size": 1 << 22,
    }


class Client:
    """A page's side of the connection."""

    def __init__(self, connection):
        self.connection, self.state = connection, {}
        self.until(lambda state: "number" in state)
        self.say()  # not held, and it is known how old that is

    def say(self, held=False, knob=(0.0, 0.0), do=None, **changes):
        said = {
            "t": time.monotonic(),
            "held": held,
            "source": "knob",
            "knob": knob,
            "shown": self.state.get("number", 0),
        }
        self.connection.send(json.dumps(said | ({"do": do} if do else {}) | changes))

    def press(self):
        """Release and press the key; a busy computer's gap between two words has let it go."""
        self.hear()
        self.say(False)
        self.say(True)

    def hear(self):
        """Return the newest state."""
        with suppress(TimeoutError):
            while True:
                reported = self.connection.recv(0.02)
                if isinstance(reported, str) and "hello" not in json.loads(reported):
                    self.state = json.loads(reported)
        return self.state

    def until(self, what, held=False, knob=(0.0, 0.0)):
        """Say the same again and again until the state is so."""
        begin = time.monotonic()
        while not what(self.hear()):
            assert time.monotonic() - begin < PATIENT, self.state
            self.say(held, knob)


def get(page, path="/", host=None):
    asked = http.client.HTTPConnection("127.0.0.1", page.port, timeout=PATIENT)
    asked.putrequest("GET", path, skip_host=True)
    for one in [f"127.0.0.1:{page.port}"] if host is None else host:
        asked.putheader("Host", one)
    asked.endheaders()
    answer = asked.getresponse()
    body = answer.read()
    asked.close()
    return answer, body


def delayed(port, there, back):
    """Give a connection to `port` whose bytes take that long (s) both ways, evenly, as through
    a slow tunnel.
    """
    ours, inner = socket.socketpair()
    outer = socket.create_connection(("127.0.0.1", port))

    def carry(source, sink, late):
        parcels = queue.SimpleQueue()

        def put():
            while (parcel := parcels.get())[1]:
                time.sleep(max(0.0, parcel[0] + late - time.monotonic()))
                with suppress(OSError):
                    sink.sendall(parcel[1])
            sink.close()

        threading.Thread(target=put, daemon=True).start()
        data = b"-"
        while data:
            try:
                data = source.recv(65536)
            except OSError:
                data = b""
            parcels.put((time.monotonic(), data))

    for way in ((inner, outer, there), (outer, inner, back)):
        threading.Thread(target=carry, args=way, daemon=True).start()
    return ours
