"""Runs: the commands of a robot and what was measured of it."""
