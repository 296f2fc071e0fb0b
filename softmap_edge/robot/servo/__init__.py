"""The servos of a rig: their bus, registers and limits, and the checks before a start."""
