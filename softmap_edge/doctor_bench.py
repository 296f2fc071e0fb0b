"""What the doctor looks at of one bench: its bundle, its rig.toml, and what its servos say when they are asked.

Servos are asked only: nothing is written to them. Pinned by tests/test_doctor.py.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path

from softmap_edge import _core
from softmap_edge.doctor import FAULT, OK, WARNING, Line
from softmap_edge.errors import ServoError, SoftmapError
from softmap_edge.servo import commission
from softmap_edge.servo.proof import TRIES, check_proved, patiently
from softmap_edge.servo.rig import Rig, read_rig


def bundle(folder: str | Path) -> Iterator[Line]:
    """A bundle: whether it loads, and holds what a robot needs."""
    from softmap_edge.bundle import load_bundle

    try:
        model = load_bundle(folder)
    except (SoftmapError, OSError) as fault:
        yield Line("bundle", FAULT, str(fault), "make it again, or get it whole")
        return
    effects = ", ".join(model.chain_names) or "none"
    yield Line("bundle", OK, f"{folder}: {model.robot}, {model.channels} commands, effects: {effects}")
    found = model.calibration
    if found is None:
        do = "run softmap calibrate with a run that has ticks"
        yield Line("calibration", FAULT, "the bundle holds none", do)
    elif found.window is None:
        do = "calibrate again with --window LOW,HIGH"
        yield Line("calibration", FAULT, "it has no window of ticks, so that nothing is allowed", do)
    else:
        low, high = found.window
        run = textwrap.shorten(found.run, 60, placeholder=" …")
        yield Line("calibration", OK, f"of {run}; window {low:+.0f} to {high:+.0f} ticks about home")
    safety = (Path(folder) / "safety.toml").is_file()
    do = "" if safety else "limits are those of the servos and of rig.toml alone; build the bundle again to have them"
    yield Line("safety.toml", OK if safety else WARNING, "there" if safety else "the bundle holds none", do)


def rig(file: str | Path) -> Iterator[Line]:
    """A bench: whether its file is sound, its servos answer and are set up, and home is proved."""
    try:
        bench = read_rig(file)
    except ServoError as fault:
        yield _line("rig", fault)
        return
    yield Line("rig", OK, f"{file}: {len(bench.servos)} servos at {bench.port}, {bench.baud} baud")
    uncapped = [servo.id for servo in bench.servos if servo.current_mA is None and _capped(servo.model)]
    if uncapped:
        do = f"write current_mA (at the stroke) to it in {file}; until then a share of the servo's own limit is taken"
        yield Line("ceiling", WARNING, f"servo {_listed(uncapped)} has no measured current", do)
    try:
        with commission.opened(bench.port, bench.baud) as bus:
            yield from _servos(bus, bench)
    except ServoError as fault:
        yield _line("bus", fault)


def _servos(bus: _core.ServoBus, bench: Rig) -> Iterator[Line]:
    for servo, (id, number) in zip(bench.servos, bench.numbers):
        name = f"servo {id}"
        told = next((told for _ in range(TRIES) if (told := bus.ping(id)) is not None), None)
        if told is None:
            yield Line(
                name, FAULT, "no answer", "check power, wiring and baud rate; softmap servo scan lists who answers"
            )
            continue
        found = commission.Found(bench.port, bench.baud, id, *told)
        if told[0] != number:
            name_found = found.model["name"] if found.model else "an unknown model"
            said = f"is {name_found} ({told[0]}), the rig says {servo.model} ({number})"
            yield Line(name, FAULT, said, "mend the rig, or connect the servo that it names")
            continue
        said_of = commission.complaints(found, patiently(commission.registers, bus, id))
        for complaint in said_of:
            what, _, do = complaint.partition("; ")
            yield Line(name, FAULT, what, do)
        if not said_of:
            yield Line(name, OK, f"{servo.model}, firmware {told[1]}, set up")
        try:
            check_proved(bus, [(id, servo.home)])
            yield Line(f"home of servo {id}", OK, f"proved since power-up, at {servo.home}")
        except ServoError as fault:
            yield _line(f"home of servo {id}", fault)


def _capped(model: str) -> bool:
    """Return whether a model caps its current."""
    return any(one["name"] == model and one["current_limit_mA"] is not None for one in _core.servo_models())


def _listed(ids: list[int]) -> str:
    return ", ".join(map(str, ids))


def _line(name: str, fault: ServoError) -> Line:
    """Return a fault as a line: what it says, and what it says to do."""
    found, _, do = str(fault).rpartition("; ")
    return Line(name, FAULT, found or do, do if found else "run softmap servo scan")
