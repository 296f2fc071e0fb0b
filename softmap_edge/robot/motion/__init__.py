"""Kinematics of a model: inverse kinematics, figures, timing."""
