"""The training side of SOFTMAP-Edge: everything that needs torch or more data than fits a robot."""
