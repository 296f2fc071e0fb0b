"""Parameters of a chain by label.

A shared parameter has one label for all channels, and a number for each.

`chain.labels` (P,) name every number: `backlash.gap[0]` of a channel, `dead_zone.slack[0+]` and
`dead_zone.slack[0-]` of the cables that a channel pulls to either side. The numbers of one group of
`chain.tie` are equal unless they are set separately, and `chain.group_labels` (P,) name the group
(`backlash.gap`). Input may use either label, or that of a channel for both of its cables; the most
exact one counts. Output has one entry for a group while its numbers are equal, else one for each.
Pinned by tests/model/test_shared_numbers.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core

Floats = NDArray[np.float64]


def readings(label: str, group: str) -> tuple[str, ...]:
    """Return the labels under which input may give a number, the most exact one first."""
    channel = label.replace("+]", "]").replace("-]", "]")
    return tuple(dict.fromkeys((label, channel, group)))


def grouped(chain: _core.Chain) -> dict[str, list[int]]:
    """Return the numbers of each group by its label, as indices into the labels of a chain."""
    groups: dict[str, list[int]] = {}
    for i, label in enumerate(chain.group_labels):
        groups.setdefault(label, []).append(i)
    return groups


def named(chain: _core.Chain, params: Floats) -> dict[str, float]:
    """Return parameters (P,) by label: one entry for each group of equal numbers, else for each."""
    found: dict[str, float] = {}
    for label, members in grouped(chain).items():
        if np.all(params[members] == params[members[0]]):
            found[label] = float(params[members[0]])
        else:
            found |= {chain.labels[i]: float(params[i]) for i in members}
    return found


def valued(chain: _core.Chain, params: Mapping[str, float], absent: Floats) -> Floats:
    """Return parameters (P,) of a chain from a mapping by label; missing ones are `absent` (P,)."""
    names = (readings(label, group) for label, group in zip(chain.labels, chain.group_labels))
    found = (
        next((params[n] for n in known if n in params), rest) for known, rest in zip(names, absent)
    )
    return np.array(list(found), float)


def spread(chain: _core.Chain, params: Floats) -> Floats:
    """Return parameters (P,) of a chain from all of them, or from one for each group (G,).

    Parameters that are already complete are returned unchanged.
    """
    groups = np.unique(chain.tie)
    return params[chain.tie] if params.shape == groups.shape else params


def differing(chain: _core.Chain, params: Floats) -> frozenset[str]:
    """Return the effects of a chain with a group whose `params` (P,) differ between channels."""
    members = grouped(chain).items()
    return frozenset(
        group.split(".")[0] for group, some in members if np.any(params[some] != params[some[0]])
    )
