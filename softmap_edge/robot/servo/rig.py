"""One rig: its servos and their home, on the machine that drives them (`rig.toml`).

A bundle may come from another person; data of a rig stay out of it. Pinned by
tests/robot/test_rig_file.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from softmap_edge import _core
from softmap_edge.errors import ServoError, SoftmapError
from softmap_edge.files.atomic import MOST_TEXT, Document, own_text, write_atomically
from softmap_edge.files.toml import TomlTable, parsed, quoted, written
from softmap_edge.robot.servo.clock import REAL_TIME, Clock
from softmap_edge.robot.servo.emergency import Emergency, read_emergency
from softmap_edge.robot.servo.models import servo_model
from softmap_edge.robot.servo.rig_ceiling import RANGES, Ceiling, read_ceiling

SCHEMA = "softmap.rig/1"
MOST_SERVOS = int(_core.limit_ranges()["servos"][1])
FARTHEST = int(_core.limit_ranges()["home"][1])  # ticks: 256 turns
# entries of a servo that are written if known
KEPT = ("home", "current_mA", "low", "high", "slew", "acceleration")


@dataclass(frozen=True)
class RigServo:
    """A servo: its id on the bus, its model's name, its home, and its ceiling.

    Home is the tick at which the finger is straight (None: never homed). The ceiling (None: not
    measured) is mA at the stroke, ticks about home, ticks/s, ticks/s².
    """

    id: int
    model: str
    home: int | None = None
    current_mA: float | None = None
    low: int | None = None
    high: int | None = None
    slew: float | None = None
    acceleration: float | None = None


@dataclass(frozen=True)
class Rig:
    """A port, its baud rate, and the servos in the order of the commands.

    `ceiling` limits all servos, `emergency` holds the stops that the loop checks, and `made` states
    how each value was found. `time` is the clock of the servos and `file` the file that the rig was
    read from; neither is stored.

    Raises:
        ServoError: two servos have one id, a model is unknown, or there are none or too many
            servos.
    """

    port: str
    baud: int
    servos: tuple[RigServo, ...]
    ceiling: Ceiling = Ceiling()
    emergency: Emergency = Emergency()
    made: Mapping[str, Document] = field(default_factory=dict)
    time: Clock = field(default=REAL_TIME, compare=False, repr=False)
    file: str | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        ids = [servo.id for servo in self.servos]
        if not 1 <= len(ids) <= MOST_SERVOS:
            raise ServoError(f"the rig has {len(ids)} servos; allowed are 1 to {MOST_SERVOS}")
        for servo in self.servos:
            try:
                known = servo_model(servo.model)
            except ServoError as fault:
                raise ServoError(f"servo {servo.id}: {fault}") from None
            if ids.count(servo.id) > 1 or not 0 <= servo.id <= 252:
                raise ServoError(
                    f"servo id {servo.id} stands twice or beyond 252; give each servo one of its "
                    "own"
                )
            if self.baud not in known["baud_rates"]:
                raise ServoError(
                    f"servo {servo.id}, a {servo.model}, has no rate of {self.baud} baud"
                )
            if not (servo.low is None or servo.low < 0) or not (
                servo.high is None or servo.high > 0
            ):
                raise ServoError(
                    f"servo {servo.id}: low {servo.low}, high {servo.high}; expected low < 0 < high"
                )

    @property
    def numbers(self) -> list[tuple[int, int]]:
        """Id and model number of each servo."""
        return [(servo.id, servo_model(servo.model)["number"]) for servo in self.servos]

    def to_toml(self) -> str:
        """Return the text of `rig.toml`."""
        lines = [f'schema = "{SCHEMA}"', f"port = {quoted(self.port)}", f"baud = {self.baud}"]
        lines += [*self.ceiling.to_toml(), *self.emergency.to_toml()]
        for servo in self.servos:
            lines += ["", "[[servo]]", f"id = {servo.id}", f'model = "{servo.model}"']
            lines += [
                f"{key} = {value}" for key in KEPT if (value := getattr(servo, key)) is not None
            ]
        for name, found in self.made.items():
            lines += [
                "",
                f"[made.{quoted(name)}]",
                *(f"{quoted(key)} = {written(message)}" for key, message in found.items()),
            ]
        return "\n".join(lines) + "\n"

    def write(self, path: str | Path) -> None:
        """Write a new `rig.toml`, complete or not at all."""
        write_atomically(path, self.to_toml())

    def note(self, path: str | Path) -> None:
        """Write the servos' data, and how it was found, into the rig's own `rig.toml`.

        The user's own entries and comments stay.

        Raises:
            ServoError: the file is not a rig any more.
            OSError: it cannot be read or written.
        """
        from softmap_edge.robot.servo.rig_edit import edited  # only an edit needs tomlkit

        read_rig(path)
        text = own_text(path, MOST_TEXT, keep_line_ends=True)
        write_atomically(path, edited(text, self.to_toml(), KEPT))


def read_rig(path: str | Path) -> Rig:
    """Read a `rig.toml`.

    Raises:
        ServoError: the file is missing, is not TOML, has another schema or a bad entry, or a key is
            unknown: a mistyped stop or limit would have no effect.
    """
    file = Path(path)
    try:
        table = TomlTable(parsed(own_text(file, MOST_TEXT)), str(file))
        table.choice("schema", (SCHEMA,), "")
        port, baud = table.get("port", (str,), ""), table.integer("baud", 57_600, 9_600, 4_500_000)
        servos = []
        for k, entry in enumerate(table.get("servo", (list,), [])):
            one = TomlTable(entry, f"{file}: servo {k + 1}")
            id = one.integer("id", None, 0, 252)
            if id is None:
                raise ServoError(f"{file}: servo {k + 1} has no id; `softmap servo scan` finds it")
            servos.append(
                RigServo(
                    id,
                    one.get("model", (str,), ""),
                    one.integer("home", None, -FARTHEST, FARTHEST),
                    one.number("current_mA", None, *RANGES["current_mA"]),
                    one.integer("low", None, *_whole(RANGES["low"])),
                    one.integer("high", None, *_whole(RANGES["high"])),
                    one.number("slew", None, *RANGES["slew"]),
                    one.number("acceleration", None, *RANGES["acceleration"]),
                )
            )
            one.done()
        if not port or baud is None:
            raise ServoError(f"{file}: no port; `softmap servo scan` finds it")
        ceiling = read_ceiling(table.table("ceiling"))
        emergency = read_emergency(table.table("emergency"), file.parent)
        made = table.table("made")
        found = {name: _found(made.table(name)) for name in made.values}
        table.done()
        return Rig(port, baud, tuple(servos), ceiling, emergency, found, file=str(file))
    except OSError as fault:
        if file.exists():
            raise ServoError(f"{file}: {fault.strerror}; give a rig.toml") from None
        from softmap_edge.files.printable import shell_file

        make = f"make it with `softmap servo setup --rig {shell_file(file)}`"
        raise ServoError(f"{file}: {fault.strerror}; {make}") from None
    except ServoError:
        raise
    except SoftmapError as fault:
        raise ServoError(str(fault)) from None
    except (ValueError, RecursionError) as fault:  # invalid TOML or text raises ValueError
        raise ServoError(f"{file}: no TOML ({fault!s:.80})") from None


def _whole(bounds: tuple[float, float]) -> tuple[int, int]:
    return int(bounds[0]), int(bounds[1])


def _found(table: TomlTable) -> Document:
    """Return how a value was found: texts, numbers and lists of them."""
    for key, value in table.values.items():
        each = value if isinstance(value, list) else [value]
        if not all(isinstance(one, str | int | float) for one in each):
            raise ServoError(
                f"{table.where}: {key} is {type(value).__name__}, expected a text, a number or a "
                "list of them"
            )
    return table.values
