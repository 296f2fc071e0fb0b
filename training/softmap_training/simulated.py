"""The training set of a network: the shapes of a sweep.

It is read from a Zarr store chunk by chunk, or from the edge's `.npz`.

    made = SimulatedSet.load("dense.zarr")
    split = made.split(seed=0)
    made.command[split.train], made.shapes(split.train)

The rule of the split is frozen (`softmap.split/1`, whose name a store holds): row r gets
splitmix64(r + 1 of the seed's stream) (Steele, Lea and Flood 2014), rows are sorted by that number;
the first 80 % are for training, the next 10 % for validation, the rest for testing. It does not
depend on a library's generator. Rows of a dense grid have near neighbours in every part, so the
test measures interpolation, not memory or the real robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import SimulationError
from softmap_edge.fem.simulator import Sweep
from softmap_training.store import SPLIT, Store, open_store

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

TRAIN, VALIDATION = 0.8, 0.1  # shares of the rows; the rest is for testing
MOST_SEED = 1 << 32


@dataclass(frozen=True)
class Split:
    """Rows (n,) to train, validate and test, ascending; the seed and the rule of the split."""

    train: Rows
    validation: Rows
    test: Rows
    seed: int
    rule: str = SPLIT


@dataclass(frozen=True)
class SimulatedSet:
    """Simulated shapes: command (S, C) mm or N, vertices (S, N, 3) mm, triangles (F, 3).

    It also holds the finger's file as text.

    `vertices` takes slices and reads only these from a store; `shapes` reads and checks any rows.
    """

    command: Floats
    vertices: Any
    triangles: NDArray[np.int32]
    finger: str
    store: Store | None = None

    @classmethod
    def load(cls, path: str | Path) -> SimulatedSet:
        """Open a store, or read the `.npz` of a sweep.

        Raises SimulationError if it is damaged or unfinished.
        """
        file = Path(path)
        if file.suffix == ".npz":
            sweep = Sweep.load(file)
            return cls(sweep.command, sweep.vertices, sweep.triangles, sweep.finger.to_toml())
        store = open_store(file)
        if not store.done.all():
            raise SimulationError(
                f"{path}: {int(store.done.sum())} of {len(store.done)} chunks are done; "
                f"the `softmap model sweep` that began "
                "it goes on with it"
            )
        return cls(
            store.command, store.vertices, store.triangles, str(store.attributes["finger"]), store
        )

    def shapes(self, rows: ArrayLike) -> NDArray[np.float32]:
        """Return the vertices (n, N, 3) mm of rows (n,), reading each chunk once.

        Raises SimulationError for missing rows and for a damaged chunk.
        """
        chosen = np.asarray(rows)
        if (
            chosen.ndim != 1
            or chosen.dtype.kind not in "iu"
            or ((chosen < 0) | (chosen >= len(self.command))).any()
        ):
            raise SimulationError(
                f"rows of shape {chosen.shape}: give whole numbers from 0 to "
                f"{len(self.command) - 1}"
            )
        if self.store is None:
            return np.asarray(self.vertices[chosen], np.float32)
        found = np.empty((len(chosen), *self.vertices.shape[1:]), np.float32)
        chunk = chosen // self.store.chunk
        for k in np.unique(chunk):
            here = chunk == k
            found[here] = self.store.read(int(k))[chosen[here] - int(k) * self.store.chunk]
        return found

    def split(self, seed: int = 0) -> Split:
        """Split the rows by the frozen rule: seed and count always give the same split.

        Raises SimulationError for an invalid seed.
        """
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < MOST_SEED:
            raise SimulationError(
                f"seed {str(seed)[:40]}: give a whole number from 0 to {MOST_SEED - 1}"
            )
        count = len(self.command)
        order = np.argsort(
            _splitmix64(np.uint64(seed << 32) + np.arange(1, count + 1, dtype=np.uint64)),
            kind="stable",
        )
        first, second = round(TRAIN * count), round((TRAIN + VALIDATION) * count)
        parts = np.split(order.astype(np.int64), [first, second])
        return Split(*(np.sort(part) for part in parts), seed=seed)


def _splitmix64(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return a well-mixed number (n,) for each position x of the stream."""
    z = x * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
