"""The page: who may connect, one driver, a key that lapses; by a plain client, and in a browser
where there is one.
"""

import json
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from page_client import PATIENT, STATE, Client, delayed, get, link, served
from waiting import until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from softmap_edge.errors import TeleopError
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.teleop import page as pages
from softmap_edge.robot.teleop.page import Page

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser") if (found := shutil.which(name))), None
)


def test_everything_is_served_from_the_package_under_a_strict_policy():
    with served() as page:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/#[\w-]{32}", page.url)
        for path, kind in (
            ("/", "text/html"),
            ("/page.js", "text/javascript"),
            ("/page_drawing.js", "text/javascript"),
            ("/page.css", "text/css"),
        ):
            answer, body = get(page, path)
            assert answer.status == 200 and answer.headers["Content-Type"].startswith(kind)
            policy = answer.headers["Content-Security-Policy"]
            assert (
                "default-src 'none'" in policy
                and "unsafe" not in policy
                and "frame-ancestors 'none'" in policy
            )
            assert (
                answer.headers["X-Frame-Options"] == "DENY"
                and answer.headers["Referrer-Policy"] == "no-referrer"
            )
            assert not re.search(rb"(src|href|from|import|url\()\W*https?:", body), (
                "nothing comes from elsewhere"
            )
            assert page.url.partition("#")[2].encode() not in body, "the token is in the link alone"
        assert (
            get(page, "/../page.py")[0].status == 404 and get(page, "/page.js?x")[0].status == 404
        )
        assert get(page, "//[x")[0].status == 404


def test_a_name_bent_to_this_computer_is_refused():
    with served() as page:
        for host in (["evil.example"], [f"evil.example:{page.port}"], ["127.0.0.1:1"], [], ["127.0.0.1"],
                     [f"127.0.0.1:{page.port}", "evil.example"]):  # fmt: skip
            assert get(page, host=host)[0].status == 421, host
        for host in (f"localhost:{page.port}", f"[::1]:{page.port}"):
            assert get(page, host=[host])[0].status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1", None])
def test_another_origin_may_not_drive(origin):
    with served() as page:
        how = link(page)
        if origin is None:
            how["additional_headers"].pop("Origin")
        else:
            how["additional_headers"]["Origin"] = origin
        with pytest.raises(InvalidStatus) as refused, connect(**how):
            pass
        assert refused.value.response.status_code == 403


def test_without_the_token_no_client_drives():
    with served() as page:
        for token in ("", "x" * 32, page.url.partition("#")[2][:-1]):
            with pytest.raises(InvalidStatus) as refused, connect(**link(page, token)):
                pass
            assert refused.value.response.status_code == 403


def test_one_page_drives_and_others_watch_and_may_stop():
    with served() as page, connect(**link(page)) as first, ExitStack() as stack:
        driver = Client(first)
        driver.until(lambda state: state.get("seat") == "mine")
        watcher = Client(stack.enter_context(connect(**link(page))))
        watcher.until(lambda state: state.get("seat") == "taken")
        watcher.say(False)
        watcher.say(True, (0.5, 0.5))
        watcher.say(do="take")
        time.sleep(0.1)
        assert not page.controls(time.monotonic()).held and page.controls(0.0).knob == (0.0, 0.0)
        watcher.say(do="stop")
        until(lambda: page.asked() == "stop")
        first.close()
        watcher.until(lambda state: state.get("seat") == "free")
        watcher.say(do="take")
        watcher.until(lambda state: state.get("seat") == "mine")


def held(page):
    return page.controls(time.monotonic()).held


def test_the_key_is_held_only_while_messages_repeat_it():
    with served() as page, connect(**link(page)) as connection:
        client = Client(connection)
        client.until(lambda state: held(page) is False and state.get("seat") == "mine")
        client.until(lambda _: held(page), held=True)
        time.sleep(1.0)  # a silence, and earlier messages are heard by now
        assert not held(page)
        client.until(lambda _: True, held=True)
        for _ in range(5):
            client.say(True)
            time.sleep(0.02)
        assert not held(page), "back from a silence it must be pressed anew"
        client.say(False)
        client.until(lambda _: held(page), held=True)
        client.say(False)
        until(lambda: not held(page))


def test_a_connection_that_is_lost_lets_go_at_once():
    with served() as page, connect(**link(page)) as connection:
        client = Client(connection)
        client.until(lambda _: held(page), held=True)
        connection.socket.shutdown(socket.SHUT_RDWR)
        until(lambda: not held(page))


def test_an_old_message_is_out_of_date():
    with served() as page, connect(**link(page)) as connection:
        client = Client(connection)
        for _ in range(3):
            client.say(False)
        time.sleep(0.05)
        client.say(True, t=time.monotonic() - 2.0)
        time.sleep(0.1)
        assert not held(page)


@pytest.mark.parametrize("there, back", [(0.6, 0.0), (0.6, 0.6), (0.3, 0.3)])
def test_a_delay_that_is_always_the_same_is_seen_and_holds_no_key(there, back):
    with (
        served() as page,
        connect(**link(page), sock=delayed(page.port, there, back)) as connection,
    ):
        client = Client(connection)
        client.until(lambda state: state.get("seat") == "mine")
        ever, end = [], time.monotonic() + 2.5
        client.until(lambda state: state.get("slow_ms") or 0)
        while time.monotonic() < end:
            client.say(time.monotonic() > end - 1.8, (0.5, 0.5))
            client.hear()
            ever.append(held(page))
        assert client.state["slow_ms"] > 1e3 * there - 1.0, "the cause is shown"
        assert not any(ever) and page.controls(0.0).knob == (0.0, 0.0)
        client.say(do="emergency")
        until(lambda: page.asked() == "emergency")


def test_a_small_delay_drives():
    with served() as page, connect(**link(page), sock=delayed(page.port, 0.02, 0.02)) as connection:
        client = Client(connection)
        client.until(lambda state: state.get("seat") == "mine")
        client.until(lambda _: held(page), held=True)


def test_the_age_of_a_word_is_never_reported_too_small():
    """Clocks apart, delays that change: the age shown is at least the true age, and exact where a
    state came at once.
    """
    link, apart = pages._Link(), 1000.0  # s that the page's clock is behind
    assert link.heard(0, 5.0 - apart, 5.1) and link.age == float("inf"), "nothing came back yet"
    for number, (there, back) in enumerate(
        [(0.2, 0.1), (0.0, 0.05), (0.2, 0.02), (3.0, 3.0), (0.01, 0.01)], 1
    ):
        begin = 10.0 * number
        link.sends(begin)
        assert link.heard(number, begin + there - apart, begin + there + back)
        assert back - 1e-6 <= link.age <= back + (there if number == 1 else 0.0) + 1e-6
    assert link.heard(5, 99.0 - apart, 102.0) and link.age == pytest.approx(3.0)
    assert not link.heard(6, 100.0 - apart, 103.0), "a state that it was not sent"


def test_connections_that_bring_no_token_are_few_and_do_not_stay(monkeypatch):
    monkeypatch.setattr(pages, "TOKEN_WITHIN", 1.0)
    with served() as page, ExitStack() as stack:
        driver = Client(stack.enter_context(connect(**link(page))))
        driver.until(lambda state: state.get("seat") == "mine")
        before, idle = threading.active_count(), []
        for _ in range(4 * pages.MOST_UNAUTHENTICATED):
            idle.append(stack.enter_context(socket.create_connection(("127.0.0.1", page.port))))
        until(lambda: sum(closed(one) for one in idle) >= 3 * pages.MOST_UNAUTHENTICATED)
        assert threading.active_count() - before <= 2 * pages.MOST_UNAUTHENTICATED + 2
        until(lambda: driver.press() or held(page))
        until(lambda: all(closed(one) for one in idle))
        until(lambda: threading.active_count() <= before + 2)
        assert get(page)[0].status == 200, "there is room again"


def closed(connection):
    """Whether the other side has closed it."""
    connection.settimeout(0.0)
    try:
        return not connection.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return False
    except OSError:
        return True


@pytest.mark.parametrize(
    "said",
    ["", "[]", "{}", "null", "[" * 900, b"\x00", '{"t": NaN}', "x" * 5000]
    + [json.dumps({"t": 0.0, "held": False, "source": "knob", "knob": [0.0, 0.0], "shown": 0} | change)
       for change in ({"t": 1e300}, {"held": 1}, {"knob": [0.0]}, {"knob": ["a", 0]}, {"source": "nose"}, {"shown": -1},
                      {"do": "fly"}, {"do": []}, {"t": True}, {"shown": 1 << 20})],
)  # fmt: skip
def test_what_is_no_message_ends_the_connection_and_drives_nothing(said):
    with served() as page, connect(**link(page)) as connection:
        connection.send(said)
        with pytest.raises(ConnectionClosed):
            while True:
                connection.recv(PATIENT)
        assert not held(page) and page.asked() is None


def test_numbers_that_are_none_or_beyond_the_range_lead_nowhere():
    ours = {"t": 0.0, "held": True, "source": "knob", "shown": 0}
    for text in ("[NaN, 0]", "[1e999, 0]", "[Infinity, 0]"):
        assert pages._read(json.dumps(ours)[:-1] + f', "knob": {text}}}') is None
    assert pages._read(json.dumps(ours | {"knob": [7.0, -7.0]}))["knob"] == (1.0, -1.0)


def test_too_many_pages_and_a_busy_port_are_refused():
    with served() as page, ExitStack() as stack:
        for count in range(pages.MOST_PAGES):
            stack.enter_context(connect(**link(page)))
            until(lambda count=count: len(page._pages) > count)
        with pytest.raises(InvalidStatus) as refused:
            stack.enter_context(connect(**link(page)))
        assert refused.value.response.status_code == 503
        with pytest.raises(
            TeleopError, match=r"page: 127\.0\.0\.1:\d+ cannot be used .*; give another --page"
        ):
            Page(page.port)
    with pytest.raises(TeleopError, match="port 70000"):
        Page(70_000)


def test_pages_that_come_at_once_are_no_more_than_are_allowed(monkeypatch):
    with served() as page:
        monkeypatch.setattr(pages, "MOST_PAGES", 1)
        with connect(**link(page)) as first:
            until(lambda: len(page._pages) == 1)
            late = Late()
            page._serve(late)  # let in before the first was counted
            assert late.closed == 1013 and len(page._pages) == 1
            assert first.recv(PATIENT)


class Late:
    """A connection that only hears that it is closed."""

    closed = None

    def close(self, code, reason):
        self.closed = code


def test_without_websockets_the_install_line_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "websockets.sync.server", None)
    with pytest.raises(
        TeleopError, match="not installed; run pip install websockets, or give --page none"
    ):
        Page(0)


@contextmanager
def verb(*options):
    """Run `softmap teleop --sim`; gives the process and the link of its page."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from softmap_edge.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, "teleop", "--sim", "--page", "0", "--json", *options]
    program = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        url = next(m[1] for line in program.stderr if (m := re.match(r"open (\S+)", line)))
        yield program, url
    finally:
        program.kill()
        program.communicate()


def ended(program):
    """Interrupt it; its document."""
    program.send_signal(signal.SIGINT)
    said, _ = program.communicate(timeout=60)
    assert program.returncode == 0
    return json.loads(said)


def test_the_command_is_driven_by_its_page():
    with verb() as (program, url):
        port, token = re.match(r"http://127\.0\.0\.1:(\d+)/#(.*)", url).groups()
        here = f"127.0.0.1:{port}"
        with connect(
            f"ws://{here}/drive?token={token}", additional_headers={"Origin": f"http://{here}"}
        ) as connection:
            client = Client(connection)
            client.until(lambda state: state.get("state") == "ready")
            client.until(lambda state: state.get("stage") == "driving", held=True)
            client.until(lambda state: state["here"][0] > 1.9, held=True, knob=(0.125, 0.0))
            client.until(lambda state: state["state"] == "hold")
            client.until(lambda state: state["state"] == "ready")
            reported = ended(program)
    assert (
        reported["schema"] == "softmap.teleop/1"
        and reported["presses"] >= 1
        and reported["ended"] == "interrupted"
    )
    assert (
        reported["driving_s"] > 0
        and reported["states_s"]["engaged"] > 0
        and reported["pictures"] == 0
    )


@pytest.mark.skipif(CHROMIUM is None, reason="not run: there is no chromium here")
def test_in_a_browser_space_drives_and_leaving_the_page_lets_go(tmp_path):
    browser = pytest.importorskip(
        "playwright.sync_api", reason="not run: playwright is not installed"
    )
    for left in reversed(range(4)):
        try:
            in_a_browser(browser)
            break
        except Starved:
            assert left, "the emulated servos never got to answer in time"


class Starved(Exception):
    """The machine was so busy with the browser that the emulated servos did not answer: begin
    again.
    """


def in_a_browser(browser):
    with verb() as (program, url), browser.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1280, "height": 800})
        wrong = []
        page.on("pageerror", lambda fault: wrong.append(str(fault)))
        page.on("console", lambda line: wrong.append(line.text) if line.type == "error" else None)
        page.goto(url)
        said = page.locator("#state")

        def shows(state):
            def shown():
                if "is silent" in page.locator("#said").text_content():
                    raise Starved
                return said.text_content() == words.NAMES[state].capitalize()

            until(shown)

        for let_go in (
            lambda: page.keyboard.up("Space"),
            lambda: page.evaluate("window.dispatchEvent(new Event('blur'))"),
            lambda: page.evaluate("document.dispatchEvent(new Event('visibilitychange'))"),
            lambda: page.keyboard.press("Escape"),
        ):
            shows("ready")
            page.keyboard.down("Space")
            shows("engaged")
            let_go()
            until(lambda: said.text_content() != words.NAMES["engaged"].capitalize())
            page.keyboard.up("Space")
        assert said.is_visible() and page.evaluate(
            "document.documentElement.scrollWidth <= innerWidth"
        )
        page.set_viewport_size({"width": 390, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert page.locator("#hold").bounding_box()["y"] < 844, "the button is in sight on a phone"
        page.goto("about:blank")
        chromium.close()
        reported = ended(program)
    assert reported["presses"] == 4 and not wrong


def test_binary_messages_are_points_and_pictures():
    """As page.js reads them: kind, number, then float32 or a JPEG."""
    import numpy as np

    picture = np.zeros((48, 64, 3), np.uint8)
    points = np.arange(6.0).reshape(2, 3)
    with Page(0) as page:
        page.shows({}, lambda: (dict(STATE), points, (0, picture)))
        with connect(**link(page)) as connection:
            got = [connection.recv(PATIENT) for _ in range(4)]
    assert struct.unpack("<II", got[1][:8]) == (pages.POINTS, 1)
    np.testing.assert_allclose(np.frombuffer(got[1][8:], "<f4"), np.arange(6.0))
    assert struct.unpack("<II", got[2][:8]) == (pages.PICTURE, 1) and got[2][8:10] == b"\xff\xd8"
    assert json.loads(got[3])["number"] == 1


def test_the_pages_files_are_where_they_are_served_from():
    folder = Path(pages.__file__).parent
    assert all((folder / name).is_file() for name in pages.SERVED.values())
