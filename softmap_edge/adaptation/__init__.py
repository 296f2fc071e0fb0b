"""Adapt a model to its robot: calibrate, add the effects found, learn the rest as a residual."""
