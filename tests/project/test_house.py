"""The package: what an import loads, and how the command answers."""

import importlib
import os
import pkgutil
import subprocess
import sys
from inspect import signature
from pathlib import Path

import pytest

import softmap_edge
from softmap_edge.cli import main
from softmap_edge.model.structure import Structure, StructureFields
from softmap_edge.rod.learn import LearnOptions, learn, learn_model
from softmap_edge.run.fields import RecordedFields
from softmap_edge.run.run import Run


def test_import_loads_numpy_and_the_core_only():
    code = (
        "import sys; before=set(sys.modules); import softmap_edge; "
        "print(sorted({m.split('.')[0] for m in set(sys.modules)-before}))"
    )
    loaded = eval(
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
    )
    extras = {
        "matplotlib",
        "meshio",
        "cv2",
        "mediapipe",
        "torch",
        "scipy",
        "onnxruntime",
        "viser",
        "plotly",
    }
    assert not extras & set(loaded)
    assert "softmap_edge" in loaded


def test_the_command_sets_the_threads_of_blas_before_numpy_is_loaded():
    code = (
        "import os, sys; from softmap_edge.cli import main; assert 'numpy' not in sys.modules; "
        "main(['--version']); assert os.environ['OPENBLAS_NUM_THREADS'] == '1'"
    )
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def test_every_public_name_is_there_and_named_once():
    assert set(softmap_edge.__all__) <= set(dir(softmap_edge))
    for name, home in softmap_edge._HOMES.items():
        value = getattr(softmap_edge, name)
        assert value is getattr(importlib.import_module(home), name)
        assert value.__doc__, name
    # A module of the same name would stand in for the public name as soon as anything imports it.
    assert not {m.name for m in pkgutil.iter_modules(softmap_edge.__path__)} & set(
        softmap_edge.__all__
    )


def test_public_names_are_loaded_late_and_unknown_ones_are_reported():
    code = (
        "import sys, softmap_edge; assert 'softmap_edge.run.run' not in sys.modules; "
        "from softmap_edge import Run; assert Run is sys.modules['softmap_edge.run.run'].Run; "
        "assert 'softmap_edge.diagnosis.diagnose' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'; there are .*compare"):
        softmap_edge.nonsense  # noqa: B018


def test_typed_keyword_arguments_are_those_of_what_takes_them():
    run = set(signature(Run).parameters)
    places = {"vertices", "points", "start", "marker_rest", "frame", "frame_sigma", "cameras"}
    taken = run - places - {"t_seen", "markers", "output"}
    assert set(RecordedFields.__annotations__) == taken
    assert set(StructureFields.__annotations__) == set(signature(Structure).parameters)
    named = set(signature(learn).parameters) & set(signature(learn_model).parameters)
    assert set(LearnOptions.__annotations__) == set(signature(learn).parameters) - named


LONGEST = 600  # lines: a longer file rarely holds one idea


def test_no_file_is_longer_than_a_reader_can_hold_in_mind():
    root = Path(__file__).parents[2]
    folders = ("softmap_edge", "training", "benches", "docs", "tests", "examples")
    files = [file for folder in folders for file in sorted((root / folder).rglob("*.py"))]
    assert len(files) > 300
    counts = {
        str(file.relative_to(root)): len(file.read_text(encoding="utf-8").splitlines())
        for file in files
    }
    long = {name: count for name, count in counts.items() if count > LONGEST}
    assert not long, f"split by concept: {long}"


@pytest.mark.parametrize(
    "argv",
    [
        ["track", "S", "--sim"],
        ["teleop", "--sim"],
        ["record", "c.csv", "--emulated", "--out", "run.npz"],
    ],
)
def test_a_recording_is_never_written_over(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("old.mcap").write_bytes(b"kept")
    assert main([*argv, "--record", "old.mcap"]) == 2
    assert "--record old.mcap: it exists; give another name" in capsys.readouterr().err
    assert Path("old.mcap").read_bytes() == b"kept"


@pytest.mark.parametrize(
    ("argv", "code"), [(["--version"], 0), (["--help"], 0), ([], 2), (["nonsense"], 2)]
)
def test_exit_codes(argv, code, capsys):
    assert main(argv) == code


def test_absent_command_says_what_to_install(capsys, monkeypatch):
    # as where softmap-training is not installed
    monkeypatch.setattr("softmap_edge.cli.entry_points", lambda group: [])
    assert main(["train"]) == 2
    assert "pip install" in capsys.readouterr().err
