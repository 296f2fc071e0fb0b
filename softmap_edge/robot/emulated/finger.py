"""A finger on emulated servos, and the camera frames of it, driven by real packets.

Horns wind tendons by the robot's own map. Hidden laws (`robot/emulated/laws.py`, never the effect
library) act between horn and body. The shape is that of the model without its effects. Frames are
stamped by a camera clock with an offset and a drift. It replaces hardware in tests and
demonstrations; results are always labelled as emulated. Pinned by
tests/robot/test_emulated_finger.py.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import Calibration, tendon_mm
from softmap_edge.robot.commissioning.setup import ServoState, gains, set_up
from softmap_edge.robot.emulated.laws import LAWS, Law
from softmap_edge.robot.emulated.named_laws import NAMED, check_hidden
from softmap_edge.robot.emulated.streamed_laws import streamed
from softmap_edge.robot.emulated.tendon_load import tendon_loads
from softmap_edge.robot.link.frames import Frame
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.clock import REAL_TIME, Clock, PacedTime, SteppedTime
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.known_state import SET_UP
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.loop_types import LoopLimits
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import Rig, RigServo
from softmap_edge.run.rest_command import home_command

Floats = NDArray[np.float64]

RATE = 200.0  # readings of the horns per second
FRAMES = 30.0  # frames per second
LATE = (0.02, 0.01)  # s from exposure to arrival of a frame: minimum, and mean of the random part
NOISE = 0.1  # mm, of each coordinate of each point
DRIFT = 30e-6  # relative rate of the camera's clock against the host's
LATEST = 15  # frames in transit at most
KEPT = 9000  # frames: five minutes
ASKED = 5  # repetitions of a request
SERVO, BAUD = "XL330-M288", 1_000_000
# s: delay and lag of the trunk's servos, from commands to encoders in its recording
ANSWER = (0.19, 0.05)


def hidden_laws(names: Sequence[str], channels: int, seed: int, strength: float = 1.0) -> list[Law]:
    """Return hidden laws of commands drawn from `seed`, scaled by `strength`.

    Raises:
        SoftmapError: a name is unknown or repeated, or a law moves no command.
    """
    check_hidden(names, seed)
    known = {**LAWS, **NAMED}
    laws = []
    for name in names:
        law = (
            known[name]
            .draw(np.random.default_rng([seed, list(known).index(name)]), channels)
            .scaled(strength)
        )
        if type(law).command is Law.command:
            raise ServoError(
                f"'{name}' moves no tendon; what lies between servo and finger can hide here"
            )
        laws.append(law)
    return laws


class EmulatedFinger:
    """A finger on the horns of `bus`, seen by a camera, from entering to leaving.

    Args:
        bus: emulated servos, in the order of the commands
        model: its prior gives the shape
        calibration: true map of ticks
        laws: hidden between horn and body (`hidden_laws`)
        seed: of noise and clock
        clock: time of the servos
    """

    def __init__(
        self,
        bus: _core.EmulatedBus,
        model: Model,
        calibration: Calibration,
        laws: Sequence[Law] = (),
        *,
        seed: int = 0,
        clock: Clock = REAL_TIME,
    ) -> None:
        channels = len(calibration.b)
        if model.channels != channels or len(bus.state()[1]) != channels:
            raise ServoError(
                f"{len(bus.state()[1])} servos, a map of {channels} and a model of "
                f"{model.channels} commands; they must agree"
            )
        self._bus, self._model, self._map = bus, model, calibration
        self._step = streamed(laws)  # in mm of tendon from rest
        self._rest, self._mm = home_command(model.command_range), tendon_mm(model.command_unit)
        self._rng = np.random.default_rng(seed)
        self._clock = clock
        # start of the camera's clock
        self._zero = clock.now() - float(self._rng.uniform(5.0, 500.0))
        self._drift = DRIFT * float(self._rng.uniform(-1.0, 1.0))
        self._blind = False
        self._frames: deque[Frame] = deque(maxlen=KEPT)
        self._acting: deque[tuple[float, Floats]] = deque(maxlen=int(KEPT * RATE / FRAMES))
        self._taken = self._last = -np.inf
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)

    def __enter__(self) -> Self:
        if isinstance(self._clock, SteppedTime):
            self._clock.each_look(self._look)
        else:
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._done.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def blind(self, dark: bool) -> None:
        """Block or unblock the view of the camera."""
        self._blind = dark

    def seen(self) -> list[Frame]:
        """Return the frames that have arrived, oldest first, at most the last `KEPT`."""
        now, frames = self._clock.now(), list(self._frames)
        return frames[:-LATEST] + [frame for frame in frames[-LATEST:] if frame.arrived <= now]

    def acting(self) -> tuple[Floats, Floats]:
        """Return the true effective commands: times (T,) s, monotonic, and (T, C) mm.

        A real robot does not report them.
        """
        known = list(self._acting)
        return np.array([t for t, _ in known]), np.array([u for _, u in known])

    def _live(self) -> None:
        due = time.monotonic()
        while not self._done.is_set():
            self._look()
            due += 1.0 / RATE
            self._done.wait(max(0.0, due - time.monotonic()))

    def _look(self) -> None:
        """Let the finger follow its horns, and take a frame if one is due."""
        now, horns = self._bus.state()
        angles, pulls = np.array([(angle, pull) for angle, _, _, pull in horns]).T
        u = self._map.A @ (pulls * (angles - self._map.home)) + self._map.b
        if now > self._last and not self._done.is_set():
            acting = self._rest + self._step(now, (u - self._rest) * self._mm) / self._mm
            self._acting.append((now, acting))
            if now - self._taken >= 1.0 / FRAMES and not self._blind:
                self._take(now, acting)
            self._last = now

    def _take(self, now: float, acting: Floats) -> None:
        self._taken = now
        points = np.asarray(self._model.prior.evaluate(acting[None])).reshape(-1, 3)
        seen = points + NOISE * self._rng.normal(size=points.shape)
        late = LATE[0] + LATE[1] * float(self._rng.exponential())
        self._frames.append(Frame((now - self._zero) * (1.0 + self._drift), now + late, seen))


@contextmanager
def emulated_robot(
    model: Model,
    calibration: Calibration,
    laws: Sequence[Law] = (),
    *,
    rate: float = 200.0,
    seed: int = 0,
    servo: str = SERVO,
    baud: int = BAUD,
    ready: bool = True,
    time: Literal["real", "paced", "stepped"] = "real",
) -> Iterator[tuple[_core.EmulatedBus, Rig, LoopLimits, EmulatedFinger]]:
    """Return an emulated bus, its rig, its limits, and a finger on it.

    The servos have the delay of the trunk's (0.19 s, lag 0.05 s: from commands to encoders in its
    recording), and draw the current that the model's tendons require. With `ready` they are set up
    and homed; without, they have factory settings, and the rig has no home. `real` time serves them
    at a pseudo-terminal, which any program can open. Otherwise they are simulated for this program,
    independent of the load of the computer (`robot/servo/clock.py`).

    Raises:
        ServoError: there is no such servo model, or it lacks the baud rate.
    """
    known = servo_model(servo)
    ids = range(1, model.channels + 1)
    homes = [round(float(home)) for home in calibration.home]
    window = calibration.window or calibration.holding(model.command_range)
    servos = [(id, int(known["number"]), baud, float(home)) for id, home in zip(ids, homes)]
    loads = tendon_loads(model, calibration, window, known)
    bus = _core.EmulatedBus(
        servos, loads, delay=ANSWER[0], lag=ANSWER[1], seed=seed, simulated=time != "real"
    )
    kept: dict[str, list[int]] = {}
    try:
        if ready:
            for id, home in zip(ids, homes):
                kept[f"servo_{id}"] = _ready(
                    ServoState(bus.path, baud, id, int(known["number"]), _core.FAST_FIRMWARE), home
                )
        clock = {"real": lambda bus: REAL_TIME, "paced": PacedTime, "stepped": SteppedTime}[time](
            bus
        )
        mounted = tuple(
            RigServo(id, servo, home if ready else None) for id, home in zip(ids, homes)
        )
        rig = Rig(bus.path, baud, mounted, made={SET_UP: kept} if kept else {}, time=clock)
        limits = loop_limits([servo_limits(servo, home, window) for home in homes], rate)
        with EmulatedFinger(bus, model, calibration, laws, seed=seed, clock=clock) as finger:
            yield bus, rig, limits, finger
    finally:
        bus.unplug()


def _ready(found: ServoState, home: int) -> list[int]:
    """Set an emulated servo up and mark it as homed; return its gains.

    Requests are repeated in case a busy computer delayed an answer.
    """
    for left in reversed(range(ASKED)):
        try:
            set_up(found)
            with opened(found.port, found.baud) as bus:
                set_mark(bus, found.id, home)
            return gains(found)
        except ServoError:
            if not left:
                raise
    raise AssertionError("unreachable: the last try returns or raises")
