"""Drive a robot from Python: a context manager around the process of the control loop.

    with Controller(rig, calibration, limits) as robot:
        robot.engage()
        for u in path:
            done = robot.target(u)   # commanded mm in, effective mm out; call it at least every
                                     # `stale` seconds
            time.sleep(0.02)

Python sends commands, never ticks. The loop guards them (docs/reference/safety.md) and never waits
for Python. If a program stops calling `target`, ends or is killed, the guard holds and then
releases tension. If the process of the loop dies or freezes, the watchdogs stop the servos, and a
thread on this side switches their torque off, whatever the program is doing. A servo that does not
confirm at the end that its torque is off is an error. Pinned by tests/robot/test_controller.py and
tests/robot/test_leaving.py.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge import _core
from softmap_edge.errors import GuardStopped, RecordingBroken, ServoError, SoftmapError
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control import session_mark
from softmap_edge.robot.control.supervisor import Supervisor, numbers, running
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.servo.clock import FROZEN, Clock
from softmap_edge.robot.servo.known_state import gains_of
from softmap_edge.robot.servo.loop_types import LoopLimits, LoopReport
from softmap_edge.robot.servo.rig import Rig
from softmap_edge.robot.servo.rig_ceiling import check_against_rig
from softmap_edge.robot.servo.status_words import kept_words

Floats = NDArray[np.float64]

REQUESTS = (
    "connect",
    "home",
    "arm",
    "engage",
    "hold",
    "stop",
    "acknowledge",
    "disconnect",
    "commission",
)
STARTS = 10.0  # s until the first report of the loop's process
SAID = 2.0  # s within which each servo has reported its torque
PASSING = ("torque", "trouble(late)")  # reasons for a denied request that may pass soon
ACTIVE = ("engaged", "hold", "safe_stop", "commissioning")


class Controller(Supervisor):
    """Drive the servos of `rig` within `limits` (`loop_limits`).

    `calibration` maps commands to ticks.

    With `kinematics` (`motion.kinematics`), commands are the effective ones: the loop compensates
    the effects of its model, except delays, from the values that were sent.

    Entering starts the loop, checks that the servos match the rig and were homed since power-up
    (`home_mark.py`), and goes to READY. With `commissioning` it goes to CONNECTED; homing is not
    required, and only small slow moves are allowed (`jog.py`). Leaving always releases tension and
    switches torque off.

    With `record`, all inputs, decisions and outputs of the loop go to a new file (`recording.py`).
    A full disk ends the recording, not the loop: `unrecorded` then holds the cause, and leaving
    raises `RecordingBroken`.

    `tell` is called with lines for the user: registers rewritten by a start (`mended`), lost or
    unrequested answers (`bus`).

    Raises:
        ServoError: a limit is missing or out of range, the loop cannot start, or a request is
            denied; the message says why.
    """

    def __init__(
        self,
        rig: Rig,
        calibration: Calibration,
        limits: LoopLimits,
        *,
        kinematics: Kinematics | None = None,
        record: str | Path | None = None,
        commissioning: bool = False,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        count = len(rig.servos)
        if len(calibration.b) != count or len(limits["servos"]) != count:
            raise ServoError(
                f"the rig has {count} servos, the calibration {len(calibration.b)}, the limits "
                f"{len(limits['servos'])}; they must agree"
            )
        self.rig, self.limits = rig, limits.copy()
        _core.check_limits(self.limits)
        if not commissioning:
            check_against_rig(rig, self.limits)
        self.calibration = calibration.turned([servo["home"] for servo in self.limits["servos"]])
        if kinematics is not None and kinematics.model.channels != count:
            raise ServoError(
                f"the model takes {kinematics.model.channels} commands, the rig has {count} servos"
            )
        self.kinematics = kinematics
        self.tell = tell
        self._commissioning = commissioning
        self._record = None if record is None else Path(record)
        self._last: LoopReport = {}
        self._end: LoopReport = {}
        self._heard = threading.Condition()
        self._process: subprocess.Popen[bytes] | None = None
        self._orders = -1
        self._ordering = threading.Lock()
        self._rescuing = threading.Lock()
        self._ending = self._drove = False
        self._stood: Floats = np.full(count, np.nan)
        self._done = self.calibration.b
        self._command: Floats | None = None
        self._drove_at: float | None = None  # s of the last target; None after the key is released
        self._pressed = False
        self._silent, self._reports, self._some = 0, -1, b""
        self._reading = threading.Lock()

    def __enter__(self) -> Self:
        session_mark.report_last(self.rig.port)
        self._start()
        try:
            self._wait(
                lambda: None not in (self._last.get("position") or [None]),
                STARTS,
                "the servos do not answer",
            )
            self._mark = session_mark.begin(
                self.rig.port, self._record, self._process.pid if self._process else 0
            )
            self._wait_for_release()
            for request in ("connect",) if self._commissioning else ("connect", "home", "arm"):
                self._reach(request)
        except BaseException:
            self.close()
            raise
        for line in self.mended:
            self.tell(line)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        ended, kept = self._close()
        if isinstance(fault, GuardStopped) and fault.cause == self._last.get("cause"):
            ended = ""  # the fault that ended the drive is reported already
        broken = (
            None if self.unrecorded is None or self.unrecorded in str(fault) else self.unrecorded
        )
        message = "; ".join(filter(None, (ended, kept, broken)))
        if message and isinstance(fault, SoftmapError):
            raise ServoError(f"{fault}; {message}") from fault
        if message and fault is not None and not kept:
            fault.add_note(message)  # no servo has torque, so the original error goes on
        elif message:
            raise ServoError(message) if ended or kept else RecordingBroken(message)

    @property
    def time(self) -> Clock:
        """The clock of the robot; a simulated one may stand still, or run faster than real time."""
        return self.rig.time

    def request(self, name: str, seconds: float = 3.0) -> None:
        """Request a change of the guard's state.

        It is `connect`, `disconnect`, `arm`, `engage`, `hold`, `stop`, `acknowledge` or
        `commission`. There is no `home`: only a start checks that the robot was homed since
        power-up.

        Raises:
            ServoError: there is no such request, it was denied, or the loop did not answer.
        """
        if name == "home":
            raise ServoError(
                f"the robot is in state {self.state}, and a running loop cannot home it (turns "
                "are lost without power); close the Controller and start another, which looks "
                "for the proof of `softmap servo home`"
            )
        if name not in REQUESTS:
            raise ServoError(
                f"no request '{name}'; there are "
                f"{', '.join(one for one in REQUESTS if one != 'home')}"
            )
        if name in ("connect", "acknowledge"):
            self._reach(name, seconds)
        else:
            self._ask(name, seconds)

    def _ask(self, name: str, seconds: float = 3.0) -> None:
        reached = {
            "connect": "connected",
            "home": "homed",
            "arm": "ready",
            "disconnect": "off",
        }.get(name)
        with self._heard:
            self._last.pop("denied", None)
            before = self._last.get("state")
        engages = name == "engage"
        self._send(
            self._command if engages else None, deadman=engages, request=REQUESTS.index(name) + 1
        )
        if name in ("stop", "hold"):
            return
        self._wait(
            lambda: self._last.get("denied") or self._last.get("state") not in (before, None),
            seconds,
            f"'{name}' was not answered",
        )
        if denied := self._last.get("denied"):
            why = words.denied(denied, self._last, self.limits)
            raise ServoError(
                self._named(f"'{name}' is denied {words.where({'state': before or 'off'})}: {why}")
            )
        if reached is not None and self._last["state"] != reached:
            raise ServoError(f"'{name}' led to another state: {self._stopped()}")

    def engage(self, u: ArrayLike | None = None) -> Floats:
        """Switch torque on at the current position and go to `u` (C,) mm, by default straight.

        Returns:
            The effective command.

        Raises:
            ServoError: it is denied.
        """
        done = self._target(self.calibration.b if u is None else u)
        self.request("engage")
        return done

    def target(self, u: ArrayLike) -> Floats:
        """Send the command `u` (C,) mm; return the effective one.

        That is the nearest command within the window of the servos. The guard rejects a command
        that is not finite, and the previous one remains effective. Each call counts as a pressed
        enable key: a program that stops calling releases the key.

        Raises:
            ServoError: `u` is not C numbers, or the guard follows no commands in its state; the
                message says which and why.
        """
        state = self.state
        if state not in ("engaged", "hold", "commissioning"):
            raise GuardStopped.by(self._stopped(), self._last.get("cause"))
        return self._target(u)

    def release(self) -> None:
        """Release the enable key: the guard holds, then releases tension."""
        self._drove_at = None
        self._send(deadman=False)

    def emergency(self, pressed: bool = True) -> None:
        """Press the emergency stop, or release it: torque is off at once.

        Torque stays off until the stop is released and `request("acknowledge")` is sent. The robot
        stays homed. May be called from any thread.

        Raises:
            ServoError: the loop does not answer; this process switched torque off instead.
        """
        self._pressed = pressed  # set before sending, so that every later order contains it
        self._send()
        if not pressed:
            return
        off = self.rig.time.wait_for(
            self._heard,
            lambda: self._last.get("emergency") and not self._last.get("torque"),
            FROZEN,
        )
        process = self._process  # another thread may be closing it
        if not off and process is not None:
            self._rescue(process)
            raise ServoError(str(self._last["rescued"]))

    def close(self) -> None:
        """Release tension, switch torque off and end the loop; torque off is sent whatever fails.

        Raises:
            ServoError: a servo has not confirmed that its torque is off, or a fault kept the finger
                from going home. Earlier calls have already raised earlier faults.
            RecordingBroken: the recording ended before the loop did.
        """
        if message := "; ".join(filter(None, self._close())):
            raise ServoError(message)
        self.check_recorded()

    def _close(self) -> tuple[str, str]:
        """Return why the finger did not go home, and a message on servos that may have torque."""
        process = self._process
        if process is None:
            return "", ""
        ended = ""
        try:
            if active := self._last.get("state") in ACTIVE:
                self._send(request=REQUESTS.index("stop") + 1)
                self.rig.time.wait_for(
                    self._heard,
                    lambda: (
                        self._last.get("state") not in ACTIVE
                        or self._frozen()
                        or "gone" in self._last
                    ),
                    float(self.limits["slacken"]) + 2.0,
                )
            if active and self._last.get("state") == "fault" and not self._pressed:
                ended = self._stopped()
        finally:
            with self._ordering:
                self._ending, self._process = True, None
                os.close(self._orders)
                self._orders = -1
            patience = self.rig.time.patience(3.0)
            try:
                with self.rig.time.running():
                    process.wait(patience)
            except subprocess.TimeoutExpired:
                self._rescue(process)
            self._reader.join(patience)
            if process.returncode != 0 and "error" not in self._last:
                self._rescue(process)
            session_mark.end(self._mark)
        if message := words.bus(self.bus):
            self.tell(message)
        left = self._end.get("kept_torque") if self._drove else None
        return ended, str(self._last.get("kept") or (kept_words(left) if left else ""))

    # --- the loop's process -------------------------------------------------------------

    def _start(self) -> None:
        if self._record is not None and self._record.exists():
            raise ServoError(f"{self._record} exists; give another name to record to")
        orders, self._orders = os.pipe()
        mine, reports = os.pipe()
        os.set_blocking(self._orders, False)
        setup = {
            "port": self.rig.port,
            "baud": self.rig.baud,
            "servos": self.rig.numbers,
            "homes": None if self._commissioning else [servo.home for servo in self.rig.servos],
            "gains": [gains_of(self.rig.made, servo.id) for servo in self.rig.servos],
            "limits": self.limits,
            "slope": self.calibration.A.reshape(-1).tolist(),
            "b": self.calibration.b.tolist(),
            "home": self.calibration.home.tolist(),
            "chain": None if self.kinematics is None else self.kinematics.document(),
            **self.rig.emergency.setup(),
        }
        if self._record is not None:
            from softmap_edge.version import __version__

            about = {
                "schema": "softmap.setup/1",
                "softmap": __version__,
                "calibration": self.calibration.to_dict(),
            }
            setup |= {"record": str(self._record.absolute()), "setup": json.dumps(about | setup)}
        setup["session"] = session_mark.path_of(self.rig.port)
        # A session of its own: Ctrl-C in the terminal reaches only this process, which releases
        # tension and ends the loop in order.
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "softmap_edge.robot.control.loop_process",
                str(orders),
                str(reports),
            ],
            stdin=subprocess.PIPE,
            pass_fds=(orders, reports),
            start_new_session=True,
        )
        os.close(orders)
        os.close(reports)
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(setup).encode())
        self._process.stdin.close()
        self._silent, self._reports, self._some = 0, mine, b""
        self.rig.time.each_step(self._drained)
        running.add(self)
        self._reader = threading.Thread(target=self._watch, args=(mine, self._process), daemon=True)
        self._reader.start()

    def _reach(self, request: str, seconds: float = 3.0) -> None:
        """Repeat a request until it is granted.

        A servo reports its torque five times a second, and one late answer is not a lasting fault.
        """
        until = self.rig.time.now() + SAID
        while True:
            try:
                return self._ask(request, seconds)
            except ServoError:
                if (
                    not str(self._last.get("denied")).startswith(PASSING)
                    or self.rig.time.now() > until
                ):
                    raise
            self.rig.time.sleep(0.05)

    def _wait_for_release(self) -> None:
        """Wait while an emergency stop of the rig is pressed: heartbeats arrive with a delay."""
        heard, last = self._heard, self._last
        if not self.rig.time.wait_for(
            heard, lambda: not last.get("emergency") or "gone" in last, STARTS
        ):
            raise ServoError(
                f"the emergency stop is pressed or dead ({self.rig.emergency}); release it, start "
                "`softmap servo heartbeat` on its computer, or mend [emergency] of rig.toml"
            )

    def _wait(self, what: Callable[[], object], seconds: float, message: str) -> None:
        self.rig.time.wait_for(
            self._heard, lambda: what() or "error" in self._last or "gone" in self._last, seconds
        )
        with self._heard:
            last, came = self._last, what()
        if "error" in last:
            raise ServoError(self._named(str(last["error"])))
        if "gone" in last:
            raise ServoError(str(last["gone"]))
        if not came:
            raise ServoError(
                self._named(
                    f"{message} within {seconds:g} s (bus: {last.get('bus')}); check power and "
                    "wiring: `softmap servo doctor --rig FILE` names what does not answer"
                )
            )

    def _send(
        self, command: Floats | None = None, *, deadman: bool = False, request: int = 0
    ) -> None:
        numbers = np.zeros(len(self.rig.servos)) if command is None else command
        flags = (
            (1 if deadman else 0) | (2 if self._pressed else 0) | (4 if command is not None else 0)
        )
        frame = struct.pack(
            f"<BB6xQ{len(numbers)}d", flags, request, round(self.rig.time.now() * 1e9), *numbers
        )
        try:
            # another thread may press the emergency stop at any time, also before and after this
            with self._ordering:
                if self._process is not None:
                    os.write(self._orders, frame)
        except (BlockingIOError, BrokenPipeError):
            self._rescue_if_needed()

    def _target(self, command: ArrayLike) -> Floats:
        u, shape = numbers(command), self.calibration.b.shape
        if u is None or u.shape != shape:
            found = f"'{command!s:.40}'" if u is None else f"of shape {u.shape}"
            raise ServoError(
                f"a command {found}, expected shape {shape}: {shape[0]} real numbers, one a servo"
            )
        self._command, self._drove_at = u, self.rig.time.now()
        self._send(u, deadman=True)
        if np.isfinite(u).all():
            self._done = self._nearest(u)
        return self._done.copy()

    def _nearest(self, u: Floats) -> Floats:
        if self.kinematics is not None and self.kinematics.model.chain_names:
            return np.clip(u, *self.kinematics.acting_bounds.T)
        return self.calibration.within(
            u, *([one[end] for one in self.limits["servos"]] for end in ("low", "high"))
        )

    def _let_go(self) -> None:
        """Close the copy of the orders' pipe in a forked child; it would outlive the program."""
        if self._orders >= 0:
            os.close(self._orders)
            self._orders, self._process = -1, None
