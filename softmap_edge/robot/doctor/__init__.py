"""Check what a computer or a rig lacks to drive a robot; nothing moves.

Each fault comes with its remedy.

    from softmap_edge.robot.doctor import examine
    print(examine())

Without a rig, nothing is sent to servos; with one, only read requests. `host.py` checks the
computer, `rig_checks.py` one rig. Pinned by tests/robot/test_doctor.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from softmap_edge.files.atomic import Document
from softmap_edge.robot.finding import FAULT, OK, WARNING, Line
from softmap_edge.robot.remedies import filled
from softmap_edge.version import __version__

__all__ = ["FAULT", "OK", "WARNING", "Examined", "Line", "examine"]


@dataclass(frozen=True)
class Examined:
    """The results of all checks; `well` if there is no fault."""

    lines: tuple[Line, ...]

    @property
    def well(self) -> bool:
        """Whether there is no fault; warnings do not count."""
        return all(line.state != FAULT for line in self.lines)

    def __str__(self) -> str:
        count = {
            state: sum(line.state == state for line in self.lines) for state in (OK, WARNING, FAULT)
        }
        summary = ", ".join(
            f"{n} {state}{'s' if n != 1 and state != OK else ''}" for state, n in count.items()
        )
        return "\n".join([*map(str, self.lines), summary])

    def to_dict(self) -> Document:
        """Return the document softmap.doctor/1."""
        lines = [asdict(line) for line in self.lines]
        return {
            "schema": "softmap.doctor/1",
            "softmap": __version__,
            "well": self.well,
            "lines": lines,
        }


def examine(
    rig: str | Path | None = None, bundle: str | Path | None = None, camera: str | None = None
) -> Examined:
    """Run all checks: of this computer, and of the given parts of a rig.

    Args:
        rig: a `rig.toml`; its port is opened, and its servos are read
        bundle: folder of the bundle; with a rig, the effective limits are checked too
        camera: number of a camera, which is opened and closed
    """
    from softmap_edge.robot.doctor import host, rig_checks

    looks: list[Callable[[], Iterable[Line]]] = [
        host.versions,
        host.processor,
        host.real_time,
        lambda: host.ports(host.DEV, rig),
        host.latency,
        host.teleoperation,
        lambda: host.cameras(camera),
    ]
    looks += [] if bundle is None else [lambda: rig_checks.check_bundle(bundle)]
    looks += [] if rig is None else [lambda: rig_checks.check_rig(rig, bundle)]
    looks += [] if rig is None or bundle is None else [lambda: rig_checks.check_limits(rig, bundle)]
    files = [None if one is None else str(one) for one in (rig, bundle)]
    lines = [line for look in looks for line in _safely(look)]
    return Examined(
        tuple(
            replace(line, do=filled(line.do, *files), found=filled(line.found, *files))
            for line in lines
        )
    )


def _safely(look: Callable[[], Iterable[Line]]) -> list[Line]:
    """Return a check's lines; a check that raises an error gives a line too.

    The doctor looks for exactly such errors.
    """
    try:
        return list(look())
    except Exception as fault:
        name = getattr(look, "__name__", "look").replace("_", " ").replace("<lambda>", "look")
        message = f"could not be looked at ({type(fault).__name__}: {str(fault)[:120]})"
        return [Line(name, FAULT, message, "this is a fault of softmap: please report it")]
