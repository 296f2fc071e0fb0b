"""Errors of the training part, derived from the base error of the edge part."""

from __future__ import annotations

from softmap_edge.errors import SoftmapError


class TrainingError(SoftmapError):
    """An unusable set, checkpoint or network; the message states the remedy."""
