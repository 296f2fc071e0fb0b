"""Turns single bits of recordings and sorts what a reader makes of each: refused, reported, the
same, or silent.
"""

import warnings
from collections import Counter

import numpy as np

from softmap_edge.errors import SoftmapError


def numbers_of(run):
    """Return the arrays of a run, for comparison to the last bit."""
    return {name: value for name, value in run.arrays().items() if name != "made_from"}


def alike(one, other):
    """Whether two runs hold the same arrays, bit for bit."""
    if one.keys() != other.keys():
        return False
    return all(np.array_equal(one[k], other[k], equal_nan=one[k].dtype.kind == "f") for k in one)


def flip_bits(path, read, count, seed):
    """Flip `count` single bits of the file at `path`, one at a time, and return how many of each
    kind there were.

    read: makes a run of the file. The kinds: `refused` (an error of ours), `reported` (a warning),
    `same` (no word and the same numbers), and `silent` (no word and other numbers), with the places
    (byte, bit) of the silent ones.
    """
    good = path.read_bytes()
    sound = numbers_of(read(path))
    rng = np.random.default_rng(seed)
    kinds, silent = Counter(), []
    for byte, bit in zip(rng.integers(len(good), size=count), rng.integers(8, size=count)):
        bad = bytearray(good)
        bad[byte] ^= 1 << bit
        path.write_bytes(bad)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                run = read(path)
            except SoftmapError:
                kinds["refused"] += 1
                continue
        kind = "reported" if said else "same" if alike(numbers_of(run), sound) else "silent"
        kinds[kind] += 1
        if kind == "silent":
            silent.append((int(byte), int(bit)))
    path.write_bytes(good)
    return kinds, silent
