"""A doubt is settled: gravity or payload, seen in one orientation, cannot be distinguished; the
experiment that is suggested is recorded, and the right one of the two is identified. The truth is a
finger of its own: another mesh, another batch of silicone, its weights solved in the finite
elements; nothing of the effect library is in it.
"""

import json

import numpy as np
import pytest
from story_of_demo import FIRST, SECRETS

from softmap_edge import builtin_model, diagnose
from softmap_edge.cli import main
from softmap_edge.experiment.blocks import chosen, plan
from softmap_edge.experiment.choose import SETTLED
from softmap_edge.robot.drive.command_file import read_commands
from softmap_edge.run.protocol import Limits
from softmap_edge.synthetic.finger import HiddenEffect, Truth

pytestmark = pytest.mark.long  # test_next_experiment.py settles the same doubt with the model
MODEL = builtin_model()


@pytest.mark.parametrize("hidden", SECRETS)
def test_one_orientation_cannot_decide_and_the_next_experiment_does(hidden, tmp_path, capsys):
    twin = {"payload": "gravity", "gravity": "payload"}[hidden]
    truth = Truth(4, (HiddenEffect(SECRETS[hidden], 0.0),))
    run = truth.measure(plan(chosen(FIRST), Limits.of(MODEL.command_range)))
    assert np.ptp(run.gravity, axis=0).max() == 0.0
    doubt = diagnose(MODEL, run)
    named = {e.name for e in doubt.effects}
    assert doubt.verdict == "ambiguous" and len(named & {"gravity", "payload"}) == 1
    other = ({"gravity", "payload"} - named).pop()
    assert any(
        set(rival.effects) == named - {"gravity", "payload"} | {other}
        for rival in doubt.alternatives
    )

    run.save(tmp_path / "old.npz")
    (tmp_path / "before.json").write_text(json.dumps(doubt.to_dict()))
    argv = [
        "next",
        str(tmp_path / "before.json"),
        "--run",
        str(tmp_path / "old.npz"),
        "--minutes",
        "0.1",
    ]
    assert main([*argv, "--out", str(tmp_path / "c.csv"), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["next"][0]["block"] == "another orientation" == reported["blocks"][0]
    assert (
        set(reported["next"][0]["settles"]) >= {"gravity", "payload"}
        and reported["next"][0]["separation"] > 2 * SETTLED
    )

    new = truth.measure(read_commands(tmp_path / "c.csv")[0], seed=1)
    settled = diagnose(MODEL, [run, new])
    assert [e.name for e in settled.effects][:1] == [hidden], settled.sentence
    rivals = {name for rival in settled.alternatives for name in rival.effects}
    assert settled.verdict == "identified" and twin not in rivals, settled.sentence
    (tmp_path / "after.json").write_text(json.dumps(settled.to_dict()))
    assert (
        main(["next", str(tmp_path / "after.json"), "--since", str(tmp_path / "before.json")]) == 0
    )
    assert (
        "Settled" in (said := capsys.readouterr().out)
        and f"Now       {hidden} (identified)" in said
    )
