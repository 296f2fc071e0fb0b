"""The next experiment: the block that an engineer would pick is ranked first, in time, and it
settles what was open.

Runs are predictions of the built-in finger's model with effects of the library and camera noise,
which is what is simulated; that it holds for a finger that was not written with the library's forms
is `test_story.py`'s to show.
"""

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from played_blocks import LIMITS, MODEL, document, played

from softmap_edge import _core, diagnose, next_experiment, save_bundle
from softmap_edge.cli import main
from softmap_edge.diagnosis.findings import Alternative, Untestable
from softmap_edge.diagnosis.separate import next_blocks
from softmap_edge.errors import SoftmapError
from softmap_edge.experiment.blocks import BLOCKS, chosen, plan
from softmap_edge.experiment.choose import SETTLED, program
from softmap_edge.model.effect_info import registry
from softmap_edge.robot.drive.command_file import read_commands
from softmap_edge.run.protocol import Protocol

UPRIGHT = [name for name, block in BLOCKS.items() if block.changes == "nothing"]


def grid(frames=60, dwell=10.0):
    """Places that are seen long after each move: nothing of a delay is left."""
    t = np.arange(0.0, frames * dwell, 0.1)
    places = np.random.default_rng(1).uniform(-8, 8, size=(frames, 2))
    u = np.repeat(places, round(dwell * 10), axis=0)
    seen = np.arange(frames) * dwell + dwell - 0.5
    return Protocol(
        "grid", t, u, np.tile([0.0, 0.0, 1.0], (t.size, 1)), seen, np.full(frames, "grid")
    )


@pytest.fixture(scope="module")
def ambiguous():
    run = played(plan(chosen(UPRIGHT), LIMITS), {"payload.mass": 9.0})
    return run, diagnose(MODEL, run)


def test_payload_or_gravity_is_settled_by_another_orientation(ambiguous):
    run, found = ambiguous
    assert found.verdict == "ambiguous" and found.alternatives
    best = next_experiment(MODEL, found, [run])[0]
    assert best.block == "another orientation"
    assert best.settles == ["payload", "gravity", "stiffness"]  # a softer body sags where it leans
    assert best.separation > 10 * SETTLED and best.minutes < 1.0
    assert best.to_dict() == {
        "block": best.block, "minutes": round(best.minutes, 2), "settles": best.settles,
        "separation": float(f"{best.separation:.4g}"),
    }  # fmt: skip
    again = diagnose(MODEL, [run, played(best.plan, {"payload.mass": 9.0}, seed=1)])
    assert (again.verdict, [e.name for e in again.effects], again.alternatives) == (
        "identified",
        ["payload"],
        (),
    )
    # As much of the same moves in the same orientation leaves it open.
    same = diagnose(
        MODEL,
        [run, played(BLOCKS["triangles of growing size"].plan(LIMITS), {"payload.mass": 9.0}, 1)],
    )
    assert same.verdict == "ambiguous"


PICKS = [
    ({"latency.delay": 0.1}, "lag", "fast and slow triangles"),
    ({"creep.strength": 0.1, "creep.tau": 8.0}, "lag", "fast and slow triangles"),
    ({"backlash.gap": 0.8}, "hysteresis", "triangles of growing size"),
    ({"offset.shift[0]": 0.8, "offset.shift[1]": -0.8}, "mount", "levels of both signs"),
]


@pytest.mark.parametrize(
    ("hidden", "other", "picked"), PICKS, ids=[pick[1] + " or other" for pick in PICKS]
)
def test_the_block_that_an_engineer_would_pick(hidden, other, picked):
    name = next(iter(hidden)).split(".")[0]
    run = played(BLOCKS["circle"].plan(LIMITS), hidden)
    stated = {label: {"value": v, "sigma": 0.1, "unit": "1"} for label, v in hidden.items()}
    found = document(
        effects=[{"name": name, "params": stated}],
        alternatives=[{"effects": [other], "why": "for the test"}],
    )
    best = next_experiment(MODEL, found, [run])[0]
    assert best.block == picked and best.settles == [name, other]


def test_what_a_grid_cannot_show_is_shown_by_a_fast_triangle():
    run = played(grid())
    found = diagnose(MODEL, run)
    hidden = {row.name for row in found.not_testable}
    assert {"latency", "lag"} <= hidden
    ranked = next_experiment(MODEL, found, [run])
    assert ranked[0].block == "fast and slow triangles" and {"latency", "lag"} <= set(
        ranked[0].settles
    )
    assert [e.separation is None for e in ranked] == sorted(e.separation is None for e in ranked)
    # Scored for itself, without the run, the same block is best.
    assert next_experiment(MODEL, found, [])[0].block == ranked[0].block
    # Recorded, they are testable.
    again = diagnose(MODEL, [run, played(ranked[0].plan, seed=1)])
    assert not {row.name for row in again.not_testable} & set(ranked[0].settles)


def test_what_no_block_settles_is_left_to_what_the_library_says():
    found = document(
        effects=[{"name": "offset", "params": {}}],
        alternatives=[{"effects": ["offset", "mount"], "why": ""}],
    )
    ranked = next_experiment(MODEL, found, [played(plan(chosen(UPRIGHT), LIMITS))])
    open_ones = [e for e in ranked if e.plan is None]
    assert all(e.separation is None and e.settles for e in open_ones)
    assert next_experiment(MODEL, document(), []) == []


def test_an_alternative_that_the_model_cannot_express_is_left_to_the_library():
    poor = MODEL.with_structure(
        fields={n: f for n, f in MODEL.fields.items() if not n.startswith("curve")}
    )
    found = document(
        effects=[{"name": "offset", "params": {}}],
        alternatives=[{"effects": ["pre_curve"], "why": ""}],
    )
    ranked = next_experiment(poor, found, [played(plan(chosen(UPRIGHT), LIMITS))])
    assert (
        ranked
        and all(e.plan is None for e in ranked)
        and {n for e in ranked for n in e.settles} >= {"pre_curve"}
    )


def test_every_effect_of_the_library_can_be_asked_for():
    """Also those that this model has no field for, and those that need what no block declares."""
    names = [e["name"] for e in _core.effects()]
    hidden = [{"name": name, "why": "", "experiment": ""} for name in names]
    ranked = next_experiment(MODEL, document(not_testable=hidden), [])
    assert {name for e in ranked for name in e.settles} == set(names)
    assert not {name for name in names if MODEL.missing_for(name)} & {
        n for e in ranked if e.plan for n in e.settles
    }


def test_blocks_are_taken_until_all_is_settled_or_time_is_up(ambiguous):
    run, found = ambiguous
    also = tuple(Untestable(name) for name in ("latency", "creep"))
    ranked = next_experiment(MODEL, replace(found, not_testable=also), [run])
    taken = program(ranked, 6.0)
    assert taken[0].block == ranked[0].block == "another orientation"
    settled = {name for e in taken for name in e.settles}
    assert settled == {name for e in ranked if e.plan for name in e.settles}
    assert len(program(ranked, 0.1)) == 1 and program([], 6.0) == []


def test_two_alternatives_and_ten_unseen_effects_take_seconds(ambiguous):
    run, found = ambiguous
    others = [n for n in found.made_from["candidates"] if n not in ("gravity", "payload")]
    everything = replace(found, not_testable=tuple(Untestable(n) for n in others[:10]))
    start = time.process_time()
    next_experiment(MODEL, everything, [run])
    assert time.process_time() - start < 20.0


def test_a_diagnosis_of_something_else_is_refused(ambiguous):
    run, found = ambiguous
    with pytest.raises(SoftmapError, match="made from other runs than the 1 given"):
        next_experiment(MODEL, found, [played(BLOCKS["circle"].plan(LIMITS))])
    with pytest.raises(SoftmapError, match="of a model with no effects, this one has payload"):
        next_experiment(MODEL.with_effects(["payload"], {"payload.mass": 9.0}), found, [run])
    with pytest.raises(SoftmapError, match="names 'wobble', which this library lacks"):
        next_experiment(MODEL, document(not_testable=[{"name": "wobble"}]), [])


# --- the command ----------------------------------------------------------------------------------


def test_next_writes_what_to_record_and_says_what_it_settles(ambiguous, tmp_path, capsys):
    run, found = ambiguous
    run.save(tmp_path / "old.npz")
    (tmp_path / "d.json").write_text(json.dumps(found.to_dict()))
    argv = [
        "next",
        str(tmp_path / "d.json"),
        "--run",
        str(tmp_path / "old.npz"),
        "--out",
        str(tmp_path / "c.csv"),
    ]
    assert main(argv) == 0
    reported = capsys.readouterr().out
    assert "Open      payload (ambiguous); alternatives: gravity" in reported
    assert reported.endswith(f"next: softmap record {tmp_path / 'c.csv'} --sim --out new.npz\n")
    assert (
        "another orientation (0.6 min): settles payload, gravity, stiffness; separation" in reported
    )
    assert "turn the robot until gravity points along 0.52 0.24 0.82" in reported
    made, robot = read_commands(tmp_path / "c.csv")
    assert robot == MODEL.robot and made.minutes < 6.0 and np.ptp(made.gravity[:, 0]) > 0.5
    assert main([*argv, "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["schema"] == "softmap.next/1" and listed["settles"][:2] == ["payload", "gravity"]
    assert listed["next"][0].keys() == {"block", "minutes", "settles", "separation"}
    assert listed["next"][0]["separation"] > SETTLED
    # With the new run the same command shows what has been settled.
    new = played(made, {"payload.mass": 9.0}, seed=1)
    (tmp_path / "d2.json").write_text(json.dumps(diagnose(MODEL, [run, new]).to_dict()))
    assert main(["next", str(tmp_path / "d2.json"), "--since", str(tmp_path / "d.json")]) == 0
    reported = capsys.readouterr().out
    assert "Before    payload (ambiguous); alternatives: gravity" in reported
    assert (
        "Now       payload (identified); alternatives: none" in reported
        and "Settled   gravity" in reported
    )


def test_what_is_named_next_to_an_alternative_is_not_open():
    """An alternative holds the rest of what is named too: only the member and its substitute are
    to be settled.
    """
    other = Alternative(("gain", "latency"), "", "lag")
    known = registry()
    (block,) = next_blocks([other], [], known, ["gain", "lag"])
    assert block.settles == ("lag", "latency") and block.block == known["lag"].experiment[0]


def test_only_the_built_in_robot_is_played_on_the_simulated_finger(tmp_path, capsys):
    save_bundle(replace(MODEL, robot="arm"), tmp_path / "arm")
    argv = ["next", "--standard", "--out", str(tmp_path / "c.csv"), "--bundle"]
    assert main([*argv, str(tmp_path / "arm")]) == 0
    reported = capsys.readouterr().out
    assert reported.endswith("c.csv --rig rig.toml --out new.npz\n") and "--sim" not in reported
    save_bundle(MODEL, tmp_path / "ours")
    assert main([*argv, str(tmp_path / "ours")]) == 0
    after = f"--sim --out new.npz --bundle {tmp_path / 'ours'}\n"
    assert capsys.readouterr().out.endswith(after)


def test_next_writes_the_standard_protocol_and_blocks_by_name(tmp_path, capsys):
    assert main(["next", "--standard", "--fastest", "20", "--out", str(tmp_path / "c.csv")]) == 0
    made, _ = read_commands(tmp_path / "c.csv")
    assert "standard protocol" in capsys.readouterr().out and 5.0 < made.minutes < 7.0
    assert np.abs(np.diff(made.command, axis=0)).max() <= 20 / 50 * 1.01
    assert main(["next", "--block", "circle", "--out", str(tmp_path / "c.csv")]) == 0
    assert set(read_commands(tmp_path / "c.csv")[0].block) == {"home", "circle"}
    capsys.readouterr()
    for argv, reported in (
        (["next"], "no diagnosis is given"),
        (["next", "--block", "wave"], "no block 'wave'"),
        (["next", "--standard", "--minutes", "0"], "give a time above 0"),
        (["next", "--standard", "--block", "circle"], "two protocols"),
        (["next", "--standard", "--out", "c.txt"], "saved as .csv"),
        (["next", "--standard", "--fastest", "-3"], "fastest speed of -3"),
        (["next", str(tmp_path / "c.csv")], "is not JSON"),
    ):
        assert main(argv) == 2
        assert reported in (said := capsys.readouterr().err) and said.count("\n") == 1
