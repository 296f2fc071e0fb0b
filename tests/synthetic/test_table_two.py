"""The paper's Table II on few waypoints: one sequence on both fingers, an alternative, effects
compensated; the workspace.
"""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from softmap_edge import SoftmapError, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.shapes import Grid
from softmap_edge.synthetic.table_two import (
    ALTERNATIVE,
    COMPENSATED,
    LETTERS,
    OURS,
    PUBLISHED_ERRORS,
    table_two,
    text_of,
)
from softmap_edge.synthetic.virtual_finger import virtual_finger

FEW = {"figures": ["O"], "rate": 1.0, "duration": 6.0}


@pytest.fixture(scope="module")
def model():
    return builtin_model()


def worse(model):
    """Return an alternative that bends a tenth too little: its commands lead too far."""
    shape = model.arrays.prior.shape
    shape = replace(shape, over=Grid(tuple(1.1 * axis for axis in shape.over.axes)))
    return replace(
        model.with_structure(prior=shape.compiled(), fields={}, cables=None, second=None),
        arrays=replace(model.arrays, prior=replace(model.arrays.prior, shape=shape)),
    )


def test_ours_an_alternative_and_the_papers_figures_stand_next_to_each_other(model):
    reported = []
    rows = {
        row.model: row
        for row in table_two(
            model, worse(model), progress=lambda name, _: reported.append(name), **FEW
        )
    }
    assert set(rows) == {OURS, ALTERNATIVE} and reported == ["O, ours", "O, rival"]
    ours, other = rows[OURS], rows[ALTERNATIVE]
    assert len(ours.simulator) == len(ours.stand_in) == 7 and ours.unreachable < 1e-3
    # each believes that it is there
    assert ours.expected.max() < 0.01 and other.expected.max() < 0.01
    assert ours.simulator.mean() < 0.3 < 0.5 < other.simulator.mean() < 1.5  # a tenth of 8 mm
    # what the stand-in has and the model lacks
    assert ours.stand_in.mean() > 2 * ours.simulator.mean()
    document = ours.to_dict()
    assert document["paper"]["simulation_mm"] == {"mean": 1.184, "sd": 0.182, "max": 1.499}
    assert document["paper"]["on"] == "other data" and document["simulator_mm"]["n"] == 7
    assert len(PUBLISHED_ERRORS) == 8


def test_one_solved_sequence_is_replayed_on_both(model, monkeypatch):
    from softmap_edge.synthetic import table_two as module

    sent = {}
    path = Simulator.path
    monkeypatch.setattr(
        Simulator,
        "path",
        lambda self, u, *a, **k: sent.setdefault("sim", (u, path(self, u, *a, **k)))[1],
    )
    monkeypatch.setattr(
        module.VirtualFinger,
        "shapes",
        lambda self, p: sent.setdefault("stood", (p, np.zeros((len(p.t_seen), 548, 3))))[1],
    )
    table_two(model, None, **FEW)
    commands, protocol = sent["sim"][0], sent["stood"][0]
    at = np.searchsorted(protocol.t, protocol.t_seen)
    # To half a tick: 0.002 mm.
    np.testing.assert_allclose(protocol.command[at], commands, atol=3e-3)
    assert np.ptp(commands, axis=0).min() > 1.0


def test_effects_that_the_stand_in_has_are_compensated(model):
    """Its turned tendons and friction, as far as two effects of the library stand for them
    (docs/do/training.md, 5).
    """
    turn = virtual_finger(1).phase_deg
    params = {"routing.phase[0]": turn, "routing.phase[1]": turn}
    params |= {"hysteresis.strength": 0.11, "hysteresis.reach": 4.3, "hysteresis.shape": 0.7}
    rows = {
        row.model: row
        for row in table_two(model.with_effects(["hysteresis", "routing"], params), None, **FEW)
    }
    assert set(rows) == {OURS, COMPENSATED} and rows[COMPENSATED].to_dict()["paper"] is None
    assert rows[COMPENSATED].stand_in.mean() < 0.6 * rows[OURS].stand_in.mean()
    # which has none of them
    assert rows[COMPENSATED].simulator.mean() > 2 * rows[OURS].simulator.mean()


@pytest.mark.long
def test_the_command_prints_the_table_and_the_document_says_the_same(
    model, tmp_path, monkeypatch, capsys
):
    """Two of the four letters show it."""
    assert tuple("SHOE") == LETTERS
    two = partial(table_two, figures="SO")
    monkeypatch.setattr("softmap_edge.commands.track.table_two", two)
    save_bundle(worse(model), tmp_path / "rival")
    options = [
        "--table",
        "--rival",
        str(tmp_path / "rival"),
        "--rate",
        "1",
        "--duration",
        "2",
        "--json",
    ]
    assert main(["track", *options]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.table2/1" and document["method"] == "paper"
    assert [(row["figure"], row["model"]) for row in document["rows"]] == [
        (f, m) for f in "SO" for m in (OURS, ALTERNATIVE)
    ]
    text = text_of(document)
    assert "paper: hardware" in text and "3.46 ± 2.98, 15.38" in text and "no hardware" in text
    assert "The paper's columns are of other data" in text and len(text.splitlines()) >= 7


def test_a_model_of_another_finger_is_refused(model):
    with pytest.raises(SoftmapError, match="'other', 2 commands; the table is of"):
        table_two(replace(model, robot="other"), None, **FEW)


@pytest.mark.parametrize(
    "options, said",
    [
        (["S", "--table"], "without one"),
        (["--plan"], "name a figure"),
        (["S", "--plan", "--rival", "b"], "--alternative goes with --table"),
        (["S", "--plan", "--reach", "1", "2", "3"], "--reach with --workspace"),
    ],
)
def test_what_does_not_go_together_is_refused(options, said, capsys):
    assert main(["track", *options]) == 2
    assert said in capsys.readouterr().err


def test_the_workspace_says_what_is_in_it_and_how_far_another_point_is(model, tmp_path, capsys):
    picture = tmp_path / "w.svg"
    argv = ["track", "--workspace", "--json"]
    assert main([*argv, "--reach", "60", "0", "60", "--picture", str(picture)]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["schema"] == "softmap.workspace/1" and reported["axes"] == "xyz"
    target = reported["target"]
    apart = np.linalg.norm(np.subtract(target["target_mm"], target["nearest_mm"]))
    assert (
        not target["reached"]
        and target["distance_mm"] == pytest.approx(apart, abs=1e-6)
        and apart > 10
    )
    assert picture.read_bytes().startswith(b"<?xml")
    there = model.tip(np.array([[4.0, -2.0]]))[0]
    assert main([*argv, "--reach", *map(str, there)]) == 0
    target = json.loads(capsys.readouterr().out)["target"]
    assert target["reached"]
    np.testing.assert_allclose(target["acting_mm"], [4.0, -2.0], atol=1e-3)
    assert main(["track", "--workspace", "--reach", "60", "0", "60"]) == 0
    assert "out of reach by" in capsys.readouterr().out
