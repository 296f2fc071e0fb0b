"""One check of the doctor as a line: its name, state, finding and remedy.

Errors here state the finding and, after "; ", the remedy (`remedies.parted`). Pinned by
tests/robot/test_doctor.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from softmap_edge.robot.remedies import parted

OK, WARNING, FAULT = "ok", "warning", "fault"


@dataclass(frozen=True)
class Line:
    """One check: its name, `ok`, `warning` or `fault`, the finding, and the remedy (or empty)."""

    name: str
    state: str
    found: str
    do: str = ""

    @property
    def fine(self) -> bool:
        """Whether the check passed."""
        return self.state == OK

    def __str__(self) -> str:
        message = f"{self.state:<8} {self.name}: {self.found}"
        return f"{message}\n{'':<9}→ {self.do}" if self.do else message


def faulty(name: str, message: object, otherwise: str) -> Line:
    """Return an error or a message as a line; `otherwise` is the remedy if the message has none."""
    found, do = parted(message)
    return Line(name, FAULT, found or "no reason is given", do or otherwise)
