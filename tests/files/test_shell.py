"""Printed commands can be pasted: a shell gives back the file's name."""

import subprocess
from types import SimpleNamespace

import pytest

from softmap_edge.commands.output import next_command, with_files
from softmap_edge.files.printable import shell_file, shell_word

NAMES = [
    *("-x.npz", "--json", "-8,3.npz", "-"),
    *("my run.npz", "it's.npz", 'a"b".npz', "$HOME.npz", "a`b`.npz", "tail\\", "*.npz", ""),
    *("line\nend", "tab\t", "\x1b[31m", "\u202egnp", "零件.npz", "it's\na \\ and '", "\udcff.npz"),
]


def pasted(line):
    """Return the arguments that bash makes of a line."""
    found = subprocess.run(
        ["bash", "-c", f"printf '%s\\0' {line}"], capture_output=True, check=True
    ).stdout
    return found.decode("utf-8", "surrogateescape").split("\0")[:-1]


@pytest.mark.parametrize("name", NAMES)
def test_a_shell_gives_back_the_name(name):
    assert pasted(shell_word(name)) == [name]
    assert pasted(shell_file(name)) == [f"./{name}" if name.startswith("-") else name]
    assert shell_file(name).isprintable()


@pytest.mark.parametrize("name", NAMES)
def test_the_next_command_can_be_pasted(name):
    name = f"./{name}" if name.startswith("--") else name  # the only form that a parser takes
    line = next_command("learn", name, "--out", name, bundle=name).removeprefix("next: ")
    file = f"./{name}" if name.startswith("-") else name
    assert pasted(line) == ["softmap", "learn", file, "--out", file, "--bundle", file]


@pytest.mark.parametrize("name", ["-r.toml", "my rig.toml", "it's.toml"])
def test_a_remedy_names_the_rig_as_it_can_be_typed(name):
    text = with_files("servo 1 is lost; `softmap servo scan --rig FILE`", SimpleNamespace(rig=name))
    assert f"--rig {shell_file(name)}`" in text
