"""Types of the control loop's limits and reports (`softmap.loop/1`).

`rust/control/report.rs` writes the reports. Nothing here needs numpy, which the loop does not load.
Pinned by tests/robot/test_controller.py.
"""

from __future__ import annotations

from typing import TypedDict


class ServoLimits(TypedDict):
    """The limits of one servo; ticks are absolute."""

    home: int
    low: int  # ticks, of its window
    high: int
    slew: float  # ticks/s
    acceleration: float  # ticks/s²
    current: float  # mA
    fastest: float  # ticks/s: a faster reading is rejected
    following: float  # largest following error, ticks
    warm: float  # °C from which its current is reduced
    hot: float  # °C from which tension is released
    voltage: tuple[float, float]  # V


class LoopLimits(TypedDict):
    """The limits of a loop, as the compiled guard takes them; times in seconds."""

    servos: list[ServoLimits]
    period: float
    stale: float  # age of a target from which the guard holds
    hold: float  # time in hold, after which tension is released
    slacken: float  # duration of releasing tension
    late: float  # a period that begins later is a fault
    silent: float  # a servo that does not answer for longer is a fault
    grace: float
    ramp: float
    jump: tuple[float, float]  # ticks: a target farther away is slowed down, or rejected
    jog_travel: float  # ticks
    jog_slew: float  # ticks/s
    jog_current: float  # mA
    band: float  # mm that a goal must reverse before its servo turns
    turns: float  # reversals per second
    burst: float


class BusCounts(TypedDict):
    """Answers on the bus so far: asked for, lost, damaged, and not asked for."""

    asked: int
    lost: int
    damaged: int
    unasked: int


def bus_counts(report: LoopReport) -> BusCounts:
    """Return the counts of answers of a report; 0 where it has none."""
    return {
        "asked": report.get("asked", 0),
        "lost": report.get("lost", 0),
        "damaged": report.get("damaged", 0),
        "unasked": report.get("unasked", 0),
    }


class LoopReport(TypedDict, total=False):
    """A report of the loop; None stands for a value of a servo that was not read."""

    schema: str
    t: float  # s, by the clock of the loop
    state: str  # of the guard (`status_words.STATES`)
    cause: str  # why it is in that state (`status_words.CAUSES`)
    servo: int | None  # index of the servo that is the cause
    id: int | None  # its id
    ids: list[int]
    torque: bool
    refused: bool  # whether a target was rejected
    denied: str | None  # why a request was denied
    emergency: bool  # whether an emergency stop is pressed
    bus: str | None  # how the bus failed
    jumped: bool  # whether a target was so far away that it is slowed down
    outside: bool  # whether a target is outside the window
    slowed: bool  # whether a target is faster than allowed
    goal: list[int | None]  # ticks
    position: list[int | None]  # ticks
    current_mA: list[float | None]
    temperature_C: list[float | None]
    voltage_V: list[float | None]
    hardware: list[int | None]  # bits of each servo's hardware errors
    overruns: int  # periods that began late
    asked: int  # requested answers so far
    lost: int
    damaged: int
    unasked: int
    warnings: list[str]  # of the start
    mended: list[str]  # registers that the start rewrote
    error: str  # why the loop did not start
    unrecorded: str  # why the recording ended before the loop
    rescued: str  # what was done for servos whose loop died
    kept: str  # which of them kept their torque
    gone: str  # why no more reports come
    ended: str  # why the loop ended
    ticks: int  # periods of the loop
    kept_torque: list[int]  # ids of servos that have not confirmed that torque is off
    late_us: dict[str, float]  # quantiles of the delay of periods, µs
    late_bins: list[int]
    command_age_us: dict[str, float] | None
