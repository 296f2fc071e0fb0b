"""Places that stand for "not seen": recognised, counted, set aside and reported, in logs and
runs.
"""

from dataclasses import replace

import numpy as np
import pytest
from logs import ROOT
from lost_markers import BUT_ALSO, GOOD, RNG, ROWS, SINES, K, T, body
from recordings import places, write_motive, write_trc

from softmap_edge.checks.lost_points import lost_points, without_lost
from softmap_edge.checks.summary import summary
from softmap_edge.cli import main
from softmap_edge.comparison.comparison import compare
from softmap_edge.diagnosis.clean import clean_run
from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.not_seen import not_seen
from softmap_edge.rod.learn import learn, learned_model
from softmap_edge.run.run import Run

CASES = ROOT / "tests" / "data" / "values"
HEAD = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "t" }\n'


# --- what counts as not seen ---------------------------------------------------------------------
@pytest.mark.parametrize("name", [*GOOD, *BUT_ALSO])
def test_what_was_measured_stays(name):
    points, u = (GOOD | BUT_ALSO)[name]
    found = not_seen(points, u)
    assert not found.mask.any(), found.lines([f"m{k}" for k in range(points.shape[1])], "")


@pytest.mark.parametrize("number", [0.0, -1.0, 9999.99, 1e6, -9999.0])
@pytest.mark.parametrize("name", list(GOOD))
def test_constants_of_a_lost_marker_are_found(name, number):
    points, u = GOOD[name]
    for how, rows in ROWS.items():
        lost = points.copy()
        lost[rows, -1] = number
        found = not_seen(lost, u).mask
        assert (found[:, -1] == rows).all() and not found[:, :-1].any(), how


@pytest.mark.parametrize("name", ["noise", "stairs", "no commands", "one marker"])
def test_a_constant_of_three_different_numbers_is_found_if_it_repeats(name):
    points, u = GOOD[name]
    rows = ROWS["here and there"]
    lost = points.copy()
    lost[rows, -1] = (12.5, 0.0, -999.0)
    assert (not_seen(lost, u).mask[:, -1] == rows).all()


def test_markers_that_are_lost_together_and_two_constants():
    points, u = GOOD["noise"]
    points = points.copy()
    points[ROWS["in one stretch"]] = 0.0
    points[ROWS["at the start"], 1] = -1.0
    found = not_seen(points, u)
    assert found.mask.sum() == 4 * 29 + 10
    first, second = found.lines(["a", "b", "c", "d"], "so")
    assert (
        first
        == "29 of 400 frames at exactly (0, 0, 0) are taken as not seen: a 29, b 29, c 29, d 29; so"
    )
    assert second == "10 of 400 frames at exactly (-1, -1, -1) are taken as not seen: b 10; so"


@pytest.mark.parametrize("name", ["noise", "no noise", "no commands"])
def test_a_marker_that_repeats_its_last_place_while_the_others_move(name):
    points, u = GOOD[name]
    held = points.copy()
    held[200:230, 1] = held[199, 1]
    found = not_seen(held, u).mask
    assert found[200:230, 1].all() and found.sum() == 30


@pytest.mark.parametrize("noise", [0.05, 0.0])
@pytest.mark.parametrize("count", [1, 3])
def test_all_markers_that_stand_still_and_then_jump_to_where_the_commands_are(noise, count):
    points = body(SINES, count, noise)
    points[200:230] = points[199]
    found = not_seen(points, SINES).mask
    assert found[200:230].all() and found.sum() == 30 * count


def test_a_force_of_9999_is_no_force():
    force = np.round(3 * np.sin(T) + 0.01 * RNG.normal(size=K), 4)[:, None, None]
    rows = ROWS["in one stretch"]
    lost = np.where(rows[:, None, None], -9999.0, force)
    assert (not_seen(lost).mask[:, 0] == rows).all() and not not_seen(force).mask.any()
    clipped = np.clip(force, None, 2.5)  # an amplifier at its limit
    assert not not_seen(clipped).mask.any()


# --- in every format -----------------------------------------------------------------------------
def written(path, points, names, number="0.000"):
    """A CSV of commands and markers; NaN is written as `number`."""
    head = ["t", "u0", "u1", *(f"{name}_{axis}" for name in names for axis in "xyz")]
    lines = [",".join(head)]
    for t, u, row in zip(T, SINES, points.reshape(len(points), -1)):
        cells = [number if np.isnan(x) else f"{x:.3f}" for x in row]
        lines.append(",".join([f"{t:.3f}", *(f"{x:.3f}" for x in u), *cells]))
    path.write_text("\n".join(lines) + "\n")
    return path


def mapped(folder, text):
    (folder / "map.toml").write_text(text)
    return read_mapping(folder / "map.toml")


def table(names, keys=""):
    columns = ", ".join(f'["{name}_x", "{name}_y", "{name}_z"]' for name in names)
    return f'{HEAD}command = {{ columns = ["u0", "u1"] }}\nmarkers = {{ {keys}columns = [{columns}] }}\n'


NAMES = ["m0", "m1", "m2", "m3"]


def dropped():
    points = body(SINES)
    lost = RNG.random((K, 4)) < 0.15
    lost[lost.all(axis=1), 0] = False
    points[lost] = np.nan
    return points


@pytest.mark.parametrize("number", ["0.000", "-1", "9999.99", "-9999"])
def test_a_csv_with_lost_markers(tmp_path, number):
    points = dropped()
    log = written(tmp_path / "log.csv", points, NAMES, number)
    done = import_logs([log], mapped(tmp_path, table(NAMES)))
    assert (done.run.visible == np.isfinite(points).all(axis=2)).all()
    (doubt,) = done.doubts
    assert "are taken as not seen: m" in doubt and 'markers.not_seen = "keep" keeps them' in doubt
    kept = import_logs([log], mapped(tmp_path, table(NAMES, 'not_seen = "keep", ')))
    assert kept.run.visible is None and not any(
        "not seen" in line for line in (*kept.notes, *kept.doubts)
    )
    # the key is kept in the run
    assert summary(kept.run).not_seen == [] and lost_points(kept.run)[1] == []


def test_numbers_that_a_mapping_declares_as_not_seen(tmp_path):
    points = body(SINES)
    points[5, 2] = np.nan
    log = written(tmp_path / "log.csv", points, NAMES, "77")
    done = import_logs([log], mapped(tmp_path, table(NAMES, "not_seen = [77], ")))
    assert not done.run.visible[5, 2] and done.run.visible.sum() == 4 * K - 1 and done.doubts == ()
    assert any("(77, 77, 77)" in note and "m2 1" in note for note in done.notes)
    for wrong in ('"always"', "7", '["lost"]'):
        with pytest.raises(RunError, match="not_seen"):
            mapped(tmp_path, table(NAMES, f"not_seen = {wrong}, "))


@pytest.mark.parametrize("write", [write_trc, write_motive])
def test_motion_capture_with_zeros(tmp_path, write):
    t, points = places(200)
    lost = RNG.random(200) < 0.15
    points[lost, 1] = 0.0
    name = "log.trc" if write is write_trc else "log.csv"
    log = write(tmp_path / name, t, points / (1 if write is write_trc else 1000))
    columns = ", ".join(f'["{m}.x", "{m}.y", "{m}.z"]' for m in ("base", "middle", "tip"))
    text = (
        'schema = "softmap.mapping/1"\n[[log]]\n'
        f'time = {{ column = "time" }}\nmarkers = {{ columns = [{columns}] }}\n'
    )
    done = import_logs([log], mapped(tmp_path, text))
    assert (done.run.visible[:, 1] == ~lost).all() and done.run.visible[:, [0, 2]].all()
    assert any(f"{lost.sum()} of 200 frames at exactly (0, 0, 0)" in doubt for doubt in done.doubts)


def test_a_proposal_says_it_and_takes_the_unit_of_the_rest(tmp_path):
    found = guess_mapping([CASES / "lost.csv"])
    (tmp_path / "map.toml").write_text(found.text)
    run = import_logs([CASES / "lost.csv"], read_mapping(tmp_path / "map.toml")).run
    assert run.frames == 35 and 'unit = "mm"' in found.text
    assert any(
        line.startswith("look at: 5 of 40 frames at exactly (0, 0, 0)") for line in found.said
    )
    points = dropped() / 1000
    text = written(tmp_path / "m.csv", 1000 * points, NAMES, "9999999").read_text()
    assert 'unit = "mm"' in guess_mapping([tmp_path / "m.csv"]).text and "9999999" in text


# --- runs of other origin ------------------------------------------------------------------------
def old_run(**more):
    points = dropped()
    return Run(t=T, t_seen=T, command=SINES, markers=np.nan_to_num(points), **more), np.isfinite(
        points
    ).all(axis=2)


def test_check_never_calls_such_a_run_sound(tmp_path, capsys):
    run, seen = old_run()
    run.save(tmp_path / "old.npz")
    assert main(["check", str(tmp_path / "old.npz")]) == 1
    out = capsys.readouterr().out
    assert (
        out.startswith("not sound")
        and "at exactly (0, 0, 0) are taken as not seen" in out
        and "visible" in out
    )
    replace(run, visible=seen).save(tmp_path / "good.npz")
    assert main(["check", str(tmp_path / "good.npz")]) == 0
    assert capsys.readouterr().out.startswith("sound ")


def test_a_field_of_the_same_name_does_not_switch_the_search_off():
    run, seen = old_run()
    for word, found in (("keep", 0), ("checked", 0), ("", 1), ("yes", 1)):
        assert len(lost_points(replace(run, extra={"not_seen": np.array(word)}))[1]) == found
    mask, _ = lost_points(replace(run, extra={"not_seen": ~seen}))
    assert np.array_equal(mask, ~seen)


def test_vertices_and_held_places_of_a_run_are_looked_at():
    points = body(SINES, 80)
    points[100:103, 70] = 0.0
    mask, (line,) = lost_points(Run(t=T, t_seen=T, command=SINES, vertices=points))
    assert mask.sum() == 3 and "vertex 70 3" in line
    held = body(SINES)
    held[200:230, 2] = held[199, 2]
    mask, (line,) = lost_points(Run(t=T, t_seen=T, command=SINES, markers=held))
    assert mask.sum() == 30 and "repeat the last place of a marker" in line


def test_what_is_not_seen_is_no_error_and_teaches_nothing():
    run, seen = old_run()
    clean = replace(run, visible=seen)
    fits = [learn(one, degree=2, static=True) for one in (run, clean)]
    assert fits[0].error_mm == pytest.approx(fits[1].error_mm) and fits[0].error_mm < 0.2
    assert any("at exactly (0, 0, 0)" in note for note in fits[0].notes) and "taken" not in str(
        fits[1].notes
    )
    model = learned_model(clean, fits[1])
    errors = [compare(model, one).error["rms_mm"] for one in (run, clean)]
    assert errors[0] == pytest.approx(errors[1]) and errors[0] < 0.2
    found = clean_run(model, run)
    assert any("at exactly (0, 0, 0)" in remark for remark in found.remarks)
    assert not np.any(found.run.visible & ~seen)
    assert without_lost(clean)[0] is clean
