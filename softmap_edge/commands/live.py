"""`softmap compare --live`: the model error on a running robot.

It follows the recording of the loop and a camera.
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.commands.own import load_own, open_model
from softmap_edge.commands.seeing import late, receiver
from softmap_edge.comparison.live import Live, LiveError
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.files.printable import printable, raw
from softmap_edge.robot.control.follow import Following

if TYPE_CHECKING:
    from softmap_edge.commands.options import CompareOptions

LOOK = 0.25  # s between two reads of the recording
LINES = 2.0  # s between two lines if the output is not a terminal
BEGINS = 30.0  # s within which a recording must begin


def compare_live(args: CompareOptions) -> int:
    """Follow a recording and a camera until the recording ends, `--seconds` are over, or Ctrl-C."""
    if args.camera is None:
        raise SoftmapError("--live needs eyes: give --camera udp://:PORT (docs/do/camera.md)")
    if args.run is None or Path(args.run).suffix != ".mcap":
        raise SoftmapError(
            "--live follows what a loop records: give its .mcap file, as of `softmap track "
            "--record`"
        )
    if args.html or len(args.bundle or []) > 1:
        raise SoftmapError(
            "--live compares one bundle and writes no page; record a run and compare that"
        )
    load_own(args)
    model = open_model(args.bundle[0] if args.bundle else None)
    live = Live(model, late(args))
    loop = _begun(args.run)
    with receiver(args, len(model.rest)) as camera:
        effects = ", ".join(model.chain_names) or "none"
        if not args.json:
            print(f"'{model.robot}', effects of the model: {effects}; Ctrl-C ends it", flush=True)
        printed, now = -LINES, live.compared()
        with contextlib.suppress(KeyboardInterrupt):
            begun = time.monotonic()
            while True:
                live.drove(loop.new())
                live.saw(camera.seen())
                now = live.compared()
                t = time.monotonic() - begun
                if sys.stdout.isatty() and not args.json:
                    print(f"\r{printable(str(now))}", end="", file=raw(sys.stdout), flush=True)
                elif t - printed >= LINES:
                    printed = t
                    print(json.dumps(now.to_dict()) if args.json else now, flush=True)
                if loop.ended or (args.seconds is not None and t >= args.seconds):
                    break
                time.sleep(LOOK)
        document = now.to_dict() | {
            "whole": True,
            "robot": model.robot,
            "effects": list(model.chain_names),
            "came": camera.taken,
            "refused": dict(camera.refused),
            "lost": camera.lost,
        }
        print(
            json.dumps(document) if args.json else _summary(now, effects, camera.summary()),
            flush=True,
        )
    return 0 if now.frames else 1


def _begun(path: str) -> Following:
    """Return the recording once it exists.

    Raises:
        RunError: it does not begin.
    """
    end = time.monotonic() + BEGINS
    if not Path(path).exists():
        print(f"waiting up to {BEGINS:g} s for {path} to be begun", file=sys.stderr, flush=True)
    while not Path(path).exists():
        if time.monotonic() > end:
            raise RunError(
                f"{path}: no recording began within {BEGINS:g} s; start what is recorded with "
                "--record"
            )
        time.sleep(LOOK)
    return Following(path)


def _summary(now: LiveError, effects: str, ending: str) -> str:
    lines = [
        "",
        f"{now}",
        f"worst frame {now.worst_mm:.2f} mm; effects of the model: {effects}; {ending}",
    ]
    if not now.frames:
        lines.append("nothing was compared: no frame came while the servos were heard")
    if now.left_out:
        lines.append(
            f"{now.left_out} frames were left out: before the first position, or more than could "
            "be followed"
        )
    return "\n".join(lines)
