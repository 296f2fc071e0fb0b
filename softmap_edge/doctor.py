"""Is this computer fit to drive a robot: everything is looked at, nothing moves, each fault comes with its remedy.

    from softmap_edge.doctor import examine
    print(examine())

Nothing is sent to a servo unless a rig is given, and then only questions. `doctor_host.py` looks at the computer,
`doctor_bench.py` at what belongs to one bench. Pinned by tests/test_doctor.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from softmap_edge import __version__

OK, WARNING, FAULT = "ok", "warning", "fault"


@dataclass(frozen=True)
class Line:
    """One thing that was looked at: its name, `ok`, `warning` or `fault`, what was found, and what to do (or empty)."""

    name: str
    state: str
    found: str
    do: str = ""

    @property
    def fine(self) -> bool:
        """Whether it is in order."""
        return self.state == OK

    def __str__(self) -> str:
        said = f"{self.state:<8} {self.name}: {self.found}"
        return f"{said}\n{'':<9}→ {self.do}" if self.do else said


@dataclass(frozen=True)
class Examined:
    """All that was looked at; it is `well` when there is no fault."""

    lines: tuple[Line, ...]

    @property
    def well(self) -> bool:
        """Whether nothing is at fault; warnings are none."""
        return all(line.state != FAULT for line in self.lines)

    def __str__(self) -> str:
        count = {state: sum(line.state == state for line in self.lines) for state in (OK, WARNING, FAULT)}
        told = ", ".join(f"{n} {state}{'s' if n != 1 and state != OK else ''}" for state, n in count.items())
        return "\n".join([*map(str, self.lines), told])

    def to_dict(self) -> dict[str, Any]:
        """Return the document softmap.doctor/1."""
        lines = [asdict(line) for line in self.lines]
        return {"schema": "softmap.doctor/1", "softmap": __version__, "well": self.well, "lines": lines}


def examine(rig: str | Path | None = None, bundle: str | Path | None = None, camera: str | None = None) -> Examined:
    """Look at everything: this computer, and what is given of a bench.

    Args:
        rig: a `rig.toml`, whose port is opened and whose servos are asked what they are. bundle: its folder. camera:
            number of a camera, which is opened and closed.
    """
    from softmap_edge import doctor_bench, doctor_host

    looks: list[Callable[[], Iterable[Line]]] = [
        doctor_host.versions,
        doctor_host.processor,
        doctor_host.real_time,
        doctor_host.ports,
        doctor_host.latency,
        doctor_host.teleoperation,
        lambda: doctor_host.cameras(camera),
    ]
    looks += [] if bundle is None else [lambda: doctor_bench.bundle(bundle)]
    looks += [] if rig is None else [lambda: doctor_bench.rig(rig)]
    return Examined(tuple(line for look in looks for line in _safely(look)))


def _safely(look: Callable[[], Iterable[Line]]) -> list[Line]:
    """Return its lines; a look that fails is a line too, for whatever it stumbles over is what a doctor is for."""
    try:
        return list(look())
    except Exception as fault:
        name = getattr(look, "__name__", "look").replace("_", " ")
        said = f"could not be looked at ({type(fault).__name__}: {str(fault)[:120]})"
        return [Line(name, FAULT, said, "this is a fault of softmap: please tell it")]
