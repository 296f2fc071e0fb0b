"""Gravity or a load that a run declares wrongly is a fault of the declaration, and no physics is
named instead.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from diagnosed_runs import diagnosed, scaled, written
from finger_runs import finger_run

from softmap_edge import builtin_model, diagnose
from softmap_edge.cli import main
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.synthetic.finger import hide


@pytest.mark.long
@pytest.mark.parametrize(("hangs", "fits"), [(0.0, "no load at all fits"), (10.0, "10")])
def test_a_load_that_is_declared_wrongly_is_no_physics(hangs, fits):
    run = finger_run()
    bare = replace(run, load=np.full(len(run.t), hangs))
    seen = builtin_model().predict(bare) + run.vertices - builtin_model().predict(run)
    wrong = replace(run, vertices=seen, load=np.full(len(run.t), 25.0))
    found = diagnose(builtin_model(), wrong)
    assert found.verdict == "measurement_fault" and found.effects == (), found.sentence
    assert "`load` is declared as up to 25 g" in found.sentence and fits in found.sentence
    right = diagnose(builtin_model(), replace(wrong, load=bare.load))
    assert right.verdict == "nothing", right.sentence


def test_gravity_upside_down_is_refused(tmp_path, capsys):
    code, _, said = diagnosed(written(tmp_path, scaled("gravity", -1.0), False), capsys)
    assert code == 2 and "declared upside down" in said


SIGNS = {"upside down": [-1.0, -1.0, -1.0], "with the wrong sign of its z": [1.0, 1.0, -1.0]}
ONE_AXIS = pytest.param("with the wrong sign of its z", marks=pytest.mark.long)


@pytest.mark.parametrize("words", ["upside down", ONE_AXIS])
def test_gravity_of_a_wrong_sign_next_to_a_weight_is_a_fault_of_the_declaration(
    words, tmp_path, capsys
):
    """The weight hides the sign from a first look; the gravity that would be needed, and the
    search, show it.
    """
    run = finger_run(["payload"], {"payload.mass": 20.0})
    replace(run, gravity=run.gravity * SIGNS[words]).save(tmp_path / "run.npz")
    argv = ["--effects", "offset,gravity,payload,mount", "--json"]
    assert main(["diagnose", str(tmp_path / "run.npz"), *argv]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (
        document["verdict"] == "measurement_fault"
        and document["effects"] == []
        and document["alternatives"] == []
    )
    assert (
        f"`gravity` is declared {words}" in document["sentence"]
        and "both held out" in document["sentence"]
    )
    run.save(tmp_path / "run.npz")
    assert main(["diagnose", str(tmp_path / "run.npz"), *argv]) == 0
    assert [entry["name"] for entry in json.loads(capsys.readouterr().out)["effects"]] == [
        "payload"
    ]


@pytest.mark.prove
@pytest.mark.parametrize(
    "names", [["payload"], ["hysteresis"], ["payload", "creep"], ["gravity"]], ids="+".join
)
def test_gravity_upside_down_next_to_what_is_hidden(names):
    whole = standard_protocol(2)
    run = hide(names, 1).measure(replace(whole, t_seen=whole.t_seen[::2], block=whole.block[::2]))
    found = diagnose(builtin_model(), replace(run, gravity=-run.gravity))
    assert (
        found.verdict == "measurement_fault"
        and "`gravity` is declared upside down" in found.sentence
    )
