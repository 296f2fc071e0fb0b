"""The bank is what it says: laws that vanish at strength zero, cases that are pure, a score, a
slice that is run.

`test_bank_rod.py` holds the rod itself. The fixed slice at the end is that of development seeds;
the full bank is `make bank`.
"""

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benches.bank import judge
from benches.bank.__main__ import SHARES, SIZES, SLICES, main, tasks
from benches.bank.bodies import body_of
from benches.bank.body_rod import guessed, hanging, template
from benches.bank.body_solid import interpolation_mm
from benches.bank.case import (
    GROSS,
    LAWS,
    SEEDS,
    at_rest,
    case,
    judge_protocol,
    protocol_of,
    seen,
    standard_protocol,
)
from benches.bank.clouds import registered, thinned
from benches.bank.law import Record
from benches.bank.laws_body import BoucWen, OgdenRoxburgh, Prony
from benches.bank.laws_drive import CableCreep, DahlElements, Gear, Loop, Motor, Stops
from benches.bank.laws_unknown import UNKNOWN
from benches.bank.model_rod import changes
from benches.bank.rod import Loads, settle
from benches.bank.section import finger
from benches.bank.store import keep
from benches.bank.watch import LEVELS, looked, rms, sections
from benches.bank.work import kept, make, work
from softmap_edge import _core
from softmap_edge.run.run import Run

BANK = Path(judge.__file__).parent
T = np.arange(0.0, 30.0, 0.02)
EVERY = {**LAWS, **UNKNOWN}
PARTS = ("young", "rest", "guide", "cable", "slack", "torn")
# mm that remain without strength: packets still come late by their jitter, the motor has its loop,
# horns their steps
LEFT = {"latency": 0.8, "rate_limit": 0.2, "saturation": 0.1, "offset": 0.004, "backlash": 0.1}


def record(u):
    u = np.asarray(u, float)
    return Record(T, u, 22.0 + 9.0 * T / T[-1])


def wave():
    return np.stack([11.0 * np.sin(1.8 * T) * T / T[-1], 11.0 * np.sin(1.3 * T + 1.0)], axis=1)


@pytest.mark.parametrize("name", [name for name in EVERY if name not in GROSS])
def test_a_law_of_no_strength_does_nothing_and_one_of_some_does(name):
    law = EVERY[name].draw(np.random.default_rng(1), 2)
    plain, u, design = record(wave()), wave(), finger(1)
    pull = np.concatenate([u, -u], axis=1)[::100]
    points = np.random.default_rng(2).normal(size=(len(pull), 5, 3)) * 30.0
    loads = Loads(pull, np.tile([0.0, 0.6, 0.8], (len(pull), 1)), np.zeros((len(pull), 3)))
    poses = settle(design, loads.rows(np.arange(2))) if name == "magnet" else None
    loads = loads.rows(np.arange(2)) if name == "magnet" else loads

    def acts(law):
        both = law.pull(plain, np.concatenate([law.drive(plain, u), -law.drive(plain, u)], axis=1))
        made, acting = law.design(design), law.loads(loads, poses)
        far = 0.0 if acting.plane is None else max(0.0, 45.0 - acting.plane[1])
        return np.array(
            [
                np.abs(both - np.concatenate([u, -u], axis=1)).max(),
                *(
                    np.abs(np.asarray(getattr(made, part)) - getattr(design, part)).max()
                    for part in PARTS
                ),
                np.abs(acting.gravity - loads.gravity).max(),
                np.abs(acting.tip - loads.tip).max(),
                far,
                np.abs(law.seen(points, T[::100]) - points).max(),
                np.abs(law.clock(T) - T).max(),
            ]
        )

    some, none = acts(law.scaled(2.0)).max(), acts(law.scaled(1e-9)).max()
    assert none < LEFT.get(name, 1e-6) and some > 1.5 * LEFT.get(name, 2e-4)


@pytest.mark.parametrize("name", list(EVERY))
def test_memory_starts_in_equilibrium_with_the_first_command(name):
    law = EVERY[name].draw(np.random.default_rng(1), 2)
    still = record(np.tile([5.0, -3.0], (len(T), 1)))
    room = Record(T, still.u, np.full(len(T), 22.0))
    out = law.pull(room, np.concatenate([law.drive(room, room.u)] * 2, axis=1) * [1, 1, -1, -1])
    if name not in ("anchor_slip", "frayed_cable"):  # a cable that is held taut lets go on purpose
        assert np.abs(out - out[0]).max() < 1e-9


def test_laws_are_what_their_formulas_say():
    ramp = np.tile(np.minimum(T, 10.0)[:, None], (1, 2))
    gear = Gear((0.5, 0.2), 0.003).drive(record(ramp), ramp)
    assert gear[400] == pytest.approx(ramp[400] - [0.5, 0.2], abs=0.01)
    lag = Loop(0.1, 0.8).drive(record(ramp), ramp)
    # of a ramp: 2ζ/ω, and the drum
    assert ramp[400] - lag[400] == pytest.approx(2 * 0.8 * 0.1 + 0.1 / 4, abs=2e-3)
    assert lag[-1] == pytest.approx(ramp[-1], abs=1e-4)
    slow = Motor(2.0).drive(record(ramp), ramp)
    assert np.diff(slow, axis=0).max() <= 0.5 * 0.02 + 1e-9
    held = np.tile(np.minimum(2 * T, 4.0)[:, None], (1, 2))
    crept = Prony((0.2, 0.1), 0.5, (0.3, 0.4, 0.3)).drive(record(held), held)
    assert crept[-1] == pytest.approx([4.8, 4.4], rel=2e-3)
    dahl = DahlElements((0.2, 0.1), 2.0).drive(record(ramp), ramp)
    assert ramp[450] - dahl[450] == pytest.approx(
        np.array([0.2, 0.1]) * (9 + 2) * 3.5 / 6, rel=1e-2
    )
    wen = BoucWen((0.25, 0.1), 2.0, 1.0, 0.5).drive(record(ramp), ramp)
    assert ramp[450] - wen[450] == pytest.approx([0.5, 0.2], rel=2e-2)
    assert np.all(OgdenRoxburgh(0.3, 10.0, 0.3).drive(record(ramp), ramp) == ramp)  # virgin loading
    stopped = Stops((4.0, 6.0), 0.1).drive(record(ramp), ramp)
    assert stopped[-1] == pytest.approx([8.0, 6.0], abs=1e-3) and stopped[300] == pytest.approx(
        [6.0, 5.93], abs=0.01
    )
    pull = np.concatenate([ramp, -ramp], axis=1)
    loss = pull - CableCreep((0.1,) * 4, 0.5).pull(record(ramp), pull)
    assert np.all(loss[:, 2:] == 0.0) and loss[-1, 0] == pytest.approx(1.0, rel=0.01)


def test_the_bank_never_calls_the_effect_library():
    for path in BANK.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        assert not names & {"Chain", "rollout", "Predictor", "predict_features", "with_effects"}, (
            path.name
        )
        if path.name not in (
            "work.py",
            "judge_learned.py",
            "model_rod.py",
            "left_out.py",
        ):  # diagnose, or pass the model or its odds on
            modules = {
                n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module
            }
            modules -= {"softmap_edge.synthetic.depth_camera"}  # cameras
            barred = (
                "diagnosis",
                "_core",
                "synthetic",
                "emulated",
                "noise",
                "checks",
                "comparison",
            )
            assert not [m for m in modules if any(word in m for word in barred)], path.name


def test_a_case_is_a_pure_function_of_its_name():
    key = ("development", "A", "real", "single", 8)
    one, two, other = case(*key), case(*key), case("reporting", *key[1:])
    assert one.to_dict() == two.to_dict() and one.hidden == ("backlash",)
    assert one.run(judge_protocol(0)).hash() == two.run(judge_protocol(0)).hash()
    assert other.hidden == one.hidden and other.laws != one.laws
    assert max(SIZES.values()) < abs(SEEDS["reporting"] - SEEDS["development"])
    twin = one.run(judge_protocol(0), ())
    # the same noise, not the same finger
    assert rms(twin.vertices - one.run(judge_protocol(0)).vertices) > 0.5


@pytest.mark.parametrize(
    ("level", "kind", "number"), [("easy", "single", 8), ("hard", "single", 0), ("real", "pair", 1)]
)
def test_what_is_hidden_moves_the_finger_as_far_as_the_level_says(level, kind, number):
    mine, protocol = case("development", "A", level, kind, number), standard_protocol(2)
    low, high = LEVELS[level].moves_mm
    plain = seen(mine.body, (), protocol, False, every=4)
    for law, reported in zip(mine.laws, mine.moved_mm):
        moved = rms(
            sections(seen(mine.body, (law,), protocol, False, every=4) - plain, mine.body.place)
        )
        assert 0.7 * low < moved < 1.3 * high and moved == pytest.approx(reported, rel=0.25)
    small = rms(
        sections(seen(mine.body, mine.small, protocol, False, every=4) - plain, mine.body.place)
    )
    assert 0.01 < small < 0.3 * low


def test_errors_of_the_camera_hang_together_in_time_and_patches_are_hidden():
    t = np.arange(0.0, 60.0, 0.25)
    points = np.random.default_rng(0).normal(size=(1, 40, 3)) * 30.0
    off, visible = looked(
        np.tile(points, (len(t), 1, 1)), t, LEVELS["real"], np.random.default_rng(1)
    )
    mean = (off - points).mean(axis=1)[:, 0]
    assert (
        np.corrcoef(mean[:-1], mean[1:])[0, 1] > 0.4 > abs(np.corrcoef(mean[:-40], mean[40:])[0, 1])
    )
    assert visible.mean() == pytest.approx(1 - round(0.08 * 40) / 40)


@pytest.mark.long
def test_clouds_give_vertices_whose_roll_is_unseen_near_the_true_ones():
    mine, protocol = case("development", "B", "clouds", "null", 0), thinned(standard_protocol(2))
    assert (
        2 * protocol.frames - standard_protocol(2).frames in (0, 1)
        and not mine.marked
        and mine.seen_as == "clouds"
    )
    few = replace(protocol, t_seen=protocol.t_seen[::20], block=protocol.block[::20])
    assert thinned(few).frames == few.frames  # few as they are
    true = mine.run(few)
    run = registered(mine.body.model(), true, mine.seed)
    assert run.frames == few.frames and run.points is None and not run.extra["roll_seen"]
    off = np.linalg.norm(run.vertices - true.vertices, axis=2)
    assert 0.05 < np.median(off) < 0.3 < 0.6 < run.visible.mean() < 0.95
    again = registered(mine.body.model(), true, mine.seed)
    assert run.hash() == again.hash()


def test_a_run_at_rest_shows_no_motion():
    protocol = at_rest(0)
    at = [np.interp(protocol.t_seen, protocol.t, c) for c in protocol.command.T]
    before = [np.interp(protocol.t_seen - 1.0, protocol.t, c) for c in protocol.command.T]
    assert np.abs(np.subtract(at, before))[:, 4:].max() < 1e-9 and protocol.frames > 100
    assert len(np.unique(protocol_of("untestable", ("payload",), 0).gravity, axis=0)) == 1


# --- the score ------------------------------------------------------------------------------------


def said(*effects, alternatives=(), verdict="identified", open_=(), settles=()):
    entries = [
        {"name": e, "share": 1.0 - 0.1 * k, "probability": 0.9} for k, e in enumerate(effects)
    ]
    return {
        "verdict": verdict,
        "effects": entries,
        "faults": [],
        "alternatives": [{"effects": list(r), "why": ""} for r in alternatives],
        "not_testable": [{"name": n} for n in open_],
        "next": [{"block": "b", "settles": list(settles)}],
    }


def judged(hidden, document, orientations=2, expressible=frozenset(LAWS), also=(), roll=True):
    return judge.judged(
        hidden, document, judge.alike(_core.effects(), orientations, roll), set(expressible), also
    )


def test_a_turned_frame_may_stand_for_turned_tendons_only_where_no_roll_is_seen():
    open_ = said("routing", alternatives=[["mount"]], verdict="ambiguous")
    assert (
        judged(["routing"], open_, roll=False)["first"] and not judged(["routing"], open_)["first"]
    )
    assert not judged(["routing"], said("twist"), roll=False)["first"]


def test_a_name_counts_only_alone_or_next_to_its_structural_equivalent():
    both = said("gain", "lag")
    assert (
        judged(["lag"], both, also=["gain"])["exact"]
        and judged(["lag", "gain"], both, also=["gain"])["exact"]
    )
    assert not judged(["lag", "gain"], said("lag"), also=["gain"])["exact"]
    assert judged(["lag"], said("lag"))["first"]
    assert not judged(["lag"], said("lag", alternatives=[["creep"]], verdict="ambiguous"))["first"]
    assert (
        not judged(["lag"], said("gain", "lag"))["first"] and not judged(["lag"], said())["first"]
    )
    assert judged(
        ["latency"], said("latency", alternatives=[["clock_shift"]], verdict="ambiguous")
    )["first"]
    pair = said(
        "payload", alternatives=[["gravity"]], verdict="ambiguous", settles=["payload", "gravity"]
    )
    assert (
        judged(["payload"], pair, orientations=1)["first"]
        and not judged(["payload"], pair)["first"]
    )
    assert judged(["gravity"], pair, orientations=1)["cannot"]
    assert not judged(["gravity"], said("payload"), orientations=1)["cannot"]


def test_sets_claims_and_what_the_library_lacks():
    both = judged(["lag", "gain"], said("gain", "lag", "mount"))
    assert not both["exact"] and [c["true"] for c in both["claims"]] == [True, True, False]
    assert judged(["lag", "gain"], said("gain", "lag"))["exact"]
    assert not judged(["lag", "gain"], said("gain"))["inside"]
    assert judged(
        ["lag", "gain"], said("gain", alternatives=[["gain", "lag"]], verdict="ambiguous")
    )["inside"]
    assert not judged(["magnet"], said())["in_library"] and judged(["lag"], said())["in_library"]
    assert not judged(["lag"], said(), expressible={"gain"})["in_library"]


def test_equivalents_share_a_name_and_a_law_may_be_more_than_its_name():
    for named in (["gain"], ["tendon_stretch"], ["gain", "tendon_stretch"]):
        assert judged(["gain", "tendon_stretch"], said(*named))["exact"]
    assert not judged(["gain", "tendon_stretch"], said("gain", "lag"))["exact"]
    beside, sided = said("kink", "one_sided_stiffness"), ["one_sided_stiffness"]
    assert judged(["kink"], beside, also=sided)["exact"] and not judged(["kink"], beside)["exact"]
    assert all(c["true"] and c["itself"] for c in judged(["kink"], beside, also=sided)["claims"])
    assert judged(["kink"], said("kink"), also=sided)["exact"]
    assert not judged(["kink"], said("one_sided_stiffness"), also=sided)["exact"]
    assert not judged(["kink", "one_sided_stiffness"], said("kink"), also=sided)["exact"]


def test_a_measurement_that_is_at_fault_in_no_known_way_is_flagged():
    assert judged(["servo_swap"], said(verdict="measurement_fault"))["flagged"]
    assert not judged(["servo_swap"], said("mount", verdict="measurement_fault"))["flagged"]


def test_shares_have_wilsons_interval_and_probabilities_their_calibration():
    assert judge.wilson(0, 300) == pytest.approx((0.0, 0.01264), abs=1e-4)
    assert judge.wilson(9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-4)
    sure = [{"probability": 0.95, "itself": k < 9} for k in range(10)]
    assert judge.calibration_error(sure) == pytest.approx(0.05)
    assert judge.calibration_error([{"probability": 0.5, "itself": True}] * 4) == pytest.approx(0.5)
    none = [{"probability": None, "itself": True}]
    assert judge.calibration_error([*sure, *none]) == judge.calibration_error(sure)
    assert judge.calibration_error(none) == 0.0


# --- the runner -----------------------------------------------------------------------------------


def test_the_full_bank_has_the_sizes_that_were_asked_for():
    every = list(tasks("reporting", 1.0, list(SIZES), list(SHARES)))
    clouds = [task for task in every if task[2] == "clouds"]
    assert {task[1] for task in clouds} == {"B"} and len(clouds) == 180
    every = [task for task in every if task not in clouds]
    for (slice_, level), sizes in SLICES.items():
        mine = [task[3] for task in tasks("reporting", 1.0, [*SIZES, "trap"], [(slice_, level)])]
        assert {kind: mine.count(kind) for kind in sizes} == sizes and len(mine) == sum(
            sizes.values()
        )
    for slices in (("shop",), ("odd",), ("learned",)):
        whole = {k: sum(s.get(k, 0) for p, s in SLICES.items() if p[0] in slices) for k in SIZES}
        assert (
            whole["null"] >= 100
            and whole["single"] >= 150
            and min(whole["pair"], whole["unknown"]) >= 60
        )
    count = {kind: sum(task[3] == kind for task in every) for kind in SIZES}
    assert (
        count == SIZES and count["null"] >= 300 and count["single"] >= 300 and count["pair"] >= 200
    )
    assert min(count[k] for k in ("unknown", "untestable", "rivals")) >= 100 and len(
        set(every)
    ) == len(every)


def test_a_case_that_fails_says_so_and_is_tried_again(tmp_path, capsys, monkeypatch):
    task = ("development", "A", "real", "null", 0)
    job = (task, str(tmp_path / "cases"), str(tmp_path), "now")
    monkeypatch.setattr("benches.bank.make.made", lambda task, root: 1 / 0)
    assert "ZeroDivisionError" in work(job)["failed"] and "ZeroDivisionError" in make(job)["failed"]
    head = dict(zip(("seeds", "slice", "level", "kind", "number"), task))
    monkeypatch.setattr(
        "benches.bank.make.made",
        lambda task, root: keep(task, root, {"hidden": [], "truth_seconds": 0}, {}),
    )
    monkeypatch.setattr("benches.bank.work.judge_case", lambda case: 1 / 0)
    assert "ZeroDivisionError" in work(job)["failed"]
    monkeypatch.setattr("benches.bank.work.judge_case", lambda case: {"case": "x", "kind": "null"})
    assert work(job)["case"] == "x"
    assert json.loads(kept(task, tmp_path).read_text()) == head | {"case": "x", "code": "now"}
    with pytest.raises(SystemExit):
        main(["--kinds", "nonsense", "--out", str(tmp_path)])
    assert "null, single" in capsys.readouterr().err


@pytest.mark.long
def test_the_model_of_the_rod_is_as_good_as_it_says():
    body, protocol = body_of("A"), judge_protocol(3)
    mine = next(
        one for n in range(40) if (one := case("development", "A", "easy", "null", n)).marked
    )
    assert mine.run(protocol, ()).markers is not None
    model = body.model()
    at = np.stack([np.interp(protocol.t_seen, protocol.t, c) for c in protocol.command.T], axis=1)
    gravity = protocol.gravity[np.searchsorted(protocol.t, protocol.t_seen, side="right") - 1]
    clean = body.points((), np.concatenate([at, -at], axis=1), gravity, False)
    reported = model.predict(
        Run(
            t=protocol.t,
            command=protocol.command,
            gravity=protocol.gravity,
            t_seen=protocol.t_seen,
            vertices=clean,
        )
    )
    hangs = gravity[:, 2] > 0.99
    assert rms((reported - clean)[hangs]) < 2.0 * model.vertex_error_mm < 0.3
    assert rms((reported - clean)[~hangs]) < 2.0 * model.vertex_error_mm + model.error_per_g_mm
    assert model.structure.stiffness_known and set(model.fields) >= set(_core.FIELDS[:6])


@pytest.mark.long
def test_the_model_of_the_rod_knows_what_large_loads_do():
    u, hung = np.random.default_rng(0).uniform(-9.0, 9.0, (12, 2)), np.array([0.0, 0.0, 0.03])
    model, t = body_of("A").model(), np.arange(12.0)
    loads = hanging(u)
    more = replace(loads, tip=np.tile(0.00980665 * 1e3 * hung, (12, 1)))
    without, under = (settle(finger(1), each, guessed(loads.pull)) for each in (loads, more))
    moved = np.subtract(*(poses.points(finger(1), *template()) for poses in (under, without)))
    run = Run(t=t, command=u, t_seen=t, vertices=moved)
    off = []
    for each in (model, model.with_structure(second=None)):
        heavy, light = (
            each.with_effects(["payload"], {"payload.mass": g}).predict(run) for g in (30.0, 0.0)
        )
        off.append(rms(heavy - light - moved) / rms(moved))
    assert off[0] < 0.08 < 0.12 < off[1], off


@pytest.mark.long
def test_the_model_of_the_rod_knows_what_a_softer_section_does_when_it_leans():
    u, model, t = (
        np.random.default_rng(0).uniform(-9.0, 9.0, (12, 2)),
        body_of("A").model(),
        np.arange(12.0),
    )
    loads = replace(hanging(u), gravity=np.tile([np.sin(0.6), 0.0, np.cos(0.6)], (12, 1)))
    design = finger(1)
    without = settle(design, loads, guessed(loads.pull)).points(design, *template())
    run = Run(t=t, command=u, t_seen=t, gravity=loads.gravity[0], vertices=without)
    params = {
        "stiff_section.amount": -0.7,
        "stiff_section.centre": 2 / 6,
        "stiff_section.width": 1 / 3,
    }
    chain = _core.Chain(["stiff_section"], 2)
    values = np.array([[params[label] for label in chain.labels]])
    said = chain.coefficients(values, gravity=run.gravity[None], load=np.zeros(1), u=u[:1])[0, 0]
    softer = design
    for name, amount in zip(_core.FIELDS, said):
        softer = changes()[name][0](softer, loads, amount)[0] if amount else softer
    moved = settle(softer, loads, guessed(loads.pull)).points(softer, *template()) - without
    off = []
    for each in (model, model.with_structure(second=None)):
        off.append(
            rms(
                each.with_effects(["stiff_section"], params).predict(run)
                - each.predict(run)
                - moved
            )
            / rms(moved)
        )
    assert off[0] < 0.2 < 0.4 < off[1], off


@pytest.mark.long
@pytest.mark.parametrize(
    ("params", "field", "amount"),
    [
        ({"routing.phase[0]": 4.0, "routing.phase[1]": 0.0}, "routing_0", 4.0),
        ({"pre_curve.x": 3.0, "pre_curve.y": 0.0}, "curve_x", 3.0),
        ({"twist.angle": 6.0}, "twist", 6.0),
    ],
)
def test_the_model_of_the_rod_knows_small_changes_of_its_design(params, field, amount):
    """At constant tension: cables that are turned are longer, which they answer once, not twice."""
    u, model, t = (
        np.random.default_rng(0).uniform(-9.0, 9.0, (12, 2)),
        body_of("A").model(),
        np.arange(12.0),
    )
    loads = hanging(u)
    without = settle(finger(1), loads, guessed(loads.pull)).points(finger(1), *template())
    design = changes()[field][0](finger(1), loads, amount)[0]
    moved = settle(design, loads, guessed(loads.pull)).points(design, *template()) - without
    run, effect = Run(t=t, command=u, t_seen=t, vertices=without), next(iter(params)).split(".")[0]
    off = rms(model.with_effects([effect], params).predict(run) - model.predict(run) - moved)
    assert off < 0.1 * rms(moved), f"{off:.3f} of {rms(moved):.2f} mm"


@pytest.mark.prove
def test_the_sweep_of_the_solid_is_interpolated_within_its_stated_error():
    assert interpolation_mm() < 0.15


FIXED = [
    ("null", 0),
    ("null", 3),
    ("single", 0),
    ("single", 8),
    ("untestable", 0),
    ("rivals", 0),
    ("removed", 8),
]
# What the search found only since its first members may leave again (29), since eccentric pulleys
# are begun from every start (23), since damage is of the body (18): pairs of the easy level that
# must be exact.
PAIRS = (29, 23, 18)


@pytest.mark.long
def test_a_fixed_slice_is_diagnosed(tmp_path, capsys):
    for kind, number in FIXED:
        work(
            (
                ("development", "A", "real", kind, number),
                str(tmp_path / "cases"),
                str(tmp_path),
                "now",
            )
        )
    for number in PAIRS:
        work(
            (
                ("development", "A", "easy", "pair", number),
                str(tmp_path / "cases"),
                str(tmp_path),
                "now",
            )
        )
    assert main(["--table", "--out", str(tmp_path)]) == 0
    reported = capsys.readouterr().out
    rows = {
        (r["kind"], r["number"]): r
        for r in (json.loads(p.read_text()) for p in tmp_path.glob("*.json"))
    }
    assert all(rows["pair", number]["exact"] for number in PAIRS), reported
    assert not [r for r in rows.values() if "failed" in r], reported
    assert not rows["null", 0]["named"] and not rows["null", 3]["named"], reported
    for key in (("single", 0), ("single", 8)):
        assert rows[key]["first"] and rows[key]["fall"] > 0.8, rows[key]
    assert rows["removed", 8]["in_library"] and "backlash" not in rows["removed", 8]["named"]
    assert rows["untestable", 0]["cannot"], rows["untestable", 0]
    assert rows["rivals", 0]["at_first"]["cannot"] and rows["rivals", 0]["first"], rows["rivals", 0]
    assert "alone in first place" in reported and "backlash" in reported
