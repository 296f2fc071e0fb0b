"""The control loop's process by itself on an emulated robot: led into any state, its reports kept
with their times.
"""

import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import deque

import numpy as np
from rigs import BAUD, MODEL, NUMBER, TICKS_PER_MM, angles, set_up

from softmap_edge import _core
from softmap_edge.robot.control.controller import REQUESTS
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits

STATES = (
    "off",
    "connected",
    "homed",
    "ready",
    "engaged",
    "hold",
    "safe_stop",
    "fault",
    "commissioning",
)
LEADS_ON = dict(off="connect", connected="home", homed="arm", ready="engage", fault="acknowledge")
HOMES = (2000, 2400)  # apart, so that exchanged ids show
FAR = (2.0, 2.0)  # mm
# s between two words to the loop, and by how much one may be late on a machine that is not busy
BEAT, LAG = 0.02, 0.01
PATIENCE = 8.0  # s for anything that must happen at all, on a busy machine


class Loop:
    """A loop on two emulated servos; enable key and target are sent by a thread, fifty times a
    second.

    Its limits are quick ones, or as `usual`.
    """

    def __init__(self, usual=False, **changes):
        slew = changes.pop("slew", 2000.0)
        servos = [(id, NUMBER, BAUD, float(home)) for id, home in zip((1, 2), HOMES)]
        load = [[(home - 1000.0, -400.0), (home, 0.0), (home + 1000.0, 400.0)] for home in HOMES]
        self.bus = _core.EmulatedBus(servos, load, delay=0.01, lag=0.03, seed=3)
        set_up(self.bus.path, homes=HOMES)
        axes = [
            servo_limits(MODEL, home, (-900.0, 900.0)) | {"slew": slew, "following": 200.0}
            for home in HOMES
        ]
        quick = dict(stale=0.5, hold=60.0, late=0.04, silent=0.2, grace=0.1, ramp=0.1, slacken=10.0)
        quick |= dict(jog_travel=150.0, jog_slew=1000.0)
        if usual:
            self.limits = loop_limits(
                [servo_limits(MODEL, home, (-900.0, 900.0)) for home in HOMES]
            )
        else:
            self.limits = loop_limits(axes, 200.0, **quick | changes)
        # s in which a blocked servo is `following` ticks behind, on the way home
        self.path = 200.0 / (0.5 * slew)
        self.reports, self.ended, self._wake = [], {}, threading.Condition()
        self.drives, self.emergency, self.command = True, False, FAR
        self._beats = deque(maxlen=1000)  # s at which this process sent
        self.untouched = False  # nothing was broken since it was led to where it is
        orders, self._orders = os.pipe()
        mine, reports = os.pipe()
        setup = dict(
            port=self.bus.path, baud=BAUD, servos=[(1, NUMBER), (2, NUMBER)], limits=self.limits
        )
        setup |= dict(
            slope=(np.eye(2) / TICKS_PER_MM).reshape(-1).tolist(), b=[0.0, 0.0], home=HOMES
        )
        setup |= dict(homes=HOMES, gpio=None, heartbeat=None)
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "softmap_edge.robot.control.loop_process",
                str(orders),
                str(reports),
            ],
            stdin=subprocess.PIPE,
            pass_fds=(orders, reports),
        )
        os.close(orders)
        os.close(reports)
        self.process.stdin.write(json.dumps(setup).encode())
        self.process.stdin.close()
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=self._read, args=(mine,)),
            threading.Thread(target=self._drive),
        ]
        for thread in self._threads:
            thread.start()
        self.wait(lambda: self.reports or self.ended)

    def close(self):
        """End the loop, and the robot."""
        self.process.send_signal(signal.SIGCONT)
        self.emergency = True  # without torque it ends at once
        self.wait(lambda: self.ended or not self.reports[-1]["torque"])
        self._closed.set()
        self._threads[1].join()
        os.close(self._orders)
        try:
            self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._threads[0].join()
        self.bus.unplug()

    def _read(self, pipe):
        with open(pipe, encoding="utf-8") as lines:
            for line in lines:
                document = json.loads(line)
                with self._wake:
                    if "state" in document:
                        self.reports.append(document)
                    elif "ended" in document or "error" in document:
                        self.ended = document
                    self._wake.notify_all()
        with self._wake:
            self.ended = self.ended or {"ended": "dead"}
            self._wake.notify_all()

    def _drive(self):
        while not self._closed.wait(BEAT):
            self._beats.append(time.monotonic())
            self.send()

    def send(self, request=None):
        """Send what a user sends now, and a request."""
        flags = 5 * self.drives + 2 * self.emergency
        asked = 0 if request is None else REQUESTS.index(request) + 1
        try:
            os.write(
                self._orders,
                struct.pack("<BB6xQ2d", flags, asked, time.monotonic_ns(), *self.command),
            )
        except OSError:  # it has ended, or is stopped and its pipe is full
            assert self.ended or self._closed.is_set() or request is None

    # --- what it says -------------------------------------------------------------------

    @property
    def state(self):
        """Where the guard stood in the last report."""
        return self.reports[-1]["state"] if self.reports else None

    def wait(self, what, seconds=PATIENCE):
        """Wait until `what()`; whether it came."""
        with self._wake:
            return self._wake.wait_for(what, seconds)

    def changes(self, since, start):
        """Return the reports since `since` (s, monotonic) in which the state is another than
        before.
        """
        state, found = start, []
        for report in list(self.reports):
            if report["t"] >= since and report["state"] != state:
                found.append(report)
                state = report["state"]
        return found

    def ask(self, request, seconds=PATIENCE):
        """Ask once; why it was denied, or None if it led somewhere."""
        before, count = self.state, len(self.reports)
        self.send(request)

        def answers():
            return [one for one in self.reports[count:] if one["denied"] or one["state"] != before]

        assert self.wait(answers, seconds), f"'{request}' is not answered in {before}"
        return answers()[0]["denied"]

    def busy(self, since):
        """Whether this process or the loop's was kept from running since then (s, monotonic)."""
        beats = [since, *(beat for beat in list(self._beats) if beat > since), time.monotonic()]
        overruns = [
            report["overruns"] for report in list(self.reports) if report["t"] > since - 0.1
        ]
        return bool(np.diff(beats).max() > BEAT + LAG or (overruns and overruns[-1] > overruns[0]))

    # --- into a state -------------------------------------------------------------------

    def reach(self, request, state):
        """Ask until `state` is reached: what servos say of themselves comes five times a second."""
        until = time.monotonic() + PATIENCE
        while self.state != state:
            said = self.ask(request)
            assert said is None or time.monotonic() < until, f"'{request}' is denied: {said}"
            if said is not None:
                time.sleep(0.02)
        return self

    def restore(self):
        """Mend everything and lead the guard to OFF."""
        self.emergency, self.command = True, FAR
        assert self.wait(lambda: self.state in ("fault", "off") and not self.reports[-1]["torque"])
        self.bus.mend()
        self.emergency = False
        if self.state == "fault":
            until = time.monotonic() + PATIENCE
            while self.ask("acknowledge") is not None:
                assert time.monotonic() < until, "never acknowledged"
                time.sleep(0.02)
            self.reach("disconnect", "off")

    def bring(self, state):
        """Lead the guard from OFF to `state`; engaged, it stands far out. A busy machine may end it
        on the way.
        """
        for _ in range(3):
            if self._lead(state) and self.state == state:
                return
            self.restore()
        raise AssertionError(f"never {state}: {self.reports[-1]}")

    def _lead(self, state):
        """Lead the guard on, once; whether it went all the way."""
        if state == "off":
            return True
        self.reach("connect", "connected")
        if state == "fault":
            self.reach("home", "homed")
            self.emergency = True
            assert self.wait(lambda: self.state == "fault")
            self.emergency = False
            time.sleep(0.03)
        if state in ("connected", "fault"):
            return True
        self.reach("home", "homed")
        if state == "commissioning":
            self.reach("commission", "commissioning")
            return self._arrives("commissioning", 150.0)
        if state == "homed":
            return True
        self.reach("arm", "ready")
        if state == "ready":
            return True
        self.reach("engage", "engaged")
        arrived = self._arrives("engaged", FAR[0] * TICKS_PER_MM)
        if arrived and state in ("hold", "safe_stop"):
            self.reach({"hold": "hold", "safe_stop": "stop"}[state], state)
        return arrived

    def _arrives(self, state, away):
        """Wait in `state` until the horns stand `away` (ticks); a busy machine may leave it on the
        way.
        """
        far = np.array(HOMES) + away
        until = time.monotonic() + PATIENCE
        while np.abs(self.angles() - far).max() > 12.0:
            if self.state != state:
                return False
            assert time.monotonic() < until, f"{self.angles()} is not {far}: {self.reports[-1]}"
            time.sleep(0.005)
        return True

    def angles(self):
        """Return how far the horns have really turned, ticks."""
        return angles(self.bus)
