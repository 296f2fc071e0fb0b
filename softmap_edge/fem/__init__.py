"""Fingers as solids.

`finger.toml`, meshes, the simulator, models made with it, and its numbers fitted to a run.
"""
