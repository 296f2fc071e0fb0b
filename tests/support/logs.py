"""Logs as laboratories write them, made for the tests of `softmap import`, and where the published
ones are.
"""

from pathlib import Path

import numpy as np
import pytest

from benches.data import find
from softmap_edge.errors import RunError
from softmap_edge.logs.importer import import_logs, read_mapping

ROOT = Path(__file__).parents[2]
ONE_LOG = """schema = "softmap.mapping/1"
robot = "bench"
[[log]]
time = { column = "t" }
command = { columns = ["a", "b"] }
markers = { columns = [["x", "y", "z"], ["p", "q", "r"]], unit = "m" }
"""


def published(name):
    """The folder of a public data set (`trunk`, `tdcr`, `beam`, `moe_finger`); without it the test
    is skipped.
    """
    folder = find(name)
    if folder is None:
        pytest.skip(f"not run: the public data '{name}' are not here; `make data` brings them")
    return folder


def made_log(rows=20, delimiter=",", seed=0):
    """A log of two channels and two markers in metres, as text and as numbers."""
    rng = np.random.default_rng(seed)
    table = np.column_stack(
        [np.arange(rows) * 0.1, rng.uniform(-9, 9, (rows, 2)), rng.uniform(-0.1, 0.1, (rows, 6))]
    )
    lines = [delimiter.join("tabxyzpqr")] + [
        delimiter.join(repr(float(x)) for x in row) for row in table
    ]
    return "\n".join(lines) + "\n", table


def imported(folder, log_text, mapping=ONE_LOG, name="log.csv"):
    (folder / name).write_bytes(log_text.encode() if isinstance(log_text, str) else log_text)
    (folder / "map.toml").write_text(mapping, encoding="utf-8")
    return import_logs([folder / name], read_mapping(folder / "map.toml"))


def fault(folder, log_text, mapping=ONE_LOG):
    with pytest.raises(RunError) as found:
        imported(folder, log_text, mapping)
    assert "\n" not in str(found.value)
    return str(found.value)
