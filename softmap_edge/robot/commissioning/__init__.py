"""Commission a rig: set up servos, home, jog, pull test, calibration without a camera."""
