"""Noise of a run: repeats, jitter, motion at rest, and the noise floor of all models."""
