"""Simulate runs of fingers with hidden effects, for the demo, tests and benchmarks."""
