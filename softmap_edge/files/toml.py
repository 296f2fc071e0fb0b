"""Read a TOML table key by key, then report its unknown keys.

Every fault is one RunError with the file, the key, the value found and the expected value.
`quoted` writes any text as TOML. Pinned by tests/robot/test_rig_file.py.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, nearest, no_name
from softmap_edge.files.atomic import Document

Array = NDArray[np.float64]
_KINDS: dict[type, str] = {
    str: "text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    list: "a list",
    dict: "a table",
}


MOST_PARTS = 16  # of a key with dots: time and memory of tomllib grow with the square of them
_BASIC, _LITERAL = r'"(?:[^"\\\n]|\\.)*+"', r"'[^'\n]*+'"
_PART = rf"(?:(?<![\w-])[\w-]++|{_BASIC}|{_LITERAL})"
_LONG_KEY = rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_PARTS}}}"
_TEXTS = (  # comments and strings, in which dots join nothing
    r"#[^\n]*+",
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\\?\Z)',
    r"'''(?:[^']|'(?!''))*+(?:'''|\Z)",
    # without an end, up to that of the line: no second search
    rf"{_BASIC[:-1]}(?:\"|(?=\n)|\\?\Z)",
    rf"{_LITERAL[:-1]}(?:'|(?=\n)|\Z)",
)
_TOKENS = re.compile(rf"(?P<long>{_LONG_KEY})|{'|'.join(_TEXTS)}", re.DOTALL)


def parsed(text: str) -> Document:
    """Return the tables of a TOML text.

    Raises:
        tomllib.TOMLDecodeError: it is not TOML, or a key has more than `MOST_PARTS` parts.
    """
    if long := next((token for token in _TOKENS.finditer(text) if token["long"]), None):
        line = text.count("\n", 0, long.start()) + 1
        raise tomllib.TOMLDecodeError(
            f"a key of more than {MOST_PARTS} parts with dots between them (at line {line})"
        )
    return tomllib.loads(text)


class TomlTable:
    """A TOML table that records the keys read, so that unknown keys can be listed."""

    def __init__(self, values: object, where: str) -> None:
        if not isinstance(values, dict):
            raise RunError(
                f"{where}: {kind(values)}, expected a table; examples/trunk.toml shows the form"
            )
        self.values, self.where, self.asked = values, where, list[str]()

    def get(self, key: str, kinds: tuple[type, ...], default: object = None) -> Any:
        """Return the value of a key; it must be of one of the given kinds."""
        self.asked.append(key)
        if key not in self.values:
            return default
        value = self.values[key]
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            names = " or ".join(_KINDS.get(k, k.__name__) for k in kinds)
            raise RunError(f"{self.where}: {key} is {kind(value)}, expected {names}")
        return value

    def number(
        self, key: str, default: float | None = None, low: float = -1e12, high: float = 1e12
    ) -> float | None:
        """Return a number within limits."""
        value = self.get(key, (int, float), default)
        if value is None:
            return None
        if not low <= value <= high:  # also false for NaN
            raise RunError(f"{self.where}: {key} = {shown(value)}, expected {low:g} to {high:g}")
        return float(value)

    def integer(self, key: str, default: int | None, low: int, high: int) -> int | None:
        """Return a whole number within limits."""
        value = self.get(key, (int,), default)
        if value is not None and not low <= value <= high:
            raise RunError(f"{self.where}: {key} = {shown(value)}, expected {low} to {high}")
        return None if value is None else int(value)

    def choice(self, key: str, allowed: tuple[str, ...], default: str) -> str:
        """Return a text that must be one of `allowed`."""
        value = str(self.get(key, (str,), default))
        if value not in allowed:
            near = nearest(value, allowed)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            raise RunError(
                f"{self.where}: {key} = '{value[:40]}', expected one of {', '.join(allowed)}{hint}"
            )
        return value

    def table(self, key: str) -> TomlTable:
        """Return a table within this one; empty if absent."""
        return TomlTable(self.get(key, (dict,), {}), f"{self.where}: {key}")

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> Array | None:
        """Return an array of numbers; None in `shape` stands for any length."""
        value = self.get(key, (list, int, float))
        if value is None:
            return None
        try:
            array = np.array(value, float)
        except (ValueError, TypeError, OverflowError) as cause:
            raise RunError(
                f"{self.where}: {key} is not a list of numbers; expected shape {shape}"
            ) from cause
        if array.ndim != len(shape) or any(
            n is not None and n != m for n, m in zip(shape, array.shape)
        ):
            raise RunError(f"{self.where}: {key} has shape {array.shape}, expected {shape}")
        if not (np.abs(array) <= 1e12).all():  # also false for NaN
            raise RunError(
                f"{self.where}: {key} holds NaN or a number beyond 1e12; give plain numbers"
            )
        return array

    def only(self, keys: Iterable[str]) -> None:
        """Raise RunError if the table holds a key that is not in `keys`, the complete list."""
        self.asked = list(keys)
        self.done()

    def done(self) -> None:
        """Raise RunError if a key was never read."""
        unknown = [key for key in self.values if key not in self.asked]
        if unknown:
            raise RunError(f"{self.where}: {no_name('key', unknown[0], self.asked)}")


def kind(value: object) -> str:
    """Return the kind of a value and the value itself, for a message."""
    name = _KINDS.get(type(value), type(value).__name__)
    return f"{name} {shown(value)!r}"


def shown(value: object) -> str:
    """Return a value as text of at most 40 characters."""
    try:
        return str(value)[:40]
    except ValueError:  # Python does not print integers of more than 4300 digits
        return "a number of thousands of digits"


def quoted(text: str) -> str:
    """Return a text as a TOML string of one line.

    Characters that UTF-8 cannot encode become `?`, as in `write_atomically`.
    """
    plain = (
        text.encode("utf-8", "replace").decode("utf-8").replace("\\", "\\\\").replace('"', '\\"')
    )
    return '"' + "".join(c if c.isprintable() else _escaped(ord(c)) for c in plain) + '"'


def _escaped(code: int) -> str:
    return f"\\u{code:04X}" if code <= 0xFFFF else f"\\U{code:08X}"


def written(value: object) -> str:
    """Return a text, a number or a list of them in TOML notation."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return quoted(value) if isinstance(value, str) else repr(value)
