"""What goes wrong on the training side; caught as one family with the edge's."""

from __future__ import annotations

from softmap_edge.errors import SoftmapError


class TrainingError(SoftmapError):
    """A set, a checkpoint or a network that cannot be used; the message says what to do."""
