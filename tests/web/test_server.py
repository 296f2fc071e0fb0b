"""The server of pages: static files for all, connections only with the token, from this page and
under an address.
"""

import http.client
import re
import sys
from contextlib import contextmanager

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from softmap_edge.errors import TeleopError
from softmap_edge.web.server import Server, Site

SITE = Site(
    "robot/teleop", {"/": "page.html", "/page.js": "page.js"}, "/socket", 100, 5.0, 4,
    TeleopError, "give another --port",
)  # fmt: skip


@contextmanager
def served(full=lambda: False):
    """Give a server that sends each message back."""

    def echo(connection):
        for message in connection:
            connection.send(message)

    server = Server(SITE, 0, "127.0.0.1", echo, full)
    server.start()
    try:
        yield server
    finally:
        server.stop()


def link(server, token=None, origin=None):
    here = f"127.0.0.1:{server.port}"
    token = server.url.partition("#")[2] if token is None else token
    headers = {"Origin": origin or f"http://{here}"}
    return {"uri": f"ws://{here}/socket?token={token}", "additional_headers": headers}


def get(server, path="/", host=None):
    asked = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20.0)
    asked.putrequest("GET", path, skip_host=True)
    asked.putheader("Host", host or f"127.0.0.1:{server.port}")
    asked.endheaders()
    answer = asked.getresponse()
    answer.read()
    asked.close()
    return answer


def test_files_are_served_to_all_and_a_connection_needs_the_link():
    with served() as server:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/#[\w-]{32}", server.url)
        answer = get(server)
        assert answer.status == 200 and answer.headers["Content-Type"].startswith("text/html")
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        for path in (
            "/page.css",
            "/page.js?x",
            "/../page.py",
            "//[x",
            "/%2e%2e/page.py",
            "/socket2",
        ):
            assert get(server, path).status == 404, path
        with connect(**link(server)) as connection:
            connection.send("there and back")
            assert connection.recv(20.0) == "there and back"


@pytest.mark.parametrize(
    "how",
    [{"token": ""}, {"token": "x" * 32}, {"origin": "http://evil.example"}, {"origin": "null"}],
)
def test_another_token_or_origin_is_refused(how):
    with served() as server:
        with pytest.raises(InvalidStatus) as refused, connect(**link(server, **how)):
            pass
        assert refused.value.response.status_code == 403
        assert get(server, host=f"evil.example:{server.port}").status == 421


def test_a_message_that_is_too_long_ends_the_connection():
    with served() as server, connect(**link(server)) as connection:
        connection.send("x" * 101)
        with pytest.raises(ConnectionClosed):
            connection.recv(20.0)


def test_a_full_page_and_a_port_in_use_are_refused(monkeypatch):
    with served(full=lambda: True) as server:
        with pytest.raises(InvalidStatus) as refused, connect(**link(server)):
            pass
        assert refused.value.response.status_code == 503
        with pytest.raises(TeleopError, match="cannot be used .*; give another --port"):
            Server(SITE, server.port, "127.0.0.1", print, lambda: False)
    with pytest.raises(TeleopError, match="port 70000"):
        Server(SITE, 70_000, "127.0.0.1", print, lambda: False)
    monkeypatch.setitem(sys.modules, "websockets.sync.server", None)
    with pytest.raises(TeleopError, match="run pip install websockets$"):
        Server(SITE, 0, "127.0.0.1", print, lambda: False)
