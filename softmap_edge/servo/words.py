"""What the guard does and why, in words: of its states, its causes, and what it denies.

Whatever shows them to somebody takes them from here. Pinned by tests/test_servo_words.py.
"""

from __future__ import annotations

from typing import Any, Literal

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
    "deadman": "the deadman was released",
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
    "homed": "home proved",
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
    "outside": "a servo stands outside its window; home it again",
    "undriven": "no fresh target, or the deadman is not pressed",
}
STATES = {
    "off": "Not connected, torque is off",
    "connected": "Connected, torque is off; home has to be proved before anything moves",
    "homed": "Home is proved, torque is off",
    "ready": "Ready, torque is off",
    "engaged": "Driving",
    "hold": "Holding where it is; it slackens soon",
    "safe_stop": "Slackening: it goes straight, then torque goes off",
    "commissioning": "Commissioning",
    "fault": "Fault, torque is off",
}
LOSES_HOME = ("silent", "hardware", "following", "lost", "dropped", "tripped")  # causes, under torque
QUIET = ("engaged", "ready")  # states in which the cause is that of what was before


def level(report: dict[str, Any]) -> Level:
    """Return the kind of state that a report tells, of which each has a colour."""
    return LEVELS.get(str(report.get("state", "off")), "off")


def state(report: dict[str, Any]) -> str:
    """Return the short name of the state that a report tells."""
    name = str(report.get("state", "off"))
    return NAMES.get(name, name)


def cause(report: dict[str, Any]) -> str:
    """Return why it is in that state, empty where nothing is told."""
    name, servo = str(report.get("cause", "none")), report.get("servo")
    why = CAUSES.get(name, name)
    if isinstance(servo, int) and why.startswith("a servo"):
        why = f"servo {servo + 1}{why[len('a servo') :]}"
    return why


def where(report: dict[str, Any]) -> str:
    """Return state and cause as part of a sentence: `in state slackening (no target came in time)`."""
    why = cause(report)
    return f"in state {state(report)}" + (f" ({why})" if why else "")


def onward(report: dict[str, Any]) -> str:
    """Return what leads a program on from a state that follows no commands."""
    state, why = report.get("state", "off"), report.get("cause")
    if state == "fault" and why == "emergency":
        return "release it, see that all is well, then acknowledge it or begin anew"
    if state == "fault" and why == "loop":
        return "begin anew"
    if state == "fault" and why not in LOSES_HOME:
        return "mend that, then acknowledge it or begin anew"
    if state in ("fault", "off", "connected"):
        return "mend that, then prove home anew (`softmap servo home`)"
    if state == "safe_stop":
        return "it slackens; once it is ready, or that is mended and acknowledged, engage it"
    return "arm and engage it first" if state == "homed" else "engage it first"


def denied(said: str) -> str:
    """Return why a request was denied, of what the loop's report says: `from(ready)`, `trouble(late)`, `torque`, …"""
    kind, _, of = said.rstrip(")").partition("(")
    return DENIED[kind].format(NAMES.get(of) or CAUSES.get(of) or of) if kind in DENIED else said


def sentence(report: dict[str, Any]) -> str:
    """Return what the guard's newest report says, and why."""
    name = str(report.get("state", "off"))
    said = STATES.get(name, name)
    why = "" if name in QUIET else cause(report)
    if name == "fault" and (report.get("torque") or report.get("cause") == "silent"):
        said = "Fault, torque off was sent; not every servo confirmed it"
    rescued = report.get("rescued")
    return f"{said}: {why}" + (f" ({rescued})" if rescued else "") if why else said


def limits(report: dict[str, Any]) -> list[str]:
    """Return what the guard keeps the targets from."""
    told = {
        "outside": "at the edge of the window",
        "slowed": "as fast as allowed",
        "jumped": "a jump is slowed down",
        "refused": "a target is refused",
    }
    return [text for key, text in told.items() if report.get(key)]


def lost(report: dict[str, Any], why: str) -> str:
    """Return why driving ended, where the guard's report does not say so, and what leads on."""
    state = str(report.get("state", "off"))
    again = "release the key and press it again"
    if state in ("off", "connected") or (state == "fault" and report.get("cause") in LOSES_HOME):
        again = "end this, and prove home anew (softmap servo home)"
    elif state in ("fault", "homed"):
        again = "let go of the key, then reset the fault"
    return again if why == sentence(report) else f"driving ended: {why}; {again}"
