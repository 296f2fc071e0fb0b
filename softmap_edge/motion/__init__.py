"""Where the tip should go: inverse kinematics, paths and their timing, tracking."""
