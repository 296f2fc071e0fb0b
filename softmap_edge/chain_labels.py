"""Parameters of a chain by label: a shared parameter has one number per channel and one label for all channels.

`chain.labels` (P,) name every number (`backlash.gap[0]`, `backlash.gap[1]`). The numbers of one group of `chain.tie`
are equal unless they are set separately, and `chain.group_labels` (P,) name the group (`backlash.gap`). Input may use
either label; if both are given, the one with an index counts. Output has one entry for a group while its numbers are
equal, else one for each channel. Pinned by tests/test_shared_numbers.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def grouped(chain: Any) -> dict[str, list[int]]:
    """Return the numbers of each group, as indices into the labels of a chain, by the label of the group."""
    groups: dict[str, list[int]] = {}
    for i, label in enumerate(chain.group_labels):
        groups.setdefault(label, []).append(i)
    return groups


def named(chain: Any, params: Floats) -> dict[str, float]:
    """Return parameters (P,) by label: one entry for each group whose numbers are equal, else one a channel."""
    found: dict[str, float] = {}
    for label, members in grouped(chain).items():
        if np.all(params[members] == params[members[0]]):
            found[label] = float(params[members[0]])
        else:
            found |= {chain.labels[i]: float(params[i]) for i in members}
    return found


def valued(chain: Any, params: Mapping[str, float], absent: Floats) -> Floats:
    """Return parameters (P,) of a chain from a mapping by label; use `absent` (P,) where it has neither label."""
    labels = zip(chain.labels, chain.group_labels, absent)
    return np.array([params.get(label, params.get(group, rest)) for label, group, rest in labels], float)


def spread(chain: Any, params: Floats) -> Floats:
    """Return parameters (P,) of a chain from all of them, or from one for each group (G,); others are unchanged."""
    groups = np.unique(chain.tie)
    return params[chain.tie] if params.shape == groups.shape else params


def differing(chain: Any, params: Floats) -> frozenset[str]:
    """Return the effects of a chain with a group whose numbers in `params` (P,) differ between channels."""
    members = grouped(chain).items()
    return frozenset(group.split(".")[0] for group, some in members if np.any(params[some] != params[some[0]]))
