"""The servos of a rig: their bus, registers, limits, and what keeps them from a start."""
