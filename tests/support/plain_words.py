"""Find words that readers of the field do not expect, by scope; each has a plain substitute.

    python tests/support/plain_words.py        prints scope, file, line and word of each

Scopes: messages and help (strings that a person reads), docstrings, public names, comments, pages,
labels of pictures.
Names in code are no prose: text in backticks, and parameters and attributes that a docstring
explains.
"""

import ast
import functools
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
# word: what to write in its place
SUBSTITUTES = {
    r"told|tells?|telling": "identify, detect, report, distinguish; of commands: commanded",
    r"rivals?": "alternative",
    r"judges?|judged|judging": "validation run, validate",
    r"anew": "again",
    r"beside": "alongside, next to",
    r"whole(?! (numbers?|ticks|turns|rows))": "complete, full",
    r"wanted": "target, required",
    r"said": "reported",
    r"slackens?|slackened": "release tension",
    r"whoever|nobody": "name the person or program",
    r"elsewhere": "imported; another place",
    r"secrets?": "hidden effect",
    r"proved|proves|prove home": "homed; shown",
    r"undone?": "compensate",
    r"there and back|on the way back": "loading and unloading, forward and reverse",
    r"verbs?": "command",
    r"mid-range": "typical strength",
    r"left unexplained": "unexplained error",
    r"stands? off": "is away from",
    r"bench": "rig (the hardware and its file), robot (the machine)",
}
# only in prose: names in code keep these
PROSE = {
    r"(?<!\|\x20)deadman": "enable key, dead-man switch",  # not the cause of that name in a table
    r"(?<!model-)form error": "model-form error",
    r"own error": "model error",
    r"static correction": "static baseline, a static function of the command",
    r"share of what is explained": "share of the explained error",
    r"moves the body by": "effect size (mm RMS)",
    r"(?:one|each|every|per|a|the) look(?!-)": "capture",
    r"(?:the|this|our) house": "architecture",
    r"by warmth": "thermal",
}
ANY = "|".join([*SUBSTITUTES, *PROSE]).replace(" ", r"\s+")
WORDS = re.compile(rf"\b(?:{ANY})\b", re.IGNORECASE)
IN_NAMES = re.compile(rf"\b(?:{'|'.join(SUBSTITUTES)})\b", re.IGNORECASE)
# folders and files that keep words for now, and why
KEPT = {
    # the bytes of its files date the stored cases: a changed comment makes all of them again
    "benches/bank/": ("secrets", "rivals", "whole", "beside"),
}
QUOTING = ("plain_words.py", "test_words.py")  # they hold the words
CODE = re.compile(r"```.*?```|`[^`]{0,120}`", re.DOTALL)


class Finding(NamedTuple):
    """A word in a file."""

    scope: str
    file: str
    line: int
    word: str


def in_text(scope: str, name: str, line: int, text: str) -> Iterator[Finding]:
    """Yield the words in a text that begins at a line of a file, apart from code in backticks."""
    text = CODE.sub(lambda code: "`" + "\n" * code[0].count("\n"), text)
    for found in WORDS.finditer(text):
        word = " ".join(found[0].lower().split())
        yield Finding(scope, name, line + text[: found.start()].count("\n"), word)


def in_code(file: Path) -> Iterator[Finding]:
    """Yield the words in messages, docstrings, public names and comments of a Python file."""
    source, name = file.read_text(encoding="utf-8"), str(file.relative_to(ROOT))
    nodes = list(ast.walk(ast.parse(source)))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docs = {
        id(node.body[0].value)
        for node in nodes
        if isinstance(node, documented) and ast.get_docstring(node)
    }
    explained = re.compile(rf"\b(?:{'|'.join(sorted(_given(nodes)))})(?=:)")
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) in docs:
                text = explained.sub(lambda found: "_" * len(found[0]), node.value)
                yield from in_text("docstrings", name, node.lineno, text)
            elif " " in node.value:
                yield from in_text("messages", name, node.lineno, node.value)
        elif isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            parts = " ".join(re.findall(r"[A-Z]?[a-z]+", node.name))
            for found in IN_NAMES.finditer(parts):
                yield Finding("names", name, node.lineno, found[0].lower())
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield from in_text("comments", name, token.start[0], token.string)


def _given(nodes: Iterable[ast.AST]) -> set[str]:
    """Return the names of parameters and attributes of a file."""
    found = {"-"}
    for node in nodes:
        if isinstance(node, ast.arg):
            found.add(node.arg)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found.add(node.target.id)
    return found


def in_test(file: Path) -> Iterator[Finding]:
    """Yield the words in docstrings, comments and names of tests; their strings quote others."""
    source = file.read_text(encoding="utf-8").splitlines()
    helpers = {k for k, line in enumerate(source, 1) if re.match(r"\s*def (?!test_)", line)}
    for one in in_code(file):
        if one.scope != "messages" and not (one.scope == "names" and one.line in helpers):
            yield one


def in_rust(file: Path) -> Iterator[Finding]:
    """Yield the words in comments of a Rust file."""
    for line, text in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        if found := re.search(r"(?:^|\s)//.*", text):
            yield from in_text("comments", str(file.relative_to(ROOT)), line, found[0])


def in_page(file: Path) -> Iterator[Finding]:
    """Yield the words in the prose of a page: no code, no addresses of links."""
    text = re.sub(
        r"```.*?```|`[^`\n]*`|\]\([^)]*\)",
        lambda found: "`" + "\n" * found[0].count("\n"),
        file.read_text("utf-8"),
        flags=re.DOTALL,
    )
    yield from in_text("pages", str(file.relative_to(ROOT)), 1, text.replace("`", "_"))


def in_picture(file: Path) -> Iterator[Finding]:
    """Yield the words in the labels of a picture; matplotlib keeps each as a comment."""
    source = file.read_text("utf-8")
    for found in re.finditer(r"<!--(.*?)-->|<text[^>]*>(.*?)</text>", source, re.DOTALL):
        line = source[: found.start()].count("\n") + 1
        label = re.sub(r"<[^>]*>", " ", found[1] or found[2])
        yield from in_text("pictures", str(file.relative_to(ROOT)), line, label)


@functools.cache
def findings() -> list[Finding]:
    """Return all findings of the repository."""
    code = [
        file
        for folder in (
            "softmap_edge",
            "training/softmap_training",
            "benches",
            "examples",
            "rust",
            "docs",
        )
        for file in (ROOT / folder).rglob("*.py")
    ]
    tests = [file for file in (ROOT / "tests").rglob("*.py") if file.name not in QUOTING]
    rust = [file for file in (ROOT / "rust").rglob("*.rs") if "target" not in file.parts]
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    pictures = list((ROOT / "docs/pictures").rglob("*.svg"))
    searched = [(in_code, code), (in_test, tests), (in_rust, rust), (in_page, pages)]
    return [
        one
        for find, files in [*searched, (in_picture, pictures)]
        for file in sorted(files)
        for one in find(file)
        if not any(one.file.startswith(place) and one.word in KEPT[place] for place in KEPT)
        and not (one.scope == "names" and one.file.startswith("benches/"))
    ]


def sentences(file: Path) -> Iterator[str]:
    """Yield the sentences of a page's prose, without tables, lists, headings and code."""
    text = re.sub(r"```.*?```|<[^>]*>", "", file.read_text("utf-8"), flags=re.S)
    for block in re.split(r"\n\s*\n", text):
        if not re.match(r"\s*(\||[-*] |\d+\. |#|    |!\[)", block):
            yield from (s for s in re.split(r"(?<=[.!?])\s+", " ".join(block.split())) if s)


if __name__ == "__main__":
    for one in findings():
        print(f"{one.scope}: {one.file}:{one.line}: {one.word}")
