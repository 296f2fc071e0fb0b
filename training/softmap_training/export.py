"""Export trained networks to ONNX: layers in sequence, without dropout.

BatchNorm is folded into the preceding linear layer.

The graph is written layer by layer, so it does not depend on the version of torch. Its opset and IR
are supported by onnxruntime and the compiled core. Pinned by tests/training/test_training.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from softmap_edge import _core
from softmap_edge.model.onnx import AGREE_MM, run_onnxruntime
from softmap_training.errors import TrainingError
from softmap_training.networks import Modes, Scale

OPSET, IR = 20, 9  # the first with Gelu; supported by onnxruntime 1.19 and later
Floats = NDArray[np.float64]


def to_onnx(network: nn.Sequential, channels: int, metadata: dict[str, str] | None = None) -> bytes:
    """Return the ONNX file of a network in training: commands (n, C) → points (n, 3N), n free.

    metadata: metadata of the file.

    Raises:
        TrainingError: a layer that bundles do not support.
    """
    graph = Graph()
    linear: tuple[Floats, Floats] | None = None
    for layer in network:
        if isinstance(layer, nn.BatchNorm1d) and linear is not None:
            linear = _folded(linear, layer)
            continue
        if linear is not None:
            graph.linear(*linear)
            linear = None
        if isinstance(layer, nn.Linear):
            linear = _numbers(layer.weight), _numbers(layer.bias)
        elif isinstance(layer, Modes):
            graph.linear(_numbers(layer.modes).T, _numbers(layer.mean))
        elif isinstance(layer, Scale):
            first, then = ("Mul", "Add") if layer.back else ("Sub", "Div")
            shift, size = _numbers(layer.shift), _numbers(layer.size)
            graph.add(first, size if layer.back else shift)
            graph.add(then, shift if layer.back else size)
        elif isinstance(layer, nn.LayerNorm):
            graph.add(
                "LayerNormalization",
                _numbers(layer.weight),
                _numbers(layer.bias),
                axis=-1,
                epsilon=layer.eps,
            )
        elif isinstance(layer, nn.ReLU):
            graph.add("Relu")
        elif isinstance(layer, nn.GELU) and layer.approximate == "none":
            graph.add("Gelu")
        elif not isinstance(layer, nn.Dropout):
            raise TrainingError(
                f"a layer {type(layer).__name__} cannot be exported; a bundle holds no such layer"
            )
    if linear is not None:
        graph.linear(*linear)
    return graph.file(channels, metadata or {})


def checked(network: nn.Sequential, content: bytes, commands: Floats) -> float:
    """Return the difference of torch, onnxruntime and the core at commands (n, C) mm, in mm.

    Raises:
        TrainingError: the difference exceeds single precision.
    """
    network.eval()
    with torch.no_grad():
        trained = network(torch.as_tensor(commands, dtype=torch.float32)).numpy()
    others = (
        run_onnxruntime(content, commands),
        np.asarray(_core.Network(content).evaluate(commands)),
    )
    apart = max(float(np.abs(trained - other).max()) for other in others)
    if not apart < AGREE_MM:
        raise TrainingError(
            f"the exported network is {apart:.2g} mm off the trained one, allowed is {AGREE_MM:g}"
        )
    return apart


class Graph:
    """A chain of nodes, extended at its end."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.at = "command"

    def add(self, kind: str, *constants: Floats, **attributes: Any) -> None:
        """Add a node whose other inputs are constants."""
        number = len(self.nodes)
        names = [f"c{number}_{k}" for k in range(len(constants))]
        self.constants += [
            numpy_helper.from_array(c.astype(np.float32), name) for c, name in zip(constants, names)
        ]
        self.also(kind, *names, **attributes)

    def integers(self, numbers: list[int]) -> str:
        """Add a constant of integers and return its name."""
        name = f"w{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.array(numbers, np.int64), name))
        return name

    def also(self, kind: str, *names: str, **attributes: Any) -> None:
        """Add a node whose other inputs are given by name."""
        number = len(self.nodes)
        self.nodes.append(
            helper.make_node(
                kind, [self.at, *names], [f"x{number}"], name=f"{kind}_{number}", **attributes
            )
        )
        self.at = f"x{number}"

    def linear(self, weights: Floats, bias: Floats) -> None:
        """Add W x + b."""
        self.add("Gemm", weights, bias, transB=1)

    def file(self, channels: int, metadata: dict[str, str], size: int | None = None) -> bytes:
        """Return the file: commands (n, channels) → numbers (n, size).

        `size` is by default that of its last constant.
        """
        size = self.constants[-1].dims[0] if size is None else size
        given = helper.make_tensor_value_info("command", TensorProto.FLOAT, ["n", channels])
        found = helper.make_tensor_value_info(self.at, TensorProto.FLOAT, ["n", size])
        graph = helper.make_graph(self.nodes, "softmap", [given], [found], self.constants)
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="softmap-training"
        )
        model.ir_version = IR
        helper.set_model_props(model, metadata)
        onnx.checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString())


def _folded(linear: tuple[Floats, Floats], norm: nn.BatchNorm1d) -> tuple[Floats, Floats]:
    """Return the linear layer with the following BatchNorm (evaluation mode) folded in."""
    weights, bias = linear
    factor = _numbers(norm.weight) / np.sqrt(_numbers(norm.running_var) + norm.eps)
    return weights * factor[:, None], (bias - _numbers(norm.running_mean)) * factor + _numbers(
        norm.bias
    )


def _numbers(tensor: Any) -> Floats:
    return np.asarray(tensor.detach().cpu().numpy(), np.float64)
