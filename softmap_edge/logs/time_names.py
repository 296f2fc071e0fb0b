"""Recognise names of time columns and the units in them: `millis`, `timeMs`, `t_usec`."""

from __future__ import annotations

import re

TIME_NAME = re.compile(r"^t$|time|stamp|clock|^sec|^t_|_t$", re.IGNORECASE)
_WORDS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": (
        "ms",
        "msec",
        "msecs",
        "milli",
        "millis",
        "millisec",
        "millisecs",
        "millisecond",
        "milliseconds",
    ),
    "us": (
        "us",
        "µs",
        "μs",
        "usec",
        "usecs",
        "micro",
        "micros",
        "microsec",
        "microsecond",
        "microseconds",
    ),
    "ns": (
        "ns",
        "nsec",
        "nsecs",
        "nano",
        "nanos",
        "nanosec",
        "nanosecs",
        "nanosecond",
        "nanoseconds",
    ),
    "min": ("min", "mins", "minute", "minutes"),
    "h": ("hour", "hours", "hrs"),
}
_UNIT = {word: unit for unit, words in _WORDS.items() for word in words}
_ALONE = {
    word for unit, words in _WORDS.items() for word in words if unit in ("ms", "us", "ns")
} - {
    "micro",
    "nano",
    "milli",
}
_WORD = re.compile(r"[A-Z]?[a-zµμ]+|[A-Z]+")


def time_unit(name: str) -> str | None:
    """Return the time unit in the last word of a name; None if there is none."""
    words = _WORD.findall(name)
    return _UNIT.get(words[-1].lower()) if words else None


def is_time_unit(name: str) -> bool:
    """Return whether a name is only a time unit below a second, such as Arduino's `millis`.

    It may be combined with `elapsed`.
    """
    words = [word.lower() for word in _WORD.findall(name)]
    return (
        bool(words)
        and words[-1] in _ALONE
        and set(words[:-1]) <= {"elapsed", "system", "uptime", "run", "since", "start"}
    )


def is_time_name(name: str) -> bool:
    """Return whether a column is named like a time; a unit may follow in brackets."""
    bare = re.sub(r"[\[(].*?[\])]", "", name).strip()
    return TIME_NAME.search(bare) is not None or is_time_unit(bare)
