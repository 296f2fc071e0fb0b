"""The page of the bank lists every constant of the decision; the glossary explains every verdict
and family.
"""

import re
from pathlib import Path

from softmap_edge.diagnosis import decision
from softmap_edge.diagnosis.document import VERDICTS
from softmap_edge.diagnosis.families import families

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_of_the_bank_lists_every_constant_with_its_value():
    page = (DOCS / "benchmarks/bank.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([A-Z_]+)` \| ([^|]+) \| ([^|]+) \|$", page, re.MULTILINE)
    listed = {
        name: tuple(float(number) for number in values.split(",")) for name, values, _ in rows
    }
    constants = {name: value for name, value in vars(decision).items() if name.isupper()}
    assert len(listed) == len(rows)
    assert listed == {
        name: value if isinstance(value, tuple) else (value,) for name, value in constants.items()
    }
    assert all(reason.strip() for _, _, reason in rows)


def test_the_page_of_words_explains_every_verdict_and_names_every_family():
    page = (DOCS / "reference/report.md").read_text(encoding="utf-8")
    for words in VERDICTS.values():
        assert f"\n| {words.split(':')[0]} |" in page, words
    (row,) = re.findall(r"^\| family \| (.*) \|$", page, re.MULTILINE)
    for family in families():
        assert family.name in row, family.name
