"""Robots as rods: `robot.toml`, models learned from a reference run."""
