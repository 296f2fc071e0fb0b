"""off_centre_pulley: a spool that turns about a point off its centre, with uneven winding."""

import numpy as np

EFFECT = {
    "name": "off_centre_pulley",
    "stage": "transmission",
    "formula": "x = u + a · sin(u / radius) + b · (cos(u / radius) − 1)",
    "doc": "The spool of each channel turns about a point off its middle.",
    "signature": "Periodic in the command, the same in loading and unloading.",
    "parameters": [
        {"name": "a", "unit": "mm", "null": 0, "start": 0.3, "low": -2, "high": 2, "doc": "odd",
         "per_channel": True},
        {"name": "b", "unit": "mm", "null": 0, "start": 0.3, "low": -2, "high": 2, "doc": "even",
         "per_channel": True},
        {"name": "radius", "unit": "mm", "null": 6, "start": 6, "low": 3, "high": 12,
         "doc": "of the spool"},
    ],
}


def rollout(params, u, t, ctx):
    a, b = np.split(params[:, None, :-1], 2, axis=2)  # (B, 1, C)
    radius = params[:, -1, None, None]
    return u + a * np.sin(u / radius) + b * (np.cos(u / radius) - 1.0)
