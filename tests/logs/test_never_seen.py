"""Markers at exactly 0, 0, 0 in every row: never seen, or the origin of the log."""

import numpy as np
import pytest

from softmap_edge.checks.summary import summary
from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.never_seen import never_seen
from softmap_edge.rod.learn import learn

RNG = np.random.default_rng(3)
T = np.arange(300) / 20
U = np.stack([8 + 7 * np.sin(0.7 * T), 8 + 7 * np.sin(1.1 * T + 1)], axis=1)
NAMES = ["m0", "m1", "m2", "m3"]


def bent(count=4):
    """Markers (K, M, 3) mm of a finger along z, with noise."""
    s = np.arange(1, count + 1)[None, :] / count
    moved = U - 8.0
    points = np.stack(
        [3 * s**2 * moved[:, :1], 3 * s**2 * moved[:, 1:], 100 * s + 0 * moved[:, :1]], axis=2
    )
    return points + 0.05 * RNG.normal(size=points.shape)


def written(path, points, names=NAMES):
    head = ["time_s", "command_0_mm", "command_1_mm"]
    head += [f"{name}_{axis}_mm" for name in names for axis in "xyz"]
    rows = np.column_stack([T, U, points.reshape(len(T), -1)])
    lines = [",".join("" if np.isnan(x) else f"{x:.4f}" for x in row) for row in rows]
    path.write_text("\n".join([",".join(head), *lines]) + "\n")
    return path


def mapped(names=NAMES, keys="", more=""):
    columns = ", ".join("[" + ", ".join(f'"{n}_{a}_mm"' for a in "xyz") + "]" for n in names)
    text = f"""schema = "softmap.mapping/1"
[[log]]
time = {{ column = "time_s", unit = "s" }}
command = {{ columns = ["command_0_mm", "command_1_mm"], unit = "mm" }}
markers = {{ {keys}columns = [{columns}] }}
{more}[blocks]
count = 5
"""
    return parse_mapping(text, "map.toml")


@pytest.mark.parametrize("number", [0.0, -1.0, 9999.99])
@pytest.mark.parametrize("axes", [2, 3])
def test_only_one_number_in_every_known_row_is_never_seen(number, axes):
    points = bent()[..., :axes]
    points[:, 1] = number
    points[10:20, 1] = np.nan
    points[:, 2] = (12.5, 0.0, 31.0)[:axes]
    assert never_seen(points).tolist() == [1]
    points[30, 1, 0] += 0.001
    assert never_seen(points).tolist() == []
    assert never_seen(points[..., :1]).size == 0


@pytest.mark.parametrize("lost", [[0], [1], [3], [2, 3]])
def test_a_guess_leaves_out_such_a_marker_and_the_frame_does_not_see_it(tmp_path, lost):
    points = bent()
    points[:, lost] = 0.0
    found = guess_mapping([written(tmp_path / "log.csv", points)])
    assert 'axes = ["x", "y", "z"]' in found.text
    reported = [line for line in found.unknown if "never seen, or is the origin" in line]
    assert len(reported) == len(lost) and "at exactly 0, 0, 0 in all 300 frames" in reported[0]
    assert 'not_seen = "keep"' in reported[0]
    entries = [line for line in found.text.split("\n") if line.startswith('    ["')]
    assert len(entries) == 4 - len(lost)
    assert not any("look at" in line for line in found.said)


@pytest.mark.parametrize("lost", [0, 1, 2, 3])
def test_a_mapping_takes_it_as_not_seen_and_says_so(tmp_path, lost):
    points = bent()
    points[:, lost] = 0.0
    log = written(tmp_path / "log.csv", points)
    done = import_logs([log], mapped())
    assert len(done.doubts) == 1 and f"markers: {NAMES[lost]}" in done.doubts[0]
    assert "at exactly 0, 0, 0 in all 300 frames" in done.doubts[0]
    assert not done.run.visible[:, lost].any() and done.run.visible.sum() == 3 * 300
    (reported,) = [one for one in summary(done.run).warnings if "seen in none" in one]
    assert reported.startswith(NAMES[lost])
    with pytest.raises(RunError, match="seen in none of 300 frames; leave it out of `markers`"):
        learn(done.run)


@pytest.mark.parametrize("lost", [0, 1, 2, 3])
def test_it_is_kept_if_asked_and_turns_no_frame(tmp_path, lost):
    points = bent()
    points[:, lost] = 0.0
    log = written(tmp_path / "log.csv", points)
    done = import_logs([log], mapped(keys='not_seen = "keep", '))
    assert done.doubts == () and done.run.visible is None
    assert any("kept as asked" in note for note in done.notes)
    assert not any("0, 0, 0" in one for one in summary(done.run).warnings)
    del done.run.extra["not_seen"]  # a run of an older version
    assert any("at exactly 0, 0, 0" in one for one in summary(done.run).warnings)


@pytest.mark.parametrize("name", ["base", "clamp_1", "mount"])
def test_a_marker_of_the_base_at_the_origin_stays(tmp_path, name):
    points = bent()
    points[:, 0] = 0.0
    names = [name, *NAMES[1:]]
    log = written(tmp_path / "log.csv", points, names)
    assert "base = { unit" in guess_mapping([log]).text
    base = f'base = {{ KEYcolumns = [["{name}_x_mm", "{name}_y_mm", "{name}_z_mm"]] }}\n'
    done = import_logs([log], mapped(NAMES[1:], more=base.replace("KEY", "")))
    assert "kept as the origin of the log" in done.doubts[0] and len(done.doubts) == 1
    assert (done.run.extra["base_markers"] == 0.0).all()
    kept = import_logs([log], mapped(NAMES[1:], more=base.replace("KEY", 'not_seen = "keep", ')))
    assert kept.doubts == ()


def test_a_log_that_saw_nothing_is_refused(tmp_path):
    log = written(tmp_path / "log.csv", 0.0 * bent())
    with pytest.raises(RunError, match="so no marker was ever seen"):
        import_logs([log], mapped())
