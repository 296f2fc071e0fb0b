"""The emergency stops of a rig: `[emergency]` of its `rig.toml`.

    [emergency]
    gpio = {chip = "/dev/gpiochip0", line = 17, active_low = false}
    udp = {port = 5006, key_file = "stop.key", timeout = 0.2}

The control loop checks them in each period (`rust/control/emergency.rs`). A stop that cannot be
read, or sends no heartbeat, counts as pressed. docs/reference/safety.md explains how to wire and
use them. Pinned by tests/robot/test_emergency.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from softmap_edge.errors import ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.files.toml import TomlTable, quoted

TIMEOUT = 0.2  # s: allows for some lost heartbeats of the usual fifty per second
SHORTEST, LONGEST = 0.02, 2.0  # s: range of `timeout`
LINES = 511  # highest line number of a chip


@dataclass(frozen=True)
class Line:
    """A line of a GPIO chip with its pull-up enabled.

    A contact that opens when pressed then reads high, and so does a broken wire. `active_low` is
    for a contact that closes to ground.
    """

    chip: str
    line: int
    active_low: bool = False


@dataclass(frozen=True)
class Beats:
    """A heartbeat on UDP `host`:`port`, signed with the key in `key_file`.

    At least one is expected every `timeout` s.
    """

    port: int
    key_file: str
    timeout: float = TIMEOUT
    host: str = "0.0.0.0"


@dataclass(frozen=True)
class Emergency:
    """The emergency stops of a rig; none by default."""

    gpio: Line | None = None
    udp: Beats | None = None

    def __str__(self) -> str:
        message = []
        if self.gpio is not None:
            message.append(f"line {self.gpio.line} of {self.gpio.chip}")
        if self.udp is not None:
            message.append(f"no heartbeat at UDP port {self.udp.port} for {self.udp.timeout:g} s")
        return ", or ".join(message) or "none"

    def setup(self) -> Document:
        """Return the settings for the process of the loop, without the key itself."""
        gpio, udp = self.gpio, self.udp
        return {
            "gpio": None if gpio is None else [gpio.chip, gpio.line, gpio.active_low],
            "heartbeat": None if udp is None else [udp.host, udp.port, udp.key_file, udp.timeout],
        }

    def to_toml(self) -> list[str]:
        """Return the lines of its table; none if there is no stop."""
        lines = []
        if self.gpio is not None:
            low = "true" if self.gpio.active_low else "false"
            lines.append(
                f"gpio = {{chip = {quoted(self.gpio.chip)}, line = {self.gpio.line}, active_low = "
                f"{low}}}"
            )
        if (udp := self.udp) is not None:
            lines.append(
                f"udp = {{host = {quoted(udp.host)}, port = {udp.port}, key_file = "
                f"{quoted(udp.key_file)}, timeout = {udp.timeout!r}}}"
            )
        return ["", "[emergency]", *lines] if lines else []


def read_emergency(table: TomlTable, folder: Path) -> Emergency:
    """Read the stops of a rig; a relative key file is in `folder`.

    Raises:
        RunError: a name is unknown, or a value is out of range.
        ServoError: a stop lacks a required entry.
    """
    gpio = udp = None
    if "gpio" in table.values:
        one = table.table("gpio")
        chip, line = one.get("chip", (str,), "/dev/gpiochip0"), one.integer("line", None, 0, LINES)
        if line is None:
            raise ServoError(f"{one.where}: no line; `gpioinfo` lists them")
        gpio = Line(chip, line, one.get("active_low", (bool,), False))
        one.done()
    if "udp" in table.values:
        one = table.table("udp")
        port, key = one.integer("port", None, 1, 65_535), one.get("key_file", (str,), "")
        if port is None or not key:
            raise ServoError(
                f"{one.where}: no port or no key_file; `softmap servo heartbeat --new-key FILE` "
                "makes one"
            )
        timeout = one.number("timeout", TIMEOUT, SHORTEST, LONGEST)
        assert timeout is not None
        udp = Beats(
            port, str((folder / key).absolute()), timeout, one.get("host", (str,), Beats.host)
        )
        one.done()
    for name in ("gpio", "udp"):
        table.get(name, (dict,))
    table.done()
    return Emergency(gpio, udp)
