"""A hand, or a knob, that drives emulated servos through the real loop, for tests: its camera, its
key, a session.
"""

import threading
import time
from contextlib import contextmanager

import numpy as np
from rigs import HOME, TICKS_PER_MM, angles, calibration, emulated_rig, torque

from softmap_edge import builtin_model
from softmap_edge.errors import TeleopError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.teleop.drive import Drive
from softmap_edge.robot.teleop.frames import Frame
from softmap_edge.robot.teleop.hand import Hand, View
from softmap_edge.robot.teleop.hand_source import CameraHandSource, NullHandSource
from softmap_edge.robot.teleop.keys import Controls, Wish
from softmap_edge.robot.teleop.mapping import DirectMapping, TipMapping

MODEL = builtin_model()
PATIENT = 15.0  # s: a busy machine
PICTURE = np.zeros((8, 8, 3), np.uint8)


def hand(aside=0.0, forward=0.8, fist=False):
    """Return a hand of 100 px whose index finger shows (forward, aside): positive to its owner's
    right, who is seen from in front.
    """
    points = np.zeros((21, 2))
    points[0], points[9], points[5] = (300, 400), (300, 300), (330, 310)
    points[8] = points[5] + 100 * np.array([-aside, -forward])
    for knuckle, tip in ((9, 12), (13, 16), (17, 20)):
        points[knuckle] = points[9] if knuckle == 9 else (300 - 3 * knuckle, 320)
        points[tip] = points[knuckle] + (0, 20 if fist else -90)
    return Hand(points, "right")


class Camera:
    """Pictures at 60 a second; `gone` ends them as a camera that is unplugged."""

    def __init__(self):
        self.gone = self.still = False

    def __iter__(self):
        for number in range(1_000_000):
            time.sleep(1 / 60)
            while self.still:
                time.sleep(0.01)
            if self.gone:
                raise TeleopError("camera 0: is gone (unplugged?); plug it in and begin again")
            yield Frame(PICTURE, time.monotonic(), number)

    def close(self):
        self.still = False
        self.gone = True


class Finder:
    """Sees `hands`, what they are now, but for the next `misses` pictures."""

    def __init__(self):
        self.hands, self.misses = [hand()], 0

    def see(self, picture, t):
        if self.misses:
            self.misses -= 1
            return []
        return list(self.hands)

    def close(self):
        pass


class Fingers:
    """An input: the key and the knob."""

    name = "the test"

    def __init__(self, source):
        self.source, self.held, self.knob, self.wish, self.rested = (
            source,
            False,
            (0.0, 0.0),
            Wish(),
            (0.0, 0.0),
        )

    def controls(self, now):
        return Controls(self.held, self.knob, self.source)

    def asked(self):
        return self.wish.take()

    def rest(self, knob):
        self.rested = knob


class Session:
    """A drive that runs in a thread."""

    cameras = Camera

    def __init__(self, source="hand", aim=DirectMapping, options=None, **limits):
        self.source, self.aim, self.options, self.limits = source, aim, options or {}, limits

    @contextmanager
    def running(self):
        self.camera, self.finder, self.fingers, self.lines = (
            self.cameras(),
            Finder(),
            Fingers(self.source),
            [],
        )
        eyes = (
            CameraHandSource("camera 0", self.camera, self.finder, View())
            if self.source == "hand"
            else NullHandSource()
        )
        kinematics = Kinematics(MODEL, axes="xy" if self.aim is TipMapping else "xyz")
        with (
            emulated_rig(**{"hold": 0.6, **self.limits}) as (self.bus, rig, limits),
            eyes,
            Controller(rig, calibration(), limits, kinematics=kinematics) as self.robot,
        ):
            self.drive = Drive(self.robot, kinematics, self.aim(kinematics), eyes, [self.fingers],
                               say=self.lines.append, show=self.take, **self.options)  # fmt: skip
            self.moment = None
            thread = threading.Thread(target=self.drive.run, daemon=True)
            thread.start()
            try:
                self.until(
                    lambda: self.moment is not None and (self.source == "knob" or eyes.hands > 2)
                )
                yield self
            finally:
                self.fingers.wish.ask("end")
                thread.join(PATIENT)
                assert not thread.is_alive()

    def take(self, moment):
        self.moment = moment

    def until(self, what, seconds=PATIENT):
        begin = time.monotonic()
        while not what():
            assert time.monotonic() - begin < seconds, (self.lines, self.moment)
            time.sleep(0.005)

    def stands(self, u):
        """Wait until the horns have turned to `u` mm."""
        self.until(lambda: np.abs(angles(self.bus) - HOME - TICKS_PER_MM * np.array(u)).max() < 15)

    def presses(self):
        """Press, and wait until it drives."""
        self.fingers.held = True
        self.until(lambda: self.moment.clutch.stage == "driving" and self.robot.state == "engaged")

    def lets_go(self):
        self.fingers.held = False
        self.until(lambda: self.moment.clutch.stage == "released")

    def stays_lost(self, why):
        """Driving ended for this reason; the guard holds, then releases tension, and nothing goes
        on while the key is held.
        """
        self.until(lambda: self.moment.clutch.stage == "lost")
        assert why in self.moment.clutch.why
        self.until(lambda: self.robot.state == "ready" and not torque(self.bus))
        assert self.moment.clutch.stage == "lost"
        assert any(why in line and "press it again" in line for line in self.lines)
