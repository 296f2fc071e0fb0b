"""The register values that a servo needs, their differences and remedies: one list for all checks.

`softmap servo setup` writes them. `servo read`, the doctor, homing and each start check them again,
because another program may have changed them. A start rewrites volatile registers (profile, gains).

Sources: the X-series control tables and their known traps. A servo counts turns in modes 4 and 5
only. On old firmware, a homing offset makes a watchdog dangerous in these modes. A return delay
costs bus time. A reversed drive mode inverts goal and position alike, so no other check detects it.
The default gains of a mode depend on the firmware: set-up lets the servo choose them, and the rig
file stores them (`[made.set_up]`). A servo protects itself by its temperature and voltage limits,
and by its shutdown mask: each must lie between what the guard allows and the factory setting.
Position limits apply in mode 3 only, so they are not in the list. Pinned by
tests/robot/test_known_state.py.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass

from softmap_edge import _core
from softmap_edge.files.atomic import Document
from softmap_edge.robot.servo.models import ServoModel, manual_gains, numbered

# with older firmware, a tripped watchdog lets the motor run on in mode 4 with a homing offset
CLEAR = 42
OLD = 38  # older firmware has no bus watchdog
NO_SHADOW, HIGHEST_ID = 255, 252  # secondary id for none; highest id on a bus
ALWAYS = 2  # status return level: every request is answered
MODES = {
    0: "current",
    1: "velocity",
    3: "position",
    4: "extended position",
    5: "current-based position",
    16: "PWM",
}
SIGNED = (
    "homing_offset",
    "goal_position",
    "present_position",
    "present_current",
    "present_velocity",
    "present_pwm",
    "goal_current",
    "goal_pwm",
)
GAINS = (
    "position_p_gain",
    "position_i_gain",
    "position_d_gain",
    "feedforward_1st_gain",
    "feedforward_2nd_gain",
)
MOST_GAIN = 16_383  # register units
PER_VOLT = 10  # register units of voltages per V
# for each bit of register 70: the remedy of its cause, and the registers that may bring it about
WAYS_OUT = {
    0x01: "check its supply voltage and cable",
    0x04: "let it cool down with torque off",
    0x08: "check its cable (a servo that reports this again is broken)",
    0x10: "check its supply and cable for a short circuit",
    0x20: "remove the load that holds it",
}
BROUGHT_BY = {0x01: ("max_voltage_limit", "min_voltage_limit"), 0x04: ("temperature_limit",)}
SET_UP = "set_up"  # key in [made] of a rig: the gains of each servo, in the order of GAINS
Values = dict[str, int]


@dataclass(frozen=True)
class ServoState:
    """A servo that answered: its port, baud rate, id and model."""

    port: str
    baud: int
    id: int
    number: int
    firmware: int

    @property
    def model(self) -> ServoModel | None:
        """The entry of its model, if the model is known."""
        return numbered(self.number)

    def __str__(self) -> str:
        name = self.model["name"] if self.model else f"unknown model {self.number}"
        return f"{self.port} at {self.baud} baud: id {self.id}, {name}, firmware {self.firmware}"


@dataclass(frozen=True)
class Asked:
    """A rig's requirements for a servo.

    The current of its cap (mA), its fastest turn (ticks/s), and its gains at set-up (in the order
    of GAINS; empty if the rig has none).

    `hot` (°C), `voltage` (V) and `window` (ticks) bound the readings at a start; None if unknown.
    `home` (ticks) is the origin of the window.
    """

    current_mA: float
    slew: float
    gains: tuple[int, ...] = ()
    hot: float | None = None
    voltage: tuple[float, float] | None = None
    window: tuple[float, float] | None = None
    home: int | None = None


@dataclass(frozen=True)
class Need:
    """A required register value: `value`, or a range.

    Attributes:
        register: its name
        value: the value that set-up writes
        least, most: ends of the allowed range; without both, only `value` is allowed
        bits: whether all bits of `value` must be set, and others may be
        passing: whether a start rewrites it itself
    """

    register: str
    value: int
    least: int | None = None
    most: int | None = None
    bits: bool = False
    passing: bool = False

    def met(self, value: int) -> bool:
        """Return whether `value` meets the requirement."""
        if self.bits:
            return value & self.value == self.value
        if self.least is None and self.most is None:
            return value == self.value
        return (self.least is None or value >= self.least) and (
            self.most is None or value <= self.most
        )

    @property
    def allowed(self) -> str:
        """The allowed values as text."""
        if self.bits or self.register == "secondary_id" or self.least == self.most:
            return f"{self.value}"
        if self.least is None:
            return f"at most {self.most}"
        return f"at least {self.least}" if self.most is None else f"{self.least} to {self.most}"


def usual(model: ServoModel) -> Asked:
    """Return the requirements for a servo without a rig."""
    from softmap_edge.robot.servo.loop_limits import (  # the loop starts without numpy
        COOL,
        CURRENT,
        SLEW,
        slowed,
        strongest,
    )

    most = CURRENT * strongest(model)
    hot = float(model["temperature_limit_C"] - COOL[1])
    return Asked(most, min(SLEW, slowed(model, most)), hot=hot, voltage=model["voltage_V"])


def most(model: ServoModel) -> Asked:
    """Return the highest requirements that a servo can meet: its factory limits."""
    from softmap_edge.robot.servo.loop_limits import strongest

    return Asked(strongest(model), float(model["fastest_ticks_per_s"]))


def needs(model: ServoModel, asked: Asked | None = None) -> list[Need]:
    """Return the required register values of a servo, in the order in which they are written.

    Args:
        model: entry of its model
        asked: requirements of the rig; None for the usual ones
    """
    asked = usual(model) if asked is None else asked
    found = [
        Need("operating_mode", model["operating_mode"]),
        Need("homing_offset", 0),
        Need("return_delay_time", 0),
        Need("drive_mode", 0),
        Need("secondary_id", NO_SHADOW, HIGHEST_ID + 1),
        Need("status_return_level", ALWAYS),
        Need("startup_configuration", 0),
        Need("pwm_limit", model["pwm_limit"]),
        Need("velocity_limit", model["velocity_limit"], _steps(model, asked.slew)),
        *_protection(model, asked),
        Need("bus_watchdog", 0, passing=True),  # a tripped one refuses goals, so it comes first
        Need("profile_velocity", 0, passing=True),
        Need("profile_acceleration", 0, passing=True),
    ]
    unit, limit = model["current_unit_mA"], model["current_limit"]
    if unit is not None and limit is not None:
        found.append(Need("current_limit", limit, min(math.floor(asked.current_mA / unit), limit)))
        found.append(Need("goal_pwm", model["pwm_limit"], passing=True))
    return found + [Need(name, gain, passing=True) for name, gain in zip(GAINS, asked.gains)]


def _protection(model: ServoModel, asked: Asked) -> list[Need]:
    """Return the requirements for the registers by which a servo protects itself.

    A limit tighter than the guard's would shut the servo down before the guard releases tension.
    """
    hottest = round(model["temperature_limit_C"])
    low, high = model["voltage_V"]
    hot = hottest if asked.hot is None else min(asked.hot, hottest)
    least, most = model["voltage_V"] if asked.voltage is None else asked.voltage
    low, high, least, most = (
        round(PER_VOLT * volts) for volts in (low, high, max(least, low), min(most, high))
    )
    return [
        Need("temperature_limit", hottest, math.ceil(hot), hottest),
        Need("max_voltage_limit", high, most, high),
        Need("min_voltage_limit", low, low, least),
        Need("shutdown", model["shutdown"], bits=True),
    ]


def differing(model: ServoModel, values: Values, asked: Asked | None = None) -> list[Need]:
    """Return the needs that the registers `values` of a servo do not meet."""
    return [need for need in needs(model, asked) if not need.met(values[need.register])]


def complaints(found: ServoState, values: Values, asked: Asked | None = None) -> list[str]:
    """Return a sentence for each fault that blocks a start: finding and, after "; ", remedy."""
    model = found.model
    if model is None:
        known = ", ".join(one["name"] for one in _core.servo_models())
        return [f"model {found.number} is not known; known are {known}"]
    remedy = f"run {setup_command(found.port, found.baud, found.id)}"
    lines = [
        f"{differs(found, need, values[need.register], asked)}; {remedy}"
        for need in differing(model, values, asked)
        if not need.passing
    ]
    if bits := values["hardware_error_status"]:
        lines.append(f"it reports {hardware(bits)}; {restart(found, bits)}")
    if values["torque_enable"]:
        lines.append(
            "its torque is on: another program drives it, or one died; `softmap servo off` "
            "releases it"
        )
    if found.firmware < OLD:
        lines.append(too_old(found))
    return lines


def passing(found: ServoState, values: Values, asked: Asked | None = None) -> list[Need]:
    """Return the needs that are not met and that a start rewrites itself."""
    model = found.model
    return (
        [] if model is None else [need for need in differing(model, values, asked) if need.passing]
    )


def differs(found: ServoState, need: Need, value: int, asked: Asked | None = None) -> str:
    """Return actual and required value of a register: `drive mode is 9, needed is 0`."""
    model = found.model
    if (
        need.register == "current_limit"
        and model is not None
        and (unit := model["current_unit_mA"]) is not None
    ):
        cap = (usual(model) if asked is None else asked).current_mA
        return f"its current limit ({value * unit:.0f} mA) is below the cap ({cap:.0f} mA)"
    note = f" ({hardware(need.value)})" if need.register == "shutdown" else ""
    return f"{holds(found, need.register, value)}, needed is {need.allowed}{note}"


def holds(found: ServoState, register: str, value: int) -> str:
    """Return the value of a register as text, with the hazard if there is one."""
    note = f" ({MODES.get(value, 'unknown')})" if register == "operating_mode" else ""
    if register == "homing_offset" and found.firmware < CLEAR:
        note = (
            f" (with one, firmware {found.firmware} lets the motor run on when its watchdog trips "
            "in mode 4)"
        )
    if register == "shutdown":
        note = f" ({hardware(value) or 'no error shuts it down'})"
    if register in ("max_voltage_limit", "min_voltage_limit"):
        note = f" ({value / PER_VOLT:.1f} V)"
    return f"{register.replace('_', ' ')} is {value}{note}"


def too_old(found: ServoState) -> str:
    """Return the message on firmware without a watchdog."""
    update = f"update it to {_core.FAST_FIRMWARE} with Dynamixel Wizard"
    return f"its firmware {found.firmware} has no bus watchdog; {update}"


def rewritten(found: ServoState) -> str:
    """Return the remedy for a register that a start rewrites."""
    return f"each start writes it again, as does {setup_command(found.port, found.baud, found.id)}"


def remarks_on_gains(found: ServoState, values: Values, asked: Asked | None = None) -> list[str]:
    """Return a sentence for each gain that differs from the initial value in the manual.

    If the rig has the gains of set-up, these count instead (`passing`), and the list is empty.
    """
    if found.model is None or (asked is not None and asked.gains):
        return []
    setup = setup_command(found.port, found.baud, found.id)
    return [
        f"{holds(found, name, values[name])}, the manual's initial value is {gain}; {setup} lets "
        "the servo set its gains again, and with --rig the rig keeps what its firmware sets"
        for name, gain in zip(GAINS, manual_gains(found.model))
        if gain != values[name]
    ]


def hardware(bits: int) -> str:
    """Return the hardware errors of register 70 as text."""
    known = [text for bit, text in _core.HARDWARE_ERRORS if bits & bit]
    left = bits & ~sum(bit for bit, _ in _core.HARDWARE_ERRORS)
    return ", ".join([*known, *([f"error {left:#04x}"] if left else [])])


def ways_out(bits: int) -> str:
    """Return what to do about the causes of hardware errors."""
    known = [text for bit, text in WAYS_OUT.items() if bits & bit]
    return ", ".join(known) or "find the cause"


def restart(found: ServoState, bits: int) -> str:
    """Return the remedy for hardware errors."""
    return (
        f"{ways_out(bits)}, then run `softmap servo reboot --port {shlex.quote(found.port)} "
        f"--baud {found.baud} --id {found.id}` (or switch its supply off and on)"
    )


def brought_by(found: ServoState, values: Values, asked: Asked | None = None) -> list[Need]:
    """Return the needs that are not met and may bring about the hardware errors in `values`."""
    bits = values["hardware_error_status"]
    names = [name for bit, some in BROUGHT_BY.items() if bits & bit for name in some]
    model = found.model
    return (
        []
        if model is None
        else [need for need in differing(model, values, asked) if need.register in names]
    )


def setup_command(port: str, baud: int, id: int, more: str = "") -> str:
    """Return the command that sets one servo up."""
    return f"`softmap servo setup --port {shlex.quote(port)} --baud {baud} --id {id}{more}`"


def _steps(model: ServoModel, slew: float) -> int:
    """Return the velocity limit for `slew` ticks/s, at most the factory setting."""
    share = min(1.0, slew / float(model["fastest_ticks_per_s"]))
    return math.ceil(share * int(model["velocity_limit"]) - 1e-9)


def gains_of(rig_made: Mapping[str, Document], id: int) -> tuple[int, ...]:
    """Return the gains of a servo at set-up, from `[made]` of its rig; empty if unknown."""
    kept = rig_made.get(SET_UP, {}).get(f"servo_{id}", [])
    complete = isinstance(kept, list) and len(kept) == len(GAINS)
    return (
        tuple(kept)
        if complete and all(type(one) is int and 0 <= one <= MOST_GAIN for one in kept)
        else ()
    )
