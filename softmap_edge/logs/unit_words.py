"""Units as logs state them: in names, in brackets, in a line of units.

Pinned by tests/logs/test_stated_units.py.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from softmap_edge.logs.mapping import LENGTH

LENGTH_WORDS = {unit: unit for unit in LENGTH} | {
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("foot", "feet"), "ft"),
    **dict.fromkeys(("millimeter", "millimetre", "millimeters", "millimetres"), "mm"),
    **dict.fromkeys(("centimeter", "centimetre", "centimeters", "centimetres"), "cm"),
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    **dict.fromkeys(("µm", "\u03bcm", "micron", "microns", "micrometer", "micrometre"), "um"),
}
# all units that are read, by their words in lower case
UNIT_WORDS = LENGTH_WORDS | {
    "deg": "deg",
    "degrees": "deg",
    "°": "deg",
    "rad": "rad",
}
UNIT_WORDS |= {
    "radians": "rad",
    "ticks": "ticks",
    "ma": "mA",
    "a": "A",
    "g": "g",
    "kg": "kg",
    "n": "N",
    "k": "K",
}
UNIT_WORDS |= {"degc": "degC", "°c": "degC", "c": "degC"}
# at the end of a name behind `_`: words of units that are not read
_SUFFIX = re.compile(
    r"_((?:\d*\.)?\d+(?:mm|cm|m|um|in|ft|deg|rad)|%|pct|percent|perc|counts?|steps?|pulses?|px|"
    r"pix|pixels?|thou|mils?|yd|nm|dm|km|mdeg|mrad|turns?|revs?|rpm|psi|k?pa|bar|mbar|volts?|mv|"
    r"ua|degf|fahrenheit|lbs?|lbf|oz|kn|mn|mg)$",
    re.IGNORECASE,
)
_FAHRENHEIT = re.compile(r"(?i:temp)\w*?(?:_([fF])|(?<=[a-z])(F))$")  # temp_f, tempF
_BRACKET = re.compile(r"[\[(]([^\[\]()]*)[\])]$")
_WORD = re.compile(r"[^\W\d_]{4,}|[xyzlr]|up|is|raw|ref|cmd|des|set|act", re.IGNORECASE)
_NUMBERED = re.compile(r" \(column \d+\)$")  # as names that occur twice are distinguished
_TYPE = re.compile(r"u?int\d*|float\d*|double|bool|str(ing)?|text|date.*|utc|n\.?a\.?|-+", re.I)


def unknown_unit(name: str, in_line: str | None, known: Collection[str]) -> str | None:
    """Return the unit that a log states for a column, if it is none of the known ones.

    Args:
        name: of the column: `cmd_0 [%]`, `cmd_0_pct`.
        in_line: the cell of a line of units; None without one.
        known: words of units that are read for such a column, in lower case.
    """
    if in_line is not None:
        text = in_line.strip("[](){} ")
        odd = text and text.lower() not in known and not _TYPE.fullmatch(text)
        return text[:20] if odd else None
    name = _NUMBERED.sub("", name)
    bracket = _BRACKET.search(name)
    if bracket is not None:
        text = bracket[1].strip()
        if not text or text.isdigit() or text.lower() in known:
            return None
        return None if _WORD.fullmatch(text) and not _SUFFIX.search(f"_{text}") else text[:20]
    suffix = _SUFFIX.search(name) or _FAHRENHEIT.search(name)
    unit = next(filter(None, suffix.groups())) if suffix else None
    return unit if unit and unit.lower() not in known else None


def unit_in_name(name: str, known: Collection[str]) -> str | None:
    """Return the unit at the end of a name: `servo_4_mm`, `Time [ms]`, `u1 (deg)`."""
    name = _NUMBERED.sub("", name)
    bracketed = re.search(r"[\[(]([^\[\]()]*)[\])]$", name.lower())
    # a multiple: 0.1mm; a unit made of several: mm/deg, N m
    if bracketed and re.match(r"\s*[\d.]+\s*[^\W\d]|.*[/·*^]|\s*k?n\s?m\s*$", bracketed[1]):
        return None
    words: list[str] = re.findall(r"[^\W\d_]+|°[a-z]?", bracketed[1]) if bracketed else []
    words = words or re.findall(r"_([^\W\d_]+|°)$", name.lower())
    if words == ["in"] and not bracketed and not re.search(r"[\dxyz]_in$", name.lower()):
        return None  # `motor_in` is an input
    return words[-1] if words and words[-1] in known else None
