"""Parameters of a chain by label.

A shared parameter has one label for all channels, and one number for each. `chain.labels` (P,) name
every number: `backlash.gap[0]` of a channel, `dead_zone.slack[0+]` and `dead_zone.slack[0-]` of the
cables that a channel pulls to either side. Numbers of one group of `chain.tie` are equal unless set
separately, and `chain.group_labels` (P,) name the group (`backlash.gap`). Input may use either
label, or a channel's label for both of its cables; the most specific one counts. Output has one
entry for a group of equal numbers, else one for each. Pinned by
tests/model/test_shared_numbers.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core

Floats = NDArray[np.float64]


def readings(label: str, group: str) -> tuple[str, ...]:
    """Return the labels under which input may give a number, most specific first."""
    channel = label.replace("+]", "]").replace("-]", "]")
    return tuple(dict.fromkeys((label, channel, group)))


def grouped(chain: _core.Chain) -> dict[str, list[int]]:
    """Return the numbers of each group by label, as indices into a chain's labels."""
    groups: dict[str, list[int]] = {}
    for i, label in enumerate(chain.group_labels):
        groups.setdefault(label, []).append(i)
    return groups


def named(chain: _core.Chain, params: Floats) -> dict[str, float]:
    """Return parameters (P,) by label: one entry for each group of equal numbers, else one each."""
    found: dict[str, float] = {}
    for label, members in grouped(chain).items():
        if np.all(params[members] == params[members[0]]):
            found[label] = float(params[members[0]])
        else:
            found |= {chain.labels[i]: float(params[i]) for i in members}
    return found


def valued(chain: _core.Chain, params: Mapping[str, float], absent: Floats) -> Floats:
    """Return a chain's parameters (P,) from a mapping by label; `absent` (P,) fills gaps."""
    names = (readings(label, group) for label, group in zip(chain.labels, chain.group_labels))
    found = (
        next((params[n] for n in known if n in params), rest) for known, rest in zip(names, absent)
    )
    return np.array(list(found), float)


def spread(chain: _core.Chain, params: Floats) -> Floats:
    """Return a chain's parameters (P,) from one for each group (G,).

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
