"""Readers of point clouds: PLY, PCD, text, arrays; each point that was not seen is left out."""
