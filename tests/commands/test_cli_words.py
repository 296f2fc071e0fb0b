"""The command line: what was meant, help of every command, a reader that leaves early, options that
are read.
"""

import argparse
import ast
import importlib
import inspect
import os
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from learned_ticks import arm

from softmap_edge.cli import commands_here, main, outliving, parser_of
from softmap_edge.commands import COMMANDS as BUILTIN
from softmap_edge.commands import RENAMED
from softmap_edge.commands.parser import parsers_below

ROOT = Path(__file__).parents[2]
COMMANDS = {command.name: command for command in commands_here()}


@pytest.mark.parametrize(
    ("argv", "hint"),
    [
        (["diagnos", "run.npz"], "did you mean 'diagnose'?"),
        (["Learn", "run.npz"], "did you mean 'learn'?"),
        (["calibrat"], "did you mean 'model calibrate'?"),
        (["algin", "run.npz"], "did you mean 'run align'?"),
        (["mvoe"], "did you mean 'servo move'?"),
        (["effcets"], "did you mean 'model effects'?"),
        (["hoem"], "did you mean 'servo home'?"),
        (["jion", "a.npz"], "did you mean 'run join'?"),
        (["tarin", "prior"], "did you mean 'train'?"),
        (["run", "algin", "a.npz"], "did you mean align?"),
        (["servo", "mvoe"], "did you mean move?"),
        (
            ["diagnose", "run.npz", "--bundel", "b"],
            "there is no option --bundel: did you mean --bundle",
        ),
        (["learn", "run.npz", "--oot", "b"], "or --out?"),
        # an abbreviation is taken; the file is what is missing
        (["import", "log.csv", "--gues"], ""),
        (["compare", "run.npz", "--htlm=x.html"], "did you mean --html"),
        (["servo", "scna"], "did you mean scan?"),
        (["servo", "scan", "--badu", "3"], "did you mean --baud"),
        (["run", "jion", "a.npz"], "did you mean join?"),
        (["run", "cut", "a.npz", "--form", "3", "--out", "b.npz"], "did you mean --from"),
        (["learn", "run.npz", "--out", "b", "--input", "gaol"], "did you mean goal?"),
        (["model", "effects", "bakclash"], "did you mean 'backlash'?"),
        (["track", "S", "--sim", "--hide", "backlahs"], "did you mean 'backlash'?"),
        (["next", "--block", "home revisit"], "did you mean 'home revisits'?"),
        (["track", "circel", "--plan"], "did you mean 'circle'?"),
    ],
)
def test_a_name_that_does_not_exist_is_answered_with_the_nearest(
    argv, hint, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 2
    assert hint in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_nothing_is_meant_by_nonsense(capsys):
    for argv in (
        ["zzzz"],
        ["model", "effects", "zzzz"],
        ["servo", "zzzz"],
        ["compare", "r.npz", "--zzzz"],
    ):
        assert main(argv) == 2
        assert "did you mean" not in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_is_what_the_option_prints(name, capsys):
    assert main(["help", *name.split()]) == 0
    reported = capsys.readouterr().out
    assert main([*name.split(), "--help"]) == 0
    assert reported == capsys.readouterr().out and reported.startswith(f"usage: softmap {name}")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples_that_are_taken_and_a_page_that_is_there(name, capsys):
    command = COMMANDS[name]
    assert main([*name.split(), "--help"]) == 0
    reported = capsys.readouterr().out
    assert command.examples and command.page
    pages = [path for path in (ROOT / "docs").rglob(f"{command.page}.md")]
    assert len(pages) == 1 and f"Page in the docs: {command.page}" in reported
    for example in command.examples:
        assert f"\n  softmap {example}\n" in reported
        assert example.startswith(f"{name} ") or example == name
        # exits where it cannot be used
        parser_of(command).parse_args(example.split()[len(name.split()) :])


def test_a_group_lists_its_actions(capsys):
    actions = [name for name in COMMANDS if name.startswith("model ")]
    assert len(actions) > 5
    for argv, code in ((["model"], 2), (["model", "--help"], 0), (["help", "model"], 0)):
        assert main(argv) == code
        reported = capsys.readouterr().out
        assert reported.startswith("usage: softmap model ACTION") and all(
            f"  {name} " in reported for name in actions
        )
    assert main(["model", "predcit"]) == 2
    assert "no action of 'model' 'predcit'; there are " in (reported := capsys.readouterr().err)
    assert "did you mean 'predict'?" in reported
    assert main(["run", "--help"]) == 0
    assert "More actions: run align, run register" in capsys.readouterr().out


def test_about_fifteen_groups_answer_the_questions_of_a_user():
    assert len({command.name.split()[0] for command in BUILTIN}) <= 17
    frozen = (
        "demo import learn build compare diagnose add check next record track teleop servo show"
    )
    assert set(frozen.split()) <= set(COMMANDS)


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_name_works_and_says_the_new_one_in_one_line(old, capsys):
    new = RENAMED[old]
    assert main([*new.split(), "--help"]) == 0
    reported = capsys.readouterr().out
    assert main([old, "--help"]) == 0
    done = capsys.readouterr()
    assert done.out == reported
    assert done.err == f"softmap: '{old}' is now '{new}'; the old name is gone after 0.1.0\n"


def test_help_alone_of_an_action_and_of_nothing(capsys):
    assert main(["help"]) == 0 and "usage: softmap COMMAND" in capsys.readouterr().out
    assert (
        main(["help", "servo", "scan"]) == 0
        and "usage: softmap servo scan" in capsys.readouterr().out
    )
    assert main(["help", "run", "cut"]) == 0 and "--block" in capsys.readouterr().out
    assert main(["help", "nothing"]) == 2 and "no command 'nothing'" in capsys.readouterr().err


@pytest.mark.parametrize("command", BUILTIN, ids=lambda command: command.name)
def test_options_are_a_frozen_dataclass_of_what_the_parser_declares(command):
    module = importlib.import_module(command.module)
    actions = [a for a in parser_of(command)._actions if isinstance(a, argparse._SubParsersAction)]
    pairs = [(parser_of(command), getattr(module, command.options, None))]
    if actions:
        pairs = [
            (parser, module.ACTIONS[name].options) for name, parser in actions[0].choices.items()
        ]
    for parser, options in pairs:
        assert options.__dataclass_params__.frozen
        assert {field.name for field in fields(options)} == {a.dest for a in parser._actions} - {
            "help"
        }


# --- a reader that leaves early -----------------------------------------------------------------
FILES = {
    "show": (["show", "run.npz"], None),
    "help": (["help"], None),
    "effects": (["model", "effects"], None),
    "check": (["check", "run.npz"], None),
    "compare": (["compare", "run.npz", "--bundle", "model", "--html", "page.html"], "page.html"),
    "diagnose": (
        ["diagnose", "run.npz", "--bundle", "model", "--effects", "offset", "--out", "d.json"],
        "d.json",
    ),
    "predict": (
        ["model", "predict", "run.npz", "--bundle", "model", "--out", "points.npz"],
        "points.npz",
    ),
    "learn": (["learn", "run.npz", "--static", "--out", "bundle"], "bundle/manifest.json"),
    "cut": (
        ["run", "cut", "run.npz", "--from", "0", "--to", "9", "--out", "piece.npz"],
        "piece.npz",
    ),
    "next": (["next", "--standard", "--out", "next.csv"], "next.csv"),
    "json": (
        ["compare", "run.npz", "--bundle", "model", "--json", "--html", "page.html"],
        "page.html",
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of an arm in ticks and its model."""
    place = tmp_path_factory.mktemp("pipes")
    arm(seconds=40.0).save(place / "run.npz")
    assert main(["learn", str(place / "run.npz"), "--static", "--out", str(place / "model")]) == 0
    return place


@pytest.mark.parametrize("both", [False, True], ids=["stdout", "both"])
@pytest.mark.parametrize(("argv", "file"), FILES.values(), ids=FILES)
def test_a_reader_that_leaves_early_costs_no_file(argv, file, both, folder):
    """The pipe is closed before the first word, and nothing is buffered: every print would
    break.
    """
    if file is not None:
        place = folder / Path(file).parts[0]
        shutil.rmtree(place, ignore_errors=True) if place.is_dir() else place.unlink(
            missing_ok=True
        )
    read, write = os.pipe()
    os.close(read)
    errors = write if both else subprocess.PIPE
    argv = [*argv, "--force"] if argv[0] in ("learn", "run") else argv
    code = "import sys; sys.modules['matplotlib'] = None  # pictures take a second\n"
    code += "from softmap_edge.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-u", "-c", code, *argv],
        cwd=folder,
        stdout=write,
        stderr=errors,
        timeout=300,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )
    os.close(write)
    assert done.returncode == 0, done.stderr
    assert both or b"Traceback" not in done.stderr and b"BrokenPipe" not in done.stderr
    assert file is None or (folder / file).stat().st_size > 100


def test_streams_that_outlive_their_reader_are_given_back():
    before = sys.stdout, sys.stderr
    with outliving():
        assert sys.stdout is not before[0] and sys.stdout.isatty() == before[0].isatty()
    assert (sys.stdout, sys.stderr) == before


# --- options that are read ----------------------------------------------------------------------
def modules_of(name, seen=None):
    """A module of commands, and those of commands and of the training package that it imports."""
    seen = {} if seen is None else seen
    if name in seen:
        return seen
    module = importlib.import_module(name)
    tree = ast.parse(inspect.getsource(module))
    seen[name] = tree
    for node in ast.walk(tree):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        for one in names:
            if one.startswith(("softmap_edge.commands", "softmap_training")):
                modules_of(one, seen)
    return seen


def read_in(trees):
    """The names that are read of an `args`: `args.x`."""
    read = set()
    for tree in trees:
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and isinstance(node.ctx, ast.Load)
            ):
                read |= (
                    {node.attr} if node.value.id in ("args", "arguments", "told", "a") else set()
                )
    return read


def unread(verb):
    """The arguments of a command that no code reads."""
    read = read_in(modules_of(verb.module).values())
    parsers = [parser_of(verb), *parsers_below(parser_of(verb))]
    found = {
        action.dest
        for parser in parsers
        for action in parser._actions
        if action.dest != argparse.SUPPRESS
    }
    return sorted(found - read - {"help"})


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_read(name):
    assert unread(COMMANDS[name]) == []


def test_an_option_that_is_not_read_would_be_found(monkeypatch):
    module = importlib.import_module("softmap_edge.commands.look")
    before = module.effects_arguments

    def more(parser):
        before(parser)
        parser.add_argument("--wobble")

    monkeypatch.setattr(module, "effects_arguments", more)
    assert unread(COMMANDS["model effects"]) == ["wobble"]


def test_a_diagnosis_draws_nothing_at_random_and_takes_no_seed(capsys, folder):
    assert (
        main(
            ["diagnose", str(folder / "run.npz"), "--bundle", str(folder / "model"), "--seed", "3"]
        )
        == 2
    )
    assert "unrecognized arguments: --seed" in capsys.readouterr().err
    argv = [
        "diagnose",
        str(folder / "run.npz"),
        "--bundle",
        str(folder / "model"),
        "--effects",
        "offset",
        "--json",
    ]
    assert main(argv) == 0
    assert '"seed"' not in capsys.readouterr().out
