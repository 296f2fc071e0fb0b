"""Trained networks of a bundle, `prior.onnx` and `residual.onnx`.

They map commands (n, C) to the points of a body (n, 3N) mm. The compiled core runs them
(`rust/network/`) with exact slopes and without onnxruntime. Training compares both when it exports
a network, and `softmap check BUNDLE` compares them again; hashes in the bundle protect the file in
between. Fits use features, not points: for them a network of up to three commands becomes a table
(`tabulated`).

A graph with other operators needs onnxruntime. It is run only if the user allows it
(`--trust-onnx`): once, in a child process with limits of memory and time, at the nodes of a grid
over its up to three commands. The results become a table (`table_from_onnxruntime`) with all
properties of a table: slopes, fields, a control loop without Python. The error of the table between
its nodes is measured, reported and limited. A graph is never run if it refers to other files, or
holds loops, branches, functions or foreign operators (`_core.check_onnx`). Pinned by
tests/model/test_network.py and tests/files/test_untrusted_bundles.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import BundleError, SoftmapError, brief
from softmap_edge.files.atomic import Document
from softmap_edge.files.child import ChildFault, in_child
from softmap_edge.files.npz import Stored
from softmap_edge.model.manifest import MAX_ONNX_BYTES
from softmap_edge.model.shapes import Grid, ModeArrays, NetworkArrays

Floats = NDArray[np.float64]

BATCH = 64  # commands per onnxruntime call, so that a wide graph needs little memory
CHILD_MB, CHILD_S = 1000, 60.0  # MB and s, limits of onnxruntime in a child process
CHECKED = 32  # commands at which both implementations are compared
AGREE_MM = 1e-3  # mm; single precision of 100 mm through five layers gives 1e-4
# of the range, on each side: a table extends this far, because effects may change commands
BEYOND = 0.15
ASKED = {1: 201, 2: 41, 3: 15}  # grid nodes per command, evaluated by onnxruntime
MOST_NODES = 4000  # nodes of a grid with axes given by the bundle
APART_MM = 0.2  # mm, RMS error of such a table between its nodes, over points and commands
KEPT_MM = 2e-3  # mm, RMS of all omitted modes of such a table
# nodes of a table by channels: error 0.001 mm for smooth networks, 0.02 mm RMS for kinked ones
NODES = {1: 201, 2: 61, 3: 21}


def read_network(
    file: Path,
    command_range: Floats,
    grid: Grid,
    trusted: Callable[[Path, str], bool],
) -> tuple[NetworkArrays | ModeArrays, Document | None]:
    """Read an ONNX file: its arrays, and a description if only onnxruntime can read it.

    A file written by training stays a network; any other becomes a table.

    Args:
        file: the file.
        command_range: range of the comparison, (C, 2) mm.
        grid: stored with the network; a table uses its axes, if any.
        trusted: called as `trusted(file, sha256)`; returns whether onnxruntime may run a graph that
            the core cannot read.

    Raises:
        BundleError: it is too large, refers to other files, holds loops, has other channels, or is
            not trusted.
    """
    size = file.stat().st_size
    if size > MAX_ONNX_BYTES:
        raise BundleError(
            f"{file.name}: {size >> 20} MB, networks of up to {MAX_ONNX_BYTES >> 20} MB are read"
        )
    content = file.read_bytes()
    try:
        _core.check_onnx(content)
    except SoftmapError as fault:
        raise BundleError(f"{file.name}: {fault}") from None
    try:
        network = _core.Network(content)
    except SoftmapError as fault:
        if not trusted(file, hashlib.sha256(content).hexdigest()):
            raise BundleError(
                f"{file.name}: {fault}. If you trust this file, --trust-onnx (in Python: "
                "load_bundle(path, trust_onnx=True)) lets onnxruntime run it, in a child process "
                "with limits"
            ) from None
        return table_from_onnxruntime(file.name, content, command_range, grid, str(fault))
    if network.channels != len(command_range):
        raise BundleError(
            f"{file.name}: {network.channels} commands, the bundle has {len(command_range)}"
        )
    return NetworkArrays(content, grid), None


def compare_with_onnxruntime(name: str, content: bytes, command_range: Floats) -> float | None:
    """Return the largest difference (mm) of core and onnxruntime at commands over the full range.

    Args:
            name: of the file.
            content: its bytes, a network that the core reads.
            command_range: (C, 2) mm.

    Returns:
        float | None: the largest difference, mm; None if onnxruntime is not installed.

    Raises:
        BundleError: they differ by more than `AGREE_MM`, or onnxruntime cannot run it.
    """
    if find_spec("onnxruntime") is None:
        return None
    commands = _some(command_range)
    apart = float(
        np.abs(run_onnxruntime(content, commands) - _core.Network(content).evaluate(commands)).max()
    )
    if not apart < AGREE_MM:
        raise BundleError(
            f"{name}: onnxruntime and the core differ by {apart:.2g} mm, allowed is {AGREE_MM:g}; "
            "export it again"
        )
    return apart


def table_from_onnxruntime(
    name: str, content: bytes, command_range: Floats, grid: Grid, why: str
) -> tuple[ModeArrays, Document]:
    """Return the arrays and a description of a table for a graph that only onnxruntime runs.

    Args:
        name: of the file.
        content: its bytes.
        command_range: (C, 2) mm.
        grid: as for `read_network`.
        why: the reason why the core cannot read it.

    Raises:
        BundleError: onnxruntime cannot run it, it has too many commands, or the table's error is
            too large.
    """
    channels = len(command_range)
    if channels not in ASKED:
        raise BundleError(
            f"{name}: {why}; onnxruntime's graphs are read as tables of up to {max(ASKED)} commands"
        )
    try:
        low, high = command_range.T
        more = BEYOND * (high - low)
        axes = [np.linspace(a, b, ASKED[channels]) for a, b in zip(low - more, high + more)]
        axes[: len(grid.axes)] = [np.asarray(axis, np.float64) for axis in grid.axes[:channels]]
        if (count := np.prod([len(axis) for axis in axes], dtype=object)) > MOST_NODES:
            raise BundleError(
                f"its axes in prior.npz make a table of {count} nodes, at most {MOST_NODES} are "
                "asked"
            )
        some, nodes = _some(command_range), _grid(axes)
        both = in_child(
            run_onnxruntime,
            content,
            np.concatenate([nodes, some]),
            megabytes=CHILD_MB,
            seconds=CHILD_S,
        )
        values, target = both[: len(nodes)], both[len(nodes) :]
    except BundleError as fault:
        raise BundleError(f"{name}: {why}. Nor by onnxruntime: {fault}") from None
    except ChildFault as fault:
        raise BundleError(
            f"{name}: {why}. onnxruntime was stopped: its run {fault}; use a smaller graph"
        ) from None
    if values.ndim != 2 or values.shape[1] % 3 or not np.isfinite(both).all():
        raise BundleError(f"{name}: {why}; its outputs {values.shape} are no finite points (n, 3N)")
    mean = values.mean(axis=0)
    size, modes = _modes(values - mean)
    rest = np.sqrt(np.cumsum(np.maximum(size, 0.0)) * 3 / values.size)  # mm, up to each mode
    modes = modes[rest > KEPT_MM][::-1] if (rest > KEPT_MM).any() else modes[-1:]
    weights = (values - mean) @ modes.T
    table = _core.Table(axes, weights, mean, np.ascontiguousarray(modes))
    apart = float(
        np.sqrt(
            np.mean(np.sum((table.evaluate(some) - target).reshape(len(some), -1, 3) ** 2, axis=2))
        )
    )
    if not apart < APART_MM:
        raise BundleError(
            f"{name}: {why}. A table of what onnxruntime makes of it would be {apart:.2g} mm off, "
            f"allowed is {APART_MM:g}; train a network of layers that are read (`softmap train "
            "prior`)"
        )
    arrays = ModeArrays(Grid(tuple(axes)), mean, Stored(modes), Stored(weights))
    return arrays, {
        "graph_sha256": hashlib.sha256(content).hexdigest(),
        "why": why,
        "table_off_mm": apart,
    }


def _modes(values: Floats) -> tuple[Floats, Floats]:
    """Return the squared sizes (K,) of the principal modes of `values` (n, M), and the modes.

    The sizes increase; the modes are (K, M).
    """
    if len(values) >= values.shape[1]:
        size, modes = np.linalg.eigh(values.T @ values)
        return size, modes.T
    size, weights = np.linalg.eigh(values @ values.T)
    return size, weights.T @ values / np.sqrt(np.maximum(size, np.finfo(float).tiny))[:, None]


def _some(command_range: Floats) -> Floats:
    low, high = command_range.T
    return np.random.default_rng(0).uniform(low, high, (CHECKED, len(low)))


def _grid(axes: Sequence[Floats]) -> Floats:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def run_onnxruntime(content: bytes, commands: Floats) -> Floats:
    """Return the outputs (n, M) of onnxruntime for an ONNX file's `content` at commands (n, C).

    Raises:
        BundleError: onnxruntime is not installed or cannot run it, or it needs too much memory.
    """
    try:
        import onnxruntime
    except ImportError:
        raise BundleError("onnxruntime is not installed; run pip install onnxruntime") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # its messages are raised as an error here
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        (given,) = session.get_inputs()
        parts = [commands[k : k + BATCH].astype(np.float32) for k in range(0, len(commands), BATCH)]
        found = [session.run(None, {given.name: part})[0] for part in parts]
    # its errors share no base class but Exception
    except Exception as fault:
        if "allocate" in str(fault) or isinstance(fault, MemoryError):
            raise BundleError(
                f"it needs more than {CHILD_MB} MB of memory; use a smaller graph"
            ) from None
        raise BundleError(
            f"onnxruntime cannot run the network ({brief(fault)}); export it again"
        ) from None
    return np.concatenate(found).astype(np.float64)


def tabulated(network: _core.Network, command_range: Floats) -> _core.Network | _core.Table:
    """Return a network with few outputs as a table over its commands; the network if too many.

    `command_range` is (C, 2) mm; the table extends `BEYOND` it on each side.
    """
    if network.channels not in NODES:
        return network
    low, high = command_range.T
    more = BEYOND * (high - low)
    axes = [np.linspace(a, b, NODES[network.channels]) for a, b in zip(low - more, high + more)]
    values = network.evaluate(_grid(axes))
    return _core.Table(axes, values, np.zeros(network.size), np.eye(network.size))
