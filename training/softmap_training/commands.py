"""The commands that this distribution adds to `softmap`; imports no torch."""

from __future__ import annotations

from softmap_edge.commands import Command


def training_commands() -> list[Command]:
    """Return the commands to add."""
    return [
        Command(
            "train",
            "make or change a model",
            "train a prior or a residual network",
            "softmap_training.train_command",
            "training",
            (
                "train prior sim.zarr --out prior",
                "train residual grid.npz again.npz --bundle prior --out corrected",
            ),
        ),
        Command(
            "evaluate",
            "understand what is missing",
            "models side by side, with the paper's figures",
            "softmap_training.evaluate_command",
            "training",
            (
                "evaluate prior --set sim.zarr --model linear modes",
                "evaluate corrected --run paths.npz --train grid.npz --html tables.html",
            ),
        ),
    ]
