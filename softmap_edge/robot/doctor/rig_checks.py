"""The doctor's checks of one rig: its bundle, its rig.toml, and the readings of its servos.

Servos are only read, never written. Pinned by tests/robot/test_doctor.py.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from softmap_edge.errors import ServoError, SoftmapError
from softmap_edge.files.printable import shell_file
from softmap_edge.robot.finding import FAULT, OK, WARNING, Line, faulty
from softmap_edge.robot.link.session import read_key
from softmap_edge.robot.remedies import parted
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.emergency import Emergency
from softmap_edge.robot.servo.examined import Member, examined, members, members_of
from softmap_edge.robot.servo.home_mark import check_confirmed
from softmap_edge.robot.servo.known_state import differs, gains_of, remarks_on_gains, rewritten
from softmap_edge.robot.servo.limits import effective_limits
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig import Rig, RigServo, read_rig

SCAN = "run `softmap servo scan --rig FILE`"


def check_bundle(folder: str | Path) -> Iterator[Line]:
    """Check whether a bundle loads, and contains what a robot needs."""
    from softmap_edge.model.bundle import load_bundle

    try:
        model = load_bundle(folder)
    except (SoftmapError, OSError) as fault:
        yield faulty("bundle", fault, "make it again, or copy the complete folder again")
        return
    effects = ", ".join(model.chain_names) or "none"
    yield Line(
        "bundle", OK, f"{folder}: {model.robot}, {model.channels} commands, effects: {effects}"
    )
    found = model.calibration
    if found is None:
        do = "run softmap model calibrate with a run that has ticks"
        yield Line("calibration", FAULT, "the bundle holds none", do)
    else:
        low, high = found.window or (0.0, 0.0)
        window = f"; window {low:+.0f} to {high:+.0f} ticks about home" if found.window else ""
        yield Line(
            "calibration", OK, f"of {textwrap.shorten(found.run, 60, placeholder=' …')}{window}"
        )
    there = (Path(folder) / "safety.toml").is_file()
    if model.safety is not None and model.safety.edited:
        do = "look at `softmap servo limits --rig FILE`, or build the bundle again"
        yield Line("safety.toml", WARNING, "edited since the bundle was written", do)
    else:
        yield Line(
            "safety.toml",
            OK,
            "there" if there else "none: the limits are derived from the model each time",
        )


def check_limits(file: str | Path, folder: str | Path) -> Iterator[Line]:
    """Check whether a finger on its rig gives limits that the guard accepts.

    Yields nothing if one of the two has a fault.
    """
    from softmap_edge.model.bundle import load_bundle

    try:
        rig, model = read_rig(file), load_bundle(folder)
    except (SoftmapError, OSError):
        return
    if model.calibration is None:
        return
    try:
        found = effective_limits(rig, model)
        found.table()
    except SoftmapError as fault:
        yield faulty("limits", fault, "`softmap servo limits` lists who sets them")
        return
    found_text = "derived from the model" if found.derived else "with those of the bundle"
    yield Line("limits", OK, f"{found_text}; `softmap servo limits` prints them")


def check_rig(file: str | Path, folder: str | Path | None = None) -> Iterator[Line]:
    """Check whether a rig file is valid, its servos answer and are set up, and it is homed.

    Args:
        file: its `rig.toml`
        folder: bundle of the finger on it, whose limits apply to the servos
    """
    try:
        rig = read_rig(file)
    except ServoError as fault:
        do = (
            "correct it there, or move it away and make it again with `softmap servo setup --rig "
            "FILE`"
        )
        yield faulty("rig", fault, do)
        return
    yield Line("rig", OK, f"{file}: {len(rig.servos)} servos at {rig.port}, {rig.baud} baud")
    uncapped = [
        servo.id
        for servo in rig.servos
        if servo.current_mA is None and servo_model(servo.model)["current_limit_mA"] is not None
    ]
    if uncapped:
        do = "run `softmap servo pull`; until then a share of the servo's own limit is taken"
        yield Line("ceiling", WARNING, f"no current was measured for servo {_listed(uncapped)}", do)
    yield from _stops(rig)
    try:
        yield from _servos(rig, _asked(rig, folder))
    except ServoError as fault:
        yield faulty("bus", fault, SCAN)


def _stops(rig: Rig) -> Iterator[Line]:
    """Check whether the rig's emergency stops work: a heartbeat's key, a line's chip."""
    stops, wrong = rig.emergency, []
    if stops.udp is not None:
        try:
            read_key(stops.udp.key_file)
        except (SoftmapError, OSError) as fault:
            key = shell_file(stops.udp.key_file)
            line, do = (
                faulty("emergency stop", fault, ""),
                f"`softmap servo heartbeat --new-key {key}` makes one for both",
            )
            wrong.append(replace(line, do=", or ".join(filter(None, [line.do, do]))))
    if stops.gpio is not None:
        try:
            if not stat.S_ISCHR(os.stat(stops.gpio.chip).st_mode):
                raise OSError(errno.ENODEV, "no GPIO chip")
            os.close(os.open(stops.gpio.chip, os.O_RDWR | os.O_NONBLOCK))
        except OSError as fault:
            found_text = f"{stops.gpio.chip}: {(fault.strerror or 'no chip').lower()}"
            wrong.append(
                Line(
                    "emergency stop",
                    FAULT,
                    found_text,
                    "gpiodetect lists the chips; mend [emergency] of the rig",
                )
            )
    yield from wrong
    if not wrong and stops != Emergency():
        yield Line("emergency stop", OK, f"stops at {stops}")


def _asked(rig: Rig, folder: str | Path | None) -> list[Member]:
    """Return the requirements for each servo: by the effective limits if known, else by the rig."""
    from softmap_edge.model.bundle import load_bundle

    if folder is not None:
        with contextlib.suppress(SoftmapError, OSError):
            table = effective_limits(rig, load_bundle(folder)).table()
            return members_of(
                rig.numbers, table, [gains_of(rig.made, servo.id) for servo in rig.servos]
            )
    return members(rig)


def _servos(rig: Rig, asked: list[Member]) -> Iterator[Line]:
    seen, asked_for = examined(rig.port, rig.baud, asked), {one.id: one.asked for one in asked}
    for servo, one in zip(rig.servos, seen):
        name, found = f"servo {servo.id}", one.found
        for complaint in (*one.wrong, *one.unfit):
            yield faulty(name, complaint, SCAN)
        if found is None or found.number != dict(rig.numbers)[servo.id] or not one.values:
            continue
        for need in one.passing:
            found_text = differs(found, need, one.values[need.register])
            yield Line(name, WARNING, found_text, rewritten(found))
        gains = [parted(line) for line in remarks_on_gains(found, one.values, asked_for[servo.id])]
        yield from (Line(name, WARNING, *parts) for parts in gains)
        if not (one.wrong or one.unfit or one.passing or gains):
            yield Line(name, OK, f"{servo.model}, firmware {found.firmware}, set up")
        yield _home(rig, servo, one.values["present_position"])


def _home(rig: Rig, servo: RigServo, position: int) -> Line:
    """Check whether a servo is homed, and how far (ticks) it is from home."""
    name = f"home of servo {servo.id}"
    try:
        with opened(rig.port, rig.baud) as bus:
            check_confirmed(bus, [(servo.id, servo.home)])
    except ServoError as fault:
        return faulty(name, str(fault).removeprefix(f"servo {servo.id}: "), SCAN)
    from softmap_edge.robot.commissioning.home import NEAR

    away = position - (servo.home or 0)
    stands = f"; it stands {away:+d} ticks from there" if abs(away) > NEAR else ""
    return Line(name, OK, f"confirmed since power-up, at {servo.home}{stands}")


def _listed(ids: list[int]) -> str:
    return ", ".join(map(str, ids))
