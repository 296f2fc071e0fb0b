"""Read the attributes with which netCDF and HDF5 files describe an array of numbers.

`scale_factor` and `add_offset` give the value of a stored number, `_FillValue` and `missing_value`
stand for no value, and `units` is the unit. Attributes are untrusted: only these are read, and only
if they are small. Pinned by tests/logs/test_hdf5_attributes.py.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.readers.columns import Array, as_floats
from softmap_edge.logs.time_names import time_unit
from softmap_edge.logs.unit_words import UNIT_WORDS

if TYPE_CHECKING:
    from h5py import Dataset

SCALES = ("scale_factor", "add_offset")
FILLS = ("_FillValue", "missing_value")
_BYTES = 256  # of an attribute
_MOST_FILLS = 16
_SHOWN = 40  # characters of a unit that is not known
_SINCE = re.compile(r"(\w+) since .*")
_NONE = ("", "1", "-", "none")  # units of plain numbers


@dataclass
class Described:
    """What the attributes of an array state.

    Attributes:
        scale, offset: value = scale x stored number + offset.
        fills: stored numbers that stand for no value.
        unit: as this program spells it; None if it is absent or not known.
        fault: why the numbers cannot be used; None if they can.
        notes: sentences for the user.
    """

    scale: float = 1.0
    offset: float = 0.0
    fills: list[NDArray[np.generic]] = field(default_factory=list)
    unit: str | None = None
    fault: str | None = None
    notes: list[str] = field(default_factory=list)

    def values(self, stored: NDArray[np.generic]) -> Array:
        """Return the values of stored numbers; NaN where there is none."""
        numbers = as_floats(stored)
        missing = np.zeros(numbers.shape, bool)
        with np.errstate(over="ignore", invalid="ignore"):
            for fill in self.fills:
                same = fill.astype(stored.dtype) if stored.dtype.kind == "f" else fill
                missing |= stored == same
            if (self.scale, self.offset) != (1.0, 0.0):
                numbers = self.scale * numbers + self.offset
        return np.where(missing, np.nan, numbers) if missing.any() else numbers


def described(name: str, entry: Dataset) -> Described:
    """Return what the attributes of an array state.

    Args:
        name: of the array, for notes.
        entry: the array.
    """
    found = Described()
    for key in (*SCALES, *FILLS, "units"):
        if key not in entry.attrs:
            continue
        value = _small(entry, key)
        if key == "units":
            _take_unit(found, name, value)
        elif value is None or value.dtype.kind not in "biuf" or not 0 < value.size <= _MOST_FILLS:
            _malformed(found, name, key)
        elif key in FILLS:
            found.fills += list(value.reshape(-1))
        elif value.size != 1 or not np.isfinite(number := float(value.reshape(-1)[0])):
            _malformed(found, name, key)
        elif key == "add_offset":
            found.offset = number
        elif number == 0.0:
            _malformed(found, name, key)
        else:
            found.scale = number
    if found.fault is None and (found.scale, found.offset) != (1.0, 0.0):
        found.notes.append(
            f"{name}: read as {found.scale:g} times the stored numbers, plus {found.offset:g}, as "
            "its attributes state"
        )
    return found


def _small(entry: Dataset, key: str) -> NDArray[np.generic] | None:
    """Return an attribute; None if it is large or holds no numbers or text."""
    held = entry.attrs.get_id(key)
    count = 0 if held.shape is None else int(np.prod(held.shape, dtype=object))
    if not count or held.dtype.kind not in "biufSO" or (held.dtype.kind == "O" and count != 1):
        return None
    if held.get_storage_size() > _BYTES:
        return None
    return np.asarray(entry.attrs[key])


def _malformed(found: Described, name: str, key: str) -> None:
    if key in SCALES:
        found.fault = f"its attribute {key} is not one plain number"
    else:
        found.notes.append(f"{name}: its attribute {key} is not a plain number and is not used")


def _take_unit(found: Described, name: str, value: NDArray[np.generic] | None) -> None:
    one = value.reshape(-1)[0] if value is not None and value.size == 1 else None
    if isinstance(one, bytes):
        one = one[:_BYTES].decode("utf-8", "replace")
    if not isinstance(one, str):
        found.notes.append(f"{name}: its attribute units is not a short text and is not used")
        return
    text = one[:_BYTES].strip(" \0[](){}")
    since = _SINCE.fullmatch(text)
    word = since[1].lower() if since else text.lower()
    found.unit = UNIT_WORDS.get(word) or (time_unit(word) if word.isalpha() else None)
    if found.unit is None and word not in _NONE:
        shown = "".join(c for c in text[:_SHOWN] if c.isprintable())
        found.notes.append(f"{name}: its unit '{shown}' is not known and is not used")
