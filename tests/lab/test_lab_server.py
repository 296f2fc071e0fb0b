"""The lab's server by a plain client, and its page in a browser where there is one."""

import json
import re
import shutil
import struct
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from lab_runs import HIDDEN, measured, session
from waiting import until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from softmap_edge.cli import main
from softmap_edge.lab import server as labs
from softmap_edge.lab.server import LabServer
from softmap_edge.lab.session import Session

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser") if (found := shutil.which(name))), None
)
PAGE = Path(labs.__file__).parent / "page"


@contextmanager
def served(folder):
    lab = session(folder)
    try:
        with LabServer(lab, 0) as server:
            yield server
    finally:
        lab.close()


def link(server, token=None):
    here = f"127.0.0.1:{server.port}"
    token = server.url.partition("#")[2] if token is None else token
    return {
        "uri": f"ws://{here}/lab?token={token}",
        "additional_headers": {"Origin": f"http://{here}"},
        "max_size": 1 << 26,
    }


def ask(connection, do, number=1, **more):
    """Return the answer to a request."""
    connection.send(json.dumps({"id": number, "do": do, **more}))
    while True:
        answer = connection.recv(30.0)
        if isinstance(answer, bytes):
            (length,) = struct.unpack("<I", answer[:4])
            answer = answer[4 : 4 + length]
        answer = json.loads(answer)
        if answer.get("re") == number:
            return answer


def test_a_client_loads_tries_and_accepts(tmp_path):
    with served(tmp_path / "lab") as server, connect(**link(server)) as page:
        assert ask(page, "state")["state"]["check"]["state"] == "not done"
        assert "not loaded" in ask(page, "shape", run=0, frame=0)["error"]
        assert "needs a check" in ask(page, "accept", effects=["backlash"], params=HIDDEN)["error"]
        assert ask(page, "run", run=0)["frames"] == 160
        assert [name for name, _ in ask(page, "shape", run=0, frame=3)["arrays"]] == [
            "seen",
            "visible",
            "before",
        ]
        tried = ask(page, "try", run=0, frame=3, effects=["backlash"], params=HIDDEN)
        assert (
            tried["rms_mm"] < 0.1 < ask(page, "comparison", run=0)["comparison"]["error"]["rms_mm"]
        )
        assert ask(page, "check")["done"] == "check"
        assert ask(page, "accept", effects=["backlash"], params=HIDDEN)["done"] == "accept"
        state = ask(page, "state")["state"]
        assert state["effects"] == ["backlash"] and state["accepted"][0]["errors_mm"][1] < 0.1
        assert "gap" in str(ask(page, "library")["library"])


def test_a_bad_request_gets_one_error_and_the_page_goes_on(tmp_path):
    with served(tmp_path / "lab") as server, connect(**link(server)) as page:
        for said in ("nonsense", b"\x00", '{"id": 3, "do": "fly"}'):
            page.send(said)
            assert json.loads(page.recv(30.0))["error"]
        for do, more in (
            ("run", {"run": 7}),
            ("run", {"run": "../x"}),
            ("try", {"run": 0, "frame": 0, "effects": ["x\x1b[31m"], "params": {}}),
        ):
            error = ask(page, do, **more)["error"]
            assert error and error.isprintable()
        assert ask(page, "state")["state"]["runs"][0]["name"] == "run0.npz"
        page.send("x" * (labs.LONGEST + 1))
        with pytest.raises(ConnectionClosed):
            page.recv(30.0)


def test_without_the_token_nothing_but_the_static_files_is_served(tmp_path):
    with served(tmp_path / "lab") as server:
        for token in ("", "x" * 32):
            with pytest.raises(InvalidStatus) as refused, connect(**link(server, token)):
                pass
            assert refused.value.response.status_code == 403


def test_the_files_are_there_small_and_load_nothing_from_another_place():
    assert {file.name for file in PAGE.iterdir()} == set(labs.SERVED.values())
    assert sum(file.stat().st_size for file in PAGE.iterdir()) < 1_000_000
    for file in PAGE.iterdir():
        content = file.read_text(encoding="utf-8")
        assert not re.search(r"(src|href|from|import|url\()\W*https?:", content)
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|\beval\b|new Function", content
        )
        assert all(int(size) >= 12 for size in re.findall(r"(\d+)px (?:system-ui|/)", content))


def test_the_command_reports_bad_inputs_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    measured(frames=20).save("run.npz")
    Path("full").mkdir()
    Path("full/other.txt").write_text("")
    assert main(["lab", "gone.npz", "--no-browser"]) == 2 and not Path("lab").exists()
    assert main(["lab", "run.npz", "--folder", "full", "--no-browser"]) == 2
    assert "holds other.txt and no session" in capsys.readouterr().err
    assert main(["lab", "run.npz", "--port", "70000", "--no-browser"]) == 2
    assert "port 70000" in capsys.readouterr().err


@pytest.mark.skipif(CHROMIUM is None, reason="not run: there is no chromium here")
def test_a_check_that_ends_in_an_error_is_not_repeated(tmp_path, monkeypatch):
    browser = pytest.importorskip(
        "playwright.sync_api", reason="not run: playwright is not installed"
    )
    calls = []

    def check(self):
        calls.append(1)
        raise MemoryError("too little memory")

    monkeypatch.setattr(Session, "check", check)
    with served(tmp_path / "lab") as server, browser.sync_playwright() as p:
        chromium = p.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page = chromium.new_page()
        page.goto(server.url)
        page.wait_for_selector("body[data-loaded=yes]")
        page.wait_for_timeout(500)
        assert len(calls) == 1
        assert "too little memory" in page.locator("#status").text_content()
        page.locator("#check").click()
        page.wait_for_timeout(300)
        assert len(calls) == 2
        chromium.close()


@pytest.mark.skipif(CHROMIUM is None, reason="not run: there is no chromium here")
def test_in_a_browser_frames_move_and_a_brush_selects_everywhere(tmp_path):
    browser = pytest.importorskip(
        "playwright.sync_api", reason="not run: playwright is not installed"
    )
    with served(tmp_path / "lab") as server, browser.sync_playwright() as p:
        chromium = p.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page = chromium.new_page(viewport={"width": 1280, "height": 800})
        wrong = []
        page.on("pageerror", lambda fault: wrong.append(str(fault)))
        page.on("console", lambda line: wrong.append(line.text) if line.type == "error" else None)
        page.goto(server.url)

        def text(name):
            return page.locator(f"#{name}").text_content()

        until(lambda: text("check-text").startswith("Check passed"))
        until(lambda: "noise floor" in text("numbers"))
        assert "mm RMS" in text("frame-error")
        scene = page.locator("#scene")
        picture = scene.screenshot()
        scene.focus()
        page.keyboard.press("ArrowRight")
        until(lambda: scene.screenshot() != picture)
        frame = text("time-text")
        page.click("#play")
        until(lambda: text("time-text") != frame)
        page.click("#play")
        page.click("#tab-where")
        box = page.locator("#timeline").bounding_box()
        page.mouse.move(box["x"] + 150, box["y"] + 30)
        page.mouse.down()
        page.mouse.move(box["x"] + 250, box["y"] + 30)
        page.mouse.up()
        until(lambda: re.match(r"\d\d of 160 frames selected", text("selection")))
        page.keyboard.press("Escape")
        until(lambda: text("selection").startswith("All 160 frames"))
        page.click("#tab-add")
        page.select_option("#library", "backlash")
        page.click("#take")
        until(lambda: text("trial").startswith("Trial on "))
        page.click("#accept")
        until(lambda: "+ backlash" in text("model"))
        page.click("#undo")
        until(lambda: "+ backlash" not in text("model"))
        page.set_viewport_size({"width": 390, "height": 844})
        for name in ("see", "where", "what", "add", "next"):
            page.click(f"#tab-{name}")
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), name
        chromium.close()
    assert not wrong


DIRECTIONS = ([0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -0.6, 0.8], [0.36, 0.48, -0.8])


@pytest.mark.skipif(CHROMIUM is None, reason="not run: there is no chromium here")
def test_gravity_points_down_on_the_page_and_shapes_keep_their_form(tmp_path):
    browser = pytest.importorskip(
        "playwright.sync_api", reason="not run: playwright is not installed"
    )
    with served(tmp_path / "lab") as server, browser.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = chromium.new_page()
        page.goto(server.url)
        turns = page.evaluate(
            "async all => { const scene = await import('/scene.js');"
            " return all.map(g => [true, false].map(hangs => scene.levelled(g, hangs))); }",
            DIRECTIONS,
        )
        chromium.close()
    for down, both in zip(DIRECTIONS, turns):
        for turn in map(np.array, both):
            np.testing.assert_allclose(turn @ down, [0, 0, -1], atol=1e-12)
            np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(turn) > 0
