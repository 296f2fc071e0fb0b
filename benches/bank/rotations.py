"""Rotations in batches: vectors to matrices and back, into and out of frames (rad)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def hat(v: Floats) -> Floats:
    """Return the matrices (..., 3, 3) of v (..., 3): hat(v) w = v × w."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def turn(v: Floats) -> Floats:
    """Return the rotations (..., 3, 3) of rotation vectors (..., 3) rad."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = hat(v)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)
    )


def log(frame: Floats) -> Floats:
    """Return the rotation vectors (..., 3) rad of rotations by less than a quarter turn."""
    part = (
        np.stack(
            [
                frame[..., 2, 1] - frame[..., 1, 2],
                frame[..., 0, 2] - frame[..., 2, 0],
                frame[..., 1, 0] - frame[..., 0, 1],
            ],
            axis=-1,
        )
        / 2
    )
    sine = np.linalg.norm(part, axis=-1)[..., None]
    return np.asarray(
        part
        * np.where(sine < 1e-9, 1.0, np.arcsin(np.minimum(sine, 1.0)) / np.maximum(sine, 1e-300))
    )


def transposed(a: Floats) -> Floats:
    """Return the transposed matrices."""
    return np.swapaxes(a, -1, -2)


def into(frame: Floats, v: Floats) -> Floats:
    """Return vectors in the frame."""
    return np.asarray(np.einsum("...ij,...i->...j", frame, v))


def out_of(frame: Floats, v: Floats) -> Floats:
    """Return vectors of the frame in space."""
    return np.asarray(np.einsum("...ij,...j->...i", frame, v))
