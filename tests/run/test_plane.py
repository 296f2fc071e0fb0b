"""Markers in a plane: read from two columns each, and nothing across the plane is predicted,
compared or aligned.
"""

import numpy as np
import pytest
from logs import ROOT

from softmap_edge.alignment.align import align_base
from softmap_edge.checks.summary import summary
from softmap_edge.cli import main
from softmap_edge.comparison.comparison import compare
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.errors import AlignError, RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.rod.learn import learn, learned_model
from softmap_edge.run.plane import flat, unmeasured
from softmap_edge.run.run import Run

CASE = ROOT / "tests" / "data" / "values" / "plane.csv"
T = np.arange(600) * 0.05
U = np.c_[8 * np.sin(0.9 * T) * np.cos(0.05 * T)]


def places(u, play=0.0, noise=0.02, seed=0):
    """Two markers (K, 2, 3) mm of a planar finger along z that bends to x; what is across, y, is
    not zero.
    """
    y, bent = np.zeros(len(u)), 0.0
    for k, x in enumerate(u[:, 0]):
        bent = min(max(bent, x - play), x + play)
        y[k] = bent
    points = np.stack(
        [np.c_[1.5 * y * a**2, 0.4 * y * a, 100 * a - 0.05 * y**2 * a] for a in (0.5, 1.0)], axis=1
    )
    return points + noise * np.random.default_rng(seed).normal(size=points.shape)


def seen_in_a_plane(play=0.0, seed=0):
    points = places(U, play, seed=seed)
    points[..., 1] = 0.0
    return Run(t=T, t_seen=T, command=U, markers=points, extra={"plane": np.array("y")})


def written(folder, head, *columns):
    rows = np.concatenate([np.reshape(c, (len(T), -1)) for c in (T, U, *columns)], axis=1)
    lines = [
        ",".join(["time", "cmd_1", *head]),
        *(",".join(f"{x:.4f}" for x in row) for row in rows),
    ]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def mapped(folder, text):
    (folder / "map.toml").write_text(text)
    return read_mapping(folder / "map.toml")


MAPPING = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time" }
command = { columns = ["cmd_1"] }
markers = { columns = [["ax", "ay"], ["bx", "by"]] }
[frame]
origin_mm = [0.0, 0.0, 7.0]
axes = ["x", "-z", "y"]
"""


def test_the_case(tmp_path, capsys):
    found = guess_mapping([CASE])
    assert '["tag_x_1", "tag_y_1"]' in found.text and any(
        "in a plane" in line for line in found.assumed
    )
    # it would refuse such a run
    assert not any("softmap run align" in line for line in found.unknown)
    done = import_logs([CASE], mapped(tmp_path, found.text))
    assert (
        done.run.markers.shape == (40, 2, 3)
        and not done.run.markers[..., 1].any()
        and done.doubts == ()
    )
    assert unmeasured(done.run) == 1 and any(
        "y of the base frame is not measured" in note for note in done.notes
    )
    done.run.save(tmp_path / "run.npz")
    assert main(["check", str(tmp_path / "run.npz")]) == 0
    out = capsys.readouterr().out
    assert (
        "what happens across the plane of the markers: their y is not measured" in out
        and "kept" not in out
    )


@pytest.mark.parametrize(
    "head",
    [
        ["x", "y"],
        ["tip.x", "tip.y", "mid.x", "mid.y"],
        ["x1", "y1", "x2", "y2", "x3", "y3"],
        ["tip_X", "tip_Y"],
    ],
)
def test_names_of_markers_in_a_plane(tmp_path, head):
    points = places(U)[:, :, [0, 2]]
    heights = np.linspace(1, 0.5, len(head) // 2)
    path = written(tmp_path, head, *(points[:, 1] * h for h in heights))
    found = guess_mapping([path])
    run = import_logs([path], mapped(tmp_path, found.text)).run
    assert run.markers.shape == (600, len(head) // 2, 3) and unmeasured(run) is not None


@pytest.mark.parametrize(
    "head", [["force_x", "force_y"], ["vel_x", "vel_y"], ["cmd_x", "cmd_y"], ["ax", "ay"]]
)
def test_pairs_that_are_no_place(tmp_path, head):
    found = guess_mapping([written(tmp_path, head, places(U)[:, 1, :2])])
    assert "\nmarkers" not in found.text


def test_a_mapping_turns_the_plane_into_the_base_frame(tmp_path):
    points = places(U)
    log = written(
        tmp_path, ["ax", "ay", "bx", "by"], points[:, 0][:, [0, 2]], points[:, 1][:, [0, 2]]
    )
    run = import_logs([log], mapped(tmp_path, MAPPING)).run
    assert (
        run.markers[..., [0, 2]] == pytest.approx(points[..., [0, 2]], abs=1e-3)
        and not run.markers[..., 1].any()
    )
    assert str(run.extra["plane"]) == "y" and run.marker_names == ["a", "b"]
    lost = places(U)
    lost[5:9, 1] = 0.0
    log = written(tmp_path, ["ax", "ay", "bx", "by"], lost[:, 0][:, [0, 2]], lost[:, 1][:, [0, 2]])
    assert import_logs([log], mapped(tmp_path, MAPPING)).run.visible.sum() == 2 * 600 - 4
    for wrong in ('[["ax", "ay"], ["bx", "by", "bx"]]', '[["ax"], ["ay"]]', '["ax", "ay"]'):
        with pytest.raises(RunError, match="in a plane"):
            mapped(tmp_path, MAPPING.replace('[["ax", "ay"], ["bx", "by"]]', wrong))
    with pytest.raises(RunError, match="give both alike"):
        mapped(
            tmp_path,
            MAPPING.replace("[frame]", 'base = { columns = [["ax", "ay", "bx"]] }\n[frame]'),
        )


def test_a_model_in_space_is_compared_in_the_plane_only():
    whole = Run(t=T, t_seen=T, command=U, markers=places(U))
    model = learned_model(whole, learn(whole, degree=2, static=True))
    run = seen_in_a_plane(seed=1)
    # mm across, which the camera does not see
    assert np.abs(model.predict(whole)[..., 1]).max() > 2.0
    assert not model.predict(run)[..., 1].any() and not model.features(run)[..., 1].any()
    assert compare(model, run).error["rms_mm"] < 0.1


def test_a_play_is_found_and_nothing_across_is_compared():
    model = learned_model(seen_in_a_plane(), learn(seen_in_a_plane(), degree=2, static=True))
    found = diagnose(
        model,
        seen_in_a_plane(play=1.0, seed=2),
        effects=["backlash", "mount", "gain", "hysteresis"],
    )
    assert "backlash" in [effect.name for effect in found.effects]
    fitted = [label for effect in (*found.effects, *found.faults) for label in effect.params]
    assert not {"mount.shift_y", "mount.turn_x", "mount.turn_z"} & set(fitted)


def test_what_a_plane_cannot_give_is_refused():
    with pytest.raises(AlignError, match="lie in a plane"):
        align_base(seen_in_a_plane(), {0: np.zeros(3), 1: np.array([0.0, 0, 50])})
    with pytest.raises(RunError, match='"x", "y" or "z"'):
        unmeasured(
            Run(t=T, t_seen=T, command=U, markers=places(U), extra={"plane": np.array("up")})
        )
    whole = Run(t=T, t_seen=T, command=U, markers=places(U))
    assert unmeasured(whole) is None and flat(whole.markers, whole) is whole.markers
    assert not any(word.about == "plane" for word in summary(whole).cannot_tell)
