"""Time the pass of a paper-sized network by us, onnxruntime and torch.

It is also compared with reading its weights once.

    2 → 256-512-1024-512-256 → 1644, BatchNorm folded, ReLU: 1.74 million numbers, 6.9 MB

Its hidden layers are random; its last one is fitted to the built-in finger by least squares. So it
has the finger's shapes without minutes of training. All sides run on one thread, one command at a
time, alternating. Reading is a streaming reduction over the bytes of the pass (NumPy's or BLAS's,
whichever is faster). Pinned by tests/benches/test_benches.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benches.row import ratio, side_by_side
from softmap_edge import _core
from softmap_edge.model.bundle import builtin_model
from softmap_edge.model.model import Model
from softmap_edge.model.shapes import NetworkArrays, PriorArrays

Floats = NDArray[np.float64]

SOME = 20  # passes per measurement
SAMPLES = 1500  # commands for fitting the last layer
AGREE_MM = 1e-4


@dataclass(frozen=True)
class PaperSized:
    """The network in torch, as its file's bytes, in the core, and as the built-in prior."""

    torch: Any
    content: bytes
    model: Model

    @cached_property
    def core(self) -> _core.Network:
        """The same in the core."""
        return _core.Network(self.content)

    @cached_property
    def onnxruntime(self) -> Callable[[NDArray[np.float32]], Any]:
        """The same in onnxruntime, on one thread."""
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        session = onnxruntime.InferenceSession(
            self.content, options, providers=["CPUExecutionProvider"]
        )
        return lambda u: session.run(None, {"command": u})[0]


@cache
def paper_sized() -> PaperSized:
    """Make the network."""
    import torch
    from softmap_training.export import to_onnx
    from softmap_training.networks import published_prior

    torch.manual_seed(0)
    base = builtin_model()
    low, high = base.command_range.T
    u = np.random.default_rng(0).uniform(low, high, (SAMPLES, base.channels))
    points = np.asarray(base.prior.evaluate(u))
    network = published_prior(u, points)
    inputs = torch.as_tensor(u, dtype=torch.float32)
    with torch.no_grad():
        network[:-2].train()(inputs)  # BatchNorm sees what comes
        for layer in network:
            if isinstance(layer, torch.nn.BatchNorm1d):
                layer.momentum = None
                layer.reset_running_stats()
        for _ in range(3):
            network[:-2](inputs)
        network.eval()
        seen = network[:-2](inputs).numpy().astype(np.float64)
        rows = np.column_stack([seen, np.ones(len(u))])
        wanted = (points - network[-1].shift.numpy()) / network[-1].size.numpy()
        ridge = 1e-3 * np.eye(rows.shape[1])
        found = np.linalg.solve(rows.T @ rows + ridge, rows.T @ wanted)
        network[-2].weight.copy_(torch.as_tensor(found[:-1].T))
        network[-2].bias.copy_(torch.as_tensor(found[-1]))
    content = to_onnx(network, base.channels)
    assert base.arrays is not None
    arrays = replace(base.arrays, prior=PriorArrays(NetworkArrays(content)))
    model = replace(
        base.with_structure(prior=_core.Network(content)), kind="network", arrays=arrays
    )
    return PaperSized(network, content, model)


def rows() -> list[dict[str, object]]:
    """Time tip with slopes against reading, and full passes against onnxruntime and torch."""
    import torch

    made, threads = paper_sized(), torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return [*_tip(made), *_whole(made)]
    finally:
        torch.set_num_threads(threads)


def _tip(made: PaperSized) -> list[dict[str, object]]:
    index = made.model.tip_indices
    weights = np.zeros((made.core.size, 3))
    for axis in range(3):
        weights[3 * index + axis, axis] = 1.0 / len(index)
    tip = made.core.project(weights, np.zeros(3))
    u = np.array([[1.0, -2.0]])
    read = reading(4 * tip.parameters)
    ours, theirs = side_by_side(_often(lambda: tip.jacobian(u)), _often(read))
    name = f"tip with exact slopes, {tip.parameters / 1e6:.2f} million numbers"
    row = ratio(
        name, ours / SOME, theirs / SOME, "reading them once", "goal ratio ≥ 0.625 (time ≤ 1.6 ×)"
    )
    jacobian = torch_jacobian(made, index)
    slopes = np.asarray(jacobian(u[0]))
    same("slopes", np.asarray(tip.jacobian(u))[0], slopes, 1e-3)
    ours, theirs = side_by_side(_often(lambda: tip.jacobian(u)), lambda: jacobian(u[0]))
    return [row, ratio("tip with exact slopes", ours / SOME, theirs, "torch", "goal > 1")]


def _whole(made: PaperSized) -> list[dict[str, object]]:
    import torch

    u = np.array([[1.0, -2.0]])
    single = u.astype(np.float32)
    given = torch.as_tensor(single)

    def by_torch() -> Any:
        with torch.inference_mode():
            return made.torch(given).numpy()

    core, ort = made.core, made.onnxruntime
    found = np.asarray(core.evaluate(u))
    same("passes", found, ort(single), AGREE_MM)
    same("passes", found, by_torch(), 10 * AGREE_MM)
    rows = []
    read = reading(4 * core.parameters)
    ours, theirs = side_by_side(_often(lambda: core.evaluate(u)), _often(read))
    rows.append(
        ratio(
            "full pass of the paper's network",
            ours / SOME,
            theirs / SOME,
            "reading it once",
            "stated",
        )
    )
    for name, peer in (("onnxruntime", lambda: ort(single)), ("torch", by_torch)):
        ours, theirs = side_by_side(_often(lambda: core.evaluate(u)), _often(peer))
        rows.append(
            ratio("full pass of the paper's network", ours / SOME, theirs / SOME, name, "goal > 1")
        )
    return rows


def torch_jacobian(made: PaperSized, index: NDArray[np.int64]) -> Callable[[Floats], Any]:
    """Return a function for the slopes (3, C) of the tip by torch backpropagation."""
    import torch

    chosen = torch.as_tensor(np.asarray(index, np.int64))

    def tip(v: Any) -> Any:
        return made.torch(v[None])[0].reshape(-1, 3)[chosen].mean(dim=0)

    return lambda u: torch.autograd.functional.jacobian(
        tip, torch.as_tensor(u, dtype=torch.float32)
    ).numpy()


def reading(count: int) -> Callable[[], object]:
    """Return a function that reads `count` bytes once, the faster of two."""
    numbers = np.random.default_rng(0).normal(size=count // 4).astype(np.float32)
    # The dot product of an array with itself is one stream; BLAS uses one thread by its threshold
    # or by the environment.
    ways: list[Callable[[], object]] = [lambda: numbers.max(), lambda: np.dot(numbers, numbers)]
    first, second = side_by_side(*(_often(way) for way in ways))
    return ways[0] if first < second else ways[1]


def same(what: str, ours: Floats, theirs: Floats, most: float) -> None:
    """Reject sides with different results."""
    apart = float(np.abs(np.asarray(ours) - np.asarray(theirs)).max())
    if not apart <= most:
        raise RuntimeError(f"{what} differ by {apart:.2g}, allowed is {most:g}")


def _often(work: Callable[[], object]) -> Callable[[], None]:
    def several() -> None:
        for _ in range(SOME):
            work()

    return several
