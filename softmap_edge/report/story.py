"""The content of a report page, which its text and its pictures share.

Pinned by tests/report/.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from softmap_edge.comparison.comparison import Comparison
from softmap_edge.comparison.series import Series
from softmap_edge.files.atomic import Document
from softmap_edge.run.in_unit import PLACES


@dataclass(frozen=True)
class Story:
    """The content of a page; `before` and `after` are comparisons of the same run."""

    before: Comparison | None
    after: Comparison | None
    diagnosis: Document | None
    series: Series | None
    floor: tuple[float, str] | None = None
    ways: Mapping[str, float | None] | None = None
    ways_on: str = ""
    unit: str = PLACES  # of every number on the page except commands

    @property
    def places(self) -> bool:
        """Whether the page is about a body; outputs have no shape to draw."""
        return self.unit == PLACES

    @property
    def things(self) -> str:
        """The compared quantity: the points of a body, or outputs."""
        return "points" if self.places else "outputs"

    @property
    def noise(self) -> str:
        """The meaning of the floor, as a phrase."""
        return "the camera's noise" if self.places else "the sensor's noise"

    @property
    def short(self) -> str:
        """Whether the shown errors are held out, for a caption; the top of the page has more."""
        known = self.series is not None and self.series.kind != "measured"
        return f"; {self.series.kind}" if known and self.series is not None else ""
