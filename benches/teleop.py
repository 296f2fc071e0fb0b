"""Time teleoperation from an image of a hand to the first loop period with its target.

The full chain runs on emulated servos: a video at its own 30 images per second, MediaPipe, hand
frame, filter, map, the loop's process. The time is from the due time of the image to the `now` of
the period that receives the command, by the recording. `python -m benches.teleop` runs it alone.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benches.data import find
from softmap_edge.errors import SoftmapError
from softmap_edge.model.bundle import builtin_model
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.emulated.finger import emulated_robot
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.teleop.drive import Drive
from softmap_edge.robot.teleop.hand import View
from softmap_edge.robot.teleop.hand_source import HandSource, camera_hand_source
from softmap_edge.robot.teleop.keys import Controls
from softmap_edge.robot.teleop.mapping import DirectMapping

# of the tests; the target of --fetch-model
MODELS = (Path.home() / ".cache/softmap-tests/hand_landmarker.task", None)
RATE = 100.0  # periods per second


class Held:
    """An input whose key is held after the first detection of a hand."""

    name = "the benchmark"

    def __init__(self, eyes: HandSource) -> None:
        self._eyes = eyes

    def controls(self, now: float) -> Controls:
        return Controls(self._eyes.hands > 0, source="hand")

    def asked(self) -> str | None:
        return None

    def rest(self, knob: tuple[float, float]) -> None:
        return None


def rows() -> list[dict[str, object]]:
    """Return latency and count, or a row with the reason if a requirement is missing."""
    folder = find("hand")
    if folder is None:
        return [_row("teleoperation: not run, there is no hand.mp4", float("nan"), "", "")]
    for model in MODELS:
        try:
            return measured(folder / "hand.mp4", model)
        except SoftmapError as fault:
            why = str(fault)
    return [_row(f"teleoperation: not run ({why[:60]})", float("nan"), "", "")]


def measured(video: Path, model: Path | None) -> list[dict[str, object]]:
    """Drive the built-in finger with the hand of a video."""
    finger = builtin_model()
    calibration = Calibration.stated(np.eye(2) / 280.0, np.zeros(2), np.full(2, 2048.0), "bench")
    kinematics, sent = Kinematics(finger), []  # sent: due time of an image, and its command
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "teleop.mcap"
        with (
            emulated_robot(finger, calibration, rate=RATE) as (_, rig, limits, _),
            Controller(rig, calibration, limits, kinematics=kinematics, record=record) as robot,
            camera_hand_source(video, model, View()) as eyes,
        ):
            drive = Drive(
                robot,
                kinematics,
                DirectMapping(kinematics),
                eyes,
                [Held(eyes)],
                rule="key",
                sent=lambda t, u: sent.append((t, tuple(u))),
            )
            account = drive.run()
        heard: dict[tuple[float, ...], list[float]] = {}
        for period in read_recording(record).periods:
            if period.get("command"):
                heard.setdefault(tuple(period["command"]), []).append(period["now"] * 1e-9)
    late = []
    for (_, before), (taken, command) in zip([(0.0, ()), *sent], sent):
        if command == before:
            continue  # both at the end of the range: it is unknown which was received
        after = [now for now in heard.get(command, []) if now >= taken]
        if after:
            late.append(after[0] - taken)
    ms = 1e3 * np.array(late)
    name = f"camera to tick, {len(sent)} pictures driven from"
    return [
        _row(f"{name}: median", float(np.median(ms)), "ms", "goal ≤ 60"),
        _row(f"{name}: p95", float(np.quantile(ms, 0.95)), "ms", "stated"),
        _row(
            f"pictures with a hand, of {eyes.taken} seen; {account.ended[-30:]}",
            eyes.hands,
            "",
            "goal ≥ 600",
        ),
        *[
            _row(f"driving ended: {why[:60]}", count, "", "0")
            for why, count in account.lost.items()
        ],
    ]


def _row(name: str, value: float, unit: str, wanted: str) -> dict[str, object]:
    return {"name": name, "value": value, "unit": unit, "wanted": wanted}


if __name__ == "__main__":
    begun = time.monotonic()
    for row in rows():
        print(f"{row['name']:<75} {row['value']:8.4g} {row['unit']:<3} {row['wanted']}")
    print(f"{time.monotonic() - begun:.0f} s", file=sys.stderr)
