"""Commands that move a rod through its range."""

import numpy as np


def commands(t):
    """Smooth wandering that fills the square of ±10 by ±8 and does not repeat in a minute."""
    x = 6 * np.sin(0.7 * t) + 4 * np.sin(1.9 * t + 1)
    return np.stack([x, 5 * np.sin(0.9 * t + 2) + 3 * np.sin(2.3 * t)], axis=1)
