"""Comparing a model with a run: known errors give known figures, known motions known cells, known
noise its floor.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from leaning_triangle import AROUND, lean, markers_of, record, triangle, tube

from softmap_edge import _core, builtin_model, diagnose
from softmap_edge.comparison.comparison import Comparison, compare
from softmap_edge.comparison.series import series
from softmap_edge.errors import ComparisonError, RunError
from softmap_edge.model.training_range import out_of_reach
from softmap_edge.noise.floor import noise_floor
from softmap_edge.run.conditions import cells, conditions
from softmap_edge.run.run import Run


def rows(comparison, name):
    return {row.label: row for row in comparison.where[name]}


def test_exact_model_has_no_error():
    found = compare(lean(), triangle())
    assert found.error["rms_mm"] < 1e-12 and found.error["max_mm"] < 1e-12
    assert found.frames == 250


def test_known_error_gives_known_figures():
    def shift(run, points):
        out = np.zeros_like(points)
        out[:125, :, 0], out[125:, :, 0] = 1.0, 3.0
        return out

    found = compare(lean(shift), triangle())
    assert found.error["rms_mm"] == pytest.approx(np.sqrt(5.0))
    assert found.error["median_mm"] == pytest.approx(2.0)
    assert found.error["p95_mm"] == pytest.approx(3.0) and found.error["max_mm"] == pytest.approx(
        3.0
    )
    assert found.error["tip_rms_mm"] == pytest.approx(np.sqrt(5.0))
    assert [row.rms_mm for row in found.where["time"]][0] == pytest.approx(1.0)
    assert [row.rms_mm for row in found.where["time"]][-1] == pytest.approx(3.0)
    assert found.worst["frame"]["rms_mm"] == pytest.approx(3.0)


def test_error_at_the_tip_is_found_at_the_tip():
    def tip(run, points):
        out = np.zeros_like(points)
        out[:, 4 * AROUND :, 1] = 2.0
        return out

    found = compare(lean(tip), triangle())
    section = found.where["section"]
    assert [row.rms_mm for row in section] == pytest.approx([0, 0, 0, 0, 2.0])
    assert section[-1].label == "5 tip" and section[-1].low == section[-1].high == 100.0
    assert found.error["tip_rms_mm"] == pytest.approx(2.0)
    assert found.worst["bins"][0] == {
        "where": "section",
        "label": "5 tip",
        "n": 250,
        "rms_mm": pytest.approx(2.0),
    }


def test_error_of_one_direction_is_found_there_only():
    def backward(run, points):
        slope = np.interp(run.t_seen, run.t, np.gradient(run.command[:, 0], run.t))
        return np.where((slope < -1)[:, None, None], [[[1.5, 0, 0]]], 0.0) * np.ones_like(points)

    direction = rows(compare(lean(backward), triangle()), "direction")
    assert set(direction) == {"still", "u0 +", "u0 −"}
    assert direction["u0 −"].rms_mm == pytest.approx(1.5, rel=0.02)
    assert direction["u0 +"].rms_mm < 1e-12 and direction["still"].rms_mm < 0.3
    assert direction["u0 −"].n == pytest.approx(100, abs=3) and direction[
        "u0 +"
    ].n == pytest.approx(50, abs=3)


def test_every_condition_holds_every_frame_once():
    run = triangle(gravity=np.array([0.0, 0.0, 1.0]), temperature=np.linspace(20, 30, 1251))
    found = cells(conditions(run, run.command))
    assert set(found) == {
        "direction",
        "speed",
        "dwell",
        "history",
        "command",
        "time",
        "orientation",
        "temperature",
    }
    for name, row in found.items():
        count = np.sum([cell.frames for cell in row], axis=0)
        assert (count == 1).all(), f"{name}: {np.flatnonzero(count != 1)[:5]}"
        for cell in row:
            if cell.low is not None and cell.high is not None:
                assert cell.low <= cell.high


def test_no_two_classes_of_a_condition_bear_one_name():
    """Warmth within a tenth of a degree and a clock that counts since 1970 need more digits than
    three.
    """
    run = triangle(temperature=np.linspace(23.11, 23.14, 1251))
    run = replace(run, t=run.t + 1.7e9, t_seen=run.t_seen + 1.7e9)
    for name, row in cells(conditions(run, run.command)).items():
        assert len({cell.label for cell in row}) == len(row), name
        bounds = [cell.label.split(" … ") for cell in row if " … " in cell.label]
        assert all(low != high.split(" ")[0] for low, high in bounds), bounds


def test_commands_as_large_as_one_another_are_one_class():
    """A servo that went to its end at once, then again to within a tick."""
    t = np.arange(0, 25.0001, 0.02)
    u = np.column_stack([11.97 + 0.03 * t / 25.0, 0 * t])
    run = record(t, u, np.arange(0.0, 25.0, 0.1))
    assert [cell.label for cell in cells(conditions(run, run.command))["history"]] == ["12 mm"]
    assert "largest past" not in str(compare(lean(), run))


def test_conditions_of_a_known_motion():
    run = triangle()
    state = conditions(run, run.command)
    at = lambda seconds: int(round(seconds * 10))  # noqa: E731
    assert state.speed[at(3)] == pytest.approx(2.0) and state.velocity[at(15), 0] == pytest.approx(
        -2.0
    )
    assert state.dwell[at(9)] == pytest.approx(4.0, abs=0.03) and state.dwell[at(3)] == 0.0
    assert state.history[at(2)] == pytest.approx(4.0) and state.history[at(24)] == pytest.approx(
        10.0
    )
    assert state.visit[at(7)] == state.visit[at(9)] != state.visit[at(23)]


def test_a_dwell_ends_where_the_robot_is_turned():
    gravity = np.tile([0.0, 0.0, 1.0], (1251, 1))
    still = conditions(triangle(gravity=gravity), triangle().command)
    gravity[400:] = [0.5, 0.0, 0.866]  # at 8 s, in the dwell from 5 to 10 s
    turned = conditions(triangle(gravity=gravity), triangle().command)
    assert still.visit[70] == still.visit[90]
    assert turned.visit[70] != turned.visit[90] and turned.dwell[90] == still.dwell[90]


def test_orientations_are_distinguished():
    flip = np.tile([0.0, 0.0, 1.0], (1251, 1))
    flip[600:] = [1.0, 0.0, 0.0]
    run = triangle(gravity=flip)
    assert {c.label for c in cells(conditions(run, run.command))["orientation"]} >= {
        "gravity +z",
        "gravity +x",
    }


def test_hidden_points_do_not_count():
    def bad(run, points):
        out = np.zeros_like(points)
        out[:, 0] = 50.0
        return out

    run = triangle()
    hidden, visible = run.vertices.copy(), np.ones(run.vertices.shape[:2], bool)
    hidden[:, 0], visible[:, 0] = np.nan, False
    assert (
        compare(lean(bad), replace(run, vertices=hidden, visible=visible)).error["max_mm"] < 1e-12
    )
    assert compare(lean(bad), run).error["max_mm"] > 49.0


@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_noise_floor_from_dwells(sigma):
    found = compare(lean(lambda run, p: 4.0), triangle(noise=sigma))
    # 80 pairs of 40 points: 1.5 %
    assert found.noise_floor_mm == pytest.approx(np.sqrt(3) * sigma, rel=0.05)
    assert "dwell" in found.made_from["noise_floor"] and not found.floor_is_bound


def test_noise_floor_from_repeated_commands():
    """One seen frame a dwell: the same two commands again and again."""
    t = np.arange(0, 120.0001, 0.05)
    u1 = np.where((t // 3) % 2 == 0, 0.0, 8.0)
    run = record(t, np.column_stack([u1, 0 * t]), np.arange(2.0, 62.0, 3.0), noise=0.2)
    found = compare(lean(), run)  # 20 frames are too few to know the shapes of the body
    assert found.noise_floor_mm == pytest.approx(np.sqrt(3) * 0.2, rel=0.1)
    assert "repeatedly" in found.made_from["noise_floor"] and found.floor_is_bound


def test_noise_floor_without_replicates_says_so():
    t = np.arange(0, 30.0, 0.02)
    u = np.column_stack([10 * np.sin(t), 8 * np.cos(0.7 * t)])
    bare = markers_of(lean())
    found = compare(bare, record(t, u, np.arange(0, 3, 0.1), noise=0.1))
    assert found.noise_floor_mm == pytest.approx(np.sqrt(3) * 0.1, rel=0.1)
    assert "no replicates" in found.made_from["noise_floor"] and found.floor_is_bound
    few = record(t, u, np.arange(0, 0.5, 0.1), noise=0.1)
    state = conditions(few, few.command)
    value, why = noise_floor(
        state, few.vertices, np.ones(few.vertices.shape[:2], bool), few.vertices
    )
    assert value is None and "too few" in why


@pytest.mark.parametrize(
    ("seconds", "source"), [(29, "what no command can make of the body's shape"), (3, "roughness")]
)
def test_noise_floor_of_a_moving_body_ignores_what_the_model_misses(seconds, source):
    """Always moving, and the model wrong by a smooth 5 mm: the shapes, or the roughness over the
    body, still give the noise.
    """
    t = np.arange(0, 30.0, 0.02)
    u = np.column_stack([10 * np.sin(t), 8 * np.cos(0.7 * t)])
    wrong = lean(
        lambda run, p: (
            5 * np.sin(3 * run.t_seen)[:, None, None] * (tube()[0][:, 2] / 100)[None, :, None] ** 2
        )
    )
    found = compare(wrong, record(t, u, np.arange(0, seconds, 0.1), noise=0.1))
    assert found.error["rms_mm"] > 2
    assert found.noise_floor_mm == pytest.approx(np.sqrt(3) * 0.1, rel=0.05)
    assert source in found.made_from["noise_floor"]


def test_the_lowest_error_without_memory_is_compared_with_the_model_on_the_same_frames():
    t = np.arange(0.0, 80.0, 0.02)
    u = np.column_stack([10.0 * np.sin(2 * np.pi * t / 8.0), 0.0 * t])
    run = record(t, u, np.arange(0.0, 79.5, 0.2), noise=0.1)
    behind = np.gradient(np.interp(run.t_seen, t, u[:, 0]))[:, None] > 0  # one way only

    def play(run, points):
        out = np.zeros_like(points)
        out[..., 0] = 2.0 * behind
        return out

    seen = replace(run, vertices=run.vertices + play(run, run.vertices))
    found = compare(lean(), seen)
    assert found.memoryless.mm < found.memoryless.error_mm  # a model without memory
    assert found.memoryless.mm == pytest.approx(1.0, rel=0.1)  # half the distance of both ways
    assert found.memoryless.error_mm == pytest.approx(np.sqrt(2.0), rel=0.1)
    assert f"this model has {found.memoryless.error_mm:.2f} mm there" in " ".join(
        str(found).split()
    )
    known = compare(lean(play), seen)
    assert known.memoryless.error_mm < 0.3 < known.memoryless.mm == found.memoryless.mm


def test_document_survives_json():
    found = compare(lean(lambda run, p: 1.0), triangle(noise=0.1))
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert Comparison.from_dict(document) == found
    assert set(document) == {
        *(
            "schema",
            "run",
            "bundle",
            "frames",
            "error",
            "noise_floor_mm",
            "memoryless_floor",
            "where",
        ),
        *("worst", "made_from"),
    }
    assert set(document["where"]) == {
        "section",
        "direction",
        "speed",
        "dwell",
        "history",
        "command",
        "time",
    }
    assert set(document["where"]["speed"][0]) == {"label", "low", "high", "n", "rms_mm"}
    assert document == compare(lean(lambda run, p: 1.0), triangle(noise=0.1)).to_dict()


@pytest.mark.parametrize(
    "damage",
    [
        None,
        [],
        {"schema": "softmap.comparison/2"},
        {"error": {}},
        {"where": {"time": [{}]}},
        {"where": 3},
        {"run": 4},
    ],
)
def test_damaged_documents_are_refused(damage):
    document = compare(lean(), triangle()).to_dict()
    document = document | damage if isinstance(damage, dict) else damage
    with pytest.raises(ComparisonError, match="softmap compare --json"):
        Comparison.from_dict(document)


def test_what_cannot_be_compared():
    run = replace(triangle(), t_seen=np.zeros(0), vertices=np.zeros((0, 40, 3)))
    with pytest.raises(ComparisonError, match="nothing to compare"):
        compare(lean(), run)
    run = triangle(visible=np.zeros((250, 40), bool))
    with pytest.raises(ComparisonError, match="visible"):
        compare(lean(), run)
    with pytest.raises(ComparisonError, match="not finite"):
        compare(lean(lambda run, p: np.nan), triangle())
    run = triangle()
    run = replace(run, vertices=run.vertices[:, :-1])
    with pytest.raises(RunError, match="39 points a frame, this model of .tube. has 40"):
        compare(lean(), run)


def test_a_run_without_commands():
    run = triangle()
    run = replace(run, command=np.zeros((len(run.t), 0)))
    still = _core.Table([], np.zeros((1, 1)), tube()[0].ravel(), np.zeros((1, tube()[0].size)))
    found = compare(lean().with_structure(prior=still, command_range=np.zeros((0, 2))), run)
    assert [row.label for row in found.where["direction"]] == ["still"]
    assert found.error["max_mm"] == pytest.approx(10.0)


def test_markers_are_their_own_sections():
    run, model = triangle(), lean(lambda run, p: 1.0)
    model = markers_of(model).with_structure(tip_indices=np.array([39]))
    assert compare(model, run).where["section"][0].label == "marker 1"
    assert series(run, model).triangles is None


def test_series_before_and_after():
    run = triangle(noise=0.1)
    found = series(run, lean(lambda run, p: 2.0), lean(lambda run, p: 0.5))
    assert found.before.shape == (250,) and found.point_after.shape == (40,)
    assert np.all(found.after < found.before) and np.all(found.point_after < found.point_before)
    assert found.point_before == pytest.approx(np.full(40, np.sqrt(12.0 + 0.03)), rel=0.05)
    with pytest.raises(ComparisonError, match="held out"):
        series(run, lean(), kind="good")


def test_hash_follows_the_content():
    runs = [triangle(noise=0.1), triangle(noise=0.1), triangle(noise=0.1, seed=1)]
    run, same, other = (compare(lean(), run).run["sha256"] for run in runs)
    assert run == same != other


@pytest.mark.parametrize(
    ("factor", "unit"), [(0.1, "centimetres"), (10.0, "tenths of a mm"), (1 / 25.4, "inches")]
)
def test_points_in_another_unit_are_no_missing_effect(factor, unit):
    """Taken as mm they gave a verdict that named gravity."""
    model = builtin_model()
    t = np.arange(20.0)
    run = Run(
        t=t,
        command=np.column_stack([8 * np.sin(t), t / 4]),
        t_seen=t,
        vertices=np.repeat(model.rest[None], 20, 0),
    )
    sound = replace(run, vertices=model.predict(run))
    assert compare(model, sound).error["rms_mm"] == pytest.approx(0.0, abs=1e-9)
    wrong = replace(sound, vertices=factor * sound.vertices)
    for use in (compare, diagnose):
        with pytest.raises(RunError, match=f"wrong units.*{unit}"):
            use(model, wrong)


def test_points_in_the_frame_of_a_camera_are_reported():
    model = builtin_model()
    t = np.arange(0.0, 20.0, 0.1)
    u = 12 * np.column_stack([np.sin(t), np.cos(t)])
    bent = np.asarray(
        model.predict(
            Run(t=t, command=u, t_seen=t, vertices=np.repeat(model.rest[None], len(t), 0))
        )
    )
    assert out_of_reach(model, Run(t=t, command=u, t_seen=t, vertices=bent)) == []
    seen = np.ones(bent.shape[:2], bool)
    seen[:, ::2] = False
    away = Run(
        t=t,
        command=u,
        t_seen=t,
        vertices=bent @ np.diag([1.0, -1.0, -1.0]) + [310, 45, 820],
        visible=seen,
    )
    [line] = out_of_reach(model, away)
    assert "`softmap run align`" in line and "reaches 117 mm" in line
