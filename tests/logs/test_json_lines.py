"""JSON Lines: one object a line, flat or nested, with missing keys, numbers as text, dates; faults
of a line are one error; other JSON is named with the way out.
"""

import gzip
import json

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

K = 60
T = np.round(0.02 * np.arange(K), 3)
U = np.round(np.stack([5 * np.sin(6 * T), 4 * np.cos(5 * T) - 4], axis=1), 4)
TIP = np.round(np.stack([3 * U[:, 0], 3 * U[:, 1], 100 + 0.01 * U[:, 0]], axis=1), 3)


def tip(k):
    return dict(zip("xyz", TIP[k].tolist()))


MAKES = {
    "flat": lambda k: (
        {"t": T[k], "cmd_1": U[k, 0], "cmd_2": U[k, 1]} | {f"tip_{a}": x for a, x in tip(k).items()}
    ),
    "nested": lambda k: {"t": T[k], "u": U[k].tolist(), "tip": tip(k)},
    "nested twice, in another order": lambda k: {
        "robot": {"command": {"u1": U[k, 0], "u2": U[k, 1]}, "tip": tip(k)},
        "time": T[k],
    },
    "numbers as text, and dates": lambda k: {
        "stamp": f"2031-05-07T10:15:{T[k]:06.3f}Z",
        "cmd_1": f"{U[k, 0]}",
        "cmd_2": U[k, 1],
        "state": "moves, slowly",
        "tip": {a: str(x) for a, x in tip(k).items()},
    },
    "keys that come later": lambda k: (
        {"t": T[k]} | ({"note": "# begins"} if k == 3 else {}) | {"u": U[k].tolist(), "tip": tip(k)}
    ),
}


def written(folder, lines, name="log.jsonl"):
    path = folder / name
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return path


def imported(path):
    text = guess_mapping([path]).text
    return import_logs([path], parse_mapping(text, path))


@pytest.mark.parametrize("make", list(MAKES))
def test_objects_become_rows(tmp_path, make):
    path = written(tmp_path, (json.dumps(MAKES[make](k)) for k in range(K)))
    done = imported(path)
    assert done.run.command == pytest.approx(U) and len(done.run.t_seen) == K
    assert np.diff(done.run.t) == pytest.approx(0.02, abs=1e-6)
    assert np.ptp(done.run.markers[:, 0] - TIP, axis=0) == pytest.approx([0, 0, 0], abs=1e-6)
    assert any(f"the keys of {K} objects are" in note for note in done.notes)


def test_objects_of_single_markers_are_a_long_table(tmp_path):
    lines = [
        json.dumps({"t": T[k], "id": name, "u1": U[k, 0], "x": x + h, "y": y, "z": z * h})
        for k in range(K)
        for h, name, (x, y, z) in ((0.5, "mid", TIP[k]), (1.0, "tip", TIP[k]))
    ]
    done = imported(written(tmp_path, lines))
    assert done.run.markers.shape == (K, 2, 3) and done.run.command.shape == (K, 1)


def test_missing_keys_null_and_nan_are_missing(tmp_path):
    rows = [MAKES["flat"](k) for k in range(K)]
    del rows[7]["tip_x"]
    rows[8]["tip_y"], rows[9]["tip_z"], rows[10]["tip_x"] = None, float("nan"), "lost"
    rows[20]["cmd_1"] = float("inf")
    done = imported(written(tmp_path, map(json.dumps, rows)))
    assert len(done.run.t_seen) == K - 4 and len(done.run.t) == K - 1
    assert any("infinite values" in note for note in done.notes)
    assert any("'lost'" in note for note in done.notes)


def test_lines_keep_their_numbers(tmp_path):
    rows = [json.dumps(MAKES["flat"](k)) for k in range(K)]
    rows[30] = rows[30].replace(f'"tip_x": {TIP[30, 0]}', '"tip_x": "12mm"')
    path = written(tmp_path, ["", *rows])
    columns = open_log(path)
    with pytest.raises(RunError, match=r"log.jsonl: line 32, column tip_x: '12mm' is not a number"):
        columns.read([columns.names.index("tip_x")])


def test_a_huge_number_is_missing_not_a_crash(tmp_path):
    rows = [json.dumps(MAKES["flat"](k)) for k in range(K)]
    rows[5] = rows[5].replace(f'"tip_x": {TIP[5, 0]}', f'"tip_x": 1{"0" * 400}')
    rows[6] = rows[6].replace(f'"tip_x": {TIP[6, 0]}', f'"tip_x": {"9" * 6000}')
    assert len(imported(written(tmp_path, rows)).run.t_seen) == K - 2


def test_a_last_line_that_was_cut_is_left_out(tmp_path):
    path = written(tmp_path, (json.dumps(MAKES["nested"](k)) for k in range(K)))
    path.write_bytes(path.read_bytes()[:-25])
    done = imported(path)
    assert len(done.run.t) == K - 1 and any("not a complete object" in note for note in done.notes)


def test_a_packed_log(tmp_path):
    path = written(tmp_path, (json.dumps(MAKES["nested"](k)) for k in range(K)))
    packed = tmp_path / "log.jsonl.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert imported(packed).run.command == pytest.approx(U)


@pytest.mark.parametrize("key", ['delimiter = ";"', 'decimal = ","', "header = false"])
def test_keys_of_tables_are_refused(tmp_path, key):
    path = written(tmp_path, (json.dumps(MAKES["flat"](k)) for k in range(K)))
    text = guess_mapping([path]).text.replace("[[log]]", f"[[log]]\n{key}")
    with pytest.raises(RunError, match="are for tables, and this log is JSON Lines"):
        import_logs([path], parse_mapping(text, path))


def test_lines_and_rows_can_be_left_out(tmp_path):
    path = written(tmp_path, (json.dumps(MAKES["flat"](k)) for k in range(K)))
    keys = "[[log]]\nskip_rows = 3\nskip_last_rows = 2"
    text = guess_mapping([path]).text.replace("[[log]]", keys)
    assert len(import_logs([path], parse_mapping(text, path)).run.t) == K - 5


def nested(levels):
    return '{"a":' * levels + "1" + "}" * levels


FAULTS = {
    "a key twice": (['{"t": 0, "x": 1}', '{"t": 1, "x": 2, "x": 3}'], "line 2 .* 'x' twice"),
    "a key twice within": (['{"a": {"b": 1, "b": 2}}'] * 2, "line 1 .* 'b' twice"),
    "one name by two ways": (['{"a.b": 1, "a": {"b": 2}}'] * 2, "line 1 .* 'a.b' twice"),
    "deep": ([nested(20)] * 2, "line 1 nests objects and lists deeper than 8 levels"),
    "very deep": ([nested(100_000)] * 2, "line 1 nests objects and lists deeper"),
    "no JSON": (
        ['{"t": 0}', '{"t": oops}', '{"t": 2}'],
        "line 2, character 7: is not a JSON object",
    ),
    "a list between": (['{"t": 0}', "[1, 2]", '{"t": 2}'], "line 2 is JSON, but no object"),
    "no values": (["{}"] * 3, "hold no values"),
    "one object": (['{"t": [1, 2, 3]}'], "holds one JSON object"),
    "very wide": ([json.dumps({"t": list(range(5000))})] * 2, "more than 4096 values"),
    "a document": (['{"frames": [', '{"t": 0}', "]}"], "is a JSON document: write one object"),
    "a list of objects": (['[{"t": 0},', '{"t": 1}]'], "is a JSON document: write one object"),
    "lists": (["[0.0, 1, 2]", "[0.1, 1, 2]"], "is a JSON document: write one object"),
}


@pytest.mark.parametrize("make", list(FAULTS))
def test_other_json_is_one_error_with_the_way_out(tmp_path, make):
    lines, message = FAULTS[make]
    with pytest.raises(RunError, match=message) as fault:
        guess_mapping([written(tmp_path, lines)])
    assert "\n" not in str(fault.value) and len(str(fault.value)) < 400


@pytest.mark.parametrize("head", ["[s],[mm],[mm],[mm]", "{t},{x},{y},{z}", "[t],x,y,z"])
def test_brackets_of_a_table_are_no_json(tmp_path, head):
    rows = [f"{T[k]},{TIP[k, 0]},{TIP[k, 1]},{TIP[k, 2]}" for k in range(K)]
    assert len(open_log(written(tmp_path, [head, *rows])).names) == 4
