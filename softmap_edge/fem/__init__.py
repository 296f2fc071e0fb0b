"""Model fingers as solids.

`finger.toml`, meshes, the simulator, models made with it, and fits of finger parameters to a run.
"""
