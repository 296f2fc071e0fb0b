"""A bench made ready: servos set up, home proved, small moves, the pull test, a first calibration."""
