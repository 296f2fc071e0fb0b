"""Trained networks of a bundle: `prior.onnx` and `residual.onnx`, commands (n, C) to the points of a body (n, 3N) mm.

The compiled core runs them (`rust/network/`), with exact slopes. When a file is read, onnxruntime runs it as well, on
commands all over the range: a second implementation, so that a damaged or foreign file is found and not driven with.
Fits look at features, not at points: there a network of up to three commands becomes a table (`tabulated`).

A graph of other operators is one that only onnxruntime runs. It is asked once, at the nodes of a grid of its up to
three commands, and goes on as a table of what it said (`elsewhere`), with everything that a table has: slopes, fields,
the control loop without Python. How far the table is from the graph between its nodes is measured, told and limited.
Pinned by tests/test_network.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import BundleError, SoftmapError, brief

Floats = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]

MOST_BYTES = 256 << 20
CHECKED = 32  # commands at which both implementations are compared
AGREE_MM = 1e-3  # single precision of 100 mm through five layers leaves 1e-4
BEYOND = 0.15  # of the range to each side that a table covers; commands that effects change may lie there
ASKED = {1: 201, 2: 41, 3: 15}  # nodes of a grid that onnxruntime is asked at
APART_MM = 0.2  # that a table of them may be off between its nodes, RMS over points and commands
KEPT_MM = 2e-3  # modes of such a table: what the others add, RMS
NODES = {1: 201, 2: 61, 3: 21}  # of a table, by channels; of smooth networks 0.001 mm, of kinked ones 0.02 mm RMS


def read_network(file: Path, command_range: Floats, told: Mapping[str, Any]) -> tuple[Arrays, dict[str, Any] | None]:
    """Read an ONNX file: the arrays of the shape that it is, and what is said of it where only onnxruntime reads it.

    One that training wrote stays a network (`onnx`), and onnxruntime is seen to give the same; another becomes a table.

    Args:
        file: the file.
        command_range: (C, 2) mm, within which both are compared.
        told: arrays of the prior beside it: a table takes its axes, where there are some.

    Raises:
        BundleError: it is too large, no graph that anything runs, of other channels, or the two differ.
    """
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise BundleError(f"{file.name}: {size >> 20} MB, networks of up to {MOST_BYTES >> 20} MB are read")
    content = file.read_bytes()
    try:
        network = _core.Network(content)
    except SoftmapError as fault:
        return elsewhere(file.name, content, command_range, told, str(fault))
    if network.channels != len(command_range):
        raise BundleError(f"{file.name}: {network.channels} commands, the bundle has {len(command_range)}")
    commands = _some(command_range)
    apart = float(np.abs(run_elsewhere(content, commands) - network.evaluate(commands)).max())
    if not apart < AGREE_MM:
        raise BundleError(
            f"{file.name}: onnxruntime and the core differ by {apart:.2g} mm, allowed is {AGREE_MM:g}; export it again"
        )
    return {"onnx": np.frombuffer(content, np.uint8)}, None


def elsewhere(
    name: str, content: bytes, command_range: Floats, told: Mapping[str, Any], why: str
) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays of a table of a graph that only onnxruntime runs, and what is to be said of it.

    Args:
        name: of the file. content: its bytes. command_range, told: as for `read_network`. why: not read by the core.

    Raises:
        BundleError: onnxruntime does not run it, it has too many commands, or a table is too far from it.
    """
    channels = len(command_range)
    if channels not in ASKED:
        raise BundleError(f"{name}: {why}; onnxruntime's graphs are read as tables of up to {max(ASKED)} commands")
    try:
        low, high = command_range.T
        more = BEYOND * (high - low)
        axes = [np.linspace(a, b, ASKED[channels]) for a, b in zip(low - more, high + more)]
        axes = [np.asarray(told.get(f"axis{c}", axis), np.float64) for c, axis in enumerate(axes)]
        values = run_elsewhere(content, _grid(axes))
        some = _some(command_range)
        wanted = run_elsewhere(content, some)
    except BundleError as fault:
        raise BundleError(f"{name}: {why}. Nor by onnxruntime: {fault}") from None
    if values.ndim != 2 or values.shape[1] % 3 or not np.isfinite(values).all() or not np.isfinite(wanted).all():
        raise BundleError(f"{name}: {why}; its outputs {values.shape} are no finite points (n, 3N)")
    mean = values.mean(axis=0)
    size, modes = np.linalg.eigh((values - mean).T @ (values - mean))
    rest = np.sqrt(np.cumsum(np.maximum(size, 0.0)) * 3 / values.size)  # mm, of all modes up to one
    modes = modes[:, rest > KEPT_MM][:, ::-1].T if (rest > KEPT_MM).any() else modes[:, -1:].T
    weights = (values - mean) @ modes.T
    table = _core.Table(axes, weights, mean, np.ascontiguousarray(modes))
    apart = float(np.sqrt(np.mean(np.sum((table.evaluate(some) - wanted).reshape(len(some), -1, 3) ** 2, axis=2))))
    if not apart < APART_MM:
        raise BundleError(
            f"{name}: {why}. A table of what onnxruntime makes of it would be {apart:.2g} mm off, allowed is "
            f"{APART_MM:g}; train a network of layers that are read (`softmap train prior`)"
        )
    arrays: Arrays = {f"axis{c}": axis for c, axis in enumerate(axes)}
    arrays |= {"mean": mean, "modes": modes, "coefficients": weights}
    return arrays, {"graph_sha256": hashlib.sha256(content).hexdigest(), "why": why, "table_off_mm": apart}


def _some(command_range: Floats) -> Floats:
    low, high = command_range.T
    return np.random.default_rng(0).uniform(low, high, (CHECKED, len(low)))


def _grid(axes: Sequence[Floats]) -> Floats:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


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
    values = network.evaluate(_grid(axes))
    return _core.Table(axes, values, np.zeros(network.size), np.eye(network.size))
