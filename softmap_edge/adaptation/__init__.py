"""Adapt a model to its robot: calibrate it, add the effects found, then learn a residual."""
