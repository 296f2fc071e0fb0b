"""The table of discovery on the built-in finger: its runs are pure, and each score accepts right
answers only.
"""

from dataclasses import replace

import numpy as np
import pytest

from benches.discovery import GROUPS, cases, hidden, static_laws, text
from softmap_edge import builtin_model, diagnose


def test_there_are_as_many_cases_as_the_page_says():
    every = cases(list(GROUPS))
    assert len(every) == 156 and len(static_laws()) == 20
    assert [sum(group == one for one, _ in every) for group in ("map", "play", "null")] == [
        48,
        12,
        24,
    ]


FEW = ("null", "play", "law")  # the others are drawn in the same way
EACH = [name if name in FEW else pytest.param(name, marks=pytest.mark.long) for name in GROUPS]


@pytest.mark.parametrize("group", EACH)
def test_a_run_is_a_pure_function_of_its_number(group):
    one, same, other = hidden(group, 1), hidden(group, 1), hidden(group, 2)
    assert one.run.hash() == same.run.hash() != other.run.hash() and one.name == same.name


@pytest.mark.long
def test_scores_accept_right_answers_only():
    """Play is right for play with its gaps, and wrong for nothing, for a map, and for a law that is
    in no library.
    """
    play = hidden("play", 0)
    found = diagnose(builtin_model(), play.run)
    assert play.wrong(found) is None
    effect = found.effects[0]
    off = {
        name: replace(number, value=1.06 * number.value) for name, number in effect.params.items()
    }
    assert "off by" in play.wrong(replace(found, effects=(replace(effect, params=off),)))
    wrong = {
        group: hidden(group, 0).wrong(found)
        for group in ("map", "law", "unknown", "strange", "null")
    }
    assert wrong == {
        "map": "a name is identified", "law": "another answer", "unknown": "a name is identified",
        "strange": "a name is identified", "null": "something is claimed",
    }  # fmt: skip
    silent = diagnose(builtin_model(), hidden("null", 0).run)
    assert hidden("null", 0).wrong(silent) is None and play.wrong(silent) == "another answer"
    assert hidden("strange", 0).wrong(silent) == "not flagged"


def test_the_table_counts_and_lists_what_is_wrong():
    row = {
        "group": "null",
        "number": 0,
        "hidden": "nothing",
        "verdict": "nothing",
        "wrong": None,
        "families": [],
        "named": [],
        "alternatives": [],
    }
    bad = row | {
        "number": 1,
        "verdict": "identified",
        "wrong": "something is claimed",
        "named": ["gain"],
    }
    lines = text([row, bad]).splitlines()
    assert lines[1].split()[:3] == ["null", "1", "2"] and np.all(
        ["null 1: nothing" in lines[2], "gain" in lines[2]]
    )
