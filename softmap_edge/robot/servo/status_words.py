"""Text for the guard's states, their causes, and the requests that it denies.

All commands and pages use it. Pinned by tests/robot/test_servo_words.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from softmap_edge.robot.remedies import parted
from softmap_edge.robot.servo.conditions import COOL_DOWN, POWER, denied_for
from softmap_edge.robot.servo.known_state import hardware, ways_out
from softmap_edge.robot.servo.loop_types import BusCounts, LoopLimits, LoopReport

Level = Literal["off", "ready", "driving", "holding", "fault"]

LEVELS: dict[str, Level] = {
    "ready": "ready",
    "engaged": "driving",
    "hold": "holding",
    "safe_stop": "holding",
    "commissioning": "holding",
    "fault": "fault",
}
CAUSES = {
    "none": "",
    "asked": "somebody asked for it",
    "deadman": "the enable key was released",
    "stale": "no target came in time",
    "refused": "targets were refused: not finite, or a jump too far",
    "late": "a servo did not answer in time",
    "overload": "a servo draws more current than it may",
    "voltage": "the supply voltage is outside its limits",
    "hot": "a servo is too hot",
    "emergency": "the emergency stop is pressed, or its line is dead",
    "silent": "a servo is silent: unplugged, or without power",
    "hardware": "a servo reports a hardware error",
    "following": "a servo does not follow: blocked, or its encoder stands",
    "lost": "a position moved faster than a servo can: turns lost, or ids exchanged",
    "dropped": "a servo lost its torque by itself: it was reset or shut down",
    "tripped": "a servo's own watchdog tripped, or it does not keep its watchdog or cap",
    "loop": "the control loop died or froze",
}
NAMES = {
    "off": "off",
    "connected": "connected",
    "homed": "home confirmed",
    "ready": "ready",
    "engaged": "driving",
    "hold": "holding",
    "safe_stop": "slackening",
    "commissioning": "commissioning",
    "fault": "fault",
}
DENIED = {
    "from": "not allowed in state {}",
    "trouble": "something is wrong: {}",
    "torque": "a servo has torque; `softmap servo off` releases it",
    "outside": (
        "a servo stands outside its window; turn it back with `softmap servo move`, or home the "
        "robot again"
    ),
    "undriven": "no fresh target, or the enable key is not pressed",
}
STATES = {
    "off": "Not connected, torque is off",
    "connected": "Connected, torque is off; home the robot before it can move",
    "homed": "Homed, torque is off",
    "ready": "Ready, torque is off",
    "engaged": "Driving",
    "hold": "Holding where it is; it releases tension soon",
    "safe_stop": "Releasing tension: it goes straight, then torque goes off",
    "commissioning": "Commissioning",
    "fault": "Fault, torque is off",
}
MANY_LOST = 0.01  # share of lost answers from which they are reported
REMEDIES = {  # remedies of causes; a cause without one needs none
    "late": (
        "check the cables of the bus, and close what else loads this computer (`softmap servo "
        "doctor --rig FILE` looks at both)"
    ),
    "overload": (
        "find what holds the finger; `softmap servo pull --rig FILE` measures the current that it "
        "needs"
    ),
    "voltage": POWER,
    "hot": COOL_DOWN,
    "emergency": "release the emergency stop",
    "silent": "check its power and its cables",
    "following": "find what holds the finger, or the coupling that slips",
    "lost": "check the ids of the servos, and every coupling",
    "dropped": "check its power, and that no other program uses the port",
    "tripped": "close other programs that use the port, and check the cables",
}
SENSED = ("hot", "voltage")  # causes whose value and limit a report shows
# causes that invalidate the home if they occur under torque
LOSES_HOME = ("silent", "hardware", "following", "lost", "dropped", "tripped")
QUIET = ("engaged", "ready")  # states in which the cause is that of the previous state


def level(report: LoopReport) -> Level:
    """Return the kind of state in a report; each kind has a colour."""
    return LEVELS.get(str(report.get("state", "off")), "off")


def state(report: LoopReport) -> str:
    """Return the short name of the state in a report."""
    name = str(report.get("state", "off"))
    return NAMES.get(name, name)


def cause(report: LoopReport, limits: LoopLimits | None = None) -> str:
    """Return why it is in that state, "" if the report names no cause.

    With `limits`, it has the value and its limit.
    """
    name, servo = str(report.get("cause", "none")), report.get("servo")
    if name == "hardware" and (message := errors(report)):
        return message
    if name in SENSED and (message := parted(denied_for(name, report, limits))[0]):
        return message
    why = CAUSES.get(name, name)
    if isinstance(servo, int) and why.startswith("a servo"):
        id = report.get("id")
        why = f"servo {servo + 1 if id is None else id}{why[len('a servo') :]}"
    return why


def errors(report: LoopReport) -> str:
    """Return the hardware errors of the servos as text; "" if there are none."""
    known = report.get("hardware") or []
    ids = report.get("ids") or list(range(1, len(known) + 1))
    message = [
        f"servo {id} reports a hardware error: {hardware(bits)}"
        for id, bits in zip(ids, known)
        if bits
    ]
    return ", ".join(message)


def bus(counts: BusCounts) -> str:
    """Return a sentence on lost or unrequested answers; "" if there are none."""
    asked = counts["asked"]
    lost = counts["lost"]
    damaged = counts["damaged"]
    unasked = counts["unasked"]
    message = [f"{unasked} answers came that this program did not ask for"] if unasked else []
    message += (
        [f"{lost} of {asked} answers of the servos were lost"] if lost > MANY_LOST * asked else []
    )
    message += [f"{damaged} were damaged"] if message and damaged else []
    why = (
        "another program uses the port, or two servos share an id"
        if unasked
        else "look at the wiring of the bus"
    )
    return f"{', '.join(message)}; {why}" if message else ""


def where(report: LoopReport, limits: LoopLimits | None = None) -> str:
    """Return state and cause as text: `in state slackening (no target came in time)`."""
    why = cause(report, limits)
    return f"in state {state(report)}" + (f" ({why})" if why else "")


def onward(report: LoopReport, *, terminal: bool = False, has_rig: bool = True) -> str:
    """Return what to do in a state that follows no commands.

    Args:
        report: newest report of the loop
        terminal: whether the reader typed a command; otherwise the reader wrote a program, and
            methods are named
        has_rig: whether the robot has a rig file; a robot emulated by a command is homed by each
            start
    """
    return _typed(report, has_rig) if terminal else _called(report)


def _typed(report: LoopReport, has_rig: bool) -> str:
    """Return what to do at the command line before the same command is run again."""
    home = (
        "home the robot again (`softmap servo home --rig FILE`)"
        if has_rig and _unhomed(report)
        else ""
    )
    steps = [_remedy(report), home]
    return ", then ".join([*filter(None, steps), "run the same command again"])


def _called(report: LoopReport) -> str:
    """Return what a program does: the remedy, and the methods of Controller to call next."""
    state, why = report.get("state", "off"), report.get("cause")
    if state == "fault" and why == "loop":
        return "start another Controller"
    if _unhomed(report):
        again = (
            "home the robot again (`softmap servo home --rig FILE`), and start another Controller"
        )
        return ", then ".join(filter(None, [_remedy(report), again]))
    acknowledge = (
        'call request("acknowledge"), request("arm") and engage(), or start another Controller'
    )
    if state == "fault":
        return ", then ".join(filter(None, [_remedy(report), acknowledge]))
    if state == "safe_stop" and _remedy(report):
        return f"torque goes off; {_remedy(report)}, then {acknowledge}"
    if state == "safe_stop":
        return "wait until it is ready, then call engage()"
    return 'call request("arm") and engage() first' if state == "homed" else "call engage() first"


def _remedy(report: LoopReport) -> str:
    """Return what removes the cause; "" if nothing needs to."""
    why = str(report.get("cause"))
    return restarts(report) if why == "hardware" else REMEDIES.get(why, "")


def _unhomed(report: LoopReport) -> bool:
    """Return whether the robot must be homed again."""
    state = report.get("state", "off")
    return state in ("off", "connected") or (state == "fault" and report.get("cause") in LOSES_HOME)


def restarts(report: LoopReport) -> str:
    """Return the remedy for a servo with a hardware error."""
    found = [
        (id, bits)
        for id, bits in zip(report.get("ids") or [], report.get("hardware") or [])
        if bits
    ]
    id, bits = found[0] if found else ("N", 0)
    return (
        f"{ways_out(bits)}, restart it (`softmap servo reboot --rig FILE --id {id}`, or its supply "
        "off and on)"
    )


def denied(message: str, report: LoopReport | None = None, limits: LoopLimits | None = None) -> str:
    """Return why a request was denied, from the loop's report.

    The reason is `from(ready)`, `trouble(late)`, `torque`, …
    """
    kind, _, of = message.rstrip(")").partition("(")
    if named := denied_for(of or kind, report or {}, limits):
        return named
    why = NAMES.get(of) or CAUSES.get(of) or of
    why += f"; {REMEDIES[of]}" if limits is not None and of in REMEDIES else ""
    if of == "hardware" and (named := errors(report or {})):
        why = f"{named}; {restarts(report or {})}"
    return DENIED[kind].format(why) if kind in DENIED else message


def sentence(report: LoopReport) -> str:
    """Return the guard's newest report in words, with its cause."""
    name = str(report.get("state", "off"))
    message = STATES.get(name, name)
    why = "" if name in QUIET else cause(report)
    if name == "fault" and (report.get("torque") or report.get("cause") == "silent"):
        message = "Fault, torque off was sent; not every servo confirmed it"
    rescued = report.get("rescued")
    return f"{message}: {why}" + (f" ({rescued})" if rescued else "") if why else message


def limits(report: LoopReport) -> list[str]:
    """Return the limit that the guard applies to the targets."""
    flags = {
        "outside": "at the edge of the window",
        "slowed": "as fast as allowed",
        "jumped": "a jump is slowed down",
        "refused": "a target is refused",
    }
    return [text for key, text in flags.items() if report.get(key)]


def lost(report: LoopReport, why: str) -> str:
    """Return why driving ended if the guard's report lacks the reason, and the remedy."""
    state = str(report.get("state", "off"))
    again = "release the key and press it again"
    if state in ("off", "connected") or (state == "fault" and report.get("cause") in LOSES_HOME):
        again = "end this, and home the robot again (softmap servo home)"
        if report.get("cause") == "hardware":
            again = f"end this, {restarts(report)}, and home the robot again (softmap servo home)"
    elif state in ("fault", "homed"):
        again = "let go of the key, then reset the fault"
    return again if why == sentence(report) else f"driving ended: {why}; {again}"


def kept_words(ids: Sequence[int]) -> str:
    """Return the message on servos that have not confirmed that their torque is off."""
    which, several = ", ".join(map(str, ids)), len(ids) > 1
    who, its, it = ("servos", "their", "they answer") if several else ("servo", "its", "it answers")
    return (
        f"{who} {which} did not confirm that {its} torque is off; cut {its} supply, or `softmap "
        f"servo off` once {it}"
    )
