"""The documentation: generated pages are current, links lead somewhere, each block of code is run
by a test.
"""

import argparse
import ast
import importlib.util
import json
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
from finger_runs import finger_run
from page import ROOT, blocks

from softmap_edge import _core, builtin_model, cli, compare, diagnose, save_bundle
from softmap_edge.cli import main
from softmap_edge.commands import RENAMED
from softmap_edge.robot.servo.rig import read_rig
from softmap_edge.robot.servo.rig_ceiling import RANGES

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
REFERENCE = ROOT / "docs/reference"


def script(name):
    """Return a script of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"docs/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_pages_are_current():
    pages = script("make_reference").pages()
    assert len(pages) >= 12
    old = [
        str(path)
        for path, text in pages.items()
        if (ROOT / path).read_text(encoding="utf-8") != text
    ]
    assert not old, "run `python docs/make_reference.py`"


def test_every_command_and_option_is_on_the_page():
    page = (REFERENCE / "cli.md").read_text(encoding="utf-8")
    for verb in cli.commands_here():
        (section,) = re.findall(
            rf"^## {verb.name}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL
        )
        actions = [a for a in cli.parser_of(verb)._actions if a.help != argparse.SUPPRESS]
        for action in actions:
            for option in action.option_strings:
                assert (
                    option in ("-h", "--help", "--json")
                    or len(option) == 2
                    or f"`{option}" in section
                ), option


# pages whose names in backticks are other things: the old names themselves, Python names, modules
OTHER_NAMES = ("cli.md", "python.md", "architecture.md")
OLD = "|".join(RENAMED)


def old_names(text):
    """Return the old names of commands in a text: `softmap OLD`, and OLD in backticks."""
    found = re.findall(rf"softmap\s+({OLD})\b|`({OLD})(?=`|\s[^`]*`)", text)
    return [first or second for first, second in found]


@pytest.mark.parametrize(
    "page",
    [page for page in (*PAGES, ROOT / "CHANGELOG.md") if page.name not in OTHER_NAMES],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_no_page_uses_an_old_name_of_a_command(page):
    assert old_names(page.read_text(encoding="utf-8")) == []


def test_no_message_help_or_example_uses_an_old_name_of_a_command():
    """Adjacent strings are one text here, as they are printed."""
    for file in [*(ROOT / "softmap_edge").rglob("*.py"), *(ROOT / "training").rglob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            texts = [node] if isinstance(node, ast.Constant) else getattr(node, "values", [])
            text = "".join(
                part.value if isinstance(part.value, str) else "…"
                for part in texts
                if isinstance(part, ast.Constant)
            )
            assert not re.search(rf"softmap\s+({OLD})\b", text), (file, node.lineno, text)
    for file in (ROOT / "examples").iterdir():
        if file.suffix in (".py", ".toml", ".md"):
            assert old_names(file.read_text(encoding="utf-8")) == [], file
    for command in cli.commands_here():
        assert all(example.split()[0] not in RENAMED for example in command.examples), command


def test_an_old_name_on_a_page_would_be_found():
    assert old_names("`softmap doctor` and `adapt`, but `model adapt`, `effects.json`") == [
        "doctor",
        "adapt",
    ]


def anchors(page):
    """Return the anchors of a page's headings, as MkDocs and GitHub make them."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)|[`*]", r"\1", head) for head in heads]
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", head.lower()).strip()) for head in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("https://", "http://")):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.is_file(), target
        assert not anchor or anchor in anchors(file), target


def test_the_first_picture_has_a_text_and_a_caption():
    for page in (ROOT / "README.md", ROOT / "docs/index.md"):
        (picture,) = re.findall(
            r"^!\[([^\]]{40,})\]\([^)]*\)\n\n\*[^*\n]+\*$", page.read_text("utf-8"), re.MULTILINE
        )
        assert "before" in picture and "after" in picture


def test_long_lines_of_code_wrap_on_the_site():
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    (style,) = re.findall(r"^extra_css: \[([^\]]+)\]$", config, re.MULTILINE)
    assert "pre > code { font-size: .76em; white-space: pre-wrap;" in (
        ROOT / "docs" / style
    ).read_text(encoding="utf-8")


def test_every_page_is_on_the_site():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    assert pages == set(re.findall(r"(?:- |: )([\w/]+\.md)$", nav, re.MULTILINE))


RUN = ("", "python", "sh", "bash")  # languages of blocks that a reader types or runs
GENERATED = {
    "docs/benchmarks/bank.md": "hours"
}  # not run here: `make bank` and its parts, by tests/benches/test_bank*.py


def test_every_block_of_code_is_run_by_a_test():
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py"))
    for page in PAGES:
        name = str(page.relative_to(ROOT))
        languages = {language for language, _ in blocks(page.read_text(encoding="utf-8"))}
        assert languages <= {*RUN, "text", "toml"}, name
        if languages & set(RUN) and name not in GENERATED:
            assert name in tests or page.name == "README.md", f"no test reads {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_blocks_of_toml_are_toml(page):
    for language, text in blocks(page.read_text(encoding="utf-8")):
        if language == "toml" and not text.rstrip().endswith(","):  # the beginning of a list
            tomllib.loads(text)


def test_the_example_of_a_rig_is_read_and_its_limits_are_those_of_the_guard(tmp_path):
    page = (REFERENCE / "rig_toml.md").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(
        *(text for language, text in blocks(page) if language == "toml"), "utf-8"
    )
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.servos[0].model == "XL330-M288" and rig.emergency.udp.port == 5006
    rows = re.findall(
        r"^\| `(\w+)` \| ([-\d. ]+) \| ([-\d. ]+) \| ([^|]*) \| .+ \|$", page, re.MULTILINE
    )
    stated = {
        name: (float(low.replace(" ", "")), float(high.replace(" ", "")))
        for name, low, high, _ in rows
    }
    assert stated == dict(RANGES)
    units = {name: unit.strip() for name, _, _, unit in rows}
    ranges = _core.limit_ranges()
    for name in RANGES:
        unit = ranges["current" if name == "current_mA" else name][2]
        assert unit in ("", units[name]), name


def test_every_key_of_a_rig_is_on_the_page():
    page = (REFERENCE / "rig_toml.md").read_text(encoding="utf-8")
    source = (ROOT / "softmap_edge/robot/servo/rig.py").read_text(encoding="utf-8")
    source += (ROOT / "softmap_edge/robot/servo/emergency.py").read_text(encoding="utf-8")
    keys = set(re.findall(r"\.(?:get|integer|number|choice|table)\(\"(\w+)\"", source))
    assert {"port", "baud", "home", "gpio", "key_file"} <= keys
    assert [key for key in sorted(keys) if f"`{key}`" not in page and f"`[[{key}]]`" not in page
            and f"`[{key}]`" not in page and f"`[{key}.NAME]`" not in page] == []  # fmt: skip


def test_every_field_of_a_run_is_on_the_page():
    from softmap_edge.run.fields import AXES

    page = (REFERENCE / "formats.md").read_text(encoding="utf-8")
    assert [name for name in AXES if f"`{name}`" not in page] == []


def test_exit_codes_are_those_of_the_command():
    page = (REFERENCE / "exit_codes.md").read_text(encoding="utf-8")
    codes = [int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)]
    assert codes == [
        cli.DONE,
        cli.FAULT,
        cli.WRONG_USE,
        cli.HUNG_UP,
        cli.INTERRUPTED,
        cli.TERMINATED,
    ]


def test_the_glossary_is_in_order_and_has_each_term_once():
    rows = re.findall(
        r"^\| ([^|]+) \| [^|]+ \|$", (REFERENCE / "glossary.md").read_text("utf-8"), re.MULTILINE
    )
    terms = [row.strip().lower() for row in rows if row.strip() not in ("term", "---")]
    assert terms == sorted(set(terms)) and len(terms) > 40


# --- documents and their schemas -----------------------------------------------------------------
@pytest.fixture(scope="module")
def documents(tmp_path_factory):
    """Documents of a real diagnosis and its neighbours by the name of their schema."""
    folder = tmp_path_factory.mktemp("documents")
    model = builtin_model()
    run = finger_run(["backlash"], {"backlash.gap": 2.0})
    run.save(folder / "run.npz")
    found = diagnose(model, run)
    (folder / "d.json").write_text(json.dumps(found.to_dict()), encoding="utf-8")
    bundle = save_bundle(found.model, folder / "better")
    return folder, {
        "softmap.diagnosis/2": json.loads(json.dumps(found.to_dict())),
        "softmap.comparison/1": json.loads(json.dumps(compare(model, run).to_dict())),
        "softmap.bundle/manifest": json.loads(
            (bundle / "manifest.json").read_text(encoding="utf-8")
        ),
        "softmap.bundle/effects": json.loads((bundle / "effects.json").read_text(encoding="utf-8")),
    }


def validator(name):
    """Return the validator of a schema of the reference; references between schemas are to files
    next to it.
    """
    files = {
        path.name: json.loads(path.read_text(encoding="utf-8"))
        for path in (REFERENCE / "schemas").iterdir()
    }
    schema = files[re.sub(r"[./]", "-", name) + ".json"]
    if name == "softmap.demo/1":
        schema["properties"]["diagnosis"] = files["softmap-diagnosis-2.json"]
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_documents_are_as_their_schemas_say(documents, monkeypatch, capsys):
    folder, made = documents
    monkeypatch.chdir(folder)
    assert main(["check", "run.npz", "--json"]) in (0, 1)
    made["softmap.check/1"] = json.loads(capsys.readouterr().out)
    assert (
        main(["next", "d.json", "--run", "run.npz", "--minutes", "0.1", "--out", "n.csv", "--json"])
        == 0
    )
    made["softmap.next/1"] = json.loads(capsys.readouterr().out)
    for name, document in made.items():
        validator(name).validate(document)
    linked = set(
        re.findall(
            r"schemas/([\w-]+\.json)", (REFERENCE / "formats.md").read_text(encoding="utf-8")
        )
    )
    assert linked == {path.name for path in (REFERENCE / "schemas").iterdir()}
    assert {re.sub(r"[./]", "-", name) + ".json" for name in made} == linked - {
        "softmap-demo-1.json"
    }


@pytest.mark.parametrize("key", ["verdict", "effects", "error"])
def test_a_document_without_a_key_is_refused_by_its_schema(documents, key):
    document = dict(documents[1]["softmap.diagnosis/2"])
    del document[key]
    with pytest.raises(jsonschema.ValidationError, match=key):
        validator("softmap.diagnosis/2").validate(document)


def test_every_document_is_listed():
    files = [
        file
        for folder in ("softmap_edge", "training/softmap_training", "rust")
        for file in (ROOT / folder).rglob("*")
    ]
    code = "".join(
        file.read_text(encoding="utf-8") for file in files if file.suffix in (".py", ".rs")
    )
    found = set(re.findall(r'"(softmap\.[a-z0-9_-]+/\d+)', code))
    listed = set(
        re.findall(
            r"softmap\.[a-z0-9_-]+/\d+", (REFERENCE / "formats.md").read_text(encoding="utf-8")
        )
    )
    assert found == listed


def test_the_picture_of_the_steps_is_drawn(tmp_path):
    assert script("figures_diagnosis").main(["--out", str(tmp_path)]) == 0
    made = (tmp_path / "diagnosis.svg").read_bytes()
    assert b"<svg" in made[:1000] and made == (ROOT / "docs/pictures/diagnosis.svg").read_bytes()


def test_the_site_is_strict_and_loads_nothing_from_the_network():
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert (
        "strict: true" in config
        and "font: false" in config
        and "polyfills: [assets/iframe-worker.js]" in config
    )
    assert Path(ROOT / "docs/assets/iframe-worker.js").is_file()
