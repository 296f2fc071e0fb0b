"""Recognise labels of what was seen: `tracked`, `valid_1`, `tip.likelihood`, `m1_status`.

Booleans always count as such labels. Other numbers count if the name says so, and if they are few
small whole numbers, or lie in 0 to 1 where the name is that of a probability. Words count if the
name says so, or if all of them are words of flags. Such columns are not places, commands or
encoders. A column of 0 and 1 without such a name may be a flag: it is not a coordinate, and a
command only with a question.
Pinned by tests/logs/test_flags.py.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REASON = "labels of what was seen"
_FLAGS = re.compile(
    r"(un)?tracked|(is)?tracked|(is)?(in)?valid|validity|(is|in)?visible|visibility|(un)?seen|"
    r"(un)?detected|mask|masked|occluded|occlusions?|hidden|lost|missing|status|flags?|ok|"
    r"gültig|gueltig|sichtbar|verdeckt"
)
_GRADES = re.compile(
    r"confidence|conf|likelihood|probability|prob|quality|score|certainty|visibility|validity"
)
_WORDS = re.compile(
    r"ok|good|bad|(in)?valid|true|false|yes|no|(un)?tracked|tracking|(not )?occluded|occlusion|"
    r"(un|not )?seen|hidden|(in)?visible|missing|lost|(not )?found|(un)?detected|present|absent|"
    r"gap|fail(ed)?|error|fault|nan|none|null|off|on|[tfyn]|ja|nein|wahr|falsch|(un)?gültig"
)
_NAME = re.compile(r"[A-Z]?[^\W\d_A-Z]+|[A-Z]+")
_FEW, _LARGEST = 10, 100  # different whole numbers of a flag, and the largest of them


def named_so(name: str) -> bool:
    """Return whether a name is that of labels of what was seen."""
    return any(_FLAGS.fullmatch(word) or _GRADES.fullmatch(word) for word in words_of(name))


def flags_of(names: Sequence[str], numbers: Array, booleans: Collection[str]) -> list[str]:
    """Return the columns that are labels of what was seen, in the order of the file.

    Args:
        names: the columns of a log.
        numbers: their cells, shape (rows, columns); NaN where missing.
        booleans: the columns that the file holds as booleans.
    """
    groups: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if name in booleans or named_so(name):
            groups.setdefault(_stem(name), []).append(k)
    found = set()
    for members in groups.values():
        grade = any(map(_GRADES.fullmatch, words_of(names[members[0]])))
        if all(names[k] in booleans for k in members) or (
            all(_like_flags(numbers[:, k], grade) for k in members)
            and np.isfinite(numbers[:, members]).any()
        ):
            found |= set(members)
        found |= {k for k in members if names[k] in booleans}
    return [name for k, name in enumerate(names) if k in found]


def is_switch(values: Array) -> bool:
    """Return whether numbers (rows,) are only 0 and 1, and both: a flag or a switch of any name."""
    kinds = np.unique(values[np.isfinite(values)])
    return len(kinds) == 2 and bool((kinds == (0.0, 1.0)).all())


def are_flags(name: str, texts: Sequence[str]) -> bool:
    """Return whether a column of text holds labels of what was seen."""
    words = {text.strip().lower() for text in texts if text.strip()}
    return named_so(name) or (bool(words) and all(map(_WORDS.fullmatch, words)))


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case: `TrialNo_2` has the words trial, no."""
    return [word.lower() for word in _NAME.findall(name)]


def _stem(name: str) -> str:
    """Return a name without numbers and axes, so that the columns of one group share it."""
    return re.sub(r"\d+|(?<![^\W\d_])[xyzXYZ](?![^\W\d_])", "#", name)


def _like_flags(values: Array, grade: bool) -> bool:
    """Return whether numbers are few small whole numbers, or lie in 0 to 1 if they are grades."""
    known = values[np.isfinite(values)]
    if grade and (known >= 0).all() and (known <= 1).all():
        return True
    kinds = np.unique(known)
    whole = bool((kinds == np.rint(kinds)).all() and (np.abs(kinds) <= _LARGEST).all())
    return whole and len(kinds) <= min(_FEW, max(2, len(known) // 4))
