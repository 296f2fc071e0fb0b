"""Runs: what a robot was commanded and what was seen of it."""
