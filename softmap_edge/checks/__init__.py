"""Checks of the data: lost points, clocks, conditions that cannot be separated, a run of another
robot.
"""
