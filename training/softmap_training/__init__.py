"""The training side of SOFTMAP-Edge: whatever needs torch or more data than fits a robot."""
