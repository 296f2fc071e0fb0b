"""The state that a page receives: driver, input, guard, hand, finger.

Pinned by tests/robot/test_teleop_page.py.
"""

from __future__ import annotations

import threading
from collections import deque

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import Document
from softmap_edge.model.model import Model
from softmap_edge.robot.servo import status_words as words
from softmap_edge.robot.teleop.drive import DriveState
from softmap_edge.robot.teleop.hand_source import HandSource
from softmap_edge.robot.teleop.mapping import HandMapping
from softmap_edge.robot.teleop.sketch import ShapePreview

Floats = NDArray[np.float64]

SEEN = 0.02  # mm: smaller changes are not redrawn
AVERAGED = 60  # ages of observations whose median is the shown latency


class PageState:
    """Convert the newest `DriveState` to what a page receives; called by the threads of pages.

    Args:
        model: model to draw
        aim: mapping that drives
        eyes: source of observations that drives
        sketch: preview of the finger
        about: what else a page receives once
    """

    def __init__(
        self,
        model: Model,
        aim: HandMapping,
        eyes: HandSource,
        sketch: ShapePreview,
        about: Document,
    ) -> None:
        self._aim, self._eyes, self._sketch = aim, eyes, sketch
        self._moment: DriveState | None = None
        self._ages: deque[float] = deque(maxlen=AVERAGED)
        self._number, self._points = -1.0, np.asarray(model.rest, float)
        self._last, self._lock = -1.0, threading.Lock()
        self.hello = {
            "schema": "softmap.teleop.page/1",
            "robot": model.robot,
            "triangles": model.triangles.tolist(),
            "rest": np.round(model.rest, 3).tolist(),
            "tip": model.tip_indices.tolist(),
            "down": bool(model.gravity_reference[2] > 0),
            "unit": model.command_unit,
            "axes": list(aim.names),
            "box": aim.box.tolist(),
            "reach": float(np.abs(self._farthest(model)).max()),
            "camera": eyes.name,
            "mirrored": eyes.view.mirrored,
            **about,
        }

    def take(self, moment: DriveState) -> None:
        """Take the newest state."""
        self._moment = moment
        if moment.sight is not None and moment.sight.t != self._last:
            self._last = moment.sight.t
            self._ages.append(moment.t - moment.sight.t)

    def view(self) -> tuple[Document, Floats | None, tuple[int, NDArray[np.uint8]] | None]:
        """Return the state, the points (N, 3) mm of the finger and the newest picture."""
        moment = self._moment
        if moment is None:
            return {"t": 0.0, "level": "off", "said": "Starting"}, None, None
        report, sight, clutch = moment.report, moment.sight, moment.clutch
        position = report.get("position") or []
        with self._lock:
            if position and None not in position and report.get("t", 0.0) > self._number:
                self._number = report.get("t", 0.0)
                points = self._sketch.points(np.array(position, float), moment.t)
                if np.abs(points - self._points).max() > SEEN:
                    self._points = points
        hand = (
            None if sight is None or sight.hand is None else np.round(sight.hand.points, 1).tolist()
        )
        picture = None if sight is None or sight.picture is None else (sight.number, sight.picture)
        low, high = self._aim.box.T
        led = moment.here if moment.led is None else moment.led
        state = {
            "t": moment.t,
            "state": str(report.get("state", "off")),
            "name": words.state(report).capitalize(),
            "level": words.level(report),
            "said": words.sentence(report),
            "stage": clutch.stage,
            "who": clutch.who,
            "why": clutch.why,
            "lost": words.lost(report, clutch.why) if clutch.stage == "lost" else "",
            "lacking": moment.lacking,
            "source": moment.controls.source,
            "limits": words.limits(report)
            + _at_ends(led, self._aim)
            + [moment.busy] * bool(moment.busy),
            "here": [round(float(x), 3) for x in moment.here],
            "led": [round(float(x), 3) for x in led],
            "hand": hand,
            "size": [640, 480] if picture is None else [picture[1].shape[1], picture[1].shape[0]],
            "seen": None if moment.seen is None else [round(float(x), 3) for x in moment.seen],
            "gone": self._eyes.gone,
            "latency_ms": round(1e3 * float(np.median(self._ages)), 1) if self._ages else None,
            "age_ms": None if moment.age is None else round(1e3 * moment.age),
            "current_mA": report.get("current_mA"),
            "temperature_C": report.get("temperature_C"),
        }
        return state, self._points, picture

    def _farthest(self, model: Model) -> Floats:
        """Return the largest lateral distance of points, mm."""
        low, high = np.asarray(model.command_range, float).T
        return np.array(
            [
                self._sketch.at(np.where(np.arange(len(low)) == c, end, 0.0))[:, :2]
                for end in (low, high)
                for c in range(len(low))
            ]
        )


def _at_ends(led: Floats, aim: HandMapping) -> list[str]:
    found = []
    for name, at, (low, high) in zip(aim.names, led, aim.box):
        room = 0.005 * (high - low)
        if at <= low + room or at >= high - room:
            found.append(f"{name} at its end")
    return found
