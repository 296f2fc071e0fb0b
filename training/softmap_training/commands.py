"""The verbs that this distribution adds to the `softmap` command; imports no torch."""

from __future__ import annotations

from typing import Any


def verbs() -> list[Any]:
    """Return the verbs to add, as `softmap_edge.commands.Verb`s. None yet: `train` joins with the network prior."""
    return []
