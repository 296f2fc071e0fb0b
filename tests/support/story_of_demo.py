"""The fingers of the demo whose story is tested."""

from softmap_edge.robot.emulated.laws import TipWeight, TrueWeight

FIRST = ["home revisits", "triangles of growing size", "diagonals", "fast and slow triangles"]


SECRETS = {"payload": TipWeight(11.0), "gravity": TrueWeight(0.45, (16.0, -9.0))}
