"""What the guard does and why, as sentences for whoever drives. Pinned by tests/test_teleop_terminal.py."""

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
    "deadman": "the key was let go",
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
    "tripped": "a servo's own watchdog tripped",
    "loop": "the control loop died or froze",
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
QUIET = ("engaged", "ready")  # states in which the cause is that of what was before


def level(state: str) -> Level:
    """Return the kind of state, of which each has a colour."""
    return LEVELS.get(state, "off")


def sentence(report: dict[str, Any]) -> str:
    """Return what the guard's newest report says, and why."""
    state, cause = str(report.get("state", "off")), str(report.get("cause", "none"))
    said = STATES.get(state, state)
    why = "" if state in QUIET else CAUSES.get(cause, cause)
    servo = report.get("servo")
    if why and isinstance(servo, int) and why.startswith("a servo"):
        why = f"servo {servo + 1}{why[len('a servo') :]}"
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
    again = "let go of the key and press it anew"
    if state in ("fault", "homed"):
        again = "let go of the key, then reset the fault"
    elif state in ("off", "connected"):
        again = "end this, and prove home anew (softmap servo home)"
    return again if why == sentence(report) else f"driving ended: {why}; {again}"
