"""Model robots as rods: `robot.toml`, and models learned from a reference run."""
