"""Write docs/reference/: commands, Python names, finger.toml, schemas, confounds.

`python docs/make_reference.py` writes them; `make docs` runs it before it builds the site.
`pages()` returns the texts, which tests/project/test_reference.py compares with the committed
pages.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import itertools
import json
import os
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # schemas.py is next to this file
from schemas import SCHEMAS

from softmap_edge import _core, cli
from softmap_edge.commands import RENAMED, Command
from softmap_edge.commands.parser import Parser

ROOT = Path(__file__).parents[1]
FOLDER = Path("docs/reference")
PYTHON = ("softmap_edge", "training/softmap_training", "benches")
ARCHITECTURE = Path("docs/architecture.md")
ALIKE = Path("docs/understand/indistinguishable.md")

COMMANDS_HEAD = """# Commands

`docs/make_reference.py` writes this page from the parsers; do not edit it. `softmap COMMAND --help` prints the same.
Every command takes `--json`: it then prints one JSON document in place of text. Each document is listed in
[Runs, bundles and documents](formats.md), each exit code in [Exit codes](exit_codes.md).
"""

NAMES_HEAD = """# Python API

`docs/make_reference.py` writes this page from `softmap_edge/__init__.pyi`; do not edit it. Import each name from
`softmap_edge`: `from softmap_edge import Run`. It is loaded on first use. Lengths are in mm, times in s, angles in
degrees, masses in g, temperatures in °C. Every error is a `SoftmapError` with one sentence for a person.
"""

GROUPS = {  # what a reader looks for: the packages whose names answer it
    "Runs and logs": ("run", "logs"),
    "Models": ("model", "fem", "rod", "adaptation"),
    "Errors of a model, and their cause": ("comparison", "diagnosis", "experiment", "report"),
    "Effects": ("_core", "user_effect"),
    "Robots": ("robot",),
    "Errors and version": ("errors", "version"),
}

FINGER_HEAD = """# finger.toml

`docs/make_reference.py` writes this page from `softmap_edge/data/finger.toml`; do not edit it. The file describes a
finger for the [simulator](../understand/simulator.md). It is the built-in finger and the template for your own: copy
it, change the numbers, and run `softmap build my_finger.toml --out my_bundle`. Its comments explain every key, also
the optional ones. `docs/do/mesh.md` is a worked example with a mesh.
"""


BETWEEN = {  # what in a run distinguishes two effects of the same form
    "never": "nothing",
    "orientation": "a second orientation, declared in the run",
    "load": "a known load at the tip",
    "base": "points of the clamped base",
    "roll": "markers or a texture that show the roll",
}


def alike_page() -> str:
    """Return the page of effects and families that look the same, by the registries.

    Its tables are made from them.
    """
    rows = ["| effect | looks like | separated by |", "|---|---|---|"]
    for effect in _core.effects():
        rows += [
            f"| `{effect['name']}` | `{other}` | {BETWEEN[key]} |"
            for other, key in sorted(effect["alike"].items())
        ]
    families = ["| family | imitated by | moves that separate them |", "|---|---|---|"]
    for family in _core.families():
        if family["mimics"]:
            block, minutes = family["experiment"]
            moves = f"{_cell(block)} ({minutes:g} min)" if block else "those of the other family"
            families.append(f"| {family['name']} | {', '.join(family['mimics'])} | {moves} |")
    return filled((ROOT / ALIKE).read_text(encoding="utf-8"), effects=rows, families=families)


def architecture_page() -> str:
    """Return the page of the architecture, its tables made from the first lines of the modules."""
    packages = [file.parent for root in PYTHON for file in (ROOT / root).rglob("__init__.py")]
    modules = [*sorted((ROOT / "rust").rglob("mod.rs")), ROOT / "rust/servo/lib.rs"]
    python = ["| package | purpose |", "|---|---|"]
    for folder in sorted(packages):
        doc = (
            ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
        )
        python.append(f"| `{folder.relative_to(ROOT)}/` | {_cell(doc.split(chr(10) * 2)[0])} |")
    core = ["| folder | purpose |", "|---|---|"]
    core += [
        f"| `{file.parent.relative_to(ROOT)}/` | {_cell(_first_sentence(file))} |"
        for file in sorted(modules)
    ]
    return filled((ROOT / ARCHITECTURE).read_text(encoding="utf-8"), packages=python, core=core)


def _first_sentence(file: Path) -> str:
    """Return the first sentence of a Rust module's documentation."""
    lines = itertools.takewhile(
        lambda line: line.startswith("//!"), file.read_text(encoding="utf-8").splitlines()
    )
    text = " ".join(line.removeprefix("//!").strip() or "\n" for line in lines).split("\n")[0]
    return re.split(r"(?<=\.) ", text)[0].strip()


def filled(page: str, **tables: list[str]) -> str:
    """Return a page with each table between `<!-- NAME -->` and `<!-- end -->`."""
    for name, rows in tables.items():
        begin, end = f"<!-- {name} -->\n", "<!-- end -->"
        before, _, rest = page.partition(begin)
        page = before + begin + "\n" + "\n".join(rows) + "\n\n" + end + rest.partition(end)[2]
    return page


def commands_page() -> str:
    """Return the page of all commands with their options."""
    commands = cli.commands_here()
    parts = [COMMANDS_HEAD]
    for group in dict.fromkeys(one.group for one in commands):
        parts += [f"| {group} | |", "|---|---|"]
        parts += [
            f"| [{v.name}](#{v.name.replace(' ', '-')}) | {_cell(v.help)} |"
            for v in commands
            if v.group == group
        ]
        parts.append("")
    for one in commands:
        parts.append(_command(one))
    parts += [
        "## Old names",
        "",
        "They work in 0.1.0 and print a line on standard error.",
        "",
        "| old | new |",
        "|---|---|",
    ]
    parts += [f"| `{old}` | [{new}](#{new.replace(' ', '-')}) |" for old, new in RENAMED.items()]
    return "\n".join(parts) + "\n"


def _command(command: Command) -> str:
    parser = cli.parser_of(command)
    lines = [f"## {command.name}", "", _sentence(command.help), ""]
    if command.examples:
        lines += ["```text", *(f"softmap {example}" for example in command.examples), "```", ""]
    if command.page:
        (page,) = (ROOT / "docs").rglob(f"{command.page}.md")
        lines += [f"Page: [{page.stem}]({os.path.relpath(page, ROOT / FOLDER)})", ""]
    lines += _options(parser)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {one.dest: one.help or "" for one in action._choices_actions}
            for name, below in action.choices.items():
                lines += [
                    f"### {command.name} {name}",
                    "",
                    _sentence(helps.get(name, "")),
                    "",
                    *_options(below),
                ]
    return "\n".join(lines)


def _options(parser: Parser | argparse.ArgumentParser) -> list[str]:
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
            continue
        if action.help == argparse.SUPPRESS or action.option_strings == ["--json"]:
            continue
        rows.append(f"| {_shape(action)} | {_cell(_help(parser, action))} |")
    if not rows:
        return []
    return ["| argument | meaning |", "|---|---|", *rows, ""]


def _shape(action: argparse.Action) -> str:
    """Return an argument as it is typed."""
    name = action.metavar or (action.dest if not action.option_strings else action.dest.upper())
    if action.choices is not None and action.metavar is None:
        name = "{" + ",".join(map(str, action.choices)) + "}"
    values = " ".join(name) if isinstance(name, tuple) else str(name)
    if action.nargs == 0:
        values = ""
    elif action.nargs == "?":
        values = f"[{values}]"
    elif action.nargs in ("+", "*"):
        values = f"{values} …"
    elif isinstance(action.nargs, int) and not isinstance(name, tuple):
        values = " ".join([values] * action.nargs)
    forms = [
        " ".join(part for part in (option, values) if part)
        for option in action.option_strings or [""]
    ]
    return ", ".join("`" + form.replace("|", "/") + "`" for form in forms)


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    text = action.help or ""
    return text % {**vars(action), "prog": parser.prog} if "%" in text else text


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def _sentence(text: str) -> str:
    text = _cell(text)
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", "!")) else ".")


def public_names() -> dict[str, str]:
    """Return the module of each public name, in the order of the stub."""
    stub = ast.parse((ROOT / "softmap_edge/__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def names_page() -> str:
    """Return the page that lists the public names by topic; the site shows their docstrings."""
    homes, parts = public_names(), [NAMES_HEAD]
    left = dict(homes)
    for topic, rooms in GROUPS.items():
        chosen = {
            name: home for name, home in left.items() if set(home.split(".")[1:]) & set(rooms)
        }
        if topic == "Models":
            chosen = {name: home for name, home in chosen.items() if "user_effect" not in home}
        parts += [f"## {topic}", "", "| name | purpose |", "|---|---|"]
        parts += [f"| `{name}` | {_purpose(home, name)} |" for name, home in chosen.items()]
        parts.append("")
        for name, home in chosen.items():
            del left[name]
            if name != "__version__":
                parts += [f"::: {home}.{name}", ""]
    if left:
        raise SystemExit(f"docs/make_reference.py: give {', '.join(left)} a group")
    return "\n".join(parts)


def _purpose(home: str, name: str) -> str:
    """Return the first paragraph of a docstring, for readers of the page without the site."""
    if name == "__version__":
        return "The version of the package, as text."
    doc = inspect.getdoc(getattr(importlib.import_module(home), name)) or ""
    return _cell(doc.split("\n\n")[0])


def finger_page() -> str:
    """Return the page of finger.toml: the template, whose comments explain every key."""
    text = (ROOT / "softmap_edge/data/finger.toml").read_text(encoding="utf-8")
    return f"{FINGER_HEAD}\n```toml\n{text.rstrip()}\n```\n"


def schema_texts() -> dict[str, str]:
    """Return the JSON schema of each document by its file name."""
    found = {}
    for name, schema in SCHEMAS.items():
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name}
        found[re.sub(r"[./]", "-", name) + ".json"] = (
            json.dumps(head | schema, indent=1, ensure_ascii=False) + "\n"
        )
    return found


def pages() -> dict[Path, str]:
    """Return the text of every generated page by its path in the repository."""
    texts = {FOLDER / "cli.md": commands_page(), FOLDER / "python.md": names_page()}
    texts[FOLDER / "finger_toml.md"] = finger_page()
    texts[ALIKE], texts[ARCHITECTURE] = alike_page(), architecture_page()
    return texts | {FOLDER / "schemas" / name: text for name, text in schema_texts().items()}


if __name__ == "__main__":
    for path, text in pages().items():
        (ROOT / path).parent.mkdir(parents=True, exist_ok=True)
        (ROOT / path).write_text(text, encoding="utf-8")
