"""Drive a real or emulated robot: servos, control loop, motions, teleoperation, checks.

Nothing here imports the simulator, the diagnosis or the reports, so it stays small on a board.
"""
