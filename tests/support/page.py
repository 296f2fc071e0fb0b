"""A page of docs/ as its reader runs it: its blocks, the words of its commands, and a folder in
which they run.
"""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from softmap_edge.cli import main

ROOT = Path(__file__).parents[2]


def blocks(page):
    """Return the fenced blocks of a page as (language, text)."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


def lines(text):
    """Return the command lines of a block as words, continued lines joined and comments dropped."""
    joined = text.replace("\\\n", " ").splitlines()
    return [words for line in joined if (words := shlex.split(line, comments=True))]


def reader(there, data):
    """Make `there` the reader's folder: the examples, and `data` where `make data` puts it."""
    (there / "data").mkdir()
    (there / "data" / data.name).symlink_to(data)
    shutil.copytree(ROOT / "examples", there / "examples")  # a link would send `../data` back here
    return there


def run_commands(page, there):
    """Run the commands of a page without Python, in their order; each must succeed. Other texts are
    left to others.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        for language, text in blocks(page):
            for words in lines(text) if language != "text" else ():
                assert words[0] in ("make", "softmap")
                assert words[0] == "make" or main(words[1:]) == 0, words


OMITTED = "…"  # a line of its own in a quote: lines of the output are left out here


def misquoted(quote, printed, reading=str.rstrip):
    """Return the first line of a quote that the output does not have there; None if all are right.

    A line follows the one before it in the output, unless the mark OMITTED is between them. Lines
    are equal if their `reading` is: it may leave out what differs between computers.
    """
    made = [reading(line) for line in printed.splitlines()]
    starts = [-1]  # places in the output after which the next line may stand
    for line in map(str.rstrip, quote.splitlines()):
        if line.strip() == OMITTED:
            starts = list(range(min(starts, default=0), len(made))) if starts else []
            continue
        first = starts == [-1]
        follow = {
            k for k in range(len(made)) if made[k] == reading(line) and (first or k - 1 in starts)
        }
        if not follow:
            return line
        starts = sorted(follow)
    return None
