"""A finger behind emulated servos, in place of hardware."""
