"""A recording of the control loop: read it, replay it through the guard, or convert it to a run.

The compiled loop writes it (`rust/control/recording.rs`): plain MCAP, one JSON message per period.
A truncated file is readable to its last complete message. A recording is untrusted input: damaged
data ends it with a reason. Pinned by tests/robot/test_recording.py.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import CalibrationError, RunError, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.recording_damage import find_shortfall
from softmap_edge.robot.servo.loop_types import BusCounts, LoopLimits, LoopReport, bus_counts
from softmap_edge.run.run import CALIBRATION, Run

SETUP, LOOP = "/setup", "/loop"
FARTHEST = 2.0**31  # ticks: range of the position register of a servo


@dataclass(frozen=True, eq=False)
class Recording:
    """The setup of a loop, and each of its periods (softmap.loop as in the schema of the file).

    Attributes:
        short: why periods may be missing; None if the loop closed the file
        incomplete: a sentence on this, with the end of the readable part and the missing amount
        doubtful: the checksum fails, so any number may be wrong
    """

    file: Path
    setup: Document
    periods: list[Document]
    short: str | None = None
    incomplete: str | None = None
    doubtful: bool = False

    @property
    def limits(self) -> LoopLimits:
        """The limits that the guard enforced."""
        return cast(LoopLimits, dict(self.setup["limits"]))

    @property
    def bus(self) -> BusCounts:
        """Counts of answers up to the last period: `asked` for, `lost`, `damaged`, `unasked`.

        Recordings of older versions have 0 of each.
        """
        last = self.periods[-1]
        return bus_counts(cast(LoopReport, {key: n for key, n in last.items() if type(n) is int}))

    @property
    def begun(self) -> float:
        """Time 0 of the run, when torque first came on: s of the host's monotonic clock.

        Raises:
            RunError: torque never came on.
        """
        return float(self.periods[self._first]["now"]) * 1e-9

    @property
    def _first(self) -> int:
        first = next((k for k, period in enumerate(self.periods) if period["torque"]), None)
        if first is None:
            raise RunError(
                f"{self.file}: torque was never on, so nothing was driven; record while the "
                "finger moves"
            )
        return first

    def replay(self) -> list[int]:
        """Let the same guard repeat its decisions in all periods; return the periods that differ.

        Raises:
            RunError: a period has another form.
        """
        try:
            again = _core.replay(self.limits, self._guard_inputs())
        except (TypeError, ValueError, OverflowError) as fault:
            raise RunError(f"{self.file}: damaged ({fault!s:.60}); record again") from None
        differ = []
        for k, (period, (state, cause, torque, goals)) in enumerate(zip(self.periods, again)):
            commanded = [goal if torque else None for goal in goals]
            if (state, cause, torque, commanded) != (
                period["state"],
                period["cause"],
                period["torque"],
                period["goal"],
            ):
                differ.append(k)
        return differ

    def run(self) -> Run:
        """Return it as a run: goals, positions (ticks), currents, hottest servo; no frames.

        Periods before torque first came on are left out. Without torque, a goal is the position of
        the servo.

        Raises:
            RunError: torque was never on, or a servo did not answer before it was.
        """
        self._guard_inputs()
        first = self._first
        kept = self.periods[first:]
        try:
            columns = {
                key: _filled(
                    [period[key] for period in kept],
                    [period[key] for period in self.periods[:first]],
                )
                for key in ("position", "current_mA", "temperature_C")
            }
            goals = np.array(
                [[np.nan if goal is None else goal for goal in period["goal"]] for period in kept],
                float,
            )
            now = np.array([period["now"] for period in kept], np.int64)
            if not columns["position"].shape == columns["current_mA"].shape[:2] == goals.shape[:2]:
                raise ValueError("goals, positions and currents of different numbers of servos")
            if (
                np.nanmax(np.abs(np.stack([goals, columns["position"]])), initial=0.0) > FARTHEST
                or goals.ndim != 2
            ):
                raise ValueError("a tick that no servo has")
        except (ValueError, KeyError, TypeError, OverflowError) as fault:
            raise RunError(f"{self.file}: damaged ({fault!s:.60}); record again") from None
        if np.isnan(columns["position"]).any():
            raise RunError(
                f"{self.file}: a servo was not heard before torque came on; record again"
            )
        goals = np.where(np.isnan(goals), columns["position"], goals)
        current = columns["current_mA"]
        return Run(
            t=(now - now[0]) * 1e-9,
            ticks=goals.astype(np.int64),
            present_ticks=columns["position"].astype(np.int64),
            current=None if np.isnan(current).any() else current,
            temperature=columns["temperature_C"].max(axis=1),
            extra=self._about(),
        )

    def _about(self) -> dict[str, NDArray[np.generic]]:
        """Return the field of a run with the servo map in use."""
        known = self.setup.get("calibration")
        return {} if known is None else {CALIBRATION: np.array(json.dumps(known))}

    @property
    def calibration(self) -> Calibration:
        """The map between ticks and mm that was used.

        Raises:
            RunError: the file does not contain it.
        """
        try:
            return Calibration.from_dict(self.setup.get("calibration"))
        except CalibrationError as fault:
            raise RunError(f"{self.file}: damaged ({fault}); record again") from None

    def _guard_inputs(self) -> list[tuple[object, ...]]:
        """Return the inputs of the guard in each period, as `_core.replay` takes them.

        Raises:
            RunError: a period has another form.
        """
        heard, servos = [], None
        for k, period in enumerate(self.periods):
            try:
                servos = _servos(period, servos)
                heard.append(_guard_input(period))
            except (ValueError, KeyError, TypeError, AttributeError, IndexError) as fault:
                raise RunError(
                    f"{self.file}: period {k} is damaged ({fault!s:.40}); record again"
                ) from None
        return heard


def _servos(period: Document, servos: int | None) -> int:
    """Return the number of servos of a period.

    Raises:
        RunError: the period has another form, or another number of servos.
    """
    _guard_input(period)
    forms = [type(period[key]) for key in ("state", "cause", "torque", "goal", "now")]
    if forms != [str, str, bool, list, int]:
        raise TypeError("state")
    if servos is not None and len(period["goal"]) != servos:
        raise ValueError("goal")
    return len(period["goal"])


def _guard_input(period: Document) -> tuple[object, ...]:
    """Return one period, as `_core.replay` takes it."""
    sensed: list[tuple[object, ...] | None] = []
    for k, position in enumerate(period["position"]):
        if position is None:
            sensed.append(None)
            continue
        health = None
        if period.get("hardware") is not None and period["hardware"][k] is not None:
            health = (
                period["hardware"][k],
                period["has_torque"][k] == 1,
                period["tripped"][k] == 1,
            )
        rest = [period[key][k] for key in ("current_mA", "voltage_V", "temperature_C")]
        sensed.append((int(position), int(period["clock"][k]), *rest, health))
    target = period.get("target")
    goal = (
        None
        if target is None
        else [float("nan") if tick is None else float(tick) for tick in target]
    )
    deadman = bool(period["deadman"]) if period["heard"] else None
    return (
        period["now"],
        sensed,
        deadman,
        goal,
        "command" in period,
        period["request"],
        period["emergency"],
    )


def read_recording(path: str | Path) -> Recording:
    """Read a recording; of a truncated one, all complete periods.

    Raises:
        RunError: it is not a recording of a loop, or it is damaged.
    """
    file = Path(path)
    if not file.is_file():
        raise RunError(
            f"{file}: no such file; give what a loop recorded, as of `softmap track --record "
            "FILE.mcap`"
        )
    try:
        messages = _core.read_recording(str(file))
        documents, broken = _documents(messages)
        setup = next((document for topic, document in documents if topic == SETUP), None)
        periods = [document for topic, document in documents if topic == LOOP]
        if setup is None or not isinstance(setup.get("limits"), dict) or not periods:
            raise RunError(
                f"{file}: holds no periods of a control loop; give what `softmap` recorded, or "
                "make a run of another MCAP file by `softmap import`"
            )
        times = [time for topic, time, _ in messages[: len(documents)] if topic == LOOP]
        lacks = find_shortfall(
            file, len(messages), len(documents), (times[-1] - times[0]) * 1e-9, broken
        )
        return Recording(file, setup, periods, lacks.why, lacks.sentence, lacks.doubtful)
    except RunError:
        raise
    except SoftmapError as fault:
        raise RunError(str(fault)) from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as fault:
        raise RunError(
            f"{file}: damaged ({type(fault).__name__} {fault!s:.60}); record again"
        ) from None


def _documents(
    messages: list[tuple[str, int, bytes]],
) -> tuple[list[tuple[str, Document]], str | None]:
    """Return topic and document of each message before the first bad one, and its fault."""
    found: list[tuple[str, Document]] = []
    servos = None
    for topic, _, message in messages:
        try:
            document = json.loads(message)
        except (ValueError, RecursionError) as fault:
            return found, f"damaged (message {len(found)} is not JSON: {fault!s:.40}); record again"
        try:
            servos = _servos(document, servos) if topic == LOOP else servos
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as fault:
            return (
                found,
                f"damaged (message {len(found)} is not a period of a loop: {fault!s:.40}); record "
                "again",
            )
        found.append((topic, document))
    return found, None


def _filled(
    rows: list[list[float | None]], before: list[list[float | None]]
) -> NDArray[np.float64]:
    """Return (T, C) numbers; a missing one is replaced by the last one before it.

    `before` is the row before the first.
    """
    padded = np.array(
        [[np.nan if value is None else value for value in row] for row in before + rows], float
    )
    at = np.where(np.isnan(padded), 0, np.arange(len(padded))[:, None])
    last = np.maximum.accumulate(at, axis=0)
    return np.asarray(np.take_along_axis(padded, last, axis=0)[len(before) :])
