"""The house itself: what an import loads, and how the command answers."""

import subprocess
import sys

import pytest

from softmap_edge.cli import main


def test_import_loads_numpy_and_the_core_only():
    code = (
        "import sys; before=set(sys.modules); import softmap_edge; "
        "print(sorted({m.split('.')[0] for m in set(sys.modules)-before}))"
    )
    loaded = eval(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
    extras = {"matplotlib", "meshio", "cv2", "mediapipe", "torch", "scipy", "onnxruntime", "viser", "plotly"}
    assert not extras & set(loaded)
    assert "softmap_edge" in loaded


@pytest.mark.parametrize(("argv", "code"), [(["--version"], 0), (["--help"], 0), ([], 2), (["nonsense"], 2)])
def test_exit_codes(argv, code, capsys):
    assert main(argv) == code


def test_absent_verb_says_what_to_install(capsys):
    assert main(["train"]) == 2
    assert "pip install" in capsys.readouterr().err
