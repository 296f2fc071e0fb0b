"""Encoders and commands that roll over after a turn are reported by import and check, and `unwrap`
counts them on.
"""

from pathlib import Path

import logs
import numpy as np
import pytest

from softmap_edge import Run
from softmap_edge.checks.summary import summary
from softmap_edge.errors import RunError
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.run.rollover import roll_over, roll_overs_of

T = np.arange(600) / 50


def motion(home, size, turn, whole=True):
    """Two channels that move slowly around a home near the end of a turn."""
    u = home + size * np.stack([np.sin(T), np.sin(1.7 * T)], axis=1)
    return np.mod(np.rint(u) if whole else u, turn), np.rint(u) if whole else u


KINDS = {
    "12-bit ticks near 0": (150, 700, 4096, "ticks"),
    "12-bit ticks near the end": (4000, 700, 4096, "ticks"),
    "10-bit ticks": (20, 300, 1024, "ticks"),
    "14-bit ticks": (16300, 3000, 16384, "ticks"),
    "degrees": (10.0, 80.0, 360.0, "deg"),
    "radians": (0.2, 1.5, 2 * np.pi, "rad"),
}


def log(folder, rows, extra=""):
    lines = [f"{t:.3f},{','.join(f'{x:.9g}' for x in row)},{extra}" for t, row in zip(T, rows)]
    (folder / "log.csv").write_text("t,u_1,u_2,note\n" + "\n".join(lines) + "\n")
    return folder / "log.csv"


def imported(path, unit, key="", name="command"):
    text = (
        f'schema = "softmap.mapping/1"\ncommand_unit = "{unit}"\n[[log]]\ntime = {{ column = "t" '
        f'}}\n{name} = {{ columns = ["u_1", "u_2"], unit = "{unit}"{key} }}'
    )
    return import_logs([path], parse_mapping(text, Path("map.toml")))


@pytest.mark.parametrize("kind", KINDS)
def test_a_roll_over_is_reported_with_the_key_that_counts_on(tmp_path, kind):
    home, size, turn, unit = KINDS[kind]
    wrapped, true = motion(home, size, turn, unit == "ticks")
    path = log(tmp_path, wrapped)
    done = imported(path, unit)
    line = next(doubt for doubt in done.doubts if "rolls over" in doubt)
    assert f"command.unwrap = {turn:.7g}" in line and "'u_1'" in line and "'u_2'" in line
    warning = [text for text in summary(done.run).warnings if "rolls over" in text]
    assert len(warning) == 1 and f"command.unwrap = {turn:.7g}" in warning[0]
    mended = imported(path, unit, f", unwrap = {turn!r}")
    found = mended.run.command
    assert (
        np.ptp(found - true, axis=0) == pytest.approx(0, abs=1e-5)
        and (found[0] == wrapped[0]).all()
    )
    assert not any("rolls over" in doubt for doubt in mended.doubts)
    assert any("counts on over" in note for note in mended.notes)
    assert not any("rolls over" in text for text in summary(mended.run).warnings)


@pytest.mark.parametrize("name", ["ticks", "present_ticks"])
def test_ticks_and_encoders_are_counted_on_as_well(tmp_path, name):
    wrapped, true = motion(100, 500, 4096)
    lines = [f"{t:.3f},{a:.0f},{b:.0f},0" for t, (a, b) in zip(T, wrapped)]
    (tmp_path / "log.csv").write_text("t,u_1,u_2,g\n" + "\n".join(lines) + "\n")
    other = "" if name == "ticks" else 'ticks = { columns = ["g", "g"] }\n'
    text = (
        f'schema = "softmap.mapping/1"\n[[log]]\ntime = {{ column = "t" }}\n{other}'
        f'{name} = {{ columns = ["u_1", "u_2"], held = "keep", unwrap = [4096, 4096.0] }}'
    )
    done = import_logs([tmp_path / "log.csv"], parse_mapping(text, Path("map.toml")))
    assert np.ptp(getattr(done.run, name) - true, axis=0) == pytest.approx(0)
    bare = import_logs(
        [tmp_path / "log.csv"],
        parse_mapping(text.replace(", unwrap = [4096, 4096.0]", ""), Path("m")),
    )
    assert any(f"{name}.unwrap = 4096" in doubt for doubt in bare.doubts)


def test_rows_without_a_value_do_not_hide_a_roll_over(tmp_path):
    wrapped, true = motion(5, 300, 4096)
    rows = wrapped.copy()
    rows[::7, 0] = np.nan
    lines = [f"{t:.3f},{'' if np.isnan(a) else f'{a:.0f}'},{b:.0f}" for t, (a, b) in zip(T, rows)]
    (tmp_path / "log.csv").write_text("t,u_1,u_2\n" + "\n".join(lines) + "\n")
    done = imported(tmp_path / "log.csv", "ticks", ", unwrap = 4096")
    kept = np.isfinite(rows[:, 0])
    assert np.ptp(done.run.command - true[kept], axis=0) == pytest.approx(0)


def test_commands_in_mm_are_checked_by_the_turn_of_their_spool(tmp_path):
    wrapped, _ = motion(10.0, 80.0, 360.0, False)
    path = log(tmp_path, wrapped)
    text = (
        'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "t" }\n'
        'command = { columns = ["u_1", "u_2"], unit = "deg", spool_radius_mm = 8 }'
    )
    run = import_logs([path], parse_mapping(text, Path("map.toml"))).run
    assert len(roll_overs_of(run)) == 1


OTHERS = {
    "steps between the ends": np.where(np.sin(T) > 0, 4095.0, 0.0),
    "steps between the ends of 360 degrees": np.where(np.sin(T) > 0, 360.0, 0.0),
    "random poses": np.random.default_rng(0).integers(0, 4096, len(T)).astype(float),
    "poses that rest": np.repeat(np.random.default_rng(1).uniform(0, 360, len(T) // 20), 20),
    "a slow full turn": np.linspace(0, 4095, len(T)),
    "steps of half a turn": np.where(np.sin(T) > 0, 3000.0, 900.0) + np.rint(10 * np.sin(9 * T)),
    "a small motion": 20 + 10 * np.sin(T),
    "nothing": np.zeros(len(T)),
    "a coarse sawtooth": np.mod(40 * np.arange(len(T)), 300) / 300 * 3000,
}


@pytest.mark.parametrize("kind", OTHERS)
def test_other_motion_is_not_a_roll_over(kind):
    assert roll_over(OTHERS[kind]) is None
    run = Run(t=T, t_seen=T[:0], command=OTHERS[kind][:, None], command_unit="ticks")
    assert roll_overs_of(run) == []


@pytest.mark.parametrize(
    ("key", "words"),
    [
        (", unwrap = 0", "unwrap = 0, expected the size of a turn"),
        (", unwrap = -360", "unwrap = -360, expected"),
        (", unwrap = [4096]", "unwrap"),
        (", unwrap = 360", "spans 40[0-9]*, more than command.unwrap = 360"),
    ],
)
def test_a_turn_that_cannot_be_is_refused(tmp_path, key, words):
    path = log(tmp_path, motion(10, 900, 4096)[0])
    with pytest.raises(RunError, match=words):
        imported(path, "ticks", key)


def test_places_do_not_roll_over(tmp_path):
    text = (
        'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "t" }\n'
        'markers = { columns = [["u_1", "u_2", "t"]], unwrap = 360 }'
    )
    with pytest.raises(RunError, match="unwrap"):
        import_logs([log(tmp_path, motion(10, 90, 360)[0])], parse_mapping(text, Path("map.toml")))


WRAPPED = """schema = "softmap.mapping/1"
command_unit = "ticks"
[[log]]
time = { column = "t" }
command = { columns = ["a", "b"], unit = "ticks", unwrap = 4096 }
"""


def with_gap(first, last, speed, empty):
    """A log of two encoders that roll over; the first has no values in some rows, which are empty
    or left out.
    """
    lines = ["t,a,b"]
    for k in range(200):
        place = str(int(2000 + speed * 0.02 * k) % 4096)
        if first <= k < last and not empty:
            continue
        lines.append(f"{0.02 * k:.2f},{'' if first <= k < last else place},{2000 + k % 3}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("empty", [True, False])
@pytest.mark.parametrize(
    ("last", "speed", "doubted"), [(140, 1800, True), (70, 1800, False), (140, 300, False)]
)
def test_turns_over_a_gap_are_doubted_where_the_speed_allows_several(
    tmp_path, empty, last, speed, doubted
):
    done = logs.imported(tmp_path, with_gap(60, last, speed, empty), WRAPPED)
    named = [doubt for doubt in done.doubts if "more than half a turn" in doubt]
    assert bool(named) == doubted and all(
        "'a' has 1 gaps" in doubt and "after 1.18 s" in doubt for doubt in named
    )
    if not doubted:
        assert np.abs(done.run.command[:, 0] - (2000 + speed * done.run.t)).max() <= 1.0


def test_whole_numbers_never_roll_over_at_two_pi():
    assert roll_over(np.arange(70.0) % 7) is None
    assert roll_over(np.arange(0.0, 30.0, 0.1) % (2 * np.pi)) is not None
