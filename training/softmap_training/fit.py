"""The loop that trains any network.

It has seeds, checkpoints after every epoch, early stopping, and a log in CSV.

A folder holds `checkpoint.pt` (weights only: tensors and numbers, no code), `log.csv`, and with
`tensorboard=True` the events of TensorBoard. The same call resumes an interrupted training and ends
with the same weights; a call with another recipe or data is rejected. Pinned by
tests/training/test_training.py.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from softmap_training.choices import Recipe
from softmap_training.errors import TrainingError

Progress = Callable[[float, str], None]
COLUMNS = ("epoch", "training_loss", "validation_mm", "rate", "seconds")


@dataclass
class Task:
    """A training task: `loss(network, some)` of samples `some` (B,), `validate(network)` in mm.

    `data` is hashed, so a checkpoint resumes only with its own data.
    """

    network: nn.Sequential
    samples: int
    loss: Callable[[nn.Sequential, Tensor], Tensor]
    validate: Callable[[nn.Sequential], float]
    data: list[Any] = field(default_factory=list)

    def key(self, recipe: Recipe) -> str:
        """Return a hash of layers, recipe and data."""
        digest = hashlib.sha256(json.dumps([str(self.network), asdict(recipe)]).encode())
        for array in self.data:
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


def fit(
    task: Task,
    recipe: Recipe,
    folder: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
    tensorboard: bool = False,
    until: int | None = None,
) -> list[dict[str, float]]:
    """Train a task's network in place, to its best epoch by validation, and return the log.

    Args:
        task: network, loss and validation.
        recipe: epochs, batch, rate and so on.
        folder: folder of checkpoints and logs; None for none.
        progress: called with the completed share and a line after every epoch.
        device: "cpu" or "cuda"; a GPU multiplies matrices in bfloat16.
        tensorboard: whether to write events of TensorBoard.
        until: stop after this many epochs of the recipe and keep the last, regardless of
            validation.

    Raises:
        TrainingError: a checkpoint of another training, or non-finite values.
    """
    network = task.network.to(device)
    optimizer = torch.optim.AdamW(network.parameters(), lr=recipe.rate, weight_decay=recipe.decay)
    steps = math.ceil(task.samples / recipe.batch) * recipe.epochs * recipe.passes
    falls = torch.optim.lr_scheduler.LambdaLR(
        optimizer, lambda step: _cosine(step / steps, recipe.last)
    )
    draw = torch.Generator().manual_seed(recipe.seed)
    state = _State(math.inf, network.state_dict(), [])
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        state = _resume(folder, task.key(recipe), network, optimizer, falls, draw) or state
    writer = _writer(folder) if tensorboard and folder is not None else None
    for epoch in range(len(state.log), until or recipe.epochs):
        since = int(np.argmin([row["validation_mm"] for row in state.log])) if state.log else 0
        if until is None and epoch - 1 - since >= recipe.patience:
            break
        ahead = time.perf_counter()
        total = _epoch(task, network, recipe, optimizer, falls, draw, device)
        network.eval()
        with torch.no_grad():
            value = task.validate(network)
        if not math.isfinite(value) or not math.isfinite(total):
            raise TrainingError(
                f"epoch {epoch}: the error is {value:g} mm and the loss {total:g}; a rate of "
                f"{recipe.rate:g} is too large for these data"
            )
        numbers = (epoch, total, value, falls.get_last_lr()[0], time.perf_counter() - ahead)
        state.log.append(dict(zip(COLUMNS, map(float, numbers))))
        if value < state.best or until is not None:
            state.best, state.weights = (
                value,
                {k: v.detach().clone() for k, v in network.state_dict().items()},
            )
        if folder is not None:
            _keep(folder, task.key(recipe), state, network, optimizer, falls, draw)
        if writer is not None:
            for name in COLUMNS[1:4]:
                writer.add_scalar(name, state.log[-1][name], epoch)
        if progress is not None:
            line = f"epoch {epoch + 1}: {value:.3f} mm held out (best {state.best:.3f})"
            progress((epoch + 1) / (until or recipe.epochs), line)
    if writer is not None:
        writer.close()
    network.load_state_dict(state.weights)
    network.to("cpu").eval()
    return state.log


def seeded(seed: int) -> None:
    """Make random numbers and the order of sums reproducible."""
    torch.manual_seed(seed)
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True)


@dataclass
class _State:
    """The state of a training: best error, its weights, and the log."""

    best: float
    weights: dict[str, Tensor]
    log: list[dict[str, float]]


def _epoch(
    task: Task,
    network: nn.Sequential,
    recipe: Recipe,
    optimizer: torch.optim.Optimizer,
    falls: torch.optim.lr_scheduler.LambdaLR,
    draw: torch.Generator,
    device: str,
) -> float:
    """Train on all samples for the passes of an epoch; return the mean loss."""
    network.train()
    sums = []
    for _ in range(recipe.passes):
        for some in torch.randperm(task.samples, generator=draw).split(recipe.batch):
            if len(some) == 1 and task.samples > 1:
                continue  # one sample has no batch statistics
            optimizer.zero_grad()
            with torch.autocast("cuda", torch.bfloat16, enabled=device == "cuda"):
                loss = task.loss(network, some.to(device))
            loss.backward()
            optimizer.step()
            falls.step()
            sums.append(loss.detach())
    return float(torch.stack(sums).mean())


def _cosine(part: float, last: float) -> float:
    return last + (1.0 - last) * 0.5 * (1.0 + math.cos(math.pi * min(1.0, part)))


def _keep(
    folder: Path, key: str, state: _State, network: Any, optimizer: Any, falls: Any, draw: Any
) -> None:
    """Write checkpoint and log atomically."""
    content = {
        "key": key,
        "network": network.state_dict(),
        "optimizer": optimizer.state_dict(),
        "falls": falls.state_dict(),
        "draw": draw.get_state(),
        "torch": torch.get_rng_state(),
        "best": state.best,
        "weights": state.weights,
        "log": state.log,
    }
    partial = folder / "checkpoint.pt.part"
    torch.save(content, partial)
    partial.replace(folder / "checkpoint.pt")
    with (folder / "log.csv").open(
        "a" if len(state.log) > 1 else "w", newline="", encoding="utf-8"
    ) as file:
        rows = csv.DictWriter(file, COLUMNS)
        if len(state.log) == 1:
            rows.writeheader()
        rows.writerow(state.log[-1])


def _resume(
    folder: Path, key: str, network: Any, optimizer: Any, falls: Any, draw: Any
) -> _State | None:
    """Restore the state of this key's training; None if it has not begun."""
    file = folder / "checkpoint.pt"
    if not file.is_file():
        return None
    try:
        kept = torch.load(file, weights_only=True)
        if kept["key"] != key:
            raise TrainingError(
                f"{folder}: a training of other data or with other numbers; choose another "
                "folder, or remove it"
            )
        network.load_state_dict(kept["network"])
        optimizer.load_state_dict(kept["optimizer"])
        falls.load_state_dict(kept["falls"])
        draw.set_state(kept["draw"])
        torch.set_rng_state(kept["torch"])
        state = _State(float(kept["best"]), kept["weights"], list(kept["log"]))
    except TrainingError:
        raise
    # torch may raise any error for a damaged file
    except Exception as fault:
        raise TrainingError(
            f"{file}: cannot be read ({type(fault).__name__}); remove it to train again"
        ) from None
    with (folder / "log.csv").open("w", newline="", encoding="utf-8") as log:
        rows = csv.DictWriter(log, COLUMNS)
        rows.writeheader()
        rows.writerows(state.log)
    return state


def _writer(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise TrainingError(
            "TensorBoard is not installed: pip install tensorboard; the log.csv is written anyway"
        ) from None
    return SummaryWriter(str(folder / "tensorboard"))
