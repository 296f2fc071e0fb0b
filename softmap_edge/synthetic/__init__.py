"""Runs of simulated fingers with hidden effects, for the demo, tests and benchmarks."""
