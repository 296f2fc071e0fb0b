"""The process of a control loop, watched by a thread: its reports, and what follows when it dies or freezes.

`controller.py` starts it. Pinned by tests/test_nobody_watches.py.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import ServoError
from softmap_edge.servo import words
from softmap_edge.servo.bus import kept_torque, opened
from softmap_edge.servo.ending import kept_words
from softmap_edge.servo.rig import Rig

FROZEN = 0.6  # s without a report after which the loop's process is taken to be frozen
LOOKS = 6  # times in that at which its reports are looked for: a program that was frozen itself misses one of them


class Watched:
    """What is heard of a loop, and who releases its servos when it can do so no more."""

    rig: Rig
    _last: dict[str, Any]
    _end: dict[str, Any]
    _heard: threading.Condition
    _rescuing: threading.Lock
    _process: subprocess.Popen[bytes] | None
    _reader: threading.Thread
    _silent: int  # looks of the reader, one after the other, that found no report
    _ending: bool
    _drove: bool
    _stood: NDArray[np.float64]

    @property
    def state(self) -> str:
        """Where the guard stands: `off`, `connected`, `homed`, `ready`, `engaged`, `hold`, `safe_stop`, `fault`, …"""
        self._rescue_if_needed()
        return str(self._last.get("state", "off"))

    @property
    def position(self) -> NDArray[np.float64]:
        """Where the servos stand (C,), ticks, by the last report that heard each: one lost answer is no place."""
        return self._stood.copy()

    @property
    def report(self) -> dict[str, Any]:
        """The newest report of the loop (softmap.loop/1)."""
        return dict(self._last)

    @property
    def ended(self) -> dict[str, Any]:
        """The last report: why the loop ended and how it kept its time; empty while it runs."""
        return dict(self._end)

    @property
    def mended(self) -> list[str]:
        """What this start wrote anew in the servos, a line each: registers that another program had left."""
        return list(self._last.get("mended", []))

    @property
    def bus(self) -> dict[str, int]:
        """How the questions on the bus went so far: answers `asked` for, `lost`, `damaged`, and `unasked` ones."""
        return {name: int(self._last.get(name, 0)) for name in words.BUS}

    def _watch(self, pipe: int, process: subprocess.Popen[bytes]) -> None:
        """Take the loop's reports until it ends; release its servos if it dies or freezes under torque."""
        some = b""
        while True:
            if not select.select([pipe], [], [], FROZEN / LOOKS)[0]:
                self._silent += 1
                if self._frozen() and self._last.get("torque") and not self._ending:
                    self._rescue(process)
                continue
            self._silent, more = 0, os.read(pipe, 65536)
            *lines, some = (some + more).split(b"\n")
            for line in lines:
                self._hear(json.loads(line))
            if not more:
                break
        os.close(pipe)
        if not self._ending and not self._end and "error" not in self._last:
            self._rescue(process)
        with self._heard:
            self._last.setdefault("gone", self._last.get("rescued", "the process of the control loop has ended"))
            self._heard.notify_all()

    def _hear(self, document: dict[str, Any]) -> None:
        with self._heard:
            self._drove |= bool(document.get("torque"))
            if "ended" in document:
                self._end = document
            elif "rescued" not in self._last:  # what was said before is no news then
                denied = self._last.get("denied")
                self._last |= document
                self._last["denied"] = document.get("denied") or denied
                heard = np.array([np.nan if at is None else at for at in document.get("position", [])], float)
                if heard.shape == self._stood.shape:
                    self._stood = np.where(np.isnan(heard), self._stood, heard)
            self._heard.notify_all()

    def _frozen(self) -> bool:
        return self._silent >= LOOKS

    def _rescue_if_needed(self) -> None:
        process = self._process
        if process is None or "error" in self._last:
            return
        if process.poll() is not None and self._reader is not threading.current_thread():
            self._reader.join(FROZEN)  # why it ended is being read
        if (process.poll() is not None and not self._end and "error" not in self._last) or self._frozen():
            self._rescue(process)

    def _rescue(self, process: subprocess.Popen[bytes]) -> None:
        """End the loop and switch torque off from here, once: the servos hold by their watchdogs."""
        with self._rescuing:
            if "rescued" in self._last:
                return
            process.kill()
            process.wait()
            said, kept = "the control loop died or froze; its servos were released from here", ""
            try:
                with opened(self.rig.port, self.rig.baud, shared=True) as bus:
                    if left := kept_torque(bus, [servo.id for servo in self.rig.servos]):
                        kept = kept_words(left)
                        said = f"the control loop died or froze; torque off was sent from here, but {kept}"
            except ServoError as fault:
                kept = f"the servos could not be released ({fault}): switch them off"
                said = f"the control loop died or froze, and {kept}"
            with self._heard:
                self._last |= {"state": "fault", "cause": "loop", "torque": bool(kept), "rescued": said, "kept": kept}
                self._heard.notify_all()
