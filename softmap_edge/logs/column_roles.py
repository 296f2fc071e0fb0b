"""Find columns of a log that a mapping uses twice, such as a command that is also a marker's x.

Pinned by tests/logs/test_column_roles.py.
"""

from __future__ import annotations

from collections.abc import Iterator

from softmap_edge.files.printable import listed
from softmap_edge.logs.mapping import Log
from softmap_edge.logs.measured import Column

_NAMED = 4  # columns that are reported one by one


def doubts_of_roles(names: list[str], log: Log) -> list[str]:
    """Return a sentence for each column that a log of a mapping uses more than once.

    Args:
        names: the columns of the log, in its order.
        log: what its columns are.
    """
    found: dict[str, list[str]] = {}
    for role, column in _roles(log):
        name = names[column] if isinstance(column, int) and column < len(names) else str(column)
        if isinstance(column, int):
            name = f"{name} (column {column})" if names.count(name) > 1 else name
        found.setdefault(name, []).append(role)
    twice = {name: roles for name, roles in found.items() if len(roles) > 1}
    doubts = [
        f"column '{name[:60]}' has {len(roles)} roles: {listed(roles, _NAMED)}. One column is one "
        "quantity: correct the columns in the mapping"
        for name, roles in list(twice.items())[:_NAMED]
    ]
    more = len(twice) - _NAMED
    return doubts + ([f"and {more} more columns with several roles"] if more > 0 else [])


def _roles(log: Log) -> Iterator[tuple[str, Column]]:
    """Yield each role of a log in a mapping, and its column."""
    for column in log.clock.columns:
        yield "time", column
    for kind, quantity in log.rows.items():
        for k, column in enumerate(quantity.columns):
            yield (f"{kind} {k + 1}" if len(quantity.columns) > 1 else kind), column
    for kind, points in (("marker", log.markers), ("base", log.base)):
        if points is not None:
            for k, column in enumerate(points.columns):
                yield f"{kind} {k // points.axes + 1} {'xyz'[k % points.axes]}", column
            for k, column in enumerate(points.likelihood):
                yield f"{kind} {k + 1} likelihood", column
    if log.output is not None:
        for k, column in enumerate(log.output.columns):
            yield f"output {k + 1}", column
