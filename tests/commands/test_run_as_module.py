"""The package and its module of commands run as the `softmap` command does."""

import subprocess
import sys

import pytest

from softmap_edge.cli import main


@pytest.mark.parametrize(
    "argv", [["--version"], [], ["servo", "scn"], ["check", "none.npz"], ["help", "show"]]
)
@pytest.mark.parametrize("module", ["softmap_edge", "softmap_edge.cli"])
def test_a_module_prints_and_returns_what_the_command_does(module, argv, tmp_path, capsys):
    command = [sys.executable, "-m", module, *argv]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    code = main(argv)
    out, err = capsys.readouterr()
    assert (done.returncode, done.stdout, done.stderr) == (code, out, err)
    assert out + err and code == (0 if argv in (["--version"], ["help", "show"]) else 2)
