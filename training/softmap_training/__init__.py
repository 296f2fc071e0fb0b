"""The training part of SOFTMAP-Edge: everything that needs torch or large data."""
