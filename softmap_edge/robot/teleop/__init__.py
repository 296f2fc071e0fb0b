"""Teleoperation: camera frames, hand landmarks, keys, the enable key, and the browser page."""
