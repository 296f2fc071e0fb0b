"""Logs become a run as the mapping says: columns, units, clocks, axes, blocks, several logs joined
by time.
"""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from logs import ONE_LOG, fault, imported, made_log

from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.files import toml as toml_table
from softmap_edge.logs import mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.run.run import Run

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/reference/mapping.md").read_text(encoding="utf-8")
PAGE_MAP = re.search(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]


# --- what docs/reference/mapping.md says ----------------------------------------------------------
def test_the_example_of_the_page_brings_markers_into_the_base_frame(tmp_path):
    names = ["stamp", "servo_a", "servo_b"] + [
        f"m{k}_{axis}" for k in range(1, 6) for axis in "xyz"
    ]
    # x, y, z of five markers
    base = np.array([[0.0, 0.0, 24.0 * k] for k in range(1, 6)]) + [3.0, 5.0, 0.0]
    seen = np.stack([base[:, 0] + 310, base[:, 2] + 45, 820 - base[:, 1]], axis=1)
    rows = [[1000 + k / 30, 90.0 * k, 0.0, *seen.ravel()] for k in range(4)]
    lines = [
        "# finger lab, servo in degrees",
        ",".join(names),
        *(",".join(map(str, row)) for row in rows),
    ]
    run = imported(tmp_path, "\n".join(lines), PAGE_MAP).run
    np.testing.assert_allclose(run.markers, np.broadcast_to(base, (4, 5, 3)), atol=1e-9)
    np.testing.assert_allclose(run.command[:, 0], np.arange(4) * 4 * np.pi)  # 90° of 8 mm
    assert run.t[0] == 0.0 and run.t_seen[-1] == pytest.approx(0.1)
    assert np.array_equal(
        imported(tmp_path, "\n".join(lines), PAGE_MAP.replace("skip_rows = 1", "")).run.t, run.t
    )


def test_every_key_and_unit_is_on_the_page(tmp_path, monkeypatch):
    asked = set()
    get = toml_table.TomlTable.get
    monkeypatch.setattr(
        toml_table.TomlTable,
        "get",
        lambda self, key, *rest: asked.add(key) or get(self, key, *rest),
    )
    (tmp_path / "map.toml").write_text(PAGE_MAP, encoding="utf-8")
    read_mapping(tmp_path / "map.toml")
    asked |= (
        set(mapping.UNITS)
        | {unit for units in mapping.UNITS.values() for unit in units}
        | set(mapping.TIME)
    )
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
    run = imported(tmp_path, text, mapping).run
    assert run.command == pytest.approx(table[:, 1:3] * factor)
    radius = {"spool_radius_mm": float(extra.split("= ")[1])} if "spool" in extra else {}
    assert {
        name: float(run.extra[name]) for name in ("spool_radius_mm",) if name in run.extra
    } == radius


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
        ("rate_hz = 50", lambda t: np.arange(len(t)) / 50),
    ],
)
def test_clocks(tmp_path, clock, expected):
    text, table = made_log()
    run = imported(tmp_path, text, ONE_LOG.replace('column = "t"', clock)).run
    assert run.t == pytest.approx(expected(table[:, 0]))


def test_a_counter_of_whole_numbers_becomes_seconds(tmp_path):
    text, table = made_log()
    log = text.replace("t,", "t,n,", 1).splitlines()
    rows = [line.replace(",", f",{7 + 2 * k},", 1) for k, line in enumerate(log[1:])]
    mapping = ONE_LOG.replace('column = "t"', 'column = "n", rate_hz = 4')
    run = imported(tmp_path, "\n".join([log[0], *rows, ""]), mapping).run
    assert run.t == pytest.approx((7 + 2 * np.arange(len(table))) / 4)


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


def test_empty_cells_of_markers_are_not_visible_and_labels_become_blocks(tmp_path):
    text, table = made_log()
    lines = text.splitlines()
    lines[3] = ",".join(lines[3].split(",")[:6] + ["", "NaN", ""])
    lines = [
        line + ("," + "part" if k == 0 else f",{'up' if k < 9 else 'down'}")
        for k, line in enumerate(lines)
    ]
    run = imported(
        tmp_path, "\n".join(lines), ONE_LOG.replace("[[log]]", '[[log]]\nblock = "part"')
    ).run
    assert not run.visible[2, 1] and run.visible.sum() == 2 * 20 - 1
    assert list(run.block[[0, 7, 8, 19]]) == ["up", "up", "down", "down"]
    assert run.markers[3] == pytest.approx(table[3, 3:].reshape(2, 3) * 1000)


def test_logs_are_joined_by_time(tmp_path):
    t, s = np.arange(0, 4.001, 0.1), np.arange(-0.5, 5, 0.25)
    slow = np.arange(0, 4.6, 0.5)
    (tmp_path / "u.csv").write_text("t,u\n" + "\n".join(f"{x:.3f},{3 * x:.6f}" for x in t))
    (tmp_path / "cam.csv").write_text(
        "ms,x,y,z\n" + "\n".join(f"{1000 * x:.1f},{x:.6f},{x * x / 10:.6f},1" for x in s)
    )
    (tmp_path / "enc.csv").write_text(
        "t,e,T\n" + "\n".join(f"{x:.3f},{2 * x:.6f},{20 + x:.6f}" for x in slow)
    )
    (tmp_path / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n[[log]]\nfile = "u*.csv"\ntime = { column = "t" }\ncommand '
        '= { columns = ["u"] }\n[[log]]\nfile = "cam*"\ntime = { column = "ms", unit = "ms" }\n'
        'markers = { columns = ["x", "y", "z"], unit = "m" }\n[[log]]\nfile = "enc*"\ntime = { '
        'column = "t" }\npresent = { columns = ["e"] }\ntemperature = { columns = ["T"] '
        "}\n[seen]\nrate_hz = 2\n[commands]\nrate_hz = 20\n[blocks]\nseconds = 2\n"
    )
    done = import_logs(
        [tmp_path / n for n in ("enc.csv", "cam.csv", "u.csv")], read_mapping(tmp_path / "map.toml")
    )
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
    assert np.array_equal(
        imported(tmp_path, text, declared, "log_100g.csv").run.load, np.full(20, 100.0)
    )
    assert np.array_equal(imported(tmp_path, text, declared).run.load, np.zeros(20))
    hidden = imported(tmp_path, text, ONE_LOG + table.format("false"), "log_100g.csv")
    assert hidden.run.load is None and any("not declared" in note for note in hidden.notes)


def test_files_that_fit_no_log_are_named(tmp_path):
    text, _ = made_log()
    (tmp_path / "map.toml").write_text(ONE_LOG.replace("[[log]]", '[[log]]\nfile = "run*.csv"'))
    for name in ("run1.csv", "other.csv", "run2.csv"):
        (tmp_path / name).write_text(text)
    mapping = read_mapping(tmp_path / "map.toml")
    with pytest.raises(RunError, match="other.csv fits no log"):
        import_logs([tmp_path / "run1.csv", tmp_path / "other.csv"], mapping)
    with pytest.raises(RunError, match="run1.csv and run2.csv overlap in time"):
        import_logs([tmp_path / "run1.csv", tmp_path / "run2.csv"], mapping)
    with pytest.raises(RunError, match="cannot be read"):
        import_logs([tmp_path / "absent.csv"], mapping)


def test_the_command_writes_a_run_and_says_what_it_did(tmp_path, capsys):
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


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("schema", "scheme", ["no key 'scheme'", "did you mean 'schema'?"]),
        ("mapping/1", "mapping/2", ["softmap.mapping/2", "expected 'softmap.mapping/1'"]),
        ("robot =", "rowbot =", ["no key 'rowbot'", "robot"]),
        ("[[log]]", "[log]", ["log is a table", "expected a list"]),
        ('{ column = "t" }', "{ }", ["needs `column`, `rate_hz`"]),
        ('{ column = "t" }', "{ rate_hz = 0 }", ["rate_hz = 0", "expected"]),
        ('{ column = "t" }', "{ rate_hz = nan }", ["rate_hz = nan", "expected"]),
        (
            '{ column = "t" }',
            '{ column = "t", unit = "hours" }',
            ["'hours'", "expected one of s, ms"],
        ),
        ('["a", "b"]', "[]", ["command: columns", "expected a list"]),
        ('["a", "b"]', '["a", "b"], unit = "deg"', ["spool_radius_mm", 'command_unit = "deg"']),
        ('["a", "b"]', '["a", "b"], scale = [1, 2, 3]', ["scale has shape (3,)", "(2,)"]),
        ('["x", "y", "z"]', '["x", "y"]', ["expected x, y, z of each marker"]),
        ('unit = "m"', 'unit = "inch"', ["'inch'", "expected one of mm, cm, m"]),
        ('robot = "bench"', "robot = 7", ["robot is a whole number '7'", "expected text"]),
        ('robot = "bench"', "robot = ", ["is not a TOML file"]),
    ],
)
def test_faults_of_a_mapping(tmp_path, old, new, words):
    text, _ = made_log()
    assert old in ONE_LOG
    message = fault(tmp_path, text, ONE_LOG.replace(old, new, 1))
    for word in words:
        assert word in message
