"""Simulate, compare and diagnose tendon-driven soft robots."""

from softmap_edge.errors import SoftmapError

__version__ = "0.1.0"
__all__ = ["SoftmapError", "__version__"]
