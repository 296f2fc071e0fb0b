"""Compute dense sweeps into a Zarr store, on the local cores or on a Dask cluster.

An interrupted sweep can be resumed.

    sweep_to_zarr(Finger.builtin(), "dense.zarr", grid_axes(Finger.builtin(), 101))

A chunk is a sequence of grid rows. It is solved independently, from the home pose along a short
path through its commands (`tour`, `Simulator.path`). So its values do not depend on other chunks or
on the machine; they equal those of `Simulator.sweep` within the solver's tolerance. One process
writes; workers of a cluster only solve. They need softmap-training and, for an imported mesh, its
file at the same path. If a worker is lost, its chunk goes to another one (Dask gives up after four
losses). Units: mm, N, g.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SimulationError, SoftmapError, brief
from softmap_edge.fem.bodies import Meshed
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator, tour
from softmap_training.store import Store, attributes_of, make, open_store

Floats = NDArray[np.float64]
Progress = Callable[[float], None]
Solved = tuple[int, Floats, Floats]

# rows: four threads of `Simulator.path`, a few seconds per finger, 1.7 MB for 548 vertices
CHUNK = 256
WAIT = 30  # timeouts for a cluster's reply, and for its first worker, s
# chunks per thread of a cluster: limits the results in memory
AHEAD = 2
ADDRESS = re.compile(r"[a-z]+://[^\s/]+:\d{1,5}")
AGAIN = "the same command goes on where it stopped"

_building = threading.Lock()


def sweep_to_zarr(
    finger: Finger,
    path: str | Path,
    axes: Sequence[Floats],
    chunk: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> tuple[Store, int]:
    """Simulate every command of a grid into a Zarr store, or resume one.

    axes: one ascending array of mm (or N) for each command · path: the folder to write or to resume
    · chunk: rows that are solved and written together, by default those of the existing store, else
    256 · dask: the address of a cluster's scheduler, the local cores without it · progress: called
    with the completed share, 0 to 1. Returns the store and the number of commands solved by this
    call. Raises SimulationError for a store of another sweep or a failing cluster,
    NoEquilibriumError, FingerError.
    """
    if dask is not None and not ADDRESS.fullmatch(dask):
        raise SimulationError(
            f"--dask {dask:.80}: no address of a scheduler; give one as tcp://HOST:8786"
        )
    path = Path(path)
    grid = [np.asarray(axis, np.float64) for axis in axes]
    store = open_store(path, "r+") if path.exists() else None
    rows = chunk or (store.chunk if store else CHUNK)
    required = attributes_of(finger, grid, rows)
    simulator = Simulator(finger)
    if store is None:
        make(path, required, simulator.template, len(finger.tendons))
        store = open_store(path, "r+")
    store.check_same(required)
    left = [int(k) for k in np.flatnonzero(~store.done)]
    report = progress or (lambda share: None)
    total, solved = len(store.done), 0

    def report_chunk(share: float) -> None:
        report((float(store.done.sum()) + share) / total)

    report_chunk(0.0)
    source = (
        _here(simulator, store, left, report_chunk)
        if dask is None
        else _on_cluster(dask, finger, store, left)
    )
    for k, vertices, pull in source if left else ():
        store.write(k, vertices, pull)
        solved += len(vertices)
        report_chunk(0.0)
    return store, solved


def solve(
    simulator: Simulator, command: Floats, progress: Progress | None = None
) -> tuple[Floats, Floats]:
    """Return vertices (n, N, 3) mm and pull (n, T) N at commands (n, C).

    They are solved from home along a short path.
    """
    order = tour(command)
    along = simulator.path_and_pull(command[order], progress=progress)
    vertices, pull = np.empty_like(along[0]), np.empty_like(along[1])
    vertices[order], pull[order] = along
    return vertices, pull


def _here(
    simulator: Simulator, store: Store, left: list[int], progress: Progress
) -> Iterator[Solved]:
    for k in left:
        yield k, *solve(simulator, store.command[store.rows(k)], progress)


def _on_cluster(address: str, finger: Finger, store: Store, left: list[int]) -> Iterator[Solved]:
    """Solve chunks on a cluster, as many at a time as it has threads, in any order."""
    from distributed import Client, as_completed

    if isinstance(finger.solid, Meshed):
        finger = finger.replace(file=str(Path(finger.solid.file).resolve()))
    text, waiting, which = finger.to_toml(), left[::-1], {}
    try:
        with Client(address, timeout=WAIT, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=WAIT)

            def submit() -> Any:
                k = waiting.pop()
                future = client.submit(_solve_there, text, store.command[store.rows(k)], pure=False)
                which[future.key] = k
                return future

            def room() -> int:
                return min(
                    len(waiting), max(1, AHEAD * sum(client.nthreads().values()) - len(which))
                )

            running = as_completed([submit() for _ in range(room())], loop=client.loop)
            for future in running:
                vertices, pull = future.result()
                yield which.pop(future.key), vertices, pull
                for _ in range(room()):
                    running.add(submit())
    except SoftmapError:
        raise
    except Exception as fault:  # a cluster may fail in many ways
        raise SimulationError(f"--dask {address}: {_of_the_cluster(fault)}; {AGAIN}") from None


def _solve_there(text: str, command: Floats) -> tuple[Floats, Floats]:
    """Solve the commands of a chunk on a worker."""
    with _building:  # the threads of a worker share one simulator
        simulator = _simulator(text)
    return solve(simulator, command)


@lru_cache(maxsize=4)
def _simulator(text: str) -> Simulator:
    return Simulator(Finger.from_toml(text))


def _of_the_cluster(fault: Exception) -> str:
    cause = brief(fault) or type(fault).__name__
    if isinstance(fault, ImportError):
        return f"a worker lacks a package ({cause}); install softmap-training there"
    if isinstance(fault, TimeoutError):
        return f"no worker answered within {WAIT} s ({cause}); start a scheduler and workers"
    return f"the cluster failed ({cause})"
