"""Noise of a run: repeats, jitter, motion at rest, and the floor below which no model can go."""
