"""docs/do/training.md as its reader runs it, on fewer commands and for fewer epochs."""

from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines

pytest.importorskip("torch")

from softmap_edge import Run, load_bundle
from softmap_edge.cli import main

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parents[2] / "docs/do/training.md").read_text(encoding="utf-8")
SHORTER = {
    "sweep": ["--steps", "15"],
    "train prior": ["--epochs", "600"],
    "train residual": ["--epochs", "40"],
    "next --protocol grid --seed 1": ["--protocol", "validation"],
    "next --protocol paths": ["--protocol", "validation"],
    "evaluate": ["--model", "table", "linear", "--seeds", "1", "--epochs", "2"],
}


def test_every_command_works_and_both_errors_fall(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for language, text in blocks(PAGE):
        # minutes; tests/adaptation/test_adaptation.py runs it on fewer frames
        if language == "text":
            continue
        for words in lines(text):
            more = next(
                (more for verb, more in SHORTER.items() if " ".join(words[1:]).startswith(verb)), []
            )
            assert words[0] == "softmap" and main([*words[1:], *more]) == 0, words
    prior = load_bundle("prior")
    assert prior.kind == "network" and prior.made_from["prior"]["test_vertex_mm"] < 0.7
    run, truth = Run.load("grid.npz"), np.load("grid_truth.npz")["vertices"]
    assert run.vertices is None and run.command is None  # nothing of the truth is in it
    off = [
        np.linalg.norm(load_bundle(name).predict(run) - truth, axis=2).mean()
        for name in ("calibrated", "corrected")
    ]
    assert off[1] < 0.8 * off[0], off
    assert (
        main(
            ["train", "prior", "sim.zarr", "--model", "gp", "--bundle", "calibrated", "--out", "gp"]
        )
        == 0
    )
    assert load_bundle("gp").kind == "table" and load_bundle("gp").calibration is not None
    assert (
        main(["train", "prior", "sim.zarr", "--model", "deepsoro", "--epochs", "1", "--out", "d"])
        == 0
    )
    assert (
        load_bundle("d", trust_onnx=True).made_from["through_onnxruntime"]["prior"]["table_off_mm"]
        < 0.2
    )
