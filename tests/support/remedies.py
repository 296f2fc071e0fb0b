"""List every text of the packages that names a `softmap …` command, and check each with the real
argument parser.

    python tests/support/remedies.py  prints file, line and command of each, and what is wrong

A command is what stands in backquotes and begins with `softmap `. Words in capitals and the parts
of an f-string are placeholders. A text may name a part of a command only (`softmap diagnose
--out`); what is missing is filled in before the parser reads it. `tests/commands/test_remedies.py`
runs this, and executes remedies.
"""

import argparse
import ast
import contextlib
import io
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from softmap_edge.cli import HELP, commands_here, parser_of
from softmap_edge.commands import ELSEWHERE, Command

ROOT = Path(__file__).parents[2]
FOLDERS = ("softmap_edge", "training/softmap_training", "rust")
COMMAND = re.compile(r"`softmap ([^`]+)`")
# without backquotes
PLAIN = re.compile(r"(?<![\w`.-])softmap ([a-z]{3,}(?: (?:[A-Z][A-Z0-9_.]*|--[a-z-]+))+)")
PLACEHOLDER = re.compile(r"[A-Z][A-Z0-9_]*([.,:][A-Za-z0-9_,:\[\]]*)?|…|\.\.\.|\[.*\]|b\d")
HOLE = "HOLE"  # stands for a part of an f-string


@dataclass(frozen=True)
class Named:
    """A command that a text names: the words after `softmap`, and where the text stands."""

    file: str
    line: int
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: softmap {' '.join(self.words)}"


@cache
def commands() -> list[Named]:
    """Return every command that a text of the packages names."""
    found = []
    for folder in FOLDERS:
        for file in sorted((ROOT / folder).rglob("*")):
            if file.suffix in (".py", ".rs"):
                texts = python_texts(file) if file.suffix == ".py" else rust_texts(file)
                name = str(file.relative_to(ROOT))
                found += [
                    Named(name, line, tuple(words))
                    for line, text in texts
                    for words in named_in(text)
                ]
    return found


def named_in(text: str) -> list[list[str]]:
    """Return the words of each command in a text; a line break within one is a space."""
    line = " ".join(text.split())
    quoted = [match.split() for match in COMMAND.findall(line)]
    # a file's first line may look like one
    plain = [match.split() for match in PLAIN.findall(COMMAND.sub("", line))]
    if not plain:
        return quoted
    known = {name.split()[0] for name in verbs()}
    return [
        *quoted,
        *(words for words in plain if words[0] in known or any(w.startswith("--") for w in words)),
    ]


@cache
def verbs() -> dict[str, Command]:
    """Return the commands of this installation by name."""
    return {verb.name: verb for verb in commands_here()}


def command_of(words: Sequence[str]) -> str:
    """Return the name of the command that these words begin with: two words for an action of a
    group.
    """
    two = " ".join(words[:2])
    return two if two in verbs() else words[0]


def python_texts(file: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of each string and f-string, parts that are computed as placeholders."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    inner = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr)
        for part in ast.walk(node)
    } - {id(node) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else HOLE for part in node.values]
            yield node.lineno, "".join(map(str, parts))
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner
        ):
            yield node.lineno, node.value


def rust_texts(file: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of each line of Rust; a command there stands in one line."""
    yield from enumerate(file.read_text(encoding="utf-8").splitlines(), start=1)


def fault(words: tuple[str, ...]) -> str | None:
    """Return what is wrong with a command, None if the parser takes it."""
    # words that are computed
    words = tuple(word for word in words if not re.fullmatch(f"({HOLE}){{2,}}", word))
    name = command_of(words)
    if name not in verbs():
        return None if words[0] in (*ELSEWHERE, HELP) else f"there is no command '{name}'"
    parser = parser_of(verbs()[name])
    argv, rest = [], list(words[len(name.split()) :])
    while actions := next(
        (a for a in parser._actions if isinstance(a, argparse._SubParsersAction)), None
    ):
        name = next((word for word in rest if not word.startswith("-")), None)
        if name is None:
            return None if not rest else f"options of '{words[0]}' without an action"
        if name not in actions.choices:
            return f"'{words[0]}' has no action '{name}'"
        rest.remove(name)
        parser = actions.choices[name]
    wrong = [
        word for word in rest if word.startswith("--") and word not in parser._option_string_actions
    ]
    if wrong:
        return f"there is no option {wrong[0]}"
    argv = filled(parser, rest)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            parser.parse_args(argv)
    except SystemExit:
        return said.getvalue().strip().splitlines()[-1]
    return None


def filled(parser: argparse.ArgumentParser, words: list[str]) -> list[str]:
    """Return the words with values for placeholders, and with what a part of a command leaves
    out.
    """
    options: list[str] = []
    places: list[str] = []
    given = set()
    while words:
        word, *words = words
        action = parser._option_string_actions.get(word)
        if action is None:
            places.append(word)
            continue
        given.add(action.dest)
        count = 0 if action.nargs == 0 else action.nargs if isinstance(action.nargs, int) else 1
        values = []
        while (
            words
            and len(values) < max(count, 9 * (action.nargs == "+"))
            and not words[0].startswith("--")
        ):
            values.append(words.pop(0))
        values += ["X"] * (count - len(values))
        options += [word, *(value(action, one) for one in values)]
    exclusive = [group for group in parser._mutually_exclusive_groups if group.required]
    for group in exclusive:
        if not any(action.dest in given for action in group._group_actions):
            action = group._group_actions[0]
            options += [
                action.option_strings[0],
                *([] if action.nargs == 0 else [value(action, "X")]),
            ]
    for action in parser._actions:
        if action.option_strings and action.required and action.dest not in given:
            options += [action.option_strings[0], value(action, "X")]
    slots = [action for action in parser._actions if not action.option_strings]
    found = [
        value(slots[min(k, len(slots) - 1)], word) if slots else word
        for k, word in enumerate(places)
    ]
    found += [
        value(action, "X") for action in slots[len(places) :] if action.nargs not in ("?", "*")
    ]
    return [*found, *options]


def value(action: argparse.Action, word: str) -> str:
    """Return a value for an argument: the word itself, or one that fits where it is a
    placeholder.
    """
    if word not in ("X", HOLE) and not PLACEHOLDER.fullmatch(word):
        return word
    if action.choices:
        return str(next(iter(action.choices)))
    return "1" if action.type in (int, float) else "X"


def faults() -> list[str]:
    """Return a line for each command that the parser does not take."""
    found = [(one, fault(one.words)) for one in commands()]
    return [f"{one}: {wrong}" for one, wrong in found if wrong]


if __name__ == "__main__":
    print("\n".join(map(str, commands())))
    wrong = faults()
    print("\n".join(wrong), file=sys.stderr)
    sys.exit(bool(wrong))
