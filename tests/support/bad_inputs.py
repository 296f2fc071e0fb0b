"""The table of bad input in docs/reference/safety.md: the message of each input, and the state of
the guard then.
"""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs/reference/safety.md"
DIFFERS = {"PORT": r"/dev/\S+", "N": r"[\d.]+"}


def table():
    """Return the page's table: input → (pattern of its line, states)."""
    section = PAGE.read_text(encoding="utf-8").split("## Bad input")[1].split("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line[:1] == "|"
    ]
    assert rows[0] == ["bad input", "the line", "guard"]
    return {name: (pattern(line), guard.lower().split(" → ")) for name, line, guard in rows[2:]}


def pattern(line):
    """Return what a line of the table matches."""
    words = re.split(r"\b(PORT|N)\b", line)
    return "".join(DIFFERS.get(word, re.escape(word)) for word in words)


TABLE = table()
