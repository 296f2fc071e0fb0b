"""Make the picture of the page that drives by hand.

An emulated finger, and the hand of a clip before the camera.

`python docs/figures_teleop.py` writes teleop.jpg into `docs/pictures/`; `--out` names another
folder. It needs the command chromium (a browser that draws without a screen), the clip (`make
data`) and the model of hands (`softmap teleop --fetch-model`), and says in one line what is absent.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

sys.path.insert(0, str(Path(__file__).parents[1]))  # benches/ is next to docs/
from benches.data import find

SIZE = (1180, 740)  # pixels of the window
LONGEST = 18.0  # s of the clip in which the picture is taken
BENT_MM = 5.0  # of command, from which on the finger looks bent
PATIENT = 1.5  # s for which a key is held that does not drive
TRIES = 4  # of a busy computer, on which an emulated servo's watchdog may trip
QUALITY = 82  # of the JPEG, of 100
SPACE = {"key": " ", "code": "Space", "windowsVirtualKeyCode": 32}


class ChromiumError(RuntimeError):
    """The browser refuses what it is asked for."""


def ask(page: ClientConnection, method: str, **params: Any) -> dict[str, Any]:
    """Ask the browser for something, and return its answer; other messages are left out."""
    page.send(json.dumps({"id": 1, "method": method, "params": params}))
    while (answer := json.loads(page.recv(timeout=20))).get("id") != 1:
        pass
    if "error" in answer:
        raise ChromiumError(f"chromium: {method}: {answer['error']['message']}")
    found: dict[str, Any] = answer["result"]
    return found


@contextlib.contextmanager
def browser(url: str) -> Iterator[ClientConnection]:
    """Open `url` in a browser without a window, and give the connection to its page."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--remote-debugging-port=0",
            f"--user-data-dir={folder}",
        ]
        command = ["chromium", *options, f"--window-size={SIZE[0]},{SIZE[1]}", url]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            port_file = Path(folder) / "DevToolsActivePort"
            until = time.monotonic() + 30
            while not port_file.exists() or not port_file.read_text().strip():
                if time.monotonic() > until or process.poll() is not None:
                    raise SystemExit("chromium did not start")
                time.sleep(0.1)
            port = port_file.read_text().split()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                pages = [tab for tab in json.load(answer) if tab["type"] == "page"]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None, compression=None) as page:
                yield page
        finally:
            process.terminate()
            process.wait(10)


def look(page: ClientConnection) -> tuple[str, float]:
    """Return the page's kind of state, and the larger command, mm; "" before it is there."""
    bars = (
        "[...document.querySelectorAll('.bar .value')].map(v => "
        "Math.abs(parseFloat(v.textContent)) || 0)"
    )
    asked = f"[document.body?.dataset.level || '', Math.max(0, ...{bars})]"
    try:
        level, largest = ask(page, "Runtime.evaluate", expression=asked, returnByValue=True)[
            "result"
        ]["value"]
    except (ChromiumError, KeyError):
        return "", 0.0
    return level, largest


def teleop_page(clip: Path) -> bytes | None:
    """Drive by the hand of a clip, and return the page as a JPEG while it drives.

    None where something ended that.
    """
    command = [sys.executable, "-c", "from softmap_edge.cli import main; raise SystemExit(main())"]
    command += ["teleop", "--sim", "--camera", str(clip), "--page", "0"]
    program = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        assert program.stderr is not None
        link = next((line for line in program.stderr if line.startswith("open ")), None)
        if link is None:
            raise SystemExit("softmap teleop did not start")
        with browser(link.split()[1]) as page:
            until = time.monotonic() + LONGEST
            while not look(page)[0] and time.monotonic() < until:
                time.sleep(0.1)
            while time.monotonic() < until:
                ask(page, "Input.dispatchKeyEvent", type="rawKeyDown", **SPACE)
                pressed = time.monotonic()
                while (now := look(page))[0] == "driving" or time.monotonic() < min(
                    pressed + PATIENT, until
                ):
                    if now[0] == "driving" and now[1] > BENT_MM:
                        picture = ask(
                            page, "Page.captureScreenshot", format="jpeg", quality=QUALITY
                        )["data"]
                        if look(page)[0] == "driving":
                            return base64.b64decode(picture)
                    time.sleep(0.1)
                ask(page, "Input.dispatchKeyEvent", type="keyUp", **SPACE)
                time.sleep(0.5)
        return None
    finally:
        program.terminate()
        program.wait(20)


def main(argv: Sequence[str] | None = None) -> int:
    """Take the picture, where everything that it needs is here."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).with_name("pictures"),
        help="folder for the picture",
    )
    args = parser.parse_args(argv)
    folder = find("hand")
    if shutil.which("chromium") is None or folder is None:
        absent = (
            "the clip of a hand (make data brings it)" if folder is None else "the command chromium"
        )
        print(f"teleop.jpg is not drawn again: {absent} is absent")
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    picture = next(
        (made for _ in range(TRIES) if (made := teleop_page(folder / "hand.mp4")) is not None), None
    )
    if picture is None:
        print(
            f"teleop.jpg is not drawn again: driving ended early {TRIES} times; try when the "
            "computer is less busy"
        )
        return 1
    (args.out / "teleop.jpg").write_bytes(picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
