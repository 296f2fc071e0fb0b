"""A finger on emulated servos, in place of hardware."""
