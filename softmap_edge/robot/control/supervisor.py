"""A thread that watches the process of the control loop, and acts if it dies or freezes.

`controller.py` starts it. Pinned by tests/robot/test_nobody_watches.py.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import threading
import weakref
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import RecordingBroken, ServoError
from softmap_edge.robot.remedies import filled
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.bus import kept_torque, opened
from softmap_edge.robot.servo.loop_types import BusCounts, LoopLimits, LoopReport, bus_counts
from softmap_edge.robot.servo.rig import Rig
from softmap_edge.run.fields import unmasked

LOOK = 0.1  # s between two checks for reports


class Running(Protocol):
    """The holder of the pipe of a running loop."""

    def _let_go(self) -> None: ...


running: weakref.WeakSet[Running] = weakref.WeakSet()


def numbers(command: ArrayLike) -> NDArray[np.float64] | None:
    """Return a command as an array of real numbers; None if it is not one."""
    try:
        found = np.asarray(command)
        return None if np.iscomplexobj(found) else unmasked(command)
    except (TypeError, ValueError):
        return None


def _forked() -> None:
    for robot in running:
        robot._let_go()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def _has_more(pipe: int, seconds: float) -> bool:
    """Return whether a pipe has bytes or has ended, after waiting for at most `seconds`."""
    poll = select.poll()  # `select` takes only descriptors below 1024
    poll.register(pipe, select.POLLIN)
    return bool(poll.poll(1e3 * seconds))


class Supervisor:
    """Read the reports of a loop, and release its servos if the loop cannot."""

    rig: Rig
    limits: LoopLimits
    # whether a command of the CLI drives: its user cannot call methods
    at_terminal: bool = False
    _drove_at: float | None
    _last: LoopReport
    _end: LoopReport
    _heard: threading.Condition
    _rescuing: threading.Lock
    _process: subprocess.Popen[bytes] | None
    _reader: threading.Thread
    # consecutive checks without a report: more than one, because a frozen program misses one too
    _silent: int
    _reports: int  # pipe of the reports; -1 without one
    _reading: threading.Lock
    _some: bytes  # part of a report that is not complete yet
    _ending: bool
    _drove: bool
    _stood: NDArray[np.float64]
    _record: Path | None
    _broken: str | None = None  # why the recording ended early
    _recorded = False  # whether the recording was checked after the end of the loop
    _mark: Path | None = None  # mark file of the session

    @property
    def state(self) -> str:
        """The state of the guard: `off`, `connected`, `homed`, `ready`, `engaged`, `hold`, …

        Also `safe_stop` and `fault`.
        """
        self._rescue_if_needed()
        return str(self._last.get("state", "off"))

    @property
    def position(self) -> NDArray[np.float64]:
        """The positions (C,) of the servos, ticks, from the last report that contains each.

        A single lost answer does not change them.
        """
        return self._stood.copy()

    @property
    def report(self) -> LoopReport:
        """The newest report of the loop (softmap.loop/1)."""
        return self._last.copy()

    @property
    def ended(self) -> LoopReport:
        """The last report: why the loop ended, and its timing; empty while it runs."""
        return self._end.copy()

    @property
    def recording(self) -> Path | None:
        """The recording file; it can be read while it grows."""
        return self._record

    @property
    def unrecorded(self) -> str | None:
        """Why the recording ended before the loop (for example a full disk); None if it did not."""
        if self._record is not None and self._broken is None and not self._recorded:
            ended = bool(self._end) and self._process is None
            lost = int(self._end.get("lost", 0)) if ended else 0
            from softmap_edge.robot.control.recording_end import broken_recording

            self._broken = broken_recording(self._record, self._last.get("unrecorded"), lost, ended)
            self._recorded = ended
        return self._broken

    def check_recorded(self) -> None:
        """Raise RecordingBroken if a recording ended before the loop."""
        if self.unrecorded is not None:
            raise RecordingBroken(self.unrecorded)

    @property
    def mended(self) -> list[str]:
        """A line for each register that this start rewrote because its value differed."""
        return list(self._last.get("mended", []))

    @property
    def bus(self) -> BusCounts:
        """Counts of answers on the bus so far: `asked` for, `lost`, `damaged` and `unasked`."""
        return bus_counts(self._last)

    def _stopped(self) -> str:
        """Return state, cause and remedy for the user of a CLI command, or of a program."""
        what = self._silence() or words.where(self._last, self.limits)
        do = words.onward(self._last, terminal=self.at_terminal, has_rig=self.rig.file is not None)
        return self._named(f"the robot is {what}; {do}")

    def _named(self, message: str) -> str:
        """Return a message whose commands name the rig file, if the rig was read from one."""
        return filled(message, self.rig.file)

    def _silence(self) -> str | None:
        """Return state and cause if the guard released tension because no target arrived.

        Sending no target counts as releasing the enable key.
        """
        silent = 0.0 if self._drove_at is None else self.rig.time.now() - self._drove_at
        if self._last.get("cause") not in ("deadman", "stale") or silent <= float(
            self.limits["stale"]
        ):
            return None
        return (
            f"in state {words.state(self._last)} (this program sent no target for {silent:.1f} s)"
        )

    def _watch(self, pipe: int, process: subprocess.Popen[bytes]) -> None:
        """Process the loop's reports until it ends; release servos if it dies or freezes.

        Freezing counts only under torque.
        """
        complete = False
        while not complete:
            if _has_more(pipe, LOOK):
                complete = not self._take()
                continue
            self._silent += 1
            if self._frozen() and self._last.get("torque") and not self._ending:
                self._rescue(process)
        with self._reading:
            self._reports = -1
            os.close(pipe)
        if not self._ending and not self._end and "error" not in self._last:
            self._rescue(process)
        with self._heard:
            self._last.setdefault(
                "gone", self._last.get("rescued", "the process of the control loop has ended")
            )
            self._heard.notify_all()

    def _take(self) -> bool:
        """Process received reports; return whether more may come.

        Also called after each step of simulated time.
        """
        with self._reading:
            while self._reports >= 0 and _has_more(self._reports, 0.0):
                self._silent, more = 0, os.read(self._reports, 65536)
                if not more:
                    return False
                *lines, self._some = (self._some + more).split(b"\n")
                for line in lines:
                    self._hear(json.loads(line))
        return True

    def _drained(self) -> None:
        """Process all received reports, so that the known state of the loop is the newest."""
        self._take()

    def _hear(self, document: LoopReport) -> None:
        with self._heard:
            self._drove |= bool(document.get("torque"))
            if "ended" in document:
                self._end = document
            elif "rescued" not in self._last:  # after a rescue, earlier reports are outdated
                denied = self._last.get("denied")
                self._last |= document
                self._last["denied"] = document.get("denied") or denied
                heard = np.array(
                    [np.nan if at is None else at for at in document.get("position", [])], float
                )
                if heard.shape == self._stood.shape:
                    self._stood = np.where(np.isnan(heard), self._stood, heard)
            self._heard.notify_all()

    def _frozen(self) -> bool:
        return self._silent * LOOK >= self.rig.time.frozen - 0.5 * LOOK

    def _rescue_if_needed(self) -> None:
        process = self._process
        if process is None or "error" in self._last:
            return
        if process.poll() is not None and self._reader is not threading.current_thread():
            # the thread is reading why the loop ended
            self._reader.join(self.rig.time.patience(0.6))
        if (
            process.poll() is not None and not self._end and "error" not in self._last
        ) or self._frozen():
            self._rescue(process)

    def _rescue(self, process: subprocess.Popen[bytes]) -> None:
        """End the loop and switch torque off from here, once; watchdogs only stop the servos."""
        with self._rescuing:
            if "rescued" in self._last:
                return
            process.kill()
            process.wait()
            rescued, kept = "the control loop died or froze; its servos were released from here", ""
            try:
                with opened(self.rig.port, self.rig.baud, shared=True) as bus:
                    if left := kept_torque(bus, [servo.id for servo in self.rig.servos]):
                        kept = words.kept_words(left)
                        rescued = (
                            "the control loop died or froze; torque off was sent from here, but "
                            f"{kept}"
                        )
            except ServoError as fault:
                kept = f"the servos could not be released ({fault}): switch them off"
                rescued = f"the control loop died or froze, and {kept}"
            with self._heard:
                self._last |= {
                    "state": "fault",
                    "cause": "loop",
                    "torque": bool(kept),
                    "rescued": rescued,
                    "kept": kept,
                }
                self._heard.notify_all()
