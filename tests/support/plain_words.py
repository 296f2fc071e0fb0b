"""Find words that readers of the field do not expect, by scope; each has a plain substitute.

    python tests/support/plain_words.py        prints scope, file, line and word of each

Scopes: messages and help (strings that a person reads), docstrings, public names, pages.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
# word: what to write in its place
SUBSTITUTES = {
    r"told|tells?|telling": "identify, detect, report, distinguish; of commands: commanded",
    r"rivals?": "alternative",
    r"judges?|judged": "validation run, validate",
    r"anew": "again",
    r"beside": "alongside, next to",
    r"whole(?! (numbers?|ticks|turns|rows))": "complete, full",
    r"wanted": "target, required",
    r"said": "reported",
    r"slackens?|slackened": "release tension",
    r"whoever|nobody": "name the person or program",
    r"elsewhere": "imported; another place",
    r"secrets?": "hidden effect",
    r"proved|proves": "homed; shown",
    r"undone?": "compensate",
    r"there and back": "loading and unloading",
    r"verbs?": "command",
    r"mid-range": "typical strength",
    r"left unexplained": "unexplained error",
    r"stands? off": "is away from",
}
WORDS = re.compile(rf"\b(?:{'|'.join(SUBSTITUTES)})\b", re.IGNORECASE)


class Finding(NamedTuple):
    """A word in a file."""

    scope: str
    file: str
    line: int
    word: str


def in_code(file: Path) -> Iterator[Finding]:
    """Yield the words in messages, docstrings and public names of a Python file."""
    tree, name = ast.parse(file.read_text(encoding="utf-8")), str(file.relative_to(ROOT))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docs = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and ast.get_docstring(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            scope = "docstrings" if id(node) in docs else "messages"
            if scope == "docstrings" or " " in node.value:
                for found in WORDS.finditer(node.value):
                    yield Finding(
                        scope,
                        name,
                        node.lineno + node.value[: found.start()].count("\n"),
                        found[0].lower(),
                    )
        elif isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            for part in re.findall(r"[A-Z]?[a-z]+", node.name):
                if WORDS.fullmatch(part):
                    yield Finding("names", name, node.lineno, part.lower())


def in_page(file: Path) -> Iterator[Finding]:
    """Yield the words in the prose of a page: no code, no addresses of links."""
    text = re.sub(
        r"```.*?```|`[^`\n]*`|\]\([^)]*\)",
        lambda m: "\n" * m[0].count("\n"),
        file.read_text("utf-8"),
        flags=re.S,
    )
    for found in WORDS.finditer(text):
        yield Finding(
            "pages",
            str(file.relative_to(ROOT)),
            1 + text[: found.start()].count("\n"),
            found[0].lower(),
        )


def findings() -> list[Finding]:
    """Return all findings of the repository."""
    code = [
        file
        for folder in ("softmap_edge", "training/softmap_training")
        for file in (ROOT / folder).rglob("*.py")
    ]
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    found = [one for file in sorted(code) for one in in_code(file)]
    return found + [one for file in sorted(pages) for one in in_page(file)]


def sentences(file: Path) -> Iterator[str]:
    """Yield the sentences of a page's prose, without tables, lists, headings and code."""
    text = re.sub(r"```.*?```|<[^>]*>", "", file.read_text("utf-8"), flags=re.S)
    for block in re.split(r"\n\s*\n", text):
        if not re.match(r"\s*(\||[-*] |\d+\. |#|    |!\[)", block):
            yield from (s for s in re.split(r"(?<=[.!?])\s+", " ".join(block.split())) if s)


if __name__ == "__main__":
    for one in findings():
        print(f"{one.scope}: {one.file}:{one.line}: {one.word}")
