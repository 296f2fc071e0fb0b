"""The commands that this distribution adds to `softmap`; imports no torch."""

from __future__ import annotations

from softmap_edge.commands import Command


def verbs() -> list[Command]:
    """Return the commands to add."""
    return [
        Command(
            "train",
            "make or change a model",
            "train a prior or a residual network",
            "softmap_training.train_verb",
        ),
        Command(
            "evaluate",
            "understand what is missing",
            "models side by side, with the paper's figures",
            "softmap_training.evaluate_verb",
        ),
    ]
