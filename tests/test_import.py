"""Logs become a run as the mapping says; faults of real CSVs are told in one line; the trunk logs as published."""

import hashlib
import http.server
import importlib.util
import json
import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from softmap_edge import mapping
from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.importer import import_logs, read_mapping, unhold
from softmap_edge.run import Run

ROOT = Path(__file__).resolve().parent.parent
TRUNK_MAP = ROOT / "examples" / "trunk.toml"
ONE_LOG = """schema = "softmap.mapping/1"
robot = "bench"
[[log]]
time = { column = "t" }
command = { columns = ["a", "b"] }
markers = { columns = [["x", "y", "z"], ["p", "q", "r"]], unit = "m" }
"""


def trunk_folder():
    for folder in (ROOT.parent / "shared" / "data" / "trunk", ROOT / "data" / "trunk"):
        if (folder / "control_inputs_controlled_1.csv").is_file():
            return folder
    pytest.skip("not run: the trunk logs are not here; `make data` brings them")


def made_log(rows=20, delimiter=",", seed=0):
    """A log of two channels and two markers in metres, as text and as numbers."""
    rng = np.random.default_rng(seed)
    table = np.column_stack([np.arange(rows) * 0.1, rng.uniform(-9, 9, (rows, 2)), rng.uniform(-0.1, 0.1, (rows, 6))])
    lines = [delimiter.join("tabxyzpqr")] + [delimiter.join(repr(float(x)) for x in row) for row in table]
    return "\n".join(lines) + "\n", table


def imported(folder, log_text, mapping=ONE_LOG, name="log.csv"):
    (folder / name).write_text(log_text, encoding="utf-8")
    (folder / "map.toml").write_text(mapping, encoding="utf-8")
    return import_logs([folder / name], read_mapping(folder / "map.toml"))


def fault(folder, log_text, mapping=ONE_LOG):
    with pytest.raises(RunError) as found:
        imported(folder, log_text, mapping)
    assert "\n" not in str(found.value)
    return str(found.value)


PAGE = (ROOT / "docs" / "mapping.md").read_text(encoding="utf-8")
PAGE_MAP = re.search(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]


# --- what docs/mapping.md says -------------------------------------------------------------
def test_the_example_of_the_page_brings_markers_into_the_base_frame(tmp_path):
    names = ["stamp", "servo_a", "servo_b"] + [f"m{k}_{axis}" for k in range(1, 6) for axis in "xyz"]
    base = np.array([[0.0, 0.0, 24.0 * k] for k in range(1, 6)]) + [3.0, 5.0, 0.0]  # x, y, z of five markers
    seen = np.stack([base[:, 0] + 310, base[:, 2] + 45, 820 - base[:, 1]], axis=1)
    rows = [[1000 + k / 30, 90.0 * k, 0.0, *seen.ravel()] for k in range(4)]
    lines = ["# finger lab, servo in degrees", ",".join(names), *(",".join(map(str, row)) for row in rows)]
    run = imported(tmp_path, "\n".join(lines), PAGE_MAP).run
    np.testing.assert_allclose(run.markers, np.broadcast_to(base, (4, 5, 3)), atol=1e-9)
    np.testing.assert_allclose(run.command[:, 0], np.arange(4) * 4 * np.pi)  # 90° of 8 mm
    assert run.t[0] == 0.0 and run.t_seen[-1] == pytest.approx(0.1)
    assert "set skip_rows" in fault(tmp_path, "\n".join(lines), PAGE_MAP.replace("skip_rows = 1", ""))


def test_every_key_and_unit_is_on_the_page(tmp_path, monkeypatch):
    asked = set()
    get = mapping._Table.get
    monkeypatch.setattr(mapping._Table, "get", lambda self, key, *rest: asked.add(key) or get(self, key, *rest))
    (tmp_path / "map.toml").write_text(PAGE_MAP, encoding="utf-8")
    read_mapping(tmp_path / "map.toml")
    asked |= set(mapping._UNITS) | {unit for units in mapping._UNITS.values() for unit in units} | set(mapping.TIME)
    assert {"skip_last_rows", "marker_rest_mm", "load_g", "spool_radius_mm"} <= asked
    assert [key for key in sorted(asked) if not re.search(rf"[`\[]{key}\b|, {key}[, ]", PAGE)] == []


# --- what a mapping can say ----------------------------------------------------------------
def test_columns_and_units(tmp_path):
    text, table = made_log()
    run = imported(tmp_path, text).run
    assert np.array_equal(run.t, table[:, 0]) and np.array_equal(run.t_seen, table[:, 0])
    assert np.array_equal(run.command, table[:, 1:3])
    assert run.markers == pytest.approx(table[:, 3:].reshape(-1, 2, 3) * 1000)
    assert run.robot == "bench" and run.command_unit == "mm"
    assert hashlib.sha256(text.encode()).hexdigest() in str(run.extra["made_from"])


@pytest.mark.parametrize(
    ("unit", "command_unit", "extra", "factor"),
    [
        ("cm", "mm", "", 10.0),
        ("m", "mm", ", scale = 0.01", 10.0),
        ("deg", "mm", ", spool_radius_mm = 6", np.pi / 180 * 6),
        ("rad", "mm", ", spool_radius_mm = 0.5", 0.5),
        ("rad", "deg", "", 180 / np.pi),
        ("deg", "rad", "", np.pi / 180),
        ("mm", "mm", ", scale = -2", -2.0),
    ],
)
def test_units_of_commands(tmp_path, unit, command_unit, extra, factor):
    text, table = made_log()
    change = f'columns = ["a", "b"], unit = "{unit}"{extra}'
    mapping = ONE_LOG.replace('columns = ["a", "b"]', change).replace(
        'robot = "bench"', f'robot = "bench"\ncommand_unit = "{command_unit}"'
    )
    assert imported(tmp_path, text, mapping).run.command == pytest.approx(table[:, 1:3] * factor)


def test_signs_offsets_and_ticks(tmp_path):
    text, table = made_log()
    mapping = ONE_LOG.replace('["a", "b"]', '["a", "b"], scale = [1, -1], offset = [0.5, 0]')
    expected = table[:, 1:3] * [1, -1] + [0.5, 0]
    assert imported(tmp_path, text, mapping).run.command == pytest.approx(expected)
    run = imported(tmp_path, text, ONE_LOG.replace("command =", "ticks =")).run
    assert np.array_equal(run.ticks, np.rint(table[:, 1:3])) and run.command is None


@pytest.mark.parametrize(
    ("clock", "expected"),
    [
        ('column = "t", unit = "ms"', lambda t: t / 1000),
        ('column = "t", offset_s = 2', lambda t: t + 2),
        ('column = "t", rate_hz = 4', lambda t: t / 4),
        ("rate_hz = 50", lambda t: np.arange(len(t)) / 50),
    ],
)
def test_clocks(tmp_path, clock, expected):
    text, table = made_log()
    run = imported(tmp_path, text, ONE_LOG.replace('column = "t"', clock)).run
    assert run.t == pytest.approx(expected(table[:, 0]))


def test_axes_and_origin_turn_the_log_into_the_base_frame(tmp_path):
    text, table = made_log()
    mapping = (
        ONE_LOG + '[frame]\naxes = ["x", "z", "-y"]\norigin_mm = [10, 20, 30]\n[constant]\n'
        "marker_rest_mm = [[10, 20, 30], [11, -80, 30]]\n"
    )
    run = imported(tmp_path, text, mapping).run
    log = table[:, 3:].reshape(-1, 2, 3) * 1000
    expected = np.stack([log[..., 0] - 10, log[..., 2] - 30, 20 - log[..., 1]], axis=-1)
    assert run.markers == pytest.approx(expected)
    assert run.marker_rest == pytest.approx(np.array([[0, 0, 0], [1, 0, 100]]))
    assert "mirror" in fault(tmp_path, text, ONE_LOG + '[frame]\naxes = ["x", "y", "-z"]\n')


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters_and_line_ends_are_found(tmp_path, delimiter, newline):
    text, table = made_log(delimiter=delimiter)
    (tmp_path / "log.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", newline).encode())
    (tmp_path / "map.toml").write_text(ONE_LOG)
    run = import_logs([tmp_path / "log.csv"], read_mapping(tmp_path / "map.toml")).run
    assert np.array_equal(run.command, table[:, 1:3])


def test_decimal_commas_and_columns_by_number(tmp_path):
    text, table = made_log(delimiter=";")
    mapping = ONE_LOG.replace("[[log]]", '[[log]]\ndecimal = ","\ndelimiter = ";"')
    assert np.array_equal(imported(tmp_path, text.replace(".", ","), mapping).run.command, table[:, 1:3])
    numbered = ONE_LOG.replace("[[log]]", "[[log]]\nheader = false").replace('"t"', "0").replace('["a", "b"]', "[1, 2]")
    numbered = numbered.replace('[["x", "y", "z"], ["p", "q", "r"]]', "[3, 4, 5, 6, 7, 8]")
    bare = text.replace(";", ",").split("\n", 1)[1]
    assert np.array_equal(imported(tmp_path, bare, numbered).run.command, table[:, 1:3])


def test_empty_cells_of_markers_are_not_visible_and_labels_become_blocks(tmp_path):
    text, table = made_log()
    lines = text.splitlines()
    lines[3] = ",".join(lines[3].split(",")[:6] + ["", "NaN", ""])
    lines = [line + ("," + "part" if k == 0 else f",{'up' if k < 9 else 'down'}") for k, line in enumerate(lines)]
    run = imported(tmp_path, "\n".join(lines), ONE_LOG.replace("[[log]]", '[[log]]\nblock = "part"')).run
    assert not run.visible[2, 1] and run.visible.sum() == 2 * 20 - 1
    assert list(run.block[[0, 7, 8, 19]]) == ["up", "up", "down", "down"]
    assert run.markers[3] == pytest.approx(table[3, 3:].reshape(2, 3) * 1000)


def test_logs_are_joined_by_time(tmp_path):
    t, s = np.arange(0, 4.001, 0.1), np.arange(-0.5, 5, 0.25)
    slow = np.arange(0, 4.6, 0.5)
    (tmp_path / "u.csv").write_text("t,u\n" + "\n".join(f"{x:.3f},{3 * x:.6f}" for x in t))
    (tmp_path / "cam.csv").write_text("ms,x,y,z\n" + "\n".join(f"{1000 * x:.1f},{x:.6f},{x * x / 10:.6f},1" for x in s))
    (tmp_path / "enc.csv").write_text("t,e,T\n" + "\n".join(f"{x:.3f},{2 * x:.6f},{20 + x:.6f}" for x in slow))
    (tmp_path / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n'
        '[[log]]\nfile = "u*.csv"\ntime = { column = "t" }\ncommand = { columns = ["u"] }\n'
        '[[log]]\nfile = "cam*"\ntime = { column = "ms", unit = "ms" }\n'
        'markers = { columns = ["x", "y", "z"], unit = "m" }\n'
        '[[log]]\nfile = "enc*"\ntime = { column = "t" }\npresent = { columns = ["e"] }\n'
        'temperature = { columns = ["T"] }\n[seen]\nrate_hz = 2\n[commands]\nrate_hz = 20\n[blocks]\nseconds = 2\n'
    )
    done = import_logs([tmp_path / n for n in ("enc.csv", "cam.csv", "u.csv")], read_mapping(tmp_path / "map.toml"))
    run = done.run
    assert run.t == pytest.approx(np.arange(81) / 20)
    assert run.command[:, 0] == pytest.approx(3 * run.t)
    assert run.present[:, 0] == pytest.approx(2 * run.t)
    assert run.temperature == pytest.approx(20 + run.t)
    assert run.t_seen == pytest.approx(np.arange(0, 4.01, 0.5))
    assert run.markers[:, 0, 1] == pytest.approx(100 * run.t_seen**2)
    assert list(run.block) == [0, 0, 0, 0, 1, 1, 1, 1, 2]
    assert any("frames lie outside" in note for note in done.notes)


def test_load_is_declared_only_where_the_mapping_says_so(tmp_path):
    text, _ = made_log()
    table = '[constant]\nload_g = {{ "*_100g.csv" = 100, "*" = 0 }}\ndeclare_load = {}\n'
    declared = ONE_LOG + table.format("true")
    assert np.array_equal(imported(tmp_path, text, declared, "log_100g.csv").run.load, np.full(20, 100.0))
    assert np.array_equal(imported(tmp_path, text, declared).run.load, np.zeros(20))
    hidden = imported(tmp_path, text, ONE_LOG + table.format("false"), "log_100g.csv")
    assert hidden.run.load is None and any("not declared" in note for note in hidden.notes)


def test_a_million_rows(tmp_path):
    rows = 1_000_000
    t = np.char.mod("%.3f", np.arange(rows) / 1000)
    (tmp_path / "log.csv").write_text("t,u\n" + "\n".join(np.char.add(np.char.add(t, ","), t)))
    (tmp_path / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "t" }\ncommand = { columns = ["u"] }\n'
    )
    run = import_logs([tmp_path / "log.csv"], read_mapping(tmp_path / "map.toml")).run
    assert run.command.shape == (rows, 1) and run.command[-1, 0] == 999.999


# --- held samples --------------------------------------------------------------------------
def test_unholding_removes_the_lag_of_a_slow_encoder():
    t = np.arange(2000) / 100
    truth = np.column_stack([30 * np.sin(t), 20 * np.cos(0.7 * t)])
    held = truth[(np.arange(2000) // 5) * 5]
    smooth, hold = unhold(t, held)
    assert hold == pytest.approx(0.05)
    inside = slice(0, 1995)  # the last hold has no next value
    chord = 30 * 0.05**2 / 8  # the farthest a line over one hold leaves a curve of this acceleration
    assert np.abs(smooth - truth)[inside].max() <= chord + 1e-12
    assert np.abs(held - truth)[inside].max() > 50 * chord  # doing nothing fails


def test_stillness_stays_and_slow_poses_are_left_alone():
    t = np.arange(1000) / 100
    ramp = np.minimum(np.maximum(t - 2, 0), 3.0) + np.maximum(t - 8, 0)  # still, moves, still for 3 s, moves
    smooth, hold = unhold(t, ramp[(np.arange(1000) // 5) * 5][:, None])
    assert hold == pytest.approx(0.05)
    assert np.abs(smooth[:, 0] - ramp)[:990].max() <= 0.05 + 1e-9
    for rows in (np.repeat(np.arange(20.0), 50)[:, None], np.arange(1000.0)[:, None], np.zeros((1000, 1))):
        same, hold = unhold(t, rows)
        assert hold == 0.0 and np.array_equal(same, rows)


# --- faults --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.replace("t,a,b", "t,a,c"), ["log.csv: no column b", "there are t, a, c"]),
        (lambda s: s.split("\n", 1)[1], ["has no header line", "header = false"]),
        (lambda s: s[:-30], ["line 21 has", "expected 9", "skip_last_rows"]),
        (lambda s: s.split("\n")[0], ["holds no rows"]),
        (lambda s: "", ["holds no lines"]),
        (lambda s: s.replace("\n0.1,", "\noops,", 1), ["line 3, column t: 'oops' is not a number"]),
        (lambda s: s.replace("\n0.1,", "\n,", 1), ["line 3: the time is empty"]),
        (lambda s: s.replace("\n0.5,", "\n0.1,", 1), ["time goes backwards at row 5"]),
        (lambda s: s.replace("\n0.5,", "\n0.4,", 1), ["time stands still at row 5"]),
        (lambda s: s.replace("0.", "\0"), ["zero bytes"]),
    ],
)
def test_faults_of_a_log(tmp_path, change, words):
    text, _ = made_log()
    message = fault(tmp_path, change(text))
    for word in words:
        assert word in message


def test_repeated_times_can_be_dropped(tmp_path):
    text, table = made_log()
    doubled = text.replace("\n0.5,", "\n0.4,", 1)
    run = imported(tmp_path, doubled, ONE_LOG.replace('column = "t"', 'column = "t", repeated = "drop"')).run
    assert len(run.t) == 19 and np.array_equal(run.command[5], table[6, 1:3])


def test_rows_can_be_skipped_at_both_ends(tmp_path):
    text, table = made_log()
    mapping = ONE_LOG.replace("[[log]]", "[[log]]\nskip_rows = 2\nskip_last_rows = 1")
    run = imported(tmp_path, "recorded on a bench\n# units: s mm m\n" + text + "0.7,1", mapping).run
    assert np.array_equal(run.command, table[:, 1:3])


def test_the_wrong_delimiter_is_recognised(tmp_path):
    text, _ = made_log(delimiter=";")
    message = fault(tmp_path, text, ONE_LOG.replace("[[log]]", '[[log]]\ndelimiter = ","'))
    assert "cut by ';'" in message
    message = fault(tmp_path, text.replace(".", ","))
    assert 'decimal = ","' in message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("schema", "scheme", ["schema ''", "softmap.mapping/1"]),
        ("mapping/1", "mapping/2", ["softmap.mapping/2", "expected 'softmap.mapping/1'"]),
        ("robot =", "rowbot =", ["no key 'rowbot'", "robot"]),
        ("[[log]]", "[log]", ["log is dict", "expected list"]),
        ('{ column = "t" }', "{ }", ["needs `column`, `rate_hz`"]),
        ('{ column = "t" }', "{ rate_hz = 0 }", ["rate_hz = 0", "expected"]),
        ('{ column = "t" }', "{ rate_hz = nan }", ["rate_hz = nan", "expected"]),
        ('{ column = "t" }', '{ column = "t", unit = "hours" }', ["'hours'", "expected one of s, ms"]),
        ('["a", "b"]', "[]", ["command: columns", "expected a list"]),
        ('["a", "b"]', '["a", "b"], unit = "deg"', ["spool_radius_mm", 'command_unit = "deg"']),
        ('["a", "b"]', '["a", "b"], scale = [1, 2, 3]', ["scale has shape (3,)", "(2,)"]),
        ('["x", "y", "z"]', '["x", "y"]', ["expected x, y, z of each marker"]),
        ('unit = "m"', 'unit = "inch"', ["'inch'", "expected one of mm, cm, m"]),
        ('robot = "bench"', "robot = 7", ["robot is int", "expected text"]),
        ('robot = "bench"', "robot = ", ["is not a TOML file"]),
    ],
)
def test_faults_of_a_mapping(tmp_path, old, new, words):
    text, _ = made_log()
    assert old in ONE_LOG
    message = fault(tmp_path, text, ONE_LOG.replace(old, new, 1))
    for word in words:
        assert word in message


def test_files_that_fit_no_log_are_named(tmp_path):
    text, _ = made_log()
    (tmp_path / "map.toml").write_text(ONE_LOG.replace("[[log]]", '[[log]]\nfile = "run*.csv"'))
    for name in ("run1.csv", "other.csv", "run2.csv"):
        (tmp_path / name).write_text(text)
    mapping = read_mapping(tmp_path / "map.toml")
    with pytest.raises(RunError, match="other.csv fits no log"):
        import_logs([tmp_path / "run1.csv", tmp_path / "other.csv"], mapping)
    with pytest.raises(RunError, match="2 of the given files fit"):
        import_logs([tmp_path / "run1.csv", tmp_path / "run2.csv"], mapping)
    with pytest.raises(RunError, match="cannot be read"):
        import_logs([tmp_path / "absent.csv"], mapping)


def test_the_verb_writes_a_run_and_says_what_it_did(tmp_path, capsys):
    text, table = made_log()
    (tmp_path / "log.csv").write_text(text)
    (tmp_path / "map.toml").write_text(ONE_LOG + "[seen]\nrate_hz = 5\n")
    argv = ["import", str(tmp_path / "log.csv"), "--map", str(tmp_path / "map.toml"), "--out"]
    assert main([*argv, str(tmp_path / "run.npz"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.import/1" and document["frames"] == 10
    assert Run.load(tmp_path / "run.npz").hash() == document["hash"]
    assert main([*argv, str(tmp_path / "run.txt")]) == 2
    assert ".npz" in capsys.readouterr().err


# --- the trunk -----------------------------------------------------------------------------
def trunk(name):
    folder = trunk_folder()
    return import_logs([folder / "control_inputs_controlled_1.csv", folder / name], read_mapping(TRUNK_MAP))


def test_the_trunk_hangs_along_z_of_the_base_frame():
    run = trunk("observations_controlled_1.csv").run
    assert (run.channels, len(run.t), run.frames, run.command_unit) == (6, 15000, 3000, "deg")
    assert np.diff(run.t_seen) == pytest.approx(np.full(2999, 0.05))
    assert list(np.bincount(run.block)) == [600] * 5
    raw = np.loadtxt(trunk_folder() / "observations_controlled_1.csv", delimiter=",", skiprows=1)
    x, y, z = raw[0, 7:10] * 1000
    assert run.markers[0, 2] == pytest.approx([x - 101.2, z - 104.6, -y])
    chord = np.diff(run.markers, axis=1, prepend=np.zeros((3000, 1, 3)))  # from the base over the three bodies
    length = np.linalg.norm(chord, axis=2)
    assert (length.std(axis=0) / length.mean(axis=0)).max() < 0.05  # a chain: another origin or axis stretches it
    assert np.median(chord[:, :, 2] / length, axis=0).min() > 0.8  # and it hangs along +z
    assert np.array_equal(run.gravity, [0, 0, 1])


def test_both_trunk_runs_play_the_same_commands_and_hide_the_load():
    free, loaded = trunk("observations_controlled_1.csv"), trunk("observations_controlled_1_100g.csv")
    assert np.array_equal(free.run.command, loaded.run.command)
    assert free.run.load is None and loaded.run.load is None
    assert any("100 g" in note and "not declared" in note for note in loaded.notes)
    assert not np.array_equal(free.run.markers, loaded.run.markers)


def test_unheld_encoders_explain_the_trunk_better_than_held_ones(tmp_path):
    """Ridge on quadratic features of the encoders, five blocks held out: the lag of holding costs accuracy."""
    folder = trunk_folder()
    (tmp_path / "held.toml").write_text(TRUNK_MAP.read_text().replace('held = "auto"', 'held = "keep"'))
    logs = [folder / "control_inputs_controlled_1.csv", folder / "observations_controlled_1.csv"]
    error = {}
    for name, path in (("unheld", TRUNK_MAP), ("held", tmp_path / "held.toml")):
        run = import_logs(logs, read_mapping(path)).run
        q = run.command_at(run.t_seen, "present") / 50
        pairs = [q[:, i] * q[:, j] for i in range(6) for j in range(i, 6)]
        features = np.column_stack([np.ones(len(q)), q, *pairs])
        target = run.markers.reshape(len(q), 9)
        miss = np.empty_like(target)
        for block in range(5):
            fit = run.block != block
            normal = features[fit].T @ features[fit] + 1e-2 * np.eye(features.shape[1])
            miss[~fit] = target[~fit] - features[~fit] @ np.linalg.solve(normal, features[fit].T @ target[fit])
        error[name] = np.sqrt((miss**2).sum(axis=1).mean() / 3)
    assert error["unheld"] < 12.0  # mm; predicting the mean scores about 39
    assert error["unheld"] < error["held"] - 0.05


# --- the data that `make data` brings ------------------------------------------------------
def fetcher():
    spec = importlib.util.spec_from_file_location("fetch_data", ROOT / "examples" / "fetch_data.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["fetch_data"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def server(tmp_path):
    """A local web server over a folder; yields the folder and its address."""
    folder = tmp_path / "web"
    folder.mkdir()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(folder))

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as web:
        thread = threading.Thread(target=web.serve_forever, daemon=True)
        thread.start()
        yield folder, f"http://127.0.0.1:{web.server_address[1]}"
        web.shutdown()
        thread.join()


def published(module, folder, content=b"1,2,3\n"):
    source = module.Source(
        "toy",
        "a toy",
        "somebody/robot",
        "0" * 40,
        "MIT",
        {"log.csv": ("a b/log.csv", hashlib.sha256(content).hexdigest())},
    )
    place = folder / "somebody" / "robot" / ("0" * 40) / "a b"
    place.mkdir(parents=True)
    (place / "log.csv").write_bytes(content)
    return source


def test_data_is_downloaded_checked_and_not_twice(server, tmp_path):
    module, (web, url) = fetcher(), server
    source = published(module, web)
    assert "1 downloaded" in module.fetch(tmp_path / "data", [source], url, None)[0]
    assert (tmp_path / "data" / "toy" / "log.csv").read_bytes() == b"1,2,3\n"
    (web / "somebody" / "robot" / ("0" * 40) / "a b" / "log.csv").unlink()
    assert "1 already there" in module.fetch(tmp_path / "data", [source], url, None)[0]
    near = module.fetch(tmp_path / "other", [source], url, tmp_path / "data")
    assert "1 copied" in near[0] and "licence MIT" in near[0]
    with pytest.raises(module.FetchError, match="cannot be had"):
        module.fetch(tmp_path / "third", [source], url, None)


def test_another_file_than_the_published_one_is_refused(server, tmp_path):
    module, (web, url) = fetcher(), server
    source = published(module, web)
    (web / "somebody" / "robot" / ("0" * 40) / "a b" / "log.csv").write_bytes(b"4,5,6\n")
    with pytest.raises(module.FetchError, match="SHA-256"):
        module.fetch(tmp_path / "data", [source], url, None)
    assert not list((tmp_path / "data").rglob("*.csv*"))
    damaged = tmp_path / "near" / "toy"
    damaged.mkdir(parents=True)
    (damaged / "log.csv").write_bytes(b"7")
    with pytest.raises(module.FetchError):  # a damaged neighbour is not taken either
        module.fetch(tmp_path / "data", [source], url, tmp_path / "near")


def test_the_table_of_sources_is_whole(capsys, tmp_path):
    module = fetcher()
    assert {"trunk", "tdcr", "beam", "moe_finger", "hand"} == {source.name for source in module.SOURCES}
    for source in module.SOURCES:
        assert len(source.commit) == 40 and source.licence
        assert source.url(next(iter(source.files)), module.BASE_URL).startswith("https://raw.githubusercontent.com/")
        assert all(len(sha256) == 64 for _, sha256 in source.files.values())
    assert module.main([str(tmp_path), "nonsense"]) == 2
    assert "trunk" in capsys.readouterr().err


def test_the_nearby_data_is_the_published_one(tmp_path):
    module = fetcher()
    if not module.NEARBY.is_dir():
        pytest.skip("not run: ../shared/data is not here")
    assert module.main([str(tmp_path / "data")]) == 0
    assert (tmp_path / "data" / "trunk" / "LICENSE").is_file()
