"""Commission a rig: set up servos, home the robot, jog, run the pull test, calibrate without a
camera.
"""
