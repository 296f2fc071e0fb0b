"""Trained networks of a bundle: `prior.onnx` and `residual.onnx`, commands (n, C) to the points of a body (n, 3N) mm.

The compiled core runs them (`rust/network/`), with exact slopes. When a file is read, onnxruntime runs it as well, on
commands all over the range: a second implementation, so that a damaged or foreign file is found and not driven with.
Fits look at features, not at points: there a network of up to three commands becomes a table (`tabulated`).
Pinned by tests/test_network.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import BundleError, SoftmapError, brief

Floats = NDArray[np.float64]

MOST_BYTES = 256 << 20
CHECKED = 32  # commands at which both implementations are compared
AGREE_MM = 1e-3  # single precision of 100 mm through five layers leaves 1e-4
BEYOND = 0.15  # of the range to each side that a table covers; commands that effects change may lie there
NODES = {1: 201, 2: 61, 3: 21}  # of a table, by channels; of smooth networks 0.001 mm, of kinked ones 0.02 mm RMS


def read_network(file: Path, command_range: Floats) -> tuple[bytes, _core.Network]:
    """Read an ONNX file that training wrote, and see that onnxruntime gives the same.

    Args:
        file: the file.
        command_range: (C, 2) mm, within which both are compared.

    Raises:
        BundleError: it is too large, no such graph, of other channels, or the two differ.
    """
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise BundleError(f"{file.name}: {size >> 20} MB, networks of up to {MOST_BYTES >> 20} MB are read")
    content = file.read_bytes()
    try:
        network = _core.Network(content)
    except SoftmapError as fault:
        raise BundleError(f"{file.name}: {fault}") from None
    if network.channels != len(command_range):
        raise BundleError(f"{file.name}: {network.channels} commands, the bundle has {len(command_range)}")
    low, high = command_range.T
    commands = np.random.default_rng(0).uniform(low, high, (CHECKED, network.channels))
    apart = float(np.abs(run_elsewhere(content, commands) - network.evaluate(commands)).max())
    if not apart < AGREE_MM:
        raise BundleError(
            f"{file.name}: onnxruntime and the core differ by {apart:.2g} mm, allowed is {AGREE_MM:g}; export it again"
        )
    return content, network


def run_elsewhere(content: bytes, commands: Floats) -> Floats:
    """Return what onnxruntime gives (n, M) for an ONNX file's `content` at commands (n, C)."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what it has to say becomes an error here
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        (given,) = session.get_inputs()
        (found,) = session.run(None, {given.name: commands.astype(np.float32)})
    # Its errors have no common class beside Exception.
    except Exception as fault:
        raise BundleError(f"onnxruntime cannot run the network ({brief(fault)}); export it again") from None
    return np.asarray(found, np.float64)


def tabulated(network: _core.Network, command_range: Floats) -> _core.Network | _core.Table:
    """Return a network of few outputs as a table over its commands, or itself where these are too many.

    command_range: (C, 2) mm; the table covers `BEYOND` more to each side.
    """
    if network.channels not in NODES:
        return network
    low, high = command_range.T
    more = BEYOND * (high - low)
    axes = [np.linspace(a, b, NODES[network.channels]) for a, b in zip(low - more, high + more)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, network.channels)
    values = network.evaluate(grid)
    return _core.Table(axes, values, np.zeros(network.size), np.eye(network.size))
