"""A finger whose commands pull one cable or the other."""

import numpy as np

# rad per mm of the two cables of each command: no two are alike
PULLS = (0.060, 0.050), (0.075, 0.055)


def finger(u, rings=3, length=110.0):
    """Markers (n, rings, 3) mm of an arm of constant curvature; a cable at work stiffens it for the
    other command.
    """
    up, down = np.maximum(u, 0.0), np.maximum(-u, 0.0)
    bend = np.stack([up[:, c] * PULLS[c][0] - down[:, c] * PULLS[c][1] for c in (0, 1)], axis=1)
    bend = bend * (1.0 - 0.012 * (up + 0.5 * down)[:, ::-1])
    angle, heading = np.maximum(np.hypot(*bend.T), 1e-9), np.arctan2(bend[:, 1], bend[:, 0])
    turned = np.linspace(0.0, 1.0, rings + 1)[1:, None] * angle
    out, along = length / angle * (1.0 - np.cos(turned)), length / angle * np.sin(turned)
    return np.stack([out * np.cos(heading), out * np.sin(heading), along], axis=2).swapaxes(0, 1)
